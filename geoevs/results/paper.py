"""What the paper prints: the numbers of its tables, and what it says of its methods."""

from functools import cache
from importlib import resources
from typing import Any

import yaml


def paper_values(table: str) -> dict[str, Any]:
    """What the paper prints in a table, by its rows."""
    return _paper()["tables"][table]


def paper_method(method: str) -> dict[str, str]:
    """The paper's `name` of a method, what it `sees`, and the words that the paper has for it.

    Those are its `paradigm` and `extra_prior`, where the paper says them.

    Nothing of a method that the paper does not have.
    """
    return _paper()["methods"].get(method, {})


@cache
def _paper() -> dict[str, Any]:
    return yaml.safe_load(
        resources.files("geoevs.results").joinpath("paper_values.yaml").read_text(encoding="utf-8")
    )
