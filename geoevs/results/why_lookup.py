"""What stands behind a cell of a table, and how it is looked up in a run's folder."""

import operator
import shlex
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from geoevs import layout
from geoevs.config.trainings import training_of, training_settings
from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.methods.contract import DEFAULT
from geoevs.protocol.entries import MethodEntry, label_of, name_of
from geoevs.results.entrants import Entrants
from geoevs.results.manifest import read_manifest
from geoevs.results.rows import read_rows, read_scores
from geoevs.results.settings import TableSettings
from geoevs.scenes.camera import view_key

SHOWN = 3
"""How many of the worst and of the best views are named."""


@dataclass(frozen=True)
class Cell:
    """A cell of a table: which table, entrant (METHOD or METHOD.VARIANT), metric and bin.

    Args:
        table: one of TABLES, or of OTHERS in `why_others`.
        entrant: as `methods` in the config names it; what else names a row in tables of OTHERS.
        metric: the column.
        bin: the row's bin, in tables that have them.
        dataset: the data set; the run's first where it is empty.
    """

    table: str
    entrant: str
    metric: str
    bin: str = ""
    dataset: str = ""

    def place(self) -> str:
        """What people call the cell: table, entrant, metric and bin."""
        return f"{self.table} {self.entrant} {self.metric} {self.bin}".strip()


SIGNS: dict[str, Callable[[pd.Series, Any], pd.Series]] = {
    "==": operator.eq,
    "!=": operator.ne,
    ">=": operator.ge,
    "<": operator.lt,
    "<=": operator.le,
    "in": pd.Series.isin,
}


class Term(NamedTuple):
    """What a column of rows must be: the term chooses the rows, its text is for people alone."""

    column: str
    sign: str
    value: Any

    def __str__(self) -> str:
        """As pandas.DataFrame.query takes it, values quoted so that it can be pasted."""
        return f"{self.column} {self.sign} {self.value!r}"


def chosen(rows: pd.DataFrame, terms: Iterable[Term]) -> pd.DataFrame:
    """The rows that meet all terms."""
    for term in terms:
        rows = rows[SIGNS[term.sign](rows[term.column], term.value)]
    return rows


@dataclass(frozen=True)
class Rows:
    """The rows of a file that a cell is computed from, and the query that finds them there."""

    file: str
    query: str
    rows: pd.DataFrame

    @classmethod
    def of(cls, file: str, frame: pd.DataFrame, terms: Sequence[Term]) -> "Rows":
        """Those of a whole file that meet all terms."""
        return cls(file, " and ".join(map(str, terms)), chosen(frame, terms))


@dataclass(frozen=True)
class Found:
    """What `explain` says of a cell.

    Args:
        value: lines with the number and notes on it.
        rows: what it is computed from.
        pictures: lines that name its views and pictures, or say why there are none.
        config: lines with the settings behind it.
        parts: the files of rows to make again.
        rules: the rules that make them.
        logs: paths of logs, which need not exist.
    """

    value: list[str]
    rows: list[Rows]
    pictures: list[str]
    config: list[str]
    parts: list[str]
    rules: tuple[str, ...] = ("fit", "render", "score")
    logs: list[str] = field(default_factory=list)


