"""From a cell of a table back to its rows, pictures, config, commit, and how to make it again."""

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from geoevs import layout
from geoevs.errors import GeoEvsError, did_you_mean
from geoevs.io import read_json, whole_file
from geoevs.protocol.entries import MethodEntry
from geoevs.protocol.scoring import THINNING
from geoevs.protocol.set_metrics import SET_METRICS
from geoevs.results.tables import TableSpec, bin_names, make_table, table_spec

SHOWN = 3
"""How many of the worst and of the best views are named."""


@dataclass(frozen=True)
class Cell:
    """A cell of a table: which table, entrant (METHOD or METHOD.VARIANT), metric and bin.

    Args:
        table: one of TABLES.
        entrant: as `methods` in the config names it.
        metric: the column.
        bin: the row's bin, in tables that have them.
        dataset: the data set; the run's first where it is empty.
    """

    table: str
    entrant: str
    metric: str
    bin: str = ""
    dataset: str = ""


def explain(cell: Cell, run: Path) -> list[str]:
    """Lines that say where a cell's number comes from.

    Raises:
        GeoEvsError: there is no such cell; the sentence names what there is.
    """
    manifest = read_json(run / layout.MANIFEST)
    settings = manifest["config"]["tables"]
    scores, sets = (_read(run / name) for name in (layout.SCORES, layout.SET_SCORES))
    spec = table_spec(cell.table)
    dataset = _known("data set", cell.dataset or scores["dataset"].iloc[0], scores["dataset"])
    _known("metric", cell.metric, (*spec.metrics, *spec.set_metrics))
    label = _known("bin", cell.bin, bin_names(spec, settings))
    method = MethodEntry.parse(cell.entrant, {}, 0)
    scores = scores[scores["dataset"] == dataset]
    names = [MethodEntry(m, v).label for m, v in _pairs(scores)]
    _known("entrant", method.label, names)

    table = make_table(cell.table, scores, settings, sets[sets["dataset"] == dataset])
    chosen = (table["method"] == method.method) & (table["variant"] == method.variant)
    row = table[chosen & (table["bin"] == label if spec.bins else True)].iloc[0]
    of_sets = cell.metric in SET_METRICS
    file, rows = (layout.SET_SCORES, sets) if of_sets else (layout.SCORES, scores)
    wanted = {"dataset": dataset, "method": method.method, "variant": method.variant}
    terms = [f'{name} == "{value}"' for name, value in [*wanted.items(), ("metric", cell.metric)]]
    terms += _of_bin(spec, label, settings) if not of_sets else [f"split in {list(spec.splits)}"]
    query = " and ".join(terms)
    rows = rows.query(query)
    seeds = sorted(scores[scores["method"] == method.method]["seed"].unique())
    labels = [MethodEntry(method.method, method.variant, {}, int(seed)).label for seed in seeds]
    scenes = list(dict.fromkeys(scores["scene"]))
    parts = [
        str(run / layout.SCORE_PART.format(dataset=dataset, scene=scene, label=name))
        for scene in scenes
        for name in labels
    ]
    return [
        *_value(cell, row),
        f"rows      {len(rows)} in {run / file}, as pandas.DataFrame.query takes them:",
        f"          {query}",
        *(_views(rows, run, dataset, cell.metric) if not of_sets else []),
        *_pictures(run, dataset, labels[0]),
        *_config(manifest["config"], method.label),
        f"commit    {manifest['commit']}, seed {manifest['seed']}, "
        f"protocol {scores['fingerprint'].iloc[0]}",
        *(f"log       {path}" for path in _logs(run, dataset, scenes[0], labels[0])),
        "rerun     " + _command(manifest, parts, str(run / f"tables/{cell.table}.csv")),
    ]


def _value(cell: Cell, row: pd.Series) -> Iterator[str]:
    value, low, high = (row[cell.metric + end] for end in ("", "_low", "_high"))
    interval = "" if pd.isna(low) else f" [{low:.6g}, {high:.6g}]"
    paper = row.get(f"{cell.metric}_paper")
    printed = "" if paper is None or pd.isna(paper) else f"; the paper prints {paper:g}"
    place = f"{cell.table} {cell.entrant} {cell.metric} {cell.bin}".strip()
    yield f"cell      {place} = {value:.6g}{interval} on {row['dataset']}{printed}"
    reasons = [why for why in row["unmeasured"].split("; ") if why.startswith(f"{cell.metric}:")]
    for text in filter(None, (row["note"], *reasons)):
        yield f"note      {text}"


