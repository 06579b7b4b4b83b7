"""What a run says in words of its best method."""

import pytest

from geoevs.protocol.rows import COST_TYPES, cost_frame
from geoevs.results.report.sentences import summarise_run

SETTINGS = {"pose_bins": [0, 15, 30], "support_bins": [0, 0.1]}
SETTINGS |= {"resamples": 200, "confidence": 0.95}


@pytest.fixture
def best(rows):
    """The sentence on the best by sparse PSNR, from what two entrants score in each frame."""

    def make(**values):
        methods = [name.replace("_", "-") for name in values]
        scores = rows(
            *[
                {"method": method, "frame": frame, "value": value}
                for method, numbers in zip(methods, values.values(), strict=True)
                for frame, value in enumerate(numbers)
            ]
        )
        blank = {"string": "", "int64": 0, "float64": 1.0}
        usual = {name: blank[kind] for name, kind in COST_TYPES.items()}
        usual |= {"dataset": "d", "scene": "s", "variant": "default"}
        usual |= {"sources": "all-cameras", "status": "ok"}
        costs = cost_frame([usual | {"method": method} for method in methods])
        said = summarise_run(scores, costs, SETTINGS)
        (sentence,) = (line for line in said if "is the best method" in line)
        return sentence

    return make


def test_a_gain_in_every_view_is_sure_though_intervals_overlap(best):
    sentence = best(geo_evs=[20.5, 30.5, 40.5], reproject=[20.0, 30.0, 40.0])
    assert sentence.startswith("By sparse PSNR of extrapolated views Geo-EVS (30.50 [2")
    assert "the best control is reproject (30.00 [2" in sentence
    assert sentence.endswith(", on which it gains +0.50 dB view by view [+0.50, +0.50].")


def test_a_gain_that_turns_around_is_doubted(best):
    sentence = best(geo_evs=[21.0, 22.0], reproject=[23.0, 19.0])
    assert "it gains +0.50 dB view by view [-2.00, +3.00], so that which of them is" in sentence


def test_a_loss_is_said_too(best):
    sentence = best(geo_evs=[21.0, 22.0], reproject=[23.0, 25.0])
    assert sentence.endswith("it gains -2.50 dB view by view [-3.00, -2.00].")


def test_one_frame_gives_no_interval(best):
    sentence = best(geo_evs=[21.0], reproject=[20.0])
    assert sentence.endswith("it gains +1.00 dB view by view; one frame a scene gives no interval.")


def test_without_a_control_or_a_shared_view_there_is_no_gain(best):
    assert best(geo_evs=[21.0]).endswith("Geo-EVS (21.00 dB) is the best method.")
    nan = float("nan")
    assert best(geo_evs=[21.0, nan], reproject=[nan, 20.0]).endswith("is reproject (20.00 dB).")