class Record:
    """A run's folder: its manifest and its rows, read when they are asked for.

    Args:
        run: the folder.
    """

    def __init__(self, run: Path) -> None:
        self.run = run
        self.needed: Mapping[str, Collection[str]] | None = None
        """What score rows are read for (see `read_scores`); all of them by default."""
        self.manifest = read_manifest(run / layout.MANIFEST)
        self.config = self.manifest["config"]
        self.settings = TableSettings.parse(self.config["tables"])

    @property
    def dropped(self) -> bool:
        """Whether the run's pictures were deleted when they were scored."""
        return bool(self.config.get("renders") == "drop")

    @cached_property
    def scores(self) -> pd.DataFrame:
        """The run's score rows, one a target and metric, or those that are needed of them."""
        if self.needed is None:
            return self.read(layout.SCORES)
        return read_scores(self.run / layout.SCORES, self.needed)

    @cached_property
    def costs(self) -> pd.DataFrame:
        """The run's cost rows, one a fit."""
        return self.read(layout.COSTS)

    @cached_property
    def entrants(self) -> Entrants:
        """The run's entrants, as they describe themselves."""
        return Entrants.read(self.run / layout.ENTRANTS)

    def entrant_line(self, method: str, variant: str = DEFAULT) -> str:
        """Who plays: name, paradigm and extra prior, as far as they are known."""
        cells = self.entrants.columns(method, variant)
        said = {"paradigm": cells["paradigm"], "extra prior": cells["extra_prior"]}
        parts = [f"{what} {text}" for what, text in said.items() if text]
        return f"entrant   {'; '.join([cells['name'], *parts])}"

    def read(self, name: str) -> pd.DataFrame:
        """The rows of one of the run's files, one of ROW_FILES.

        Raises:
            GeoEvsError: it is missing or damaged, or holds what no such rows can (see `read_rows`).
        """
        return read_rows(self.run / name, name)

    def dataset(self, name: str) -> str:
        """The data set of that name; the run's first where it is empty."""
        here = self.scores["dataset"]
        return known("data set", name or here.iloc[0], here)

    def entrant(self, name: str, dataset: str) -> MethodEntry:
        """The method and variant called METHOD or METHOD.VARIANT, if the data set has it."""
        here = self.scores.loc[self.scores["dataset"] == dataset, ["method", "variant"]]
        pairs = here.drop_duplicates().itertuples(index=False, name=None)
        entrant = MethodEntry.parse(name, {}, 0)
        known("entrant", entrant.name, [name_of(*pair) for pair in pairs])
        return entrant

    def entries(self, dataset: str, method: str, variants: Iterable[str]) -> list[MethodEntry]:
        """The variants of a method with every seed that each was run with."""
        here = self.scores[(self.scores["dataset"] == dataset) & (self.scores["method"] == method)]
        return [
            MethodEntry(method, variant, {}, int(seed))
            for variant in dict.fromkeys(variants)
            for seed in sorted(here.loc[here["variant"] == variant, "seed"].unique())
        ]

    def scenes(self, dataset: str) -> list[str]:
        """The scenes of a data set that were scored."""
        return self.scores.loc[self.scores["dataset"] == dataset, "scene"].unique().tolist()

    def path(self, pattern: str, dataset: str, scene: str, label: str = "") -> str:
        """A path of the run by its pattern in the layout."""
        return str(self.run / pattern.format(dataset=dataset, scene=scene, label=label))

    def parts(self, dataset: str, scenes: Iterable[str], entries: list[MethodEntry]) -> list[str]:
        """The files of score rows, costs beside them, of entrants on scenes."""
        return [
            self.path(layout.SCORE_PART, dataset, scene, entry.label)
            for scene in scenes
            for entry in entries
        ]

    def logs(self, rows: Iterable[Any]) -> list[str]:
        """Where the logs of the fits behind score or cost rows would lie, in the rows' order."""
        fits = dict.fromkeys(
            (row.dataset, row.scene, label_of(row.method, row.variant, row.seed)) for row in rows
        )
        return [
            self.path(pattern, *fit)
            for fit in fits
            for pattern in (layout.FIT_LOG, layout.RENDER_LOG)
        ]

    def extremes(self, rows: pd.DataFrame) -> Iterator[str]:
        """The score rows' lowest and highest values, each with its view's picture."""
        for title, row in ranked(rows):
            label = label_of(row.method, row.variant, row.seed)
            folder = self.path(layout.RENDERS, row.dataset, row.scene, label)
            yield f"{title:9} {row.value:.4g}: {folder}/{view_key(row.target, row.frame)}.png"

    def pictures(self, dataset: str, label: str) -> Iterator[str]:
        """Where an entrant's pictures lie, and what scored them."""
        renders = self.path(layout.RENDERS, dataset, "<scene>", label)
        gone = ", dropped when they were scored" if self.dropped else ""
        yield f"pictures  {renders}/<view>/<frame>.png{gone}"
        for pattern in (layout.REFERENCES, layout.TRUTH, layout.SCENE):
            yield f"          {self.path(pattern, dataset, '<scene>')}"

    def config_of(self, names: Iterable[str]) -> list[str]:
        """The settings that entrants and their trainings had, by their names in the config."""
        lines = []
        for name in dict.fromkeys(names):
            method = self.config["methods"].get(name) or {}
            lines.append(f"methods.{name}: {method}")
            training = training_of(name.partition(".")[0], str(method.get("training") or ""))
            if training and "trainings" in self.config:
                lines.append(f"trainings {training}: {self._training(training)}")
        return [*lines, f"tables: {self.config['tables']}"]

    def _training(self, training: str) -> dict[str, Any]:
        """The settings of a training, METHOD/VARIANT.

        Raises:
            GeoEvsError: the manifest's config has no sections where trainings stand.
        """
        try:
            return training_settings(self.config, training)
        except (AttributeError, TypeError, ValueError) as error:
            raise GeoEvsError(
                f"{self.run / layout.MANIFEST}: 'config.trainings' is no section of trainings; "
                "make it again"
            ) from error

    def command(self, found: Found, table: str) -> str:
        """Makes the cell's rows again, and no others, then the table."""
        files = self.manifest.get("configfiles", [])
        configs = f" --configfile {shlex.join(files)}" if files else ""
        snakemake = f"snakemake --cores 2{configs}"
        return (
            f"{snakemake} --forcerun {' '.join(found.rules)} -- {shlex.join(found.parts)} && "
            f"{snakemake} -- {shlex.quote(str(self.run / f'tables/{table}.csv'))}"
        )


def ranked(rows: pd.DataFrame) -> Iterator[tuple[str, Any]]:
    """The rows with the lowest values, then those with the highest; nothing of those without."""
    ordered = rows.dropna(subset="value").sort_values("value", kind="stable")
    for title, some in (("lowest", ordered.head(SHOWN)), ("highest", ordered.tail(SHOWN)[::-1])):
        for row in some.itertuples():
            yield title, row


def terms_of(**wanted: Any) -> list[Term]:
    """Terms of columns that are a value, or one of a list of values.

    >>> [str(term) for term in terms_of(method="mine", split=["observed"])]
    ["method == 'mine'", "split in ['observed']"]
    """
    return [
        Term(name, "in" if isinstance(value, list) else "==", value)
        for name, value in wanted.items()
    ]


def value_line(cell: Cell, row: Any, dataset: str, more: str = "") -> str:
    """A table's row at the cell: the number and its interval, if it has one."""
    value, low, high = (row.get(cell.metric + end) for end in ("", "_low", "_high"))
    interval = "" if low is None or pd.isna(low) else f" [{low:.6g}, {high:.6g}]"
    return f"cell      {cell.place()} = {value:.6g}{interval} on {dataset}{more}"


def known(kind: str, value: str, allowed: Iterable[str]) -> str:
    """The value, if it is allowed.

    Raises:
        GeoEvsError: it is not; the sentence names what is.
    """
    allowed = list(dict.fromkeys(allowed))
    if value not in allowed:
        raise GeoEvsError(f"there is no {kind} '{value}' here; {did_you_mean(value, allowed)}")
    return value
