"""What a cluster is sent: groups, what they ask for, and what is left when this end is killed."""

import os
import re
import signal
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pandas as pd
import psutil
import pytest
import yaml
import yte

PROJECT = Path(__file__).parents[2]
SMOKE = ("--configfile", "config.yaml", "workflow/scales/smoke.yaml", "networks.yaml")
APART = ("--executor", "apart", "--jobs", "4", "--latency-wait", "20")
SPARED = ("slurm", "kubernetes")
CONTROLS = ("reference", "mean-colour")


@pytest.fixture
def apart(workspace, plugins, monkeypatch):
    """A workspace whose Snakemake knows an executor that sends jobs elsewhere."""
    monkeypatch.setenv("PYTHONPATH", plugins)
    return workspace


def jobs_of(dry: str) -> list[dict[str, str]]:
    """What a dry run prints of each job: its rule, its group's number and its lines."""
    jobs, group = [], 0
    for line in dry.splitlines():
        group += "Group job" in line
        if found := re.fullmatch(r"( *)(?:local)?rule (\w+):", line):
            jobs.append({"rule": found[2], "group": str(group) if found[1] else ""})
        elif jobs and (found := re.fullmatch(r" +(wildcards|threads|resources): (.*)", line)):
            jobs[-1][found[1]] = found[2]
    return jobs


def kill_all_in(folder: Path) -> None:
    """Kill the jobs that a run in this folder has left."""
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if Path(process.cwd()).is_relative_to(folder):
                process.kill()
                process.wait(10)


def asked(job: dict[str, str]) -> dict[str, str]:
    """Its resources by name."""
    return dict(part.split("=", 1) for part in job["resources"].split(", "))


def test_a_scene_is_sent_as_few_jobs(apart):
    dry = apart.snakemake(*SMOKE, *APART, "-n", "--", "tables", "audit", "stability")
    assert dry.returncode == 0, (dry.stdout + dry.stderr)[-3000:]
    jobs = jobs_of(dry.stdout)
    place = "dataset=street, scene=junction-201"
    here = [job for job in jobs if job.get("wildcards", "").startswith(place)]
    entrants = [job["wildcards"] for job in here if job["rule"] == "fit"]
    alone = [job["rule"] for job in here if not job["group"]]
    assert sorted(alone) == ["audit_scene", "depth_scores_of_scene"]
    groups = {}
    for job in here:
        groups.setdefault(job["group"], []).append(job)
    groups.pop("")
    assert len(groups) + len(alone) <= len(entrants) + 4
    of_scene, *of_entrants = sorted(
        (sorted(job["rule"] for job in group) for group in groups.values()), reverse=True
    )
    of_a_scene = ["references", "scene", "scene_hash", "targets", "truth", "truth_features"]
    assert of_scene == of_a_scene
    assert of_entrants == [["fit", "render", "score"]] * len(entrants)
    for group in groups.values():  # of one entrant
        assert len({job["wildcards"] for job in group}) == 1

    stressed = [job for job in jobs if "dataset=street-stability" in job.get("wildcards", "")]
    assert all(job["group"] for job in stressed)
    rules = (PROJECT / "workflow/rules/resources.smk").read_text(encoding="utf-8")
    listed = rules.partition("\nlocalrules:\n")[2].partition("\n\n")[0]
    local = set(re.findall(r"^    (\w+),$", listed, re.MULTILINE))
    assert local >= {
        "scores",
        "costs",
        "set_scores",
        "table",
        "cost_table",
        "stability_scores",
        "audit_page",
    }
    assert not local & {"scene", "fit", "render", "train", "report", "figure", "manifest"}


# Of 64 x 96 pixels and two frames: megapixels of a picture, and of all frames.
PICTURE, FRAMES = 0.006144, 0.012288


def test_jobs_ask_for_what_their_pictures_take(apart):
    part = "results/smoke/parts/street/junction-201/geo-evs.scores.parquet"
    first = jobs_of(apart.snakemake(*SMOKE, *APART, "-n", "--", part).stdout)
    by_rule = {job["rule"]: asked(job) for job in first}
    assert by_rule["fit"]["mem_mb"] == "2125"  # 2000 + 20000 PICTURE + 100 FRAMES = 2124.1
    assert by_rule["scene"]["mem_mb"] == "1593"  # 1500 + 15000 PICTURE + 20 FRAMES = 1592.4
    assert by_rule["truth"]["runtime"] == "31"  # 30 + 25 FRAMES = 30.3
    assert by_rule["fit"]["runtime"] == by_rule["render"]["runtime"] == "270"  # 30 + 2 x 7200 s
    assert by_rule["train"]["runtime"] == "750"  # 30 + 43200 s
    assert not any("gpu" in resources for resources in by_rule.values())

    (apart.folder / "own.yaml").write_text(
        "cluster: {gpu: 1}\nbudget: {limits: {render: null}}\nresolution: [640, 960]\n"
    )
    again = apart.snakemake(*SMOKE, "own.yaml", *APART, "--attempt", "2", "-n", "--", part)
    by_rule = {job["rule"]: asked(job) for job in jobs_of(again.stdout)}
    with_gpu = {rule for rule, resources in by_rule.items() if resources.get("gpu") == "1"}
    assert with_gpu == {"fit", "render", "train", "finetune_geometry", "point_maps"}
    assert by_rule["fit"]["mem_mb"] == "28822"  # 2 (2000 + 20000 x 0.6144 + 100 x 1.2288)
    assert "runtime" not in by_rule["render"]  # it may run for ever


