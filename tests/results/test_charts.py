import numpy as np
import pandas as pd
import pytest

from geoevs.results.charts import chart_html, chart_png, speed_accuracy, speed_accuracy_chart

SETTINGS = {"resamples": 100, "confidence": 0.9}
# seconds a view, sparse PSNR of two frames
ENTRANTS = {
    ("mean-colour", "default"): (0.001, (10.0, 12.0)),
    ("reproject", "default"): (0.010, (20.0, 24.0)),
    ("geo-evs", "default"): (0.100, (21.0, 22.0)),  # slower and worse than reproject
    ("geo-evs", "t1"): (0.020, (25.0, 25.0)),
    ("reference", "default"): (0.001, (60.0, 60.0)),
}


@pytest.fixture
def rows():
    scores, costs = [], []
    for (method, variant), (seconds, values) in ENTRANTS.items():
        entrant = {"dataset": "d", "method": method, "variant": variant}
        for frame, value in enumerate(values):
            score = {"scene": "s", "frame": frame, "split": "extrapolation", "stressor": ""}
            kept = {"metric": "sparse_psnr", "value": value, "status": "ok"}
            scores += [{**entrant, **score, **kept}]
            scores += [{**entrant, **score, **kept, "split": "observed", "value": 99.0}]
            scores += [{**entrant, **score, **kept, "stressor": "thinning", "value": 99.0}]
        cost = {"sources": "all-cameras", "status": "ok", "device": "cpu", "threads": 2}
        zero = dict.fromkeys(("fit_seconds", "peak_memory", "gpu_memory", "primitives"), 0.0)
        sizes = {"parameters": 0.0, "bytes": 0.0}
        costs.append({**entrant, **cost, **zero, **sizes, "render_seconds": seconds})
    return pd.DataFrame(scores), pd.DataFrame(costs)


def test_the_frontier_holds_what_nothing_beats_in_both(rows):
    table = speed_accuracy(*rows, SETTINGS).set_index(["method", "variant"])
    assert "reference" not in table.index.get_level_values(0)
    assert table["mean"].to_dict() == {
        ("mean-colour", "default"): 11.0,
        ("reproject", "default"): 22.0,
        ("geo-evs", "default"): 21.5,
        ("geo-evs", "t1"): 25.0,
    }
    assert table["frontier"].to_dict() == {
        ("mean-colour", "default"): True,
        ("reproject", "default"): True,
        ("geo-evs", "default"): False,
        ("geo-evs", "t1"): True,
    }
    assert table["control"].tolist() == [True, True, False, False]


def test_a_faster_better_entrant_empties_the_frontier(rows):
    scores, costs = rows
    costs.loc[costs["variant"] == "t1", "render_seconds"] = 0.0001
    table = speed_accuracy(scores, costs, SETTINGS)
    assert table.loc[table["frontier"], "variant"].tolist() == ["t1"]


def test_entrants_that_failed_are_no_points(rows):
    scores, costs = rows
    scores.loc[scores["method"] == "reproject", "value"] = np.nan
    table = speed_accuracy(scores, costs, SETTINGS)
    assert "reproject" not in set(table["method"])


def test_the_page_needs_no_network(rows):
    chart = speed_accuracy_chart(speed_accuracy(*rows, SETTINGS))
    page = chart_html(chart)
    assert 'src="http' not in page
    assert "Geo-EVS (t1)" in page
    assert chart_png(chart).startswith(b"\x89PNG")
