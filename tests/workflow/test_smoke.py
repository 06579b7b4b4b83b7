import random
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from geoevs.conditions.artifact_masks import read_artifact_masks
from geoevs.conditions.pairs import read_pairs
from geoevs.core.files import read_json
from geoevs.core.images import read_image
from geoevs.geometry.vggt import load_vggt
from geoevs.protocol.depth_scoring import DEPTH_SCORE_TYPES
from geoevs.results.table_specs import TABLES

CONTROLS = ["reference", "mean-colour", "nearest-view", "reproject", "reproject-inpaint"]
BASELINES = ["three-dgs", "street-gaussians", "emernerf", "freevs"]
OF_THE_PAPER = ["geo-evs", *BASELINES]  # of its methods, those that this suite runs
# Everything but timings, which no two runs share.
STABLE = (
    *("scores.parquet", "tables", "figures", "renders", "scenes", "truth", "references"),
    *("masks", "depths", "geometry", "point-maps", "prepared", "trained"),
    "entrants.json",
)
STRESSED = "street-stability"  # a data set that the killed run does not need
UNSTABLE = {
    "costs.csv",
    "costs.md",
    "render.json",
    *("seconds.json", "vggt.seconds.json"),
    *(f"geometry.{s}" for s in ("csv", "md", "tex")),
    *(f"complexity.{s}" for s in ("csv", "md")),
}


def files(folder: Path) -> dict[str, bytes]:
    found = {}
    for name in STABLE:
        root = folder / name
        for path in [root] if root.is_file() else sorted(root.rglob("*")):
            if path.is_file() and path.name not in UNSTABLE and STRESSED not in path.parts:
                found[str(path.relative_to(folder))] = path.read_bytes()
    return found


def test_the_whole_dag_runs(smoke_run):
    workspace, run = smoke_run
    assert run.returncode == 0, run.stderr[-3000:]
    results = workspace.folder / "results/smoke"
    for table in TABLES:
        for suffix in (".csv", ".md", ".tex"):
            assert (results / f"tables/{table}{suffix}").stat().st_size > 100
        assert read_image(results / f"figures/{table}.png").std() > 10
    ablation = pd.read_csv(results / "tables/ablation.csv").set_index("variant")
    assert list(ablation.index) == ["v1", "default"]
    assert np.isfinite(ablation.loc["v1", "masked_observed_psnr_removed_diff"])
    sizes = pd.read_csv(results / "tables/complexity.csv")
    assert sizes["note"].tolist() == ["no fixed size was run"]
    trained = results / "trained/geo-evs/v3.seed0"
    assert (trained / "denoiser.safetensors").exists()
    assert len((results / "training/geo-evs/v3.seed0/losses.csv").read_text().splitlines()) == 1 + 6
    assert (results / "trained/freevs/default.seed0/denoiser.safetensors").exists()
    agreement = pd.read_csv(results / "tables/rank_agreement.csv")
    measured = agreement[agreement["methods"] > 0]  # LPIPS has no weights here
    assert measured["methods"].tolist() == [len(OF_THE_PAPER)] * 4
    assert measured["tau"].between(-1, 1).all()
    manifest = read_json(results / "manifest.json")
    assert {Path(name).name for name in manifest["inputs"]} >= {"junction-201", "prior.safetensors"}
    assert manifest["configfiles"][:2] == ["config.yaml", "workflow/scales/smoke.yaml"]


def test_it_makes_pairs_and_masks(smoke_run):
    workspace, run = smoke_run
    assert run.returncode == 0, run.stderr[-3000:]
    results = workspace.folder / "results/smoke"
    pairs = read_pairs([results / "prepared/geo-evs/street-train/straight-301.npz"])
    assert pairs.target.shape == (10, 64, 96, 3)
    library = read_artifact_masks(results / "prepared/geo-evs/combined.npz")
    # Two frames at two shifts: straight ahead, and half-way to both sides.
    assert len(library) == 2 * 2 * 3
    assert set(library.scene) == set(pairs.scene) == {"straight-301"}
    assert np.all((library.support > 0.5) & (library.support < 1))
    assert read_image(results / "figures/artifact-masks.png").std() > 10


