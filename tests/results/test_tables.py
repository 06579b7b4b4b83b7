import math

import pandas as pd
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.results.entrants import Entrants, Info
from geoevs.results.formats import to_latex, to_markdown
from geoevs.results.settings import TableSettings
from geoevs.results.table_specs import bin_labels, table_spec
from geoevs.results.tables import make_table

SETTINGS = TableSettings(
    [0, 5, 10], [0, 0.02, 0.1], resamples=100, confidence=0.95, ablation="geo-evs"
)
ENTRANTS = Entrants(
    {
        "reproject": Info("Reprojection", "control", "none", "lidar", "views"),
        "reference": Info("Reference", "control"),
        "mean-colour": Info("Mean colour", "control"),
        "geo-evs": Info("Ours", "diffusion", "a latent prior", "lidar training", "views"),
        "zeta.wide": Info("Zeta", "control"),
    }
)
FAILED = {"status": "failed", "value": math.nan}
PAPER = ["three-dgs", "emernerf", "street-gaussians", "freevs", "geo-evs"]


@pytest.fixture
def table(rows):
    def make(name, *changes):
        return make_table(name, rows(*changes), SETTINGS, ENTRANTS)

    return make


def one(table, **where):
    for column, value in where.items():
        table = table[table[column] == value]
    (row,) = table.to_dict("records")
    return row


def test_the_paper_comes_first_then_methods_then_controls(table):
    made = table(
        "extrapolation",
        *[{"method": name} for name in ("reproject", "reference", "zeta", "geo-evs", "alpha")],
    )
    assert made["method"].tolist() == [*PAPER, "zeta", "alpha", "reproject", "reference"]
    assert made["group"].tolist() == ["paper"] * 5 + ["method"] * 2 + ["control"] * 2


def test_who_plays_is_said_in_the_last_columns(table):
    made = table("observed", {"method": "geo-evs"}, {"method": "zeta"}, {"method": "reproject"})
    assert list(made)[-5:] == ["name", "paradigm", "extra_prior", "needs", "sees"]
    shown = {row["method"]: tuple(row.values())[-5:] for row in made.to_dict("records")}
    # The paper's name, but what was run here; of what was not run, what the paper says.
    words = ("Geo-EVS", "diffusion", "a latent prior", "lidar training", "views")
    assert shown["geo-evs"] == words
    assert shown["bevgen"] == ("BEVGen", "autoregression", "none", "", "layout")
    assert shown["reproject"] == ("Reprojection", "control", "none", "lidar", "views")
    assert shown["zeta"] == ("zeta", "", "", "", "")


def test_a_variant_alone_may_be_a_control(table):
    made = table("masked", {"method": "zeta"}, {"method": "zeta", "variant": "wide"})
    groups = made.drop_duplicates("variant").set_index("variant")["group"]
    assert groups.to_dict() == {"default": "method", "wide": "control"}


def test_paper_and_measured_stand_side_by_side(table):
    made = table(
        "extrapolation",
        {"method": "geo-evs", "value": 1.5},
        {"method": "geo-evs", "variant": "v1", "value": 2.5},
        {"method": "zeta", "metric": "psnr"},
    )
    paper = [name for name in made if name.endswith("_paper")]
    assert paper == ["sparse_psnr_paper", "sparse_ssim_paper"]
    ours = one(made, method="geo-evs", variant="default")
    assert (ours["sparse_psnr_paper"], ours["sparse_psnr"]) == (23.65, 1.5)
    assert (ours["sparse_ssim_paper"], ours["n"]) == (0.941, 1)
    variant = one(made, method="geo-evs", variant="v1")
    assert math.isnan(variant["sparse_psnr_paper"])
    assert variant["sparse_psnr"] == 2.5
    missing = one(made, method="three-dgs")
    assert missing["sparse_psnr_paper"] == 19.84
    assert math.isnan(missing["sparse_psnr"])
    assert missing["note"] == "not run"


