"""Two runs are compared in every value and picture, and in nothing that is timed."""

import shutil

import numpy as np
import pandas as pd
import pytest

from benchmarks.same_run import differences, digest_of
from geoevs.core.images import write_image


@pytest.fixture
def run(tmp_path):
    """A run of two entrants on one scene, with a table and a network."""
    folder = tmp_path / "run"
    (folder / "tables").mkdir(parents=True)
    place = {"dataset": "d", "scene": "s", "frame": 0, "target": "t", "split": "extrapolation"}
    rows = [
        {
            **place,
            "method": method,
            "variant": "default",
            "seed": 0,
            "stressor": "",
            "level": np.nan,
        }
        | {"metric": metric, "lateral_shift": 1.0, "value": 0.1 + 0.2, "fingerprint": "abc"}
        for method in ("a", "b")
        for metric in ("psnr", "ssim")
    ]
    pd.DataFrame(rows).to_parquet(folder / "scores.parquet")
    table = pd.DataFrame({"method": ["a"], "psnr": [20.0], "fit_seconds": [1.0]})
    table.to_csv(folder / "tables/extrapolation.csv", index=False)
    write_image(folder / "renders/d/s/a/view/000000.png", np.zeros((4, 6, 3), np.uint8))
    (folder / "trained/a/v1.seed0").mkdir(parents=True)
    (folder / "trained/a/v1.seed0/net.safetensors").write_bytes(b"weights")
    return folder


def changed(run, tmp_path, change):
    """What differs between the run and a copy of it with a change."""
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    change(copy)
    return differences(digest_of(run), digest_of(copy))


def rewrite(path, **columns):
    """Rewrite a table with some columns changed."""
    if path.suffix == ".csv":
        pd.read_csv(path).assign(**columns).to_csv(path, index=False)
    else:
        pd.read_parquet(path).assign(**columns).to_parquet(path)


def test_a_run_is_itself_whatever_the_order_of_rows_and_what_is_timed(run, tmp_path):
    def change(copy):
        rows = pd.read_parquet(copy / "scores.parquet")
        rows[::-1].assign(fingerprint="other").to_parquet(copy / "scores.parquet")
        rewrite(copy / "tables/extrapolation.csv", fit_seconds=9.0, name="A", another=1)

    assert changed(run, tmp_path, change) == []


def test_a_value_that_differs_in_its_last_bit_is_found(run, tmp_path):
    def change(copy):
        rows = pd.read_parquet(copy / "scores.parquet")
        rows.loc[3, "value"] = np.nextafter(rows.loc[3, "value"], 1)
        rows.to_parquet(copy / "scores.parquet")

    assert changed(run, tmp_path, change) == ["differs: scores.parquet d/s/b/default/0"]


def test_tables_pictures_and_networks_count(run, tmp_path):
    def change(copy):
        rewrite(copy / "tables/extrapolation.csv", psnr=20.000000001)
        write_image(copy / "renders/d/s/a/view/000000.png", np.ones((4, 6, 3), np.uint8))
        (copy / "trained/a/v1.seed0/net.safetensors").write_bytes(b"other")

    assert changed(run, tmp_path, change) == [
        "differs: tables/extrapolation.csv column psnr",
        "differs: renders/d/s/a",
        "differs: networks v1.seed0/net.safetensors",
    ]


def test_what_one_run_lacks_is_named(run, tmp_path):
    lines = changed(run, tmp_path, lambda copy: shutil.rmtree(copy / "renders"))
    assert lines == ["only in the first: renders/d/s/a"]