def test_it_fine_tunes_and_scores_depth(smoke_run):
    workspace, run = smoke_run
    assert run.returncode == 0, run.stderr[-3000:]
    results = workspace.folder / "results/smoke"
    before = load_vggt(workspace.folder / "weights/vggt-nano.safetensors")
    after = load_vggt(results / "geometry/vggt.safetensors")
    assert after.config == before.config
    losses = np.loadtxt(results / "training/vggt/losses.csv", delimiter=",", skiprows=1)
    assert len(losses) == 4

    rows = pd.read_parquet(results / "depth-scores.parquet")
    assert list(rows.columns) == list(DEPTH_SCORE_TYPES)
    # Two frames of five cameras, in four metrics.
    counts = rows.groupby(["model", "stage", "scale"]).size().to_dict()
    network = [("vggt-nano", stage) for stage in ("fine-tuned", "pretrained")]
    assert counts == {
        ("lidar", "control", "lidar"): 40,
        **{(*entrant, scale): 40 for entrant in network for scale in ("lidar", "none")},
    }
    assert set(rows["scene"]) == {"junction-201"}
    assert set(rows["truth"]) == {"dense"}

    table = pd.read_csv(results / "tables/geometry.csv").set_index(["stage", "scale"])
    assert table["abs_rel_change"].notna().sum() == 2
    # LiDAR mends what four steps cannot.
    assert table.loc[("fine-tuned", "lidar"), "abs_rel"] < table["abs_rel"]["pretrained", "none"]
    assert table["abs_rel"].idxmin() == ("control", "lidar")
    assert (results / "tables/geometry.tex").stat().st_size > 300


def test_scores_order_the_controls(smoke_run):
    workspace, _ = smoke_run
    table = pd.read_csv(workspace.folder / "results/smoke/tables/extrapolation.csv")
    means = table.set_index("method")["sparse_psnr"]
    assert means["reference"] > 50
    assert means["reproject-inpaint"] > means["mean-colour"]
    assert means["reproject-inpaint"] > means["reproject"]
    rows = table.set_index("method")
    assert rows.loc[CONTROLS, "group"].eq("control").all()
    assert rows.loc["reproject", ["name", "paradigm"]].tolist() == ["Reprojection", "control"]
    assert rows.loc["street-gaussians", "needs"] == "sfm lidar tracks"
    # Six training steps already beat one colour; of the paper's other methods few have run.
    assert means["geo-evs-support"] > means["mean-colour"]
    assert (means[BASELINES] > means["mean-colour"]).all()
    others = table[(table["group"] == "paper") & ~table["method"].isin(OF_THE_PAPER)]
    assert others["sparse_psnr"].isna().all()


def test_truth_and_reference_agree_on_who_is_better(smoke_run):
    workspace, _ = smoke_run
    table = pd.read_csv(workspace.folder / "results/smoke/tables/extrapolation.csv")
    rows = table.set_index("method").loc[["mean-colour", "reproject", "reproject-inpaint"]]
    assert rows["sparse_psnr"].rank().tolist() == rows["psnr"].rank().tolist()


def test_masked_views_tell_their_pixels_apart(smoke_run):
    workspace, _ = smoke_run
    table = pd.read_csv(workspace.folder / "results/smoke/tables/masked.csv")
    for _, rows in table.groupby("bin"):
        rows = rows.set_index("method")
        black, filled = rows.loc["reproject"], rows.loc["reproject-inpaint"]
        assert filled["psnr_supported"] == black["psnr_supported"]
        for part in ("removed", "unsupported"):
            assert filled[f"psnr_{part}"] > black[f"psnr_{part}"]
    observed = table[table["bin"] == "masked-observed"]
    assert observed["psnr_never"].isna().all()  # a view supports all of itself
    extrapolated = table[table["bin"] == "masked-extrapolation"].set_index("method")
    sparse = extrapolated["sparse_psnr_removed"]
    assert sparse["reference"] > 50
    assert sparse["reproject-inpaint"] > sparse["reproject"]
    assert extrapolated["psnr_never"]["reproject-inpaint"] > extrapolated["psnr_never"]["reproject"]