def test_only_the_tables_split_counts(table):
    made = table(
        "interpolation",
        {"split": "interpolation", "metric": "ssim", "value": 0.5},
        {"split": "observed", "metric": "ssim", "value": 0.9, "frame": 1},
        {"split": "extrapolation", "metric": "ssim", "value": 0.1, "frame": 2},
    )
    row = one(made, method="mine")
    assert (row["ssim"], row["n"], row["note"]) == (0.5, 1, "")
    assert "lpips_paper" in made
    assert made["lpips"].isna().all()


def test_worse_than_the_floor_in_either_direction(table):
    floor = {"method": "mean-colour", "split": "interpolation"}
    made = table(
        "interpolation",
        {**floor, "metric": "psnr", "value": 20.0},
        {**floor, "metric": "mae", "value": 0.1},
        {**floor, "metric": "psnr", "value": 90.0, "variant": "other"},
        *[
            {"method": method, "split": "interpolation", "metric": metric, "value": value}
            for method, metric, value in [
                ("worse", "psnr", 19.9),
                ("worse", "mae", 0.11),
                ("better", "psnr", 20.1),
                ("better", "mae", 0.09),
                ("equal", "psnr", 20.0),
                ("equal", "mae", 0.1),
                ("mixed", "psnr", 25.0),
                ("mixed", "mae", 0.2),
                ("broken", "psnr", math.nan),
            ]
        ],
    )
    flags = made.set_index("method")["below_floor"]
    assert set(flags["worse"].split()) == {"psnr", "mae"}
    assert flags[["better", "equal", "mixed", "broken"]].tolist() == ["", "", "mae", ""]
    assert (flags["mean-colour"] == "").all()


def test_bins_are_half_open_but_the_last(table):
    made = table(
        "pose_offset",
        *[
            {"split": "pose-sweep", "pose_offset": angle, "value": angle, "frame": frame}
            for frame, angle in enumerate([0.0, 4.9, 5.0, 10.0, 10.1])
        ],
    )
    mine = made[made["method"] == "mine"]
    assert mine["bin"].tolist() == bin_labels(SETTINGS.pose_bins) == ["0-5", "5-10"]
    assert mine["sparse_psnr"].tolist() == pytest.approx([(0 + 4.9) / 2, (5 + 10) / 2])
    assert mine["n"].tolist() == [2, 2]
    paper = made[made["method"] == "geo-evs"]
    assert paper["sparse_psnr_paper"].tolist() == [24.17, 23.8]


def test_thinned_rows_fill_the_sparsity_table_alone(table):
    changes = (
        {"value": 20.0, "support_ratio": 0.05},
        {"value": 30.0, "support_ratio": 0.01, "stressor": "reference-thinning", "level": 0.2},
        {"value": 90.0, "support_ratio": 0.01, "stressor": "something-else", "level": 1.0},
    )
    assert one(table("extrapolation", *changes), method="mine")["sparse_psnr"] == 20.0
    sparsity = table("sparsity", *changes)
    mine = sparsity[sparsity["method"] == "mine"].set_index("bin")["sparse_psnr"]
    assert mine.to_dict() == {"0-0.02": 30.0, "0.02-0.1": 20.0}


def test_the_masked_table_has_both_splits(table):
    observed, virtual = "masked-observed", "masked-extrapolation"
    made = table(
        "masked",
        {"split": observed, "metric": "psnr_removed", "value": 10.0},
        {"split": virtual, "metric": "psnr_removed", "value": 20.0},
        {"split": virtual, "metric": "sparse_psnr_removed", "value": 30.0},
        {"split": "extrapolation", "metric": "psnr_supported", "value": 90.0},
        {"method": "late", "split": "observed", "metric": "psnr"},
    )
    mine = made[made["method"] == "mine"].set_index("bin")
    assert mine.index.tolist() == [observed, virtual]
    assert mine["psnr_removed"].tolist() == [10.0, 20.0]
    assert mine.loc[virtual, "sparse_psnr_removed"] == 30.0
    assert mine["psnr_supported"].isna().all()
    assert mine["n"].tolist() == [1, 1]  # of the first metric that is defined there
    late = made[made["method"] == "late"]
    assert late["note"].tolist() == ["no view here"] * 2
    assert set(made["method"]) == {"mine", "late"}  # the paper has none


