"""Table 3's stage at smoke scale: detectors of every setting, from scenes to tables."""

import pandas as pd
import pytest

from geoevs.core.images import read_image


@pytest.mark.detection
def test_detectors_of_every_setting_are_compared(workspace):
    run = workspace.snakemake(*workspace.SMOKE, "--", "detection")
    assert run.returncode == 0, run.stderr[-3000:]
    results = workspace.folder / "results/smoke"
    table = pd.read_csv(results / "tables/detection.csv").set_index("setting")
    assert {"blind", "native", "longer", "augmented", "with-mean-colour", "with-truth"} == {
        *table.index
    }
    assert (table["failed"] == 0).all()
    assert table["views"].to_dict() == {
        name: 9 if name.startswith("with-") else 5 for name in table.index
    }
    assert table["let_mapl"].between(0, 100).all()
    assert (table["truths"] == table["truths"].iloc[0]).all()
    assert table["truths"].iloc[0] > 0
    assert table.loc["native", "let_mapl_paper"] == 34.9
    task = pd.read_csv(results / "tables/task_offsets.csv")
    assert task[["label", "offset"]].values.tolist() == [
        ["recorded", 0.0], *([name, 1.0] for name in ("truth", "mean-colour"))
    ]  # fmt: skip
    assert task["nta_iou"].between(0, 100).all()
    assert read_image(results / "figures/detection.png").std() > 10
    tracks = pd.read_parquet(
        results / "detection/given/street-detection/straight-2901/tracks.parquet"
    )
    assert len(tracks) == 0
