"""What Snakemake says of a config that it, or the Snakefile, cannot read."""

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from geoevs.config.places import merge_order

PROJECT = Path(__file__).parents[2]


@pytest.fixture
def said(tmp_path):
    """What a dry run says that is refused, in a folder with overlays of these texts."""
    for name in ("Snakefile", "workflow", "profiles", "config.yaml", "geoevs"):
        (tmp_path / name).symlink_to(PROJECT / name)

    def run(overlays: dict[str, bytes | str], *arguments: str) -> str:
        for name, text in overlays.items():
            (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
        command = [sys.executable, "-m", "snakemake", "-n", "--cores", "1", *arguments]
        begun = time.monotonic()
        process = subprocess.run(
            [*command, "--", "tables"], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert time.monotonic() - begun < 30  # 3 s where nothing else runs
        assert process.returncode != 0
        text = process.stdout + process.stderr
        assert "Traceback" not in text
        return text

    return run


GIVEN = ("--configfile", "config.yaml", "over.yaml")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("run: x\na:\n\tb: 3\n", "over.yaml:3: this is not YAML (found character '\\t'"),
        ("run: x\n".encode("utf-16"), "over.yaml is not UTF-8 text; save it as UTF-8"),
        ("- a\n", "over.yaml:1: a config holds settings as NAME: VALUE, and this is a list"),
        ("a: &a [*a]\n", "over.yaml:1: this anchor stands within itself"),
    ],
)
def test_an_overlay_that_snakemake_reads_first(said, text, sentence):
    assert sentence in said({"over.yaml": text}, *GIVEN)


def test_an_overlay_that_is_missing(said):
    assert "there is no config file workflow/scales/smok.yaml; did you mean 'smoke.yaml'?" in said(
        {}, "--configfile", "config.yaml", "workflow/scales/smok.yaml"
    )


@pytest.mark.parametrize(
    ("arguments", "place"),
    [
        (GIVEN, "over.yaml:2: "),
        (("--configfile", "over.yaml"), "over.yaml:2: "),
        (("--configfile", "over.yaml", "good.yaml", "--config", "run=x"), "over.yaml:2: "),
        (("--configfile", "good.yaml", "--config", "seed=-1"), "--config: "),
    ],
)
def test_the_origin_of_a_mistake_is_named(said, arguments, place):
    overlays = {"over.yaml": "# mine\nseed: -1\n", "good.yaml": "run: y\n"}
    assert f"\n{place}'seed' is wrong: -1 is too small" in said(overlays, *arguments)


def test_a_mistake_is_placed_where_snakemake_takes_the_value_from(tmp_path):
    files = {"config.yaml": "own", "a.yaml": "first", "b.yaml": "second"}
    for name, value in files.items():
        (tmp_path / name).write_text(yaml.safe_dump({name[0]: value, "all": value}))
    (tmp_path / "Snakefile").write_text(
        'configfile: "config.yaml"\n'
        "import json, sys\n"
        "given = workflow.config_settings.configfiles\n"
        "own = workflow.configfiles[len(given):]\n"
        'print("FOUND", json.dumps([config["all"], list(map(str, own)), list(map(str, given))]))\n'
        "rule all:\n"
    )
    for given in (
        [],
        ["a.yaml"],
        ["config.yaml", "a.yaml"],
        ["b.yaml", "config.yaml"],
        ["a.yaml", "b.yaml", "a.yaml"],
        [str(tmp_path / "b.yaml")],
    ):
        options = ["--configfile", *given] if given else []
        run = subprocess.run(
            [sys.executable, "-m", "snakemake", "-n", "--cores", "1", *options],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        value, own, names = json.loads(re.search(r"FOUND (.*)", run.stdout + run.stderr)[1])
        assert files[merge_order(own, names)[-1].name] == value, given


STEP = """
import json, sys
from pathlib import Path
from geoevs.core.attempts import attempt_after
told, out = int(sys.argv[1]), Path(sys.argv[2])
Path("runs").open("a").write(f"{told} ")
fault = Path("fault").exists()
out.mkdir()
out.joinpath("fit.json").write_text(json.dumps({"a": {"attempt": attempt_after(told, fault)}}))
"""


def test_faults_of_the_machine_in_succession_have_one_more_attempt(tmp_path):
    (tmp_path / "step.py").write_text(STEP)
    (tmp_path / "Snakefile").write_text(
        "from pathlib import Path\n"
        "LIMITS = {}\n"
        "in_run = str\n"
        f'include: "{PROJECT}/workflow/rules/attempts.smk"\n'
        "rule all:\n"
        '    input: "models/x"\n'
        "rule fit:\n"
        '    output: directory("models/{label}")\n'
        "    params:\n"
        '        attempt=attempt("models/{label}", "fit.json"),\n'
        '        told=told("fit.json"),\n'
        '        other=Path("other").read_text(),\n'
        f'    shell: "{sys.executable} step.py {{params.told}} {{output}}"\n'
    )

    def runs(fault: bool, other: str = "0") -> list[int]:
        """What the step is told in one call of snakemake, if it is run at all."""
        for name, there in (("fault", fault), ("other", True)):
            (tmp_path / name).unlink(missing_ok=True)
            if there:
                (tmp_path / name).write_text(other)
        (tmp_path / "runs").write_text("")
        command = [sys.executable, "-m", "snakemake", "--cores", "1", "--quiet", "all"]
        subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
        return [int(told) for told in (tmp_path / "runs").read_text().split()]

    assert runs(fault=True) == [0]
    assert runs(fault=True) == [3]  # the next call tries again
    assert runs(fault=True) == []  # and the second in succession stays
    assert runs(fault=False, other="1") == [3]  # until something else changes
    assert runs(fault=False, other="1") == []
    assert runs(fault=True, other="2") == [2]  # long after the first
    assert runs(fault=False, other="2") == [5]
    assert runs(fault=False, other="2") == []
