import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from geoevs.cli import main as cli
from geoevs.core.parquet import write_parquet
from geoevs.methods.tiny import write_tiny_scene


def test_without_arguments_it_shows_its_commands():
    command = [sys.executable, "-m", "geoevs.cli.main"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    text = run.stdout + run.stderr
    for name in ("scene", "targets", "fit", "render", "score", "table", "check-adapter"):
        assert f" {name} " in text
    assert "Traceback" not in text


def test_the_help_shows_what_people_call_first(geoevs):
    code, text, _ = geoevs("--help")
    assert code == 0
    _, people, workflow = re.split("─ For people ─|─ For the workflow ─", text)
    names = re.compile("│ ([a-z-]+)  ")
    assert tuple(names.findall(people)) == cli.FOR_PEOPLE
    assert {"scene", "fit", "stress", "stability-score", "report"} <= set(names.findall(workflow))
    assert not set(names.findall(workflow)) & set(cli.FOR_PEOPLE)


def test_an_unknown_command_is_named(geoevs):
    code, _, errors = geoevs("scor")
    assert code == 2
    assert "No such command 'scor'" in errors


def test_a_mistake_is_one_line_and_exit_code_1(geoevs, tmp_path):
    code, output, errors = geoevs(
        "targets",
        "--scene",
        tmp_path / "none",
        "--protocol",
        "{}",
        "--out",
        tmp_path / "t",
    )
    scene = tmp_path / "none" / "scene.json"
    assert (code, output) == (1, "")
    assert errors == f"error: {scene} is missing; make or copy it there\n"


def test_failures_are_those_of_the_run_and_of_its_stability_suite(geoevs, tmp_path):
    row = {"dataset": "d", "scene": "s", "method": "mine", "variant": "default", "stage": "fit"}
    row |= {"status": "failed", "reason": "no points", "log": "a.log"}
    costs, stability = tmp_path / "costs.parquet", tmp_path / "scores.parquet"
    assert geoevs("failures", costs, stability) == (0, "", "")
    pd.DataFrame([row | {"sources": "all-cameras"}]).to_parquet(costs)
    stress = {"stressor": "support", "level": 0.01, "seed": 2}
    pd.DataFrame([row | stress]).to_parquet(stability)
    _, _, errors = geoevs("failures", costs, stability)
    start = "FAILED: mine (default) could not fit d/s, "
    assert errors.splitlines() == [
        f"{start}from all-cameras: no points; log: a.log",
        f"{start}stressed by support 0.01 (draws 2): no points; log: a.log",
    ]


def test_the_log_keeps_the_traceback(geoevs, tmp_path):
    log = tmp_path / "logs" / "a.log"
    _, _, errors = geoevs("--log", log, "failures", tmp_path)
    assert errors.startswith(f"error: {tmp_path} is a folder, not a file")
    assert errors.count("\n") == 1
    assert log.read_text().startswith(f"{errors}\nTraceback")


def test_a_fault_of_ours_says_where_its_traceback_is(geoevs, tmp_path, monkeypatch):
    def fail(*arguments):
        raise ZeroDivisionError("two\nlines")

    monkeypatch.setattr("geoevs.protocol.targets.make_targets", fail)
    scene = write_tiny_scene(tmp_path / "tiny").folder
    arguments = ("targets", "--scene", scene, "--protocol", "{}", "--out", tmp_path / "t")
    code, _, errors = geoevs(*arguments)
    start = "internal error: ZeroDivisionError: two lines ("
    assert code == 1
    assert errors == f"{start}repeat it as `geoevs --log FILE ...` for the traceback)\n"
    _, _, errors = geoevs("--log", tmp_path / "log", *arguments)
    assert errors == f"{start}see {tmp_path / 'log'})\n"
    assert "Traceback" in (tmp_path / "log").read_text()


def test_a_log_that_cannot_be_written_is_the_error(geoevs, tmp_path):
    (tmp_path / "file").write_text("")
    code, _, errors = geoevs("--log", tmp_path / "file" / "log", "failures", tmp_path / "none")
    assert code == 1
    assert errors.startswith(f"error: cannot write {tmp_path / 'file' / 'log'} (")


def test_a_log_of_a_good_run_is_empty(geoevs, tmp_path):
    code, output, errors = geoevs("--log", tmp_path / "log", "failures", tmp_path / "none")
    assert (code, output, errors) == (0, "", "")
    assert (tmp_path / "log").read_text() == ""


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("frames=8", "--protocol is not JSON (Expecting value: line 1 column 1 (char 0)); write "),
        ("{", "--protocol is not JSON ("),
        ("[1]", "--protocol is [1]; write a JSON object, such as '{\"steps\": 100}'"),
    ],
)
def test_options_that_are_not_json_are_one_sentence(geoevs, tmp_path, text, sentence):
    scene = write_tiny_scene(tmp_path / "tiny").folder
    code, _, errors = geoevs(
        "targets",
        "--scene",
        scene,
        "--protocol",
        text,
        "--out",
        tmp_path / "targets.json",
    )
    assert code == 1
    assert errors.startswith(f"error: {sentence}")
    assert not (tmp_path / "targets.json").exists()


def test_an_unknown_table_is_named(geoevs, tmp_path):
    settings = ("--settings", "{}", "--entrants", tmp_path / "e", "--out", tmp_path / "t")
    code, _, errors = geoevs("table", "interpolate", "--scores", tmp_path / "none", *settings)
    assert code == 1
    assert errors.startswith("error: there is no table 'interpolate'; did you mean 'interpolation'")


