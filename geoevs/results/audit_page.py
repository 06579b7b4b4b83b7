"""The audit in words, every number of them from its tables."""

import math
from pathlib import Path

import pandas as pd

from geoevs.core.files import write_text
from geoevs.results.audit import audit_tables
from geoevs.results.audit_chart import agreement_chart, support_chart
from geoevs.results.chart_pages import write_page
from geoevs.results.entrants import Entrants
from geoevs.results.escaping import csv_text
from geoevs.results.formats import markdown_grid
from geoevs.results.settings import TableSettings

RANKS_WELL = 0.8
"""The tau from which on methods are said to be ranked well: nine of ten pairs in the same order."""


def write_audit(
    folder: Path, rows: pd.DataFrame, settings: TableSettings, entrants: Entrants
) -> None:
    """Write the audit's tables as CSV, two of them as charts, and the page in words.

    Args:
        folder: where `<table>.csv`, `agreement` and `support_bias` as PNG and HTML, and `audit.md`
            go.
        rows: the audit's rows (AUDIT_TYPES).
        settings: the config's `tables` section.
        entrants: who plays.
    """
    tables = audit_tables(rows, settings, entrants)
    for name, table in tables.items():
        write_text(folder / f"{name}.csv", csv_text(table))
    write_page(folder / "agreement", agreement_chart(tables["agreement"]))
    write_page(folder / "support_bias", support_chart(tables["support_bias"]))
    write_text(folder / "audit.md", audit_markdown(tables))


def audit_markdown(tables: dict[str, pd.DataFrame]) -> str:
    """One page: when to trust the sparse metric, then what stands behind each sentence.

    Args:
        tables: what `audit_tables` made, by name.
    """
    parts = ["# The metric on trial\n"]
    for dataset in tables["ceiling"]["dataset"].unique():
        of_dataset = {
            name: table[table["dataset"] == dataset] if len(table) else table
            for name, table in tables.items()
        }
        parts.append(f"## {dataset}: When sparse PSNR can be trusted\n")
        parts += [f"- {sentence}" for sentence in _verdicts(of_dataset)]
        parts.append("")
        if len(of_dataset["agreement"]):
            parts.append(_agreement_grid(of_dataset["agreement"]) + "\n")
    return "\n".join(parts)


def _verdicts(tables: dict[str, pd.DataFrame]) -> list[str]:
    said = []
    if len(tables["agreement"]):
        said += _ranking(tables["agreement"])
        said += _support(tables["support_bias"])
        said += _wrong_pixels(tables["reference_errors"])
    said += _ceiling(tables["ceiling"])
    said += _harm(tables["harm"])
    if len(tables["conditioning_gain"]):
        said += _gain(tables["conditioning_gain"])
    return said


def _ranking(table: pd.DataFrame) -> list[str]:
    rows = table[table["metric"] == "sparse_psnr"].set_index("share")
    whole, thin = rows.loc[rows.index.max()], rows.loc[rows.index.min()]
    well = "It ranks" if whole["tau_low"] >= RANKS_WELL else "It does not surely rank"
    entrants = f"{whole['entrants']:.0f} entrants"
    if whole["left_out"]:
        entrants += f" ({whole['left_out']:.0f} left out, as views are missing)"
    gap = "no difference in one frame was large enough to be trusted"
    thin_gap = "no difference was"
    if not math.isnan(whole["gap"]):
        gap = f"entrants {whole['gap']:.1f} dB apart in one frame are in dense PSNR's order 19 "
        gap += "times in 20"
    if not math.isnan(thin["gap"]):
        thin_gap = f"it takes {thin['gap']:.1f} dB"
    return [
        f"**Ranks.** {well} {entrants} as dense PSNR does: Kendall's tau is "
        f"{_interval(whole, 'tau')} at a support of {whole['support']:.3f}, and "
        f"{_interval(thin, 'tau')} at {thin['support']:.4f}.",
        f"**Gaps.** At a support of {whole['support']:.3f}, {gap}; at {thin['support']:.4f}, "
        f"{thin_gap}.",
        f"**Level.** It is not dense PSNR: it lies {_interval(whole, 'bias')} dB from it.",
    ]


