"""What the report waits for."""

import re

SUITES = r"results/smoke/(stability|audit)/"


def test_it_waits_for_the_suites_that_the_same_call_runs(workspace):
    assert suites_before_the_report(workspace, "stability", "audit") == {"stability", "audit"}


def test_of_others_it_has_those_that_were_run_before(workspace):
    page = workspace.folder / "results/smoke/audit/audit.md"
    page.parent.mkdir(parents=True)
    page.write_text("")
    assert suites_before_the_report(workspace) == {"audit"}


def suites_before_the_report(workspace, *others):
    plan = workspace.snakemake(*workspace.SMOKE, "-n", "--", *others, "report")
    assert plan.returncode == 0, plan.stderr[-3000:]
    found = re.search(r"^rule report:\n    input: (.*)", plan.stdout + plan.stderr, re.MULTILINE)
    return set(re.findall(SUITES, found[1]))