def test_failures_are_noted(table):
    other = {"method": "b", **FAILED}
    made = table("extrapolation", {}, {"frame": 1}, {"frame": 2, **FAILED}, other)
    row = one(made, method="mine")
    assert (row["n"], row["failed"], row["note"]) == (
        2,
        1,
        "failed on 1 of 3 views; mean of those delivered, not ranked",
    )
    assert one(made, method="b")["note"] == "failed on 1 of 1 views"


def test_a_mean_of_fewer_views_is_marked_metric_by_metric(table):
    psnr = {"metric": "psnr", "frame": 1}
    made = table(
        "extrapolation",
        *({"method": "whole", "frame": frame} for frame in (0, 1)),
        {"method": "whole", **psnr},
        {"method": "failing"},
        {"method": "failing", "frame": 1, **FAILED},
        {"method": "failing", **psnr},
        {"method": "absent"},
        {"method": "gone", **FAILED},
        {"method": "gone", "frame": 1, **FAILED},
    )
    partial = made.set_index("method")["partial"]
    assert partial["whole"] == ""
    assert partial["failing"] == "sparse_psnr"
    assert partial["absent"] == "sparse_psnr"
    assert partial["gone"] == ""  # it has no mean
    notes = made.set_index("method")["note"]
    assert (
        notes["absent"]
        == "lacks 1 of 2 views that others have; mean of those delivered, not ranked"
    )
    assert notes["gone"] == "failed on 2 of 2 views"


def test_one_failed_seed_makes_a_mean_partial(table):
    seeds = [{"seed": seed, "value": 20.0 + seed} for seed in (0, 1, 2)]
    made = table("extrapolation", *seeds[:2], seeds[2] | FAILED, {"method": "other"})
    assert one(made, method="mine")["partial"] == "sparse_psnr"
    assert one(made, method="other")["partial"] == ""
    assert one(table("extrapolation", *seeds, {"method": "other"}), method="mine")["partial"] == ""


@pytest.mark.parametrize("lost", ["failing", "mean-colour"])
def test_the_floor_is_met_on_the_views_that_both_delivered(table, lost):
    # The hard frame is worth 10 dB less; who failed there would stand above, or below, everybody.
    values = {"mean-colour": (20.0, 10.0), "failing": (19.0, 9.0), "fine": (21.0, 11.0)}
    made = table(
        "extrapolation",
        *(
            {"method": name, "frame": frame, "value": value}
            | (FAILED if (name, frame) == (lost, 1) else {})
            for name, numbers in values.items()
            for frame, value in enumerate(numbers)
        ),
    )
    flags = made.set_index("method")["below_floor"]
    assert flags[["failing", "fine", "mean-colour"]].tolist() == ["sparse_psnr", "", ""]


def test_distances_over_fewer_images_are_marked(rows):
    usual = {"dataset": "d", "split": "observed", "variant": "default", "seed": 0, "status": "ok"}
    usual |= {"metric": "fid", "low": 1.0, "high": 3.0, "floor": 1.0, "reason": ""}
    sets = pd.DataFrame(
        [
            usual | {"method": "geo-evs", "value": 2.0, "views": 4, "failed": 4},
            usual | {"method": "zeta", "value": 5.0, "views": 8, "failed": 0},
            usual | {"method": "none", "value": math.nan, "views": 0, "failed": 8},
        ]
    )
    scores = rows(
        *({"method": name, "split": "observed", "metric": "psnr"} for name in sets["method"])
    )
    made = make_table("observed", scores, SETTINGS, ENTRANTS, sets).set_index("method")
    assert made.loc[["geo-evs", "zeta", "none"], "partial"].tolist() == ["fid", "", ""]
    text = to_markdown(table_spec("observed"), made.reset_index())
    assert "2.00 [1.00, 3.00] †" in text
    assert "5.00 [1.00, 3.00] |" in text