def _of_bin(spec: TableSpec, label: str, settings: dict[str, Any]) -> list[str]:
    """What a query asks of the rows that a table averages in one bin."""
    stressors = ["", THINNING] if spec.edges == "support_bins" else [""]
    plain = [f"stressor in {stressors}"]
    if not spec.edges:
        return [f"split in {[label] if spec.bins else list(spec.splits)}", *plain]
    number = list(bin_names(spec, settings)).index(label)
    low, high = settings[spec.edges][number : number + 2]
    below = "<=" if high == settings[spec.edges][-1] else "<"
    place = f"{spec.bins} >= {low} and {spec.bins} {below} {high}"
    return [f"split in {list(spec.splits)}", place, *plain]


def _config(config: dict[str, Any], label: str) -> Iterator[str]:
    """The settings that the entrant, its training and the table had."""
    method = config["methods"].get(label) or {}
    yield f"config    methods.{label}: {method}"
    if "training" in method:
        common = {key: value for key, value in config["training"].items() if key != "variants"}
        variant = config["training"]["variants"][method["training"]]
        yield f"          training.{method['training']}: {common | variant}"
    yield f"          tables: {config['tables']}"


def _views(rows: pd.DataFrame, run: Path, dataset: str, metric: str) -> Iterator[str]:
    """The views with the lowest and the highest values, each with its picture."""
    ranked = rows.dropna(subset="value").sort_values("value", kind="stable")
    for title, some in (("lowest", ranked.head(SHOWN)), ("highest", ranked.tail(SHOWN)[::-1])):
        for row in some.itertuples():
            label = MethodEntry(row.method, row.variant, {}, int(row.seed)).label
            folder = _folder(run, layout.RENDERS, dataset, row.scene, label)
            yield f"{title:9} {row.value:.4g}: {folder}/{row.target}/{row.frame:06d}.png"


def _folder(run: Path, pattern: str, dataset: str, scene: str, label: str = "") -> str:
    return str(run / pattern.format(dataset=dataset, scene=scene, label=label))


def _pictures(run: Path, dataset: str, label: str) -> Iterator[str]:
    """Where the entrant's pictures lie, and what scored them."""
    yield f"pictures  {_folder(run, layout.RENDERS, dataset, '<scene>', label)}/<view>/<frame>.png"
    for pattern in (layout.REFERENCES, layout.TRUTH, layout.SCENE):
        yield f"          {_folder(run, pattern, dataset, '<scene>')}"


def _logs(run: Path, dataset: str, scene: str, label: str) -> list[str]:
    paths = (run / f"logs/{step}/{dataset}/{scene}/{label}.log" for step in ("fit", "render"))
    return [str(path) for path in paths if path.exists()]


def _command(manifest: dict[str, Any], parts: list[str], table: str) -> str:
    """Fits, renders and scores this entrant alone, then remakes the table."""
    files = manifest.get("configfiles", [])
    configs = f" --configfile {shlex.join(files)}" if files else ""
    snakemake = f"snakemake --cores 2{configs}"
    return (
        f"{snakemake} --forcerun fit render score -- {shlex.join(parts)} && "
        f"{snakemake} -- {shlex.quote(table)}"
    )


def _pairs(scores: pd.DataFrame) -> list[tuple[str, str]]:
    pairs = scores[["method", "variant"]].drop_duplicates()
    return list(pairs.itertuples(index=False, name=None))


def _known(kind: str, value: str, allowed: Any) -> str:
    """The value, if it is allowed."""
    allowed = list(dict.fromkeys(allowed))
    if value not in allowed:
        raise GeoEvsError(f"there is no {kind} '{value}' here; {did_you_mean(value, allowed)}")
    return value


def _read(path: Path) -> pd.DataFrame:
    with whole_file(path):
        return pd.read_parquet(path)