def test_stress_lowers_the_curves(smoke_run):
    workspace, run = smoke_run
    assert run.returncode == 0, run.stderr[-3000:]
    results = workspace.folder / "results/smoke/stability"
    table = pd.read_csv(results / "stability.csv")
    assert set(table["stressor"]) == {"support", "motion", "lateral", "edges"}
    support = table[(table["stressor"] == "support") & (table["metric"] == "sparse_psnr")]
    means = support.pivot_table("mean", "level", "method", dropna=False)
    assert means["reproject"][0.005] < means["reproject"][0.05]
    assert means["mean-colour"][0.005] == means["mean-colour"][0.05]  # it reads no LiDAR
    assert set(pd.read_csv(results / "breaking_points.csv")["method"]) == {"geo-evs"}
    spread = pd.read_csv(results / "seed_spread.csv").set_index(["method", "metric"])["mean"]
    assert spread["geo-evs", "seed_spread_new"] > spread["reproject", "seed_spread_new"] == 0
    for stressor in ("support", "motion", "lateral", "edges"):
        assert read_image(results / f"{stressor}.png").std() > 10
        assert 'src="http' not in (results / f"{stressor}.html").read_text()


def test_the_metric_is_on_trial(smoke_run):
    workspace, _ = smoke_run
    audit = workspace.folder / "results/smoke/audit"
    agreement = pd.read_csv(audit / "agreement.csv").set_index(["metric", "share"])
    assert agreement.loc[("sparse_psnr", 1.0), "tau"] > 0.3
    assert agreement.loc[("sparse_psnr", 1.0), "entrants"] >= 6
    bias = pd.read_csv(audit / "support_bias.csv").set_index(["metric", "share"])["mean"]
    assert bias["sparse_ssim_zero_fill", 0.01] > 0.1 > abs(bias["sparse_ssim", 0.5])
    errors = pd.read_csv(audit / "reference_errors.csv").set_index("metric")["mean"]
    assert errors["footprint_leak"] < errors["pixel_leak"] < errors["pixel_wrong"] < 0.5
    assert errors["pixel_psnr_right"] > errors["pixel_psnr"]
    gain = pd.read_csv(audit / "conditioning_gain.csv").set_index("method")["mean"]
    assert gain["reproject"] > gain["nearest-view"]
    page = (audit / "audit.md").read_text()
    assert "When sparse PSNR can be trusted" in page
    assert read_image(audit / "agreement.png").std() > 10


def test_a_failing_method_is_a_status_and_the_last_line(smoke_run):
    workspace, run = smoke_run
    scores = pd.read_parquet(workspace.folder / "results/smoke/scores.parquet")
    failed = scores[scores["method"] == "external"]
    assert (failed["status"] == "failed").all()
    assert failed["value"].isna().all()
    assert failed["stage"].unique().tolist() == ["fit"]
    assert (workspace.folder / failed["log"].iloc[0]).exists()
    others = scores[scores["method"] != "external"]
    assert len(failed) == len(others[others["method"] == "reproject"])
    assert not (others["status"] == "failed").any()
    last = [line for line in run.stderr.splitlines() if line.strip()][-6:]
    named = [line for line in last if line.startswith("FAILED: external")]
    assert named
    assert "nowhere" in named[0]


