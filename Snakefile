# Geo-EVS: the whole protocol as one DAG. `snakemake --cores 2 tables` makes every table.
from pathlib import Path

from geoevs.config.files import read_nodes
from geoevs.core.errors import GeoEvsError
from snakemake.exceptions import WorkflowError
from snakemake.utils import min_version

min_version("9.27")
if Path("config.yaml").exists():
    try:
        read_nodes("config.yaml")
    except GeoEvsError as mistake:
        raise WorkflowError(str(mistake)) from None


configfile: "config.yaml"


# The base of `snakemake --sdm apptainer`; constraints.txt pins what is installed on it. A tag can be
# moved: where that matters, name the image by its digest (docker://python@sha256:...).
container: "docker://python:3.11.13-bookworm"


include: "workflow/rules/common.smk"
include: "workflow/rules/attempts.smk"
include: "workflow/rules/resources.smk"
include: "workflow/rules/provenance.smk"
include: "workflow/rules/scenes.smk"
include: "workflow/rules/geometry.smk"
include: "workflow/rules/trainings_common.smk"
include: "workflow/rules/trainings.smk"
include: "workflow/rules/targets.smk"
include: "workflow/rules/baselines.smk"
include: "workflow/rules/score.smk"
include: "workflow/rules/tables.smk"
include: "workflow/rules/charts.smk"
include: "workflow/rules/stability_common.smk"
include: "workflow/rules/stability.smk"
include: "workflow/rules/audit.smk"
include: "workflow/rules/detection_common.smk"
include: "workflow/rules/detection.smk"
include: "workflow/rules/report.smk"
include: "workflow/rules/pretrain.smk"


rule all:
    default_target: True
    input:
        rules.tables.input,
        rules.breakdowns.input,
        rules.charts.input,
        rules.report.output,


onstart:
    lock_run()
    # Locally no queue needs sparing, and the rate limiter of Snakemake 9.27 wakes the scheduler once
    # more a second for every job done: a third of a core after 300, beside fits that are timed.
    if workflow.local_exec:
        workflow.scheduler.job_rate_limiter = None


onsuccess:
    shell(f"geoevs failures {RUN}/{layout.COSTS} {RUN}/{layout.STABILITY_SCORES}")


onerror:
    shell(f"geoevs failures {RUN}/{layout.COSTS} {RUN}/{layout.STABILITY_SCORES}")
