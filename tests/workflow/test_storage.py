"""Without a shared file system: jobs read and write what Snakemake says, wherever that lies."""

import re

COPIES = ".snakemake/storage/folder/bucket"
"""Where jobs find their copies of what lies in the storage."""


def test_no_command_names_a_file_that_snakemake_did_not_give_it(workspace, plugins, monkeypatch):
    """A path of the run outside the copies is neither an input nor an output of its job.

    The folders of trainings are none: killed ones go on from them.
    """
    monkeypatch.setenv("PYTHONPATH", plugins)
    whole = (
        *("tables", "charts", "report"),
        *("conditions", "stability", "audit", "detection", "pretrain"),
    )
    dry = workspace.snakemake(*workspace.STORAGE, *workspace.SMOKE, "-n", "-p", "--", *whole)
    assert dry.returncode == 0, (dry.stdout + dry.stderr)[-3000:]
    commands = re.findall(r"geoevs --log .*", dry.stdout)
    named = {command.split()[3] for command in commands}
    assert named >= {"scene", "fit", "render", "train", "table", "chart", "report", "audit-scene"}
    for command in commands:
        assert set(re.findall(r"--run (\S+)", command)) <= {f"{COPIES}/results/smoke"}
        rest = re.sub(r"--work \S+", "", command).replace(f"{COPIES}/results/smoke", "")
        assert "results/smoke" not in rest, command
