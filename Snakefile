# Geo-EVS: the whole protocol as one DAG. `snakemake --cores 2 tables` makes every table.
from snakemake.utils import min_version

min_version("9.27")


configfile: "config.yaml"


include: "workflow/rules/common.smk"
include: "workflow/rules/scenes.smk"
include: "workflow/rules/targets.smk"
include: "workflow/rules/baselines.smk"
include: "workflow/rules/score.smk"
include: "workflow/rules/tables.smk"


container: None


rule all:
    input:
        rules.tables.input,
        rules.breakdowns.input,
    default_target: True
