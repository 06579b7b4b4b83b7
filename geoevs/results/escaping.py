"""What others wrote, as each format must have it so that it stays the text that it is."""

import json
import re
from pathlib import Path
from typing import Any

import pandas as pd

from geoevs.core.files import whole_file
from geoevs.core.text import clean

FORMULA = re.compile(r"[=+\-@＝＋－＠\t\r]")
"""What begins a cell that spreadsheets compute."""

RANGE = re.compile(r"([0-9.]+)-([0-9.]+)")
"""A bin such as 5-10, which spreadsheets take for a date."""

LONGEST = 2000
"""Most characters of a text in a page or in a cell of one."""

NAMING = ("dataset", "scene", "method", "variant", "name", "bin")
"""Columns of CSV files that are text, whatever it looks like."""

_LATEX_WORDS = {"~": "asciitilde", "^": "asciicircum", "\\": "backslash"}
_LATEX_WORDS |= {"<": "less", ">": "greater", "|": "bar"}
_LATEX_SYMBOLS = {
    "∞": "infty",
    "↑": "uparrow",
    "↓": "downarrow",
    "▼": "blacktriangledown",
    "†": "dagger",
}
LATEX = {
    **{letter: f"\\{letter}" for letter in "_%&#${}"},
    **{letter: rf"\text{word}{{}}" for letter, word in _LATEX_WORDS.items()},
    **{letter: rf"$\{word}$" for letter, word in _LATEX_SYMBOLS.items()},
}
"""Letters that LaTeX does not print as they stand, and what prints them."""


def csv_text(table: pd.DataFrame) -> str:
    """A table as CSV in which no text is a formula or a date to a spreadsheet; numbers stay.

    A text that would be a formula gets an apostrophe before it. The bin 5-10 is written `5 to 10`.

    >>> csv_text(pd.DataFrame({"bin": ["5-10"], "note": ["=1+1"], "value": [-1.5]})).splitlines()
    ['bin,note,value', "5 to 10,'=1+1,-1.5"]
    """
    changed = {}
    for name, column in table.items():
        cells = [_csv_cell(cell, name) if isinstance(cell, str) else cell for cell in column]
        if any(new is not old for new, old in zip(cells, column, strict=True)):
            changed[name] = pd.Series(cells, index=table.index, dtype=object)
    return table.assign(**changed).to_csv(index=False)


def _csv_cell(text: str, column: Any) -> str:
    if column == "bin" and (ends := RANGE.fullmatch(text)):
        return f"{ends[1]} to {ends[2]}"
    return f"'{text}" if FORMULA.match(text) else text


def read_csv(path: Path) -> pd.DataFrame:
    """Read what `csv_text` wrote: columns of numbers as numbers, all others as the texts there.

    Raises:
        GeoEvsError: the file is missing or damaged.
    """
    with whole_file(path):
        table = pd.read_csv(path, dtype=str, keep_default_na=False, encoding="utf-8")
        return table.apply(_numbers_or_text)


def _numbers_or_text(column: pd.Series) -> pd.Series:
    numbers = pd.to_numeric(column.where(column != "", "nan"), errors="coerce")
    spoken = numbers.isna() & ~column.isin(["", "nan"])
    if column.name not in NAMING and not spoken.any():
        return numbers
    quoted = column.str.startswith("'") & column.str.slice(1).str.match(FORMULA)
    return column.where(~quoted, column.str.slice(1))


def markdown_text(text: str) -> str:
    r"""Text as Markdown that shows it: no code, tags, links, pictures or headings.

    Brackets stay as they are, since an interval is no link.

    >>> print(markdown_text("# `a` <b> ![c](d) [1, 2]"))
    \# \`a\` \<b> ![c]\(d) [1, 2]
    """
    line = re.sub(r"([\\`*<])", r"\\\1", clean(text, LONGEST))
    return re.sub(r"(?<=\])(?=[(:\[])|^(?=#)", r"\\", line)


def markdown_cell(text: str) -> str:
    """`markdown_text` within one cell of a table."""
    return markdown_text(text).replace("|", r"\|")


def latex_text(text: str) -> str:
    r"""Text as LaTeX that prints it.

    >>> print(latex_text("50% of $x_1$ *"))
    50\% of \$x\_1\$ *
    """
    return "".join(LATEX.get(letter, letter) for letter in clean(text, LONGEST))


def script_json(value: Any) -> str:
    r"""JSON for a script element, in which no text is markup.

    >>> print(script_json("</script><!--"))
    "\u003c/script>\u003c!--"
    """
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))  # of ASCII alone
    return text.replace("<", r"\u003c")