def test_a_method_that_ran_out_of_memory_asks_for_more(apart):
    render = apart.folder / "results/smoke/renders/street/junction-201/reproject/render.json"
    render.parent.mkdir(parents=True)
    render.write_text('{"all-cameras": {"attempt": 1}}')
    part = "results/smoke/parts/street/junction-201/reproject.scores.parquet"
    jobs = jobs_of(apart.snakemake(*SMOKE, *APART, "-n", "-F", "--", part).stdout)
    by_rule = {job["rule"]: asked(job) for job in jobs}
    assert (by_rule["fit"]["mem_mb"], by_rule["render"]["mem_mb"]) == ("2125", "4249")


def test_a_local_run_has_neither_groups_nor_limits(workspace):
    part = "results/smoke/parts/street/junction-201/reproject.scores.parquet"
    dry = workspace.snakemake(*SMOKE, "-n", "--", part)
    assert dry.returncode == 0, dry.stderr[-3000:]
    assert "Group job" not in dry.stdout
    threads = {job["rule"]: job.get("threads") for job in jobs_of(dry.stdout)}
    assert threads["fit"] == threads["render"] == "2"


@pytest.mark.parametrize("name", SPARED)
def test_profiles_keep_what_the_default_one_says(name):
    texts = [(PROJECT / f"profiles/{one}/config.yaml").read_text() for one in ("default", name)]
    raw = [yaml.safe_load(text) for text in texts]
    assert raw[0]["__definitions__"] == raw[1]["__definitions__"]
    default, profile = (yte.process_yaml(text, require_use_yte=True) for text in texts)
    del default["cores"]
    assert profile.items() >= default.items()
    assert profile["cores"] == profile["max-threads"]
    assert profile["retries"] == 1


@pytest.mark.parametrize("name", SPARED)
def test_snakemake_takes_a_profile(apart, monkeypatch, name):
    pytest.importorskip(f"snakemake_executor_plugin_{name}", reason=f"no plugin for {name}")
    given = ["-n", "--workflow-profile", f"profiles/{name}", *SMOKE]
    if name == "kubernetes":  # with a storage that is there
        given += ["--default-storage-provider", "folder", "--default-storage-prefix", "bucket"]
        for key in ("ACCESS_KEY", "SECRET_KEY"):
            monkeypatch.setenv(f"SNAKEMAKE_STORAGE_S3_{key}", "none")
    dry = apart.snakemake(*given, "--", "tables")
    assert dry.returncode == 0, (dry.stdout + dry.stderr)[-3000:]


@pytest.mark.cluster
def test_a_run_goes_on_when_the_process_that_sends_its_jobs_is_killed(apart):
    whole = yaml.safe_load((PROJECT / "config.yaml").read_text())
    nobody = dict.fromkeys(whole["methods"])
    overlay = {
        "geometry": {"model": "lidar", "finetune": None},
        "methods": nobody | {name: {} for name in CONTROLS},
        "stability": {"datasets": [], "methods": dict.fromkeys(whole["stability"]["methods"])},
    }
    (apart.folder / "own.yaml").write_text(yaml.safe_dump(overlay))
    tables = [f"results/smoke/tables/{table}.csv" for table in ("extrapolation", "costs")]
    given = (*SMOKE, "own.yaml", *APART, "--", *tables)
    sent = apart.folder / "jobs.txt"

    process = apart.start(*given)
    deadline = time.monotonic() + 600
    while not (sent.exists() and "fit render score" in sent.read_text()):
        assert process.poll() is None, "the run ended before it could be killed"
        assert time.monotonic() < deadline, "no entrant was sent"
        time.sleep(0.2)
    refused = apart.snakemake(*given)
    assert f"is being written by process {process.pid} on " in refused.stdout + refused.stderr
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    kill_all_in(apart.folder)  # as `scancel` does, which docs/cluster.md says to call

    done = apart.snakemake(*given)
    assert done.returncode == 0, (done.stdout + done.stderr)[-5000:]
    # What was done of an entrant is not sent again.
    entrant = ("fit render score", "render score", "score")
    others = set(sent.read_text().splitlines()).difference(entrant)
    scene = "references scene targets truth truth_features"
    assert others == {scene, "score_sets"}
    assert Counter(sent.read_text().splitlines())[scene] == 1
    costs = pd.read_csv(apart.folder / tables[1])
    assert set(costs["n"]) == {1}
    assert costs["machines"].nunique() == 1
    assert costs["timed_on"].isna().all()
    assert "Nothing to be done" in apart.snakemake("-n", *SMOKE, "own.yaml", "--", *tables).stdout
