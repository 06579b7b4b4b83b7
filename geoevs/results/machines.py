"""Which machines timed what: seconds of different processors stand in no table without a word."""

import pandas as pd

from geoevs.protocol.entries import FAILED

NAMED = 3
"""Most hosts of a processor that a sentence names; it counts the others."""


def machines_of(fits: pd.DataFrame) -> str:
    """The processors that fits were timed on, in the rows' order, each with its hosts.

    Args:
        fits: cost rows; those of earlier versions name no host.

    >>> rows = [("b", "Xeon"), ("a", "EPYC"), ("b", "Xeon"), ("c", "Xeon"), ("", "")]
    >>> machines_of(pd.DataFrame(rows, columns=["host", "cpu"]))
    'Xeon (b, c), EPYC (a), unknown'
    """
    hosts = fits.groupby("cpu", sort=False)["host"].unique()
    return ", ".join(_named(cpu, [*filter(None, of_cpu)]) for cpu, of_cpu in hosts.items())


def timed_on(costs: pd.DataFrame) -> dict[str, str]:
    """By data set, a sentence on the machines of fits that did not fail; empty where it is one."""
    return {name: _sentence(rows) for name, rows in costs.groupby("dataset", sort=False)}


def _sentence(costs: pd.DataFrame) -> str:
    rows = costs[costs["status"] != FAILED]
    machines, processors = rows[["host", "cpu"]].drop_duplicates(), rows["cpu"].nunique()
    if len(machines) < 2:
        return ""
    if processors == 1:
        return f"Timed on {len(machines)} machines with one processor: {machines_of(rows)}."
    return (
        f"Timed on {len(machines)} machines with {processors} processors, whose seconds do not "
        f"compare: {machines_of(rows)}."
    )


def _named(cpu: str, hosts: list[str]) -> str:
    more = [f"{len(hosts) - NAMED} more"] if len(hosts) > NAMED else []
    names = ", ".join([*hosts[:NAMED], *more])
    return f"{cpu or 'unknown'} ({names})" if names else cpu or "unknown"