def test_settings_of_tables_are_checked(geoevs, tmp_path):
    given = ("--scores", tmp_path / "s", "--entrants", tmp_path / "e", "--out", tmp_path / "t")
    geoevs("entrants", "--options", "{}", "--out", tmp_path / "e")
    pd.DataFrame().to_parquet(tmp_path / "s")
    code, _, errors = geoevs("ablation-table", *given, "--settings", '{"resample": 9}')
    assert code == 1
    assert errors.startswith("error: the section 'tables' has no option 'resample'; did you mean")


def test_entrants_are_written_down(geoevs, tmp_path):
    options = '{"truth": {}, "mean-colour": {}}'
    path = tmp_path / "entrants.json"
    assert geoevs("entrants", "--options", options, "--out", path) == (0, "", "")
    names = {name: found["name"] for name, found in json.loads(path.read_text()).items()}
    assert names == {"truth": "Truth", "mean-colour": "Mean colour"}


def test_a_scene_without_its_data_set_is_named(geoevs, tmp_path):
    arguments = ("--run", tmp_path, "--labels", "a", "--keeps", "[1.0]", "--out", tmp_path / "o")
    code, _, errors = geoevs("grid", "observed", "--scenes", "101", *arguments)
    assert code == 1
    assert errors == "error: --scenes 101 is not of the form DATASET/SCENE; name both\n"


def test_a_stage_writes_what_the_next_one_reads(geoevs, tmp_path):
    scene = write_tiny_scene(tmp_path / "tiny").folder
    protocol = {
        "lateral": [1.0],
        "pose_sweep": {"angles": [], "every": 1},
        "masked": {"yaw": [20.0], "lateral": [2.0], "every": 2},
    }
    targets = tmp_path / "targets.json"
    code, _, errors = geoevs(
        "targets",
        "--scene",
        scene,
        "--protocol",
        json.dumps(protocol),
        "--out",
        targets,
    )
    assert (code, errors) == (0, "")
    # Two frames of three cameras, one interpolation and one shift to either side; the first has
    # them masked, too, but for the interpolation.
    assert len(json.loads(targets.read_text())) == 2 * (3 + 1 + 2) + (3 + 2)
    code, _, errors = geoevs(
        "references",
        "--scene",
        scene,
        "--targets",
        targets,
        "--out",
        tmp_path / "r.npz",
        "--masks",
        tmp_path / "m.npz",
    )
    assert (code, errors) == (0, "")
    assert (tmp_path / "r.npz").stat().st_size > 1000
    assert (tmp_path / "m.npz").stat().st_size > 1000


def test_files_of_rows_may_be_listed(geoevs, tmp_path):
    for number in range(3):
        write_parquet(tmp_path / f"{number}.parquet", pd.DataFrame({"a": [number]}))
    (tmp_path / "list").write_text(f"{tmp_path}/2.parquet\n{tmp_path}/1.parquet\n")
    out = ("--out", tmp_path / "all.parquet")
    listed = ("--list", tmp_path / "list")
    assert geoevs("collect", tmp_path / "0.parquet", *listed, *out) == (0, "", "")
    assert pd.read_parquet(tmp_path / "all.parquet")["a"].tolist() == [0, 2, 1]
    (tmp_path / "list").write_text("")
    code, _, errors = geoevs("collect", *listed, *out)
    assert code == 1
    assert errors == (
        f"error: there are no files to make {tmp_path}/all.parquet from; name at least one\n"
    )
    (tmp_path / "list").write_bytes(b"\xff\xfe")
    assert "is missing; make or copy it there" in geoevs("collect", *listed, *out)[2]


def test_rules_collect_more_files_than_an_argument_list_holds(tmp_path):
    """As Snakemake runs a long command: from a script."""
    rules = Path("workflow/rules/common.smk").read_text(encoding="utf-8")
    command = ast.literal_eval(re.search(r"^COLLECT = \((.*?)^\)", rules, re.M | re.S)[1].strip())
    for part in ("{input:q}", "{log:q}", "{output:q}"):
        assert part in command
    names = [tmp_path / f"{number:0100}.parquet" for number in range(30_000)]
    command = command.replace("{input:q}", " ".join(map(str, names)))
    command = command.replace("{log:q}", f"{tmp_path}/log")
    command = command.replace("{output:q}", f"{tmp_path}/all.parquet")
    assert len(command) > os.sysconf("SC_ARG_MAX")
    (tmp_path / "script.sh").write_text(f"set -euo pipefail; {command}")
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    run = subprocess.run(
        ["bash", tmp_path / "script.sh"],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    assert run.stderr == f"error: {names[0]} is missing; make or copy it there\n"


def test_rows_of_many_jobs_become_one_file(geoevs, tmp_path):
    frames = [pd.DataFrame({"a": ["x"] * count, "b": range(count)}) for count in (2, 0, 3)]
    frames = [frame.astype({"a": "string", "b": "int64"}) for frame in frames]
    parts = [tmp_path / f"{number}.parquet" for number in range(3)]
    for part, frame in zip(parts, frames, strict=True):
        write_parquet(part, frame)
    assert geoevs("collect", *parts, "--out", tmp_path / "all.parquet") == (0, "", "")
    found = pd.read_parquet(tmp_path / "all.parquet")
    pd.testing.assert_frame_equal(found, pd.concat(frames, ignore_index=True))
    write_parquet(parts[2], frames[0].drop(columns="b"))
    code, _, errors = geoevs("collect", *parts, "--out", tmp_path / "all.parquet")
    assert code == 1
    assert errors == (
        f"error: {parts[2]} has other columns than {parts[0]}; delete it and make it again\n"
    )
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "all.parquet"), found)
