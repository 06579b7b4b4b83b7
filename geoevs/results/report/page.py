"""The page itself: tables, charts, pictures, failures and the manifest in one HTML file."""

import base64
import hashlib
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
import vl_convert

from geoevs import layout
from geoevs.core.errors import GeoEvsError
from geoevs.core.text import printable
from geoevs.protocol.entries import label_of
from geoevs.results.entrants import ENTRANT, INFO, Entrants
from geoevs.results.escaping import read_csv, script_json
from geoevs.results.failures import Failure, run_failures
from geoevs.results.manifest import read_manifest
from geoevs.results.report.markdown import markdown_html
from geoevs.results.report.pictures import comparison, file_address
from geoevs.results.report.sentences import summarise_gaps, summarise_run
from geoevs.results.report.suites import summarise_suites
from geoevs.results.rows import TABLE_COLUMNS, read_rows
from geoevs.results.run_folder import log_tail, refuse_links_out
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import TABLES

PAGE_BYTES = 24_500_000
"""About what a page may take: its pictures get what tables, charts and libraries leave."""

NOTHING_COMPARED = {"frames": 0, "all_frames": 0, "quality": 0}
"""In the place of what `comparison` finds, to see what the rest of a page takes."""

COMPARED = ("sparse_psnr", "psnr")
"""Metrics that the comparison of pictures names for a single view."""


@dataclass(frozen=True)
class Exhibit:
    """Something a run holds: words, a table, an interactive chart or a picture, or more of them.

    Args:
        name: what it is called, from its file.
        rows: the CSV.
        chart: the Vega-Lite chart.
        picture: the address of a picture, where there is no chart.
        words: what a page in words says, as HTML.
    """

    name: str
    rows: pd.DataFrame | None = None
    chart: dict[str, Any] | None = None
    picture: str = ""
    words: str = ""


def make_page(run: Path, threads: int = 1) -> str:
    """The report of a run, from its rows and from whatever tables and charts it holds.

    Args:
        run: the run's folder.
        threads: that compress its pictures.

    Raises:
        GeoEvsError: rows or the manifest are missing or hold what they cannot, or a link leads out
            of the run.
    """
    refuse_links_out(run)
    manifest = read_manifest(run / layout.MANIFEST)
    scores = read_rows(run / layout.SCORES, layout.SCORES, TABLE_COLUMNS)
    costs, sets = (read_rows(run / name, name) for name in (layout.COSTS, layout.SET_SCORES))
    exhibits = {folder: list(_exhibits(run / folder)) for folder in _result_folders(run)}
    tables = [exhibit for exhibit in exhibits.pop("tables", []) if exhibit.rows is not None]
    failures = run_failures(run)
    settings = TableSettings.parse(manifest["config"]["tables"])
    entrants = Entrants.read(run / layout.ENTRANTS)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("geoevs.results.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["table"] = partial(table_html, entrants=entrants)
    scripts = [
        vl_convert.javascript_bundle().replace("</script", "<\\/script").replace("\r\n", "\n"),
        *map(_asset, SCRIPTS),
    ]
    page = partial(
        environment.get_template("page.html.jinja").render,
        run=run.name,
        manifest=manifest,
        manifest_text=json.dumps(manifest, indent=1),
        sentences=[
            *summarise_run(scores, costs, settings, entrants),
            *summarise_suites(run),
            *summarise_gaps(failures, scores, sets, entrants),
        ],
        tables=sorted(tables, key=lambda exhibit: _table_order(exhibit.name)),
        titles={name: spec.title for name, spec in TABLES.items()},
        exhibits={folder: parts for folder, parts in exhibits.items() if parts},
        failures=[_described(failure, entrants, run) for failure in failures],
        featured=settings.ablation,
        charts=script_json(
            {
                f"{folder}/{exhibit.name}": exhibit.chart
                for folder, parts in exhibits.items()
                for exhibit in parts
                if exhibit.chart
            }
        ),
        scripts=scripts,
        policy=content_policy(scripts),
        style=_asset("page.css"),
    )
    rest = len(page(compared=NOTHING_COMPARED, data="").encode())
    compared = compared_views(run, scores, PAGE_BYTES - rest, threads)
    return page(compared=compared, data=script_json(compared | {"featured": settings.ablation}))


SCRIPTS = ("img-comparison-slider.js", "sortable-tablesort.js", "page.js")
"""What the page runs beside Vega, in this order."""


def _asset(path: str) -> str:
    return resources.files("geoevs.results.report").joinpath(path).read_text(encoding="utf-8")


def content_policy(scripts: Sequence[str]) -> str:
    """A Content-Security-Policy: a browser runs these scripts alone, and loads nothing."""
    hashes = (base64.b64encode(hashlib.sha256(script.encode()).digest()) for script in scripts)
    allowed = " ".join(f"'sha256-{digest.decode()}'" for digest in hashes)
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )


def compared_views(run: Path, scores: pd.DataFrame, budget: int, threads: int) -> dict[str, Any]:
    """What the comparison of pictures needs: see `comparison`; and each view's own scores."""
    scenes = list(scores[["dataset", "scene"]].drop_duplicates().itertuples(index=False, name=None))
    entries = scores[["method", "variant", "seed"]].drop_duplicates()
    labels = [label_of(*entry) for entry in entries.itertuples(index=False, name=None)]
    views = comparison(run, scenes, labels, budget, threads)
    rows = scores[scores["metric"].isin(COMPARED) & (scores["stressor"] == "")]
    measured: dict[tuple, dict[str, dict[str, float]]] = {}
    for row in rows[rows["value"].map(math.isfinite)].itertuples():
        label = label_of(row.method, row.variant, row.seed)
        view = measured.setdefault((row.dataset, row.scene, row.frame, row.target), {})
        view.setdefault(label, {})[row.metric] = round(row.value, 2)
    for view in views["views"]:
        key = tuple(view[name] for name in ("dataset", "scene", "frame", "view"))
        view["scores"] = measured.get(key, {})
    return views


def _result_folders(run: Path) -> list[str]:
    """Folders of results, charts first."""
    folders = (path.name for path in run.iterdir() if path.is_dir() and path.name[0] != ".")
    return sorted(set(folders) - layout.DATA_FOLDERS, key=lambda name: (name != "charts", name))


SUFFIXES = ("csv", "png", "html", "md")


def _exhibits(folder: Path) -> Iterator[Exhibit]:
    """What lies in a folder of results, files of one stem together.

    Those with words come first, then those of a table, in the order of TABLES.
    """
    stems = {path.stem for suffix in SUFFIXES for path in folder.glob(f"*.{suffix}")}
    for stem in sorted(
        stems, key=lambda stem: (not (folder / f"{stem}.md").exists(), _table_order(stem))
    ):
        table, picture, page, words = (folder / f"{stem}.{suffix}" for suffix in SUFFIXES)
        chart = chart_of(page) if page.is_file() else None
        yield Exhibit(
            stem,
            read_csv(table) if table.is_file() else None,
            chart,
            file_address(picture) if picture.is_file() and chart is None else "",
            markdown_html(_words(words)) if words.is_file() else "",
        )


def _text(path: Path) -> str:
    """A page of the run: UTF-8, and what is not stays a question mark."""
    return path.read_text(encoding="utf-8", errors="replace")


def _words(path: Path) -> str:
    return "\n".join(map(printable, _text(path).splitlines()))


def chart_of(page: Path) -> dict[str, Any] | None:
    """The Vega-Lite chart in a page that Altair wrote; None where there is none.

    Its own wishes for how it is embedded are left out.

    Raises:
        GeoEvsError: what stands there is no chart.
    """
    text = _text(page)
    match = re.search(r"\b(?:const|var|let) spec = (?=\{)", text)
    if match is None:
        return None
    try:
        spec, _ = json.JSONDecoder(parse_constant=_refuse).raw_decode(text, match.end())
    except (ValueError, RecursionError) as error:
        raise GeoEvsError(f"{page} holds no chart that can be read; make it again") from error
    return {name: value for name, value in spec.items() if name != "usermeta"}


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no JSON")


def _table_order(name: str) -> tuple[int, str]:
    names = list(TABLES)
    return names.index(name) if name in names else len(names), name


def _described(failure: Failure, entrants: Entrants, run: Path) -> dict[str, str]:
    return {
        "name": entrants.name(failure.method, failure.variant),
        "place": failure.place,
        "stage": failure.stage,
        "reason": failure.reason,
        "log": failure.log,
        "text": log_tail(run, failure.log),
    }


def table_html(rows: pd.DataFrame, entrants: Entrants) -> jinja2.utils.markupsafe.Markup:
    """A table that readers can sort; a mean's interval stands in its cell.

    Columns without any value are left out, who plays comes first, and controls are set in italics.
    """
    rows = rows.dropna(axis="columns", how="all")
    rows = rows[sorted(rows, key=lambda name: name not in (*ENTRANT, *INFO))]
    ends = {name for name in rows if name.endswith(("_low", "_high"))}
    ends = {name for name in ends if re.sub("_(low|high)$", "", name) in rows}
    columns = [name for name in rows if name not in ends]
    escape = jinja2.utils.markupsafe.escape
    head = "".join(f'<th scope="col">{escape(name.replace("_", " "))}</th>' for name in columns)
    body = []
    for row in rows.to_dict("records"):
        who = (str(row[name]) for name in ENTRANT[1:] if name in row)
        control = "method" in row and entrants.is_control(*who)
        cells = "".join(_cell(name, row) for name in columns)
        body.append(f"<tr{' class=control' if control else ''}>{cells}</tr>")
    markup = f"<thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody>"
    return jinja2.utils.markupsafe.Markup(f'<table class="sortable n-last">{markup}</table>')


def _cell(name: str, row: Mapping[str, Any]) -> str:
    value = row[name]
    if isinstance(value, str):
        return f"<td>{jinja2.utils.markupsafe.escape(value)}</td>"
    if value is None or math.isnan(value):
        return '<td data-sort=""></td>'
    text = _number(value)
    low, high = (row.get(name + end, math.nan) for end in ("_low", "_high"))
    if not (math.isnan(low) or math.isnan(high)):
        text += f" <small>[{_number(low)}, {_number(high)}]</small>"
    return f'<td class="number" data-sort="{value}">{text}</td>'


def _number(value: float) -> str:
    """Four significant digits.

    >>> _number(0.123456), _number(12.0), _number(math.inf)
    ('0.1235', '12', '∞')
    """
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    return f"{value:.4g}" if abs(value) < 1e5 else f"{value:,.0f}"