def test_the_report_shows_every_table_chart_and_failure(smoke_run):
    workspace, _ = smoke_run
    results = workspace.folder / "results/smoke"
    page = (results / "report.html").read_text()
    assert len(page) < 5e6
    for path in (*results.glob("tables/*.csv"), *results.glob("charts/*.csv")):
        assert f'aria-label="Table {path.stem}"' in page or f"charts/{path.stem}" in page
    assert "External images could not fit street/junction-201" in page
    assert "Not measured: fid, as " in page


def test_distances_of_sets_fill_the_table_of_observed_views(smoke_run):
    workspace, _ = smoke_run
    table = pd.read_csv(workspace.folder / "results/smoke/tables/observed.csv")
    rows = table.set_index(["method", "variant"])
    copies, flat = (rows.loc[(name, "default")] for name in ("truth", "mean-colour"))
    assert copies["texture_energy"] == pytest.approx(0.0, abs=1e-6)
    assert flat["texture_energy"] > 10 * abs(flat["texture_energy_floor"])
    learned = ["efficientnet_kd", "efficientnet_fd", "efficientnet_layers"]
    assert copies[learned].to_numpy(float) == pytest.approx(0.0, abs=1e-6)
    assert flat["efficientnet_kd"] > 10 * abs(flat["efficientnet_kd_floor"])
    ran = rows[rows["n"] > 0]
    assert ran[["texture_energy", *learned]].notna().all(axis=None)
    assert ran["unmeasured"].str.contains("fid: ").all()


def test_why_names_what_a_cell_was_made_of(smoke_run):
    workspace, _ = smoke_run
    command = [sys.executable, "-m", "geoevs.cli.main", "why", "extrapolation", "geo-evs"]
    run = subprocess.run(
        [*command, "sparse_psnr", "--run", "smoke"],
        cwd=workspace.folder,
        capture_output=True,
        text=True,
        check=True,
    )
    shown = re.search(r"lowest +\S+: (\S+)", run.stdout)
    assert (workspace.folder / shown[1]).exists()
    rerun = shlex.split(run.stdout.splitlines()[-1].removeprefix("rerun"))
    first = rerun[: rerun.index("&&")]
    assert first[0] == "snakemake"
    plan = workspace.snakemake("-n", *first[3:])
    jobs = re.findall(r"^rule (\w+):", plan.stdout + plan.stderr, re.MULTILINE)
    assert jobs == ["fit", "render", "score"]


def test_compare_says_what_a_table_leaves_open(smoke_run):
    workspace, _ = smoke_run
    command = [sys.executable, "-m", "geoevs.cli.main", "compare", "extrapolation"]
    run = subprocess.run(
        [*command, "reproject-inpaint", "mean-colour", "--run", "smoke"],
        cwd=workspace.folder,
        capture_output=True,
        text=True,
        check=True,
    )
    table = pd.read_csv(workspace.folder / "results/smoke/tables/extrapolation.csv")
    means = table[table["variant"] == "default"].set_index("method")["psnr"]
    line = next(line.split() for line in run.stdout.splitlines() if line.split()[0] == "psnr")
    assert line[2:4] == [f"{means[name]:.2f}" for name in ("reproject-inpaint", "mean-colour")]
    gain = means["reproject-inpaint"] - means["mean-colour"]
    assert float(line[4]) == pytest.approx(gain, abs=0.011)


def test_a_second_call_has_nothing_to_do(smoke_run):
    workspace, _ = smoke_run
    wanted = (*workspace.EVERYTHING, "report")
    again = workspace.snakemake(*workspace.SMOKE, "failing.yaml", "-n", "--", *wanted)
    assert "Nothing to be done" in again.stdout + again.stderr


