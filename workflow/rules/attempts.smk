# Which attempt of a step a job is, by what the last one left (geoevs/core/attempts.py).

from geoevs.core.attempts import attempt_file, next_attempt


def attempt_of(output, outcomes):
    """The number of the attempt that an output asks for, or files of these names in it."""
    files = [file for name in outcomes for file in Path(output).glob(name)]
    alone = [Path(output), attempt_file(Path(output))]
    return next_attempt(files if outcomes else alone, LIMITS)


def attempt(pattern, *outcomes):
    """A function for `params`: half the number of the attempt, which makes a job run again.

    After a fault of the machine it is another than the last time.
    """
    return lambda wildcards: (
        attempt_of(in_run(pattern).format(**wildcards), outcomes) // 2
    )


def tried(pattern, *outcomes):
    """A function for resources: the number itself, odd after a fault of the machine."""
    return lambda wildcards: attempt_of(in_run(pattern).format(**wildcards), outcomes)


def told(*outcomes):
    """A function for `params`: the number of the attempt, which a job is told.

    Snakemake does not remember params that are made of an output, so it makes no job run again.
    """
    return lambda wildcards, output: attempt_of(output[0], outcomes)