@pytest.mark.parametrize(
    ("name", "column", "places", "text"),
    [
        ("pose_offset", "pose_offset", [1.0, 9.0], ""),
        (
            "pose_offset",
            "pose_offset",
            [1.0, 10.0, 10.1, 31.0],
            "2 of 4 views lie in no bin: 2 above 10",
        ),
        (
            "sparsity",
            "support_ratio",
            [0.01, math.nan],
            "1 of 2 views lie in no bin: 1 without a support_ratio",
        ),
        (
            "sparsity",
            "support_ratio",
            [-0.1, 0.2],
            "2 of 2 views lie in no bin: 1 below 0, 1 above 0.1",
        ),
    ],
)
def test_views_in_no_bin_are_counted_once_for_all_entrants(rows, name, column, places, text):
    spec = table_spec(name)
    scores = rows(
        *(
            {
                "method": method,
                "split": spec.splits[0],
                "metric": metric,
                column: place,
                "frame": frame,
            }
            for method in ("mine", "other")
            for metric in ("sparse_psnr", "sparse_ssim")
            for frame, place in enumerate(places)
        )
    )
    made = make_table(name, scores, SETTINGS, ENTRANTS)
    assert made["outside"].unique().tolist() == [text]
    inside = made.loc[made["method"] == "mine", "n"].sum()
    assert inside == len(places) - int(text[:1] or 0)
    page, latex = to_markdown(spec, made), to_latex(spec, made)
    assert (f"\n{text}.\n" in page) == bool(text)
    assert (f"\n% {text}\n" in latex) == bool(text)


def test_an_angle_that_was_set_to_an_edge_is_on_it(table):
    # As arc cosines give them.
    angles = [4.999999999999999, 5.000000000000001, 10.000000000000002]
    made = table(
        "pose_offset",
        *(
            {"split": "pose-sweep", "pose_offset": angle, "frame": frame}
            for frame, angle in enumerate(angles)
        ),
    )
    assert made.loc[made["method"] == "mine", "n"].tolist() == [0, 3]
    assert set(made["outside"]) == {""}


def test_not_run_is_said_of_each_data_set_and_variant(table):
    made = table(
        "extrapolation",
        {"dataset": "one", "method": "geo-evs", "variant": "v1"},
        {"dataset": "two", "method": "mine"},
        {"dataset": "two", "method": "late", "split": "observed"},
    )
    assert made["dataset"].unique().tolist() == ["one", "two"]
    found = made.set_index(["dataset", "method", "variant"])["note"].to_dict()
    notes = {key: note for key, note in found.items() if key[1] in ("geo-evs", "mine")}
    assert len(notes) == 2 * 3
    assert [key for key, note in notes.items() if note == ""] == [
        ("one", "geo-evs", "v1"),
        ("two", "mine", "default"),
    ]
    assert {note for note in notes.values() if note} == {"not run"}
    assert one(made, dataset="two", method="late")["note"] == "no view here"


def test_a_split_that_the_run_lacks_gives_an_empty_table(table):
    made = table("pose_offset", {})
    assert made[made["method"] == "mine"]["note"].tolist() == ["no view here"] * 2
    assert made["sparse_psnr"].isna().all()


def test_different_protocols_are_refused(table):
    with pytest.raises(GeoEvsError, match="come from different protocols"):
        table("extrapolation", {}, {"fingerprint": "g"})


def test_unknown_tables_are_named(table):
    with pytest.raises(GeoEvsError, match=r"^there is no table 'sparse'; did you mean 'sparsity'"):
        table("sparse", {})