def test_training_is_a_cost_beside_the_fit(smoke_run):
    workspace, _ = smoke_run
    results = workspace.folder / "results/smoke"
    costs = pd.read_csv(results / "tables/costs.csv").set_index(["method", "variant"])
    tuned = read_json(results / "geometry/vggt.seconds.json")["training"]
    for method, training in (("geo-evs", "geo-evs/v3"), ("freevs", "freevs/default")):
        seconds = read_json(results / f"trained/{training}.seed0/seconds.json")
        assert seconds.get("geometry", tuned) == tuned > 0
        spent = costs.loc[(method, "default"), "training_seconds"]
        assert spent == pytest.approx(sum(seconds.values()))
    assert np.isnan(costs.loc[("three-dgs", "default"), "training_seconds"])
    assert "starts from" in costs.loc[("three-dgs", "default"), "note"]
    assert "training seconds" in (results / "report.html").read_text()


def test_another_bootstrap_remakes_tables_alone(smoke_run):
    workspace, _ = smoke_run
    (workspace.folder / "other.yaml").write_text("tables: {resamples: 200}\n")
    overlays = ("failing.yaml", "other.yaml")
    plan = workspace.snakemake(*workspace.SMOKE, *overlays, "-n", "--", "tables")
    text = plan.stdout + plan.stderr
    assert "rule table:" in text
    for rule in ("scene", "fit", "render", "score", "truth", "references", "prepare"):
        assert f"rule {rule}:" not in text


def test_other_starting_weights_fine_tune_again(smoke_run, tmp_path):
    workspace, _ = smoke_run
    weights = shutil.copytree(workspace.folder / "weights", tmp_path / "other")
    with (weights / "vggt-nano.safetensors").open("ab") as file:
        file.write(b" ")
    overlay = workspace.folder / "moved.yaml"
    overlay.write_text(f"weights: {tmp_path / 'other'}\n")
    made = workspace.snakemake(*workspace.SMOKE, "failing.yaml", "moved.yaml", "-n", "--", "tables")
    assert made.returncode == 0, made.stderr[-3000:]
    rules = set(re.findall(r"^rule (\w+):$", made.stdout + made.stderr, re.MULTILINE))
    assert {"finetune_geometry", "depth_scores_of_scene", "geometry_table"} <= rules
    assert not {"scene", "truth", "references"} & rules


def test_a_killed_run_goes_on_to_the_same_bytes(smoke_run, workspace):
    finished, _ = smoke_run
    (workspace.folder / "failing.yaml").symlink_to(finished.folder / "failing.yaml")
    arguments = (*workspace.SMOKE, "failing.yaml", "--", *workspace.RESUMED)
    moments = random.Random(0)
    for _ in range(2):
        left = workspace.kill_at_work(moments.uniform(0, 8), *arguments)
        assert left & workspace.half_made()
    last = workspace.snakemake(*arguments)
    assert last.returncode == 0, last.stderr[-3000:]
    assert not workspace.half_made()
    expected = files(finished.folder / "results/smoke")
    found = files(workspace.folder / "results/smoke")
    assert found.keys() <= expected.keys()
    assert len(found) > 20
    assert [name for name in found if found[name] != expected[name]] == []


def refusal(run) -> str:
    """What a run says that could not start; dry ones say it on standard output."""
    assert run.returncode != 0
    text = run.stdout + run.stderr
    assert "Traceback" not in text
    return text


def test_a_wrong_key_is_one_sentence(workspace):
    (workspace.folder / "wrong.yaml").write_text("protocol:\n  pose_swep: {every: 2}\n")
    run = workspace.snakemake("--configfile", "config.yaml", "wrong.yaml", "-n")
    sentence = "wrong.yaml:2: 'pose_swep' is not a known key; did you mean 'pose_sweep'?"
    assert sentence in refusal(run)


def test_a_config_that_is_not_yaml_is_one_sentence(workspace):
    (workspace.folder / "config.yaml").unlink()
    (workspace.folder / "config.yaml").write_text("run: smoke\nevaluate: [street\n")
    sentence = "config.yaml:3: this is not YAML (expected ',' or ']'"
    assert sentence in refusal(workspace.snakemake("-n"))