def _support(table: pd.DataFrame) -> list[str]:
    bias = table.set_index(["metric", "share"])["mean"]
    worst = bias["sparse_psnr"].abs().idxmax()
    thin = min(table["share"], key=lambda share: abs(share - 0.05))
    return [
        f"**Support alone.** On random pixels of the truth, sparse PSNR is off by "
        f"{bias['sparse_psnr', thin]:+.2f} dB at a support of {thin:g}, and at worst by "
        f"{bias['sparse_psnr', worst]:+.2f} dB, at {worst:g}. At {thin:g}, normalised sparse SSIM "
        f"is off by {bias['sparse_ssim', thin]:+.3f}, the zero-filled reading by "
        f"{bias['sparse_ssim_zero_fill', thin]:+.3f}."
    ]


def _wrong_pixels(table: pd.DataFrame) -> list[str]:
    mean = table.set_index("metric")["mean"]
    kinds = ("wrong", "leak", "colour")
    pixel, footprint = (
        [f"{100 * mean[f'{rule}_{kind}']:.1f} %" for kind in kinds]
        for rule in ("pixel", "footprint")
    )
    return [
        f"**Wrong pixels.** {pixel[0]} of the reference's pixels are wrong: {pixel[1]} background "
        f"that leaks through, {pixel[2]} coloured across an occlusion edge. Under the footprint "
        f"rule {footprint[0]} are: {footprint[1]} and {footprint[2]}.",
        f"**Best score.** The truth itself scores {mean['pixel_psnr']:.1f} dB against the "
        f"reference, {mean['pixel_psnr_right']:.1f} dB on the pixels that are not wrong. Scores "
        "near that say nothing.",
    ]


def _ceiling(table: pd.DataFrame) -> list[str]:
    rows = table[table["metric"] == "sparse_psnr"].set_index("target")
    cameras = ", ".join(f"{camera} {mean:.1f}" for camera, mean in rows["mean"].items())
    return [
        "**Noise ceiling.** Photos of recorded cameras score, against LiDAR that the other cameras "
        f"coloured, in dB: {cameras}. Where cameras overlap, expect no more of a method."
    ]


def _harm(table: pd.DataFrame) -> list[str]:
    """Which distances rise with every grade of every harm, and from which grade above the floor."""
    rising, others, floors = [], [], []
    for metric, rows in table.groupby("metric", sort=False):
        graded = [group["distance"] for _, group in rows.groupby("harm", sort=False)]
        rises = all((distance.diff()[1:] > 0).all() for distance in graded)
        (rising if rises else others).append(metric)
        beyond = rows[rows["distance"] > rows["floor"]].groupby("harm", sort=False).first()
        grades = ", ".join(f"{harm} {grade:g}" for harm, grade in beyond["grade"].items())
        floors.append(f"{metric} from {grades or 'no grade'} on")
    if table.empty:
        return []
    said = (
        f"**Harm.** With every grade of blur, noise and holes rise: {', '.join(rising) or 'none'}"
    )
    said += f"; do not: {', '.join(others)}" if others else ""
    return [f"{said}. Beyond the distance of another instant are {'; '.join(floors)}."]


def _gain(table: pd.DataFrame) -> list[str]:
    rows = table[table["lacking"] == 0]
    rows = rows.rename(columns={"mean": "gain", "low": "gain_low", "high": "gain_high"})
    if rows.empty:
        return []
    most = rows.loc[rows["gain"].idxmax()]
    who = f"{most['name']} gains" if most["gain"] > 0 else f"nobody gains: {most['name']} has"
    return [
        f"**Leaks.** Scored on the points that it may read, {who} {_interval(most, 'gain')} dB "
        "over the split that keeps them apart; the median entrant's difference is "
        f"{rows['gain'].median():+.2f}."
    ]


def _interval(row: pd.Series, name: str, digits: int = 2) -> str:
    """A mean and its interval; nothing where there is none."""
    if math.isnan(row[name]):
        return ""
    mean, low, high = (f"{row[name + end]:.{digits}f}" for end in ("", "_low", "_high"))
    return f"{mean} [{low}, {high}]"


def _agreement_grid(table: pd.DataFrame) -> str:
    body = [
        [
            row["metric"],
            f"{row['support']:.4f}",
            _interval(row, "bias", 2 if "psnr" in row["metric"] else 4),  # dB, or shares of 1
            _interval(row, "tau"),
            "" if math.isnan(row["gap"]) else f"{row['gap']:.2g}",
        ]
        for _, row in table.iterrows()
    ]
    return markdown_grid(["metric", "support", "bias", "tau", "trusted gap in a frame"], body)
