"""A small run that has everything a report shows: pictures, tables, charts and a failure."""

import dataclasses
import math
import shutil

import numpy as np
import pandas as pd
import pytest

from geoevs import layout
from geoevs.core.files import write_bytes, write_json, write_text
from geoevs.core.images import write_image
from geoevs.protocol.records import write_records
from geoevs.protocol.reference import References
from geoevs.protocol.rows import COST_TYPES, SCORE_TYPES, cost_frame, score_frame
from geoevs.protocol.set_scoring import set_frame
from geoevs.protocol.targets import read_targets, virtual_targets
from geoevs.results.chart_pages import draw_page, page_html
from geoevs.results.charts import speed_accuracy
from geoevs.results.entrants import Entrants
from geoevs.results.report.page import make_page
from geoevs.results.settings import TableSettings
from geoevs.results.tables import make_table

PLACE = {"dataset": "d", "scene": "s"}
SETTINGS = TableSettings([0, 15, 30], [0, 0.1], 100, 0.95, "geo-evs")
DESCRIBED = {
    "mean-colour": {"name": "mean-colour", "paradigm": "control"},
    "reproject": {"name": "Reprojection", "paradigm": "control", "needs": "lidar"},
    "geo-evs": {"name": "Geo-EVS", "paradigm": "diffusion", "needs": "lidar training"},
    "grey": {"name": "Grey", "paradigm": "reconstruction"},
}
BLANK = {"extra_prior": "none", "needs": "", "sees": "views", "citation": ""}
VALUES = {"mean-colour": 11.0, "reproject": 20.0, "geo-evs": 22.0, "grey": 9.0, "broken": math.nan}
WORDS = """# Breaking <points>

*none*: it stays [above](http://host) it ![so](http://host/a.png).

| method | support |
| --- | --- |
| <b>3DGS</b> | 0.1 |
"""


@pytest.fixture(scope="session")
def reported(run, tmp_path_factory):
    """The folder of a run whose references have black pixels, and its page."""
    run = shutil.copytree(run, tmp_path_factory.mktemp("reported") / "run")
    targets = read_targets(run / layout.TARGETS.format(**PLACE))
    blacken(run / layout.REFERENCES.format(**PLACE), targets)
    blank = {"string": "", "int64": 0, "float64": math.nan}
    usual = {name: blank[kind] for name, kind in SCORE_TYPES.items()} | PLACE
    usual |= {"variant": "default", "fingerprint": "f", "support_ratio": 0.01, "lateral_shift": 0.0}
    rows = [
        {
            **{**usual, "split": target.split, "frame": target.frame, "method": method},
            **{"target": target.camera.name, "pose_offset": target.pose_offset},
            **{"metric": metric, "value": value + target.frame, "seed": 0},
            "status": "failed" if math.isnan(value) else "ok",
        }
        for method, value in VALUES.items()
        for target in targets
        for metric in ("sparse_psnr", "psnr")
    ]
    rows.append({**rows[0], "metric": "lpips", "status": "unavailable", "reason": "no weights"})
    log = run / "logs/fit/d/s/broken.log"
    write_text(log, "Traceback: <out of points>\n")
    zero = {name: blank[kind] for name, kind in COST_TYPES.items()} | PLACE
    costs = [
        {
            **{**zero, "method": method, "variant": "default", "sources": sources},
            **{"render_seconds": 10 ** (number - 3), "fit_seconds": 1.0, "peak_memory": 10**8},
            **({"status": "ok"} if method != "broken" else failure(log)),
        }
        for number, method in enumerate(VALUES)
        for sources in ("all-cameras", "front-side")
    ]
    scores, spent, sets = score_frame(rows), cost_frame(costs), set_frame([])
    for path, frame in ((layout.SCORES, scores), (layout.COSTS, spent), (layout.SET_SCORES, sets)):
        write_bytes(run / path, frame.to_parquet(index=False))
    stress = {"stressor": "support", "level": 0.01, "seed": 1, **failure(log)}
    stressed = score_frame([{**rows[0], **stress}])
    write_bytes(run / layout.STABILITY_SCORES, stressed.to_parquet(index=False))
    write_json(run / layout.ENTRANTS, {name: BLANK | one for name, one in DESCRIBED.items()})
    entrants = Entrants.read(run / layout.ENTRANTS)
    config = {"tables": dataclasses.asdict(SETTINGS), "methods": {"grey": {}}}
    machine = {"processor": "a processor", "cores": 2}
    versions = {"python": "3.11"}
    manifest = {
        "commit": "abc",
        "protocol": 7,
        "seed": 0,
        "config": config,
        "configfiles": ["config.yaml", "other.yaml"],
        "versions": versions,
        "machine": machine,
    }
    write_json(run / layout.MANIFEST, manifest)
    table = make_table("extrapolation", scores, SETTINGS, entrants)
    write_text(run / "tables/extrapolation.csv", table.to_csv(index=False))
    points = speed_accuracy("extrapolation", scores, spent, SETTINGS, entrants)
    write_text(run / "charts/extrapolation.csv", points.to_csv(index=False))
    write_text(
        run / "charts/extrapolation.html",
        page_html(draw_page("extrapolation", points, SETTINGS).to_dict()),
    )
    write_text(run / "stability/thinning.csv", pd.DataFrame({"level": [1, 2]}).to_csv(index=False))
    write_image(run / "stability/thinning.png", np.full((20, 30, 3), 200, np.uint8))
    write_text(run / "stability/breaking_points.md", WORDS)
    page = run / layout.REPORT
    write_text(page, make_page(run))
    return run, page


def blacken(path, targets):
    """Make every other valid pixel of the references black."""
    references = References(path)
    changed = {}
    for target in virtual_targets(targets):
        found = references[target.key]
        rgb = found.rgb * (np.arange(len(found.rgb)) % 2)[:, None]
        changed[target.key] = dataclasses.replace(found, rgb=rgb.astype(np.float32))
    write_records(path, changed)


def failure(log):
    return {"status": "failed", "stage": "fit", "reason": "no <points>", "log": str(log)}
