"""Who plays: what tables show of an entrant, from the run's file of them."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Self

import pandas as pd

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json
from geoevs.core.names import check_name
from geoevs.core.text import clean
from geoevs.methods.contract import CONTROL, DEFAULT
from geoevs.protocol.entries import name_of
from geoevs.results.paper import paper_method

ENTRANT = ["dataset", "method", "variant"]
"""Columns that tell who was scored on what."""


@dataclass(frozen=True)
class Info:
    """What tables show of an entrant, each a column: see MethodInfo, whose needs are one text."""

    name: str
    paradigm: str = ""
    extra_prior: str = ""
    needs: str = ""
    sees: str = ""


INFO = [field.name for field in fields(Info)]
"""Columns that tables have of it, behind their own."""


class Entrants:
    """The entrants of a run, by their names in the config.

    One that is not among them, as a method of the paper that was not run, is what the paper says of
    it, or its bare name.
    """

    def __init__(self, described: Mapping[str, Info]) -> None:
        self._described = described
        self._names = Counter(self._plain_name(*_parted(name)) for name in described)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Those that `geoevs entrants` wrote down.

        Raises:
            GeoEvsError: the file is missing or of another shape, or a name is none.
        """
        found = read_json(path)
        try:
            rows = {name: Info(*(_text(row[key]) for key in INFO)) for name, row in found.items()}
        except (AttributeError, KeyError, TypeError) as error:
            raise GeoEvsError(
                f"{path} does not say who plays; delete it and make it again"
            ) from error
        return cls({check_name(name, "entrant", path): info for name, info in rows.items()})

    def name(self, method: str, variant: str = DEFAULT) -> str:
        """How tables write an entrant; names that several methods have tell whose they are."""
        name = self._plain_name(method, variant)
        return f"{name} [{method}]" if self._names[name] > 1 else name

    def is_control(self, method: str, variant: str = DEFAULT) -> bool:
        """Whether an entrant only marks a floor, a ceiling or a simple baseline."""
        return self._info(method, variant).paradigm == CONTROL

    def columns(self, method: str, variant: str = DEFAULT) -> dict[str, str]:
        """The cells of an entrant, by INFO."""
        return asdict(self._info(method, variant)) | {"name": self.name(method, variant)}

    def describe(self, table: pd.DataFrame) -> pd.DataFrame:
        """A table with the columns `method` and `variant`, if any, and INFO behind its own."""
        pairs = zip(table["method"], table["variant"], strict=True)
        cells = [self.columns(method, variant or DEFAULT) for method, variant in pairs]
        return table.join(pd.DataFrame(cells, columns=INFO, index=table.index))

    def _info(self, method: str, variant: str) -> Info:
        unknown = Info(**{"name": method} | paper_method(method))
        return self._described.get(name_of(method, variant), unknown)

    def _plain_name(self, method: str, variant: str) -> str:
        """The paper's name where it has one, else the method's own."""
        name = paper_method(method).get("name") or self._info(method, variant).name or method
        return name if variant == DEFAULT else f"{name} ({variant})"


def _text(said: Any) -> str:
    if not isinstance(said, str):
        raise TypeError(said)
    return clean(said)


def _parted(name: str) -> tuple[str, str]:
    method, _, variant = name.partition(".")
    return method, variant or DEFAULT
