"""What a run says in words of its methods."""

import pytest

from geoevs.protocol.rows import COST_TYPES, cost_frame
from geoevs.results.entrants import Entrants, Info
from geoevs.results.report.sentences import summarise_run
from geoevs.results.settings import TableSettings

SETTINGS = TableSettings([0, 10, 20, 30], [0, 0.1], 200, 0.95, "geo-evs")
ENTRANTS = Entrants(
    {
        "reproject": Info("Reprojection", "control"),
        "nearest-view": Info("Nearest view", "control"),
        "mine": Info("Mine", "reconstruction"),
    }
)


@pytest.fixture
def said(rows):
    """The sentences of a run, from its score rows; all its entrants cost the same."""

    def make(*changes):
        scores = rows(*changes)
        blank = {"string": "", "int64": 0, "float64": 1.0}
        usual = {name: blank[kind] for name, kind in COST_TYPES.items()}
        usual |= {"dataset": "d", "scene": "s", "variant": "default"}
        usual |= {"sources": "all-cameras", "status": "ok"}
        costs = cost_frame([usual | {"method": method} for method in scores["method"].unique()])
        return summarise_run(scores, costs, SETTINGS, ENTRANTS)

    return make


@pytest.fixture
def best(said):
    """What is said of the best by sparse PSNR, from what entrants score in each frame."""

    def make(**values):
        lines = said(
            *[
                {"method": name.replace("_", "-"), "frame": frame, "value": value}
                for name, numbers in values.items()
                for frame, value in enumerate(numbers)
            ]
        )
        (line,) = (line for line in lines if "the best method is" in line)
        return line

    return make


def test_a_gain_in_every_view_is_sure_though_intervals_overlap(best):
    text = best(geo_evs=[20.5, 30.5, 40.5], reproject=[20.0, 30.0, 40.0])
    start = "By sparse PSNR of extrapolated views the best method is Geo-EVS (30.50 [2"
    assert text.startswith(start)
    assert "The best control is Reprojection (30.00 [2" in text
    assert text.endswith("View by view Geo-EVS gains 0.50 dB [0.50, 0.50] on Reprojection.")


def test_a_gain_that_turns_around_is_doubted(best):
    text = best(geo_evs=[21.0, 22.0], reproject=[23.0, 19.0])
    assert "Geo-EVS gains 0.50 dB [-2.00, 3.00] on Reprojection. Which of the two is" in text
    assert text.endswith("is better is not certain.")


def test_a_loss_is_called_one(best):
    text = best(geo_evs=[21.0, 22.0], reproject=[23.0, 25.0])
    assert text.endswith("View by view Geo-EVS loses 2.50 dB [2.00, 3.00] to Reprojection.")


def test_a_loss_that_turns_around_is_doubted(best):
    text = best(geo_evs=[21.0, 22.0], reproject=[20.0, 25.0])
    assert "loses 1.00 dB [-1.00, 3.00] to Reprojection. Which of the two is better is not" in text


def test_one_frame_gives_no_interval(best):
    text = best(geo_evs=[21.0], reproject=[20.0])
    assert text.endswith("gains 1.00 dB on Reprojection. One frame a scene gives no interval.")


def test_without_a_control_there_is_no_gain(best):
    assert best(geo_evs=[21.0]).endswith("the best method is Geo-EVS (21.00 dB).")


def test_the_best_is_the_highest_of_several(best):
    scores = {"worst": [18.0], "mine": [22.0], "geo_evs": [21.0]}
    text = best(**scores, nearest_view=[12.0], reproject=[19.5])
    assert (
        "the best method is Mine (22.00 dB). The best control is Reprojection (19.50 dB)." in text
    )
    assert "View by view Mine gains 2.50 dB on Reprojection." in text


def test_what_angles_cost_is_the_last_bin_minus_the_first(said):
    # The middle bin says nothing, nor do controls.
    values = {"geo-evs": (21.0, 30.0, 18.5), "mine": (20.0, 0.0, 19.0), "other": (20.0, 9.0, 20.5)}
    values |= {"reproject": (22.0, 9.0, 9.0)}
    lines = said(
        *[
            {"method": method, "split": "pose-sweep", "pose_offset": angle, "value": value}
            for method, numbers in values.items()
            for angle, value in zip((5.0, 15.0, 25.0), numbers, strict=True)
        ]
    )
    assert (
        "From 0-10 to 20-30 degrees off the front camera, sparse PSNR changes by: "
        "other +0.50 dB, Mine -1.00 dB, Geo-EVS -2.50 dB."
    ) in lines


NAN = float("nan")
FAILED = {"value": NAN, "status": "failed"}


def test_survivors_of_the_hard_frame_are_not_the_best(best):
    # Geo-EVS is 1 dB worse than Mine wherever both are, and has no hard frame.
    text = best(
        geo_evs=[29.0, NAN], mine=[30.0, 10.0], reproject=[31.0, 9.0], mean_colour=[5.0, NAN]
    )
    assert text.startswith("By sparse PSNR of extrapolated views the best method is Mine (20.00 [")
    assert "The best control is Reprojection (20.00 [" in text
    assert text.endswith(
        "Not ranked, as views are missing: Geo-EVS (29.00 dB on 1 of 2 views), "
        "mean-colour (5.00 dB on 1 of 2 views)."
    )


def test_where_every_method_lacks_a_view_none_is_the_best(said):
    lines = said(
        {"method": "geo-evs", "value": 21.0},
        {"method": "geo-evs", "frame": 1, **FAILED},
        {"method": "reproject", "frame": 1, "value": 20.0},
        {"method": "reproject", "value": 20.0},
    )
    (text,) = (line for line in lines if line.startswith("By "))
    assert "no method is the best, as none delivered all of them. The best control is Rep" in text
    assert "View by view" not in text
    assert lines[0].endswith("; 1 of them failed on some or all.")
    (frontier,) = (line for line in lines if "faster and better" in line)
    assert frontier.startswith("Of those that delivered every view, nothing is both faster and")
    assert "Geo-EVS" not in frontier


def test_a_decline_needs_the_views_of_both_ends(said):
    values = {"geo-evs": (21.0, 18.5), "mine": (20.0, None), "other": (None, 19.0)}
    lines = said(
        *[
            {"method": method, "split": "pose-sweep", "pose_offset": angle, "frame": frame}
            | ({"value": number} if number and not (method == "other" and frame) else FAILED)
            for method, numbers in values.items()
            for angle, number in zip((5.0, 25.0), numbers, strict=True)
            for frame in (0, 1)
        ]
    )
    (text,) = (line for line in lines if line.startswith("From 0-10 to 20-30"))
    assert text.endswith(
        "changes by: Geo-EVS -2.50 dB. Left out, as views are missing: Mine, other."
    )


def test_worse_than_the_floor_says_of_which_views(said):
    floor = [{"method": "mean-colour", "frame": frame, "value": 20.0} for frame in (0, 1)]
    lines = said(
        *floor, {"method": "mine", "value": 19.0}, {"method": "mine", "frame": 1, **FAILED}
    )
    (text,) = (line for line in lines if line.startswith("Worse than one colour"))
    assert text.endswith("Mine on sparse_psnr (on the views that it delivered).")
