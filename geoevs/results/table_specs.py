"""The paper's tables: which rows each averages, by which bins, and which columns it shows."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from geoevs.core.errors import GeoEvsError, did_you_mean
from geoevs.protocol.scoring import THINNING
from geoevs.results.settings import TableSettings
from geoevs.results.views import VIEW

DIGITS = 9
"""Decimals of a bin's column that count: angles of poses are off by 1e-14 degrees."""

SET_COLUMNS = ("fid", "kid", "efficientnet_kd", "efficientnet_fd", "texture_energy")
"""The distances of sets that tables of many views show."""


@dataclass(frozen=True)
class TableSpec:
    """A table of the paper: which rows it averages, which columns it shows.

    Args:
        title: its heading.
        splits: the splits whose rows it averages.
        metrics: measured columns, the paper's first.
        set_metrics: columns of distances between sets of images, each with its floor.
        bins: the row column that divides it, or none.
        edges: the config key, under `tables`, of the bins' edges; none where each split is a bin.
    """

    title: str
    splits: tuple[str, ...]
    metrics: tuple[str, ...]
    set_metrics: tuple[str, ...] = ()
    bins: str = ""
    edges: str = ""


TABLES = {
    "extrapolation": TableSpec(
        "Extrapolation: half-way yaw, shifted sideways (paper table 2, top)",
        ("extrapolation",),
        (
            "sparse_psnr",
            "sparse_ssim",
            "sparse_psnr_new",
            "sparse_psnr_footprint",
            "psnr",
            "psnr_new",
            "psnr_supported",
            "ssim",
            "gms",
            "lpips",
            "efficientnet_layers",
        ),
        set_metrics=SET_COLUMNS,
    ),
    "interpolation": TableSpec(
        "Interpolation: the front camera from the front-side ones (paper table 5)",
        ("interpolation",),
        ("ssim", "psnr", "lpips", "mae", "gms", "efficientnet_layers"),
        set_metrics=("efficientnet_kd", "efficientnet_fd", "texture_energy"),
    ),
    "observed": TableSpec(
        "Observed views, themselves among the sources (paper table 1)",
        ("observed",),
        ("psnr", "ssim", "mae", "gms", "lpips", "efficientnet_layers"),
        set_metrics=SET_COLUMNS,
    ),
    "pose_offset": TableSpec(
        "By angle to the front camera, in degrees (paper table 2, bottom left)",
        ("pose-sweep",),
        ("sparse_psnr", "sparse_ssim", "psnr", "gms"),
        bins="pose_offset",
        edges="pose_bins",
    ),
    "sparsity": TableSpec(
        "By support ratio of the sparse reference (paper table 2, bottom right)",
        ("extrapolation",),
        ("sparse_psnr", "sparse_ssim", "sparse_ssim_zero_fill"),
        bins="support_ratio",
        edges="support_bins",
    ),
    "masked": TableSpec(
        "Masked views: conditions degraded by validity masks of other poses (paper section 3.4)",
        ("masked-observed", "masked-extrapolation"),
        (
            "psnr_supported",
            "psnr_removed",
            "psnr_never",
            "psnr_unsupported",
            "psnr",
            "sparse_psnr_removed",
        ),
        bins="split",
    ),
}


def table_spec(name: str) -> TableSpec:
    """The table called `name`.

    Raises:
        GeoEvsError: there is none; the sentence names the nearest one.
    """
    if name not in TABLES:
        raise GeoEvsError(f"there is no table '{name}'; {did_you_mean(name, TABLES)}")
    return TABLES[name]


def rows_needed(spec: TableSpec) -> dict[str, Sequence[str]]:
    """What the score rows of a table have in their columns of text (see `read_scores`)."""
    return {"split": spec.splits, "metric": spec.metrics}


def bin_labels(edges: Sequence[float]) -> list[str]:
    """Names of the bins between edges, as the paper writes them.

    >>> bin_labels([0, 0.02, 0.05])
    ['0-0.02', '0.02-0.05']
    """
    return [f"{low:g}-{high:g}" for low, high in itertools.pairwise(edges)]


def bin_names(spec: TableSpec, settings: TableSettings) -> Sequence[str]:
    """The bins of a table in order; one without a name where it has none."""
    if not spec.bins:
        return [""]
    return bin_labels(getattr(settings, spec.edges)) if spec.edges else spec.splits


def table_rows(spec: TableSpec, scores: pd.DataFrame, settings: TableSettings) -> pd.DataFrame:
    """The score rows that a table averages, with the column `bin`; those in no bin are left out."""
    rows = _rows_of_table(spec, scores)
    if not spec.edges:
        return rows.assign(
            bin=rows[spec.bins]
            if spec.bins
            else pd.Categorical.from_codes(np.zeros(len(rows), np.int8), [""])
        )
    edges = getattr(settings, spec.edges)
    closed = [*edges[:-1], math.nextafter(edges[-1], math.inf)]  # the last bin holds its end
    cut = pd.cut(_places(rows, spec), closed, right=False, labels=bin_labels(edges))
    return rows.assign(bin=cut.astype("string").astype("category")).dropna(subset="bin")


def views_in_no_bin(
    spec: TableSpec, scores: pd.DataFrame, settings: TableSettings
) -> dict[str, str]:
    """For every data set that has some, how many views a table leaves out, and where they lie.

    A view that is scored at several shares of its reference counts once for each.
    """
    if not spec.edges:
        return {}
    edges = getattr(settings, spec.edges)
    views = _rows_of_table(spec, scores).drop_duplicates(["dataset", *VIEW])
    found = {}
    for dataset, here in _places(views, spec).groupby(views["dataset"], sort=False):
        counts = {
            f"below {edges[0]:g}": (here < edges[0]).sum(),
            f"above {edges[-1]:g}": (here > edges[-1]).sum(),
            f"without a {spec.bins}": here.isna().sum(),
        }
        places = [f"{count} {place}" for place, count in counts.items() if count]
        if places:
            outside = f"{sum(counts.values())} of {len(here)} views lie in no bin"
            found[dataset] = f"{outside}: {', '.join(places)}"
    return found


def _places(rows: pd.DataFrame, spec: TableSpec) -> pd.Series:
    """Where rows lie among a table's edges; an angle that was set to an edge is on it."""
    return rows[spec.bins].round(DIGITS)


def _rows_of_table(spec: TableSpec, scores: pd.DataFrame) -> pd.DataFrame:
    """The score rows of a table, whatever their bin."""
    rows = scores[scores["split"].isin(spec.splits) & scores["metric"].isin(spec.metrics)]
    return rows[
        (rows["stressor"] == "") | ((rows["stressor"] == THINNING) & (spec.edges == "support_bins"))
    ]
