import copy
import math

import pandas as pd
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.methods.tiny import write_tiny_scene
from geoevs.protocol import rows
from geoevs.protocol.metrics import METRICS, MetricSpec
from geoevs.protocol.rows import (
    COST_TYPES,
    SCORE_TYPES,
    check_fingerprints,
    cost_frame,
    protocol_fingerprint,
    score_frame,
)

PROTOCOL = {"lateral": [-1.0, 1.0], "pose_sweep": {"angles": [10.0], "every": 2}}


def test_the_same_protocol_has_the_same_fingerprint(stage):
    before = protocol_fingerprint(stage.store, PROTOCOL)
    turned = dict(reversed(PROTOCOL.items()))
    assert protocol_fingerprint(stage.store, turned) == before
    assert len(before) == 16


@pytest.mark.parametrize("key", ["lateral", "angles", "every"])
def test_the_fingerprint_changes_with_the_protocol(stage, key):
    changed = copy.deepcopy(PROTOCOL)
    (changed if key == "lateral" else changed["pose_sweep"])[key] = [2.0]
    before = protocol_fingerprint(stage.store, PROTOCOL)
    assert protocol_fingerprint(stage.store, changed) != before


def test_the_fingerprint_changes_with_the_cameras(stage, tmp_path):
    fewer = write_tiny_scene(tmp_path / "fewer", cameras=("front", "left"))
    before = protocol_fingerprint(stage.store, PROTOCOL)
    assert protocol_fingerprint(fewer, PROTOCOL) != before


@pytest.mark.parametrize(
    "constant", ["PROTOCOL", "SSIM_SIGMA", "FOOTPRINT_RADIUS", "FOOTPRINT_TOLERANCE"]
)
def test_the_fingerprint_changes_with_the_rules_of_scoring(stage, monkeypatch, constant):
    before = protocol_fingerprint(stage.store, PROTOCOL)
    monkeypatch.setattr(rows, constant, 99)
    assert protocol_fingerprint(stage.store, PROTOCOL) != before


def test_the_fingerprint_changes_with_a_metric(stage, monkeypatch):
    before = protocol_fingerprint(stage.store, PROTOCOL)
    spec = METRICS["psnr"]
    monkeypatch.setitem(METRICS, "psnr", MetricSpec(spec.kind, "reference"))
    assert protocol_fingerprint(stage.store, PROTOCOL) != before


def fingerprints(*pairs: tuple[str, str]) -> pd.DataFrame:
    return pd.DataFrame(pairs, columns=["dataset", "fingerprint"])


def test_data_sets_may_differ_from_each_other():
    check_fingerprints(fingerprints(("a", "1"), ("b", "2"), ("a", "1")))


def test_mixtures_within_a_data_set_are_refused():
    mixed = fingerprints(("a", "1"), ("b", "3"), ("b", "2"), ("b", "3"))
    with pytest.raises(GeoEvsError, match=r"^scores of dataset 'b' .*\(2, 3\); rerun `snakemake "):
        check_fingerprints(mixed)


def test_rows_are_typed_even_where_there_are_none():
    for frame, types in ((score_frame([]), SCORE_TYPES), (cost_frame([]), COST_TYPES)):
        assert len(frame) == 0
        assert {name: str(kind) for name, kind in frame.dtypes.items()} == types


def test_a_row_keeps_its_values_through_parquet(tmp_path):
    row = {
        name: {"string": "a", "int64": 2, "float64": math.inf}[t] for name, t in SCORE_TYPES.items()
    }
    score_frame([row]).to_parquet(tmp_path / "rows.parquet", index=False)
    assert pd.read_parquet(tmp_path / "rows.parquet").to_dict("records") == [row]
