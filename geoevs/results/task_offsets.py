"""The task metrics as a table: how far a detector can be trusted on an entrant's pictures."""

import math
from typing import Any

import numpy as np
import pandas as pd

from geoevs.detection.task_metrics import NTA_IOU
from geoevs.detection.task_rows import RECORDED
from geoevs.results.bootstrap import redraw
from geoevs.results.detection_stage import Entries, about_entrant
from geoevs.results.entrants import Entrants
from geoevs.results.settings import TableSettings

NOTHING = {
    **dict.fromkeys(("nta_iou", "nta_iou_low", "nta_iou_high"), math.nan),
    **dict.fromkeys(("vehicles", "frames", "seeds"), 0),
}
"""Of an offset of which something failed."""


def task_table(
    rows: pd.DataFrame, settings: TableSettings, entries: Entries, entrants: Entrants
) -> pd.DataFrame:
    """One row for every entrant and offset, RECORDED first.

    Args:
        rows: rows of TASK_TYPES (`geoevs.detection.task_rows`).
        settings: the config's `tables` section.
        entries: method and variant by label.
        entrants: who plays.

    Returns:
        `label`, `name`, `group`, `method`, `variant`, `needs`, `offset`, `nta_iou` in percent with
        `_low` and `_high`, `vehicles`, `frames`, `seeds`, `note`. An offset of which something
        failed has a note in the place of numbers.
    """
    found = []
    rows = rows[rows["metric"] == NTA_IOU]
    for (label, offset), group in rows.groupby(["label", "offset"], sort=False):
        failed = group[group["reason"] != ""]
        about, note = _about(label, entries, entrants)
        row = {"label": label, "offset": offset, **about, **NOTHING}
        if len(failed):
            note = f"{len(failed)} of {len(group)} frames failed: {failed['reason'].iloc[0]}"
        else:
            row |= _measured(group, settings)
        found.append(row | {"note": note})
    return pd.DataFrame(found)


def _measured(rows: pd.DataFrame, settings: TableSettings) -> dict[str, Any]:
    """The mean over vehicles; scenes and seeds are redrawn."""
    cells = rows.pivot_table(["value", "count"], "seed", "scene", aggfunc="sum", sort=True)
    value, count = (cells[name].to_numpy(np.float64) for name in ("value", "count"))
    rng = np.random.default_rng(0)
    seeds, scenes = (redraw(np.zeros(n), settings.resamples, rng) for n in value.shape)
    total = count.sum()
    mean = 100 * value.sum() / total if total else math.nan
    low = high = math.nan
    if value.size > 1 and total:
        with np.errstate(invalid="ignore"):
            drawn = (seeds @ value * scenes).sum(axis=1) / (seeds @ count * scenes).sum(axis=1)
        low, high = 100 * np.nanquantile(drawn, settings.tails, method="inverted_cdf")
    return {
        "nta_iou": mean,
        "nta_iou_low": float(low),
        "nta_iou_high": float(high),
        "vehicles": int(count[0].sum()),
        "frames": len(rows) // len(value),
        "seeds": len(value),
    }


def _about(label: str, entries: Entries, entrants: Entrants) -> tuple[dict[str, str], str]:
    if label == RECORDED:
        nobody = dict.fromkeys(("method", "variant", "needs"), "")
        return {"name": RECORDED, "group": "recorded", **nobody}, ""
    return about_entrant(*entries[label], entrants)
