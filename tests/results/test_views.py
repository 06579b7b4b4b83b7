"""What entrants lack: by hand, and that nobody rises by failing."""

import math
import re

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geoevs.protocol.rows import COST_TYPES, SCORE_TYPES, cost_frame, score_frame
from geoevs.results.charts import COSTS, speed_accuracy
from geoevs.results.entrants import ENTRANT, Entrants, Info
from geoevs.results.report.sentences import summarise_run
from geoevs.results.settings import TableSettings
from geoevs.results.tables import make_table
from geoevs.results.views import lacking, lacking_of_sets, with_lacking

SETTINGS = TableSettings([0, 15, 30], [0, 0.1], 20, 0.9, "geo-evs")
ENTRANTS = Entrants(
    {
        "mean-colour": Info("Mean colour", "control"),
        "copy": Info("Copy", "control"),
        **{name: Info(name.title(), "reconstruction") for name in ("mine", "other", "third")},
    }
)
FAILED = {"status": "failed", "value": math.nan}
EMPTY = {"status": "empty-mask", "value": math.nan}
BY = [*ENTRANT, "metric"]


def missing(table, view=None):
    """What `lacking` says, by entrant and metric where there are several."""
    found = lacking(table, BY, **({"view": view} if view else {}))
    return found.set_index(["method", "metric"])["lacking"].to_dict()


def of(method, *changes):
    return [{"method": method, "frame": frame, **change} for frame, change in enumerate(changes)]


@pytest.mark.parametrize(
    ("mine", "other", "expected"),
    [
        ([{}, {}], [{}, {}], (0, 0)),
        ([{}, FAILED], [{}, {}], (1, 0)),
        ([FAILED, FAILED], [{}, {}], (2, 0)),
        ([{}], [{}, {}], (1, 0)),  # there is no row
        ([{}, EMPTY], [{}, {}], (1, 0)),
        ([{}, EMPTY], [{}, EMPTY], (0, 0)),  # nobody has a value there
        ([{}, FAILED], [{}, EMPTY], (1, 0)),  # but a failure is one
        ([{}, FAILED], [FAILED, {}], (1, 1)),
        ([{}, FAILED], [{}, FAILED], (1, 1)),
    ],
)
def test_what_is_lacking(rows, mine, other, expected):
    found = missing(rows(*of("mine", *mine), *of("other", *other)))
    assert tuple(found.values()) == expected


def test_a_view_is_due_once_for_every_seed_of_the_entrant(rows):
    seeds = [{"seed": seed} for seed in (0, 1, 2)]
    trained = [row | seed for row in of("mine", {}, {}) for seed in seeds]
    assert missing(rows(*trained, *of("other", {}, {}))) == {
        ("mine", "sparse_psnr"): 0,
        ("other", "sparse_psnr"): 0,
    }
    trained[4] |= FAILED
    assert missing(rows(*trained, *of("other", {}, {})))["mine", "sparse_psnr"] == 1


def test_a_draw_is_a_view_that_all_share(rows):
    # The second draw has no pixel to score in the second frame, for either.
    drawn = [
        {"method": method, "frame": frame, "seed": draw} | (EMPTY if frame * draw else {})
        for method in ("mine", "other")
        for frame in (0, 1)
        for draw in (0, 1)
    ]
    view = ["scene", "frame", "target", "seed"]
    assert set(missing(rows(*drawn), view).values()) == {0}
    drawn[0] |= FAILED
    assert missing(rows(*drawn), view)["mine", "sparse_psnr"] == 1


def test_metrics_data_sets_and_levels_are_places_of_their_own(rows):
    table = rows(
        *of("mine", {}, {"metric": "psnr", **FAILED}, {"dataset": "e"}),
        *of("other", {}, {"metric": "psnr"}, {"dataset": "e"}),
        {"method": "other", "stressor": "thinning", "level": 0.5},
    )
    found = with_lacking(table, BY)
    assert found["method"].tolist() == table["method"].tolist()
    assert found.loc[found["method"] == "mine", "lacking"].tolist() == [1, 1, 0]
    assert (found.loc[found["method"] == "other", "lacking"] == 0).all()


def test_distances_of_sets_lack_the_images_that_others_have():
    sets = pd.DataFrame(
        [("d", "s", 8, 0), ("d", "s", 6, 2), ("d", "s", 0, 8), ("d", "t", 3, 0)],
        columns=["dataset", "split", "views", "failed"],
    )
    assert lacking_of_sets(sets).tolist() == [0, 2, 8, 0]


NAMES = ("mean-colour", "copy", "mine", "other", "third")
VIEWS = [(scene, frame, side) for scene in ("easy", "hard") for frame in (0, 1) for side in "lr"]
FRAME_OF = st.sampled_from(VIEWS)


def blank(types):
    usual = {"string": "", "int64": 0, "float64": 1.0}
    return {name: usual[kind] for name, kind in types.items()} | {"dataset": "d"}


@st.composite
def runs(draw):
    """Values and seconds of all entrants, none of them equal, and views that each failed on."""
    count = len(NAMES) * len(VIEWS)
    values = draw(st.lists(st.integers(0, 10_000), min_size=count, max_size=count, unique=True))
    seconds = draw(st.lists(st.integers(1, 99), min_size=5, max_size=5, unique=True))
    failed = {
        name: draw(st.sets(FRAME_OF, max_size=2)) for name in draw(st.sets(st.sampled_from(NAMES)))
    }
    return (
        dict(zip(NAMES, zip(*[iter(values)] * len(VIEWS), strict=True), strict=True)),
        seconds,
        failed,
    )


def made(values, seconds, failed, order=NAMES):
    """Score and cost rows of a run; a whole scene's failures are of its fit."""
    scores, costs = [], []
    for name in order:
        lost = failed.get(name, set())
        for (scene, frame, target), value in zip(VIEWS, values[name], strict=True):
            row = blank(SCORE_TYPES) | {"scene": scene, "frame": frame, "target": target}
            row |= {"method": name, "variant": "default", "metric": "sparse_psnr", "status": "ok"}
            row |= {
                "value": value / 100,
                "level": math.nan,
                "support_ratio": 0.05,
                "fingerprint": "f",
            }
            row |= FAILED if (scene, frame, target) in lost else {}
            for split, angle in (("extrapolation", 10.0), ("pose-sweep", 10.0 if frame else 20.0)):
                scores.append(row | {"split": split, "pose_offset": angle})
        for scene in ("easy", "hard"):
            cost = blank(COST_TYPES) | {"scene": scene, "method": name, "variant": "default"}
            cost |= {"sources": "all-cameras", "status": "ok"}
            cost["render_seconds"] = float(seconds[NAMES.index(name)])
            whole = {view for view in VIEWS if view[0] == scene}
            costs.append(cost | ({"status": "failed"} if whole <= lost else {}))
    return score_frame(scores), cost_frame(costs)


def places(run):
    """Every entrant's place by its mean, 99 if it is not ranked, and its frontiers."""
    points = speed_accuracy("extrapolation", *run, SETTINGS, ENTRANTS).set_index("method")
    ranked = points[points["lacking"] == 0]["mean"].rank(ascending=False)
    fronts = points[[f"{cost}_frontier" for cost in COSTS]]
    nowhere = (False,) * len(COSTS)
    return {name: ranked.get(name, 99) for name in NAMES}, {
        name: tuple(fronts.loc[name]) if name in fronts.index else nowhere for name in NAMES
    }


@settings(deadline=None, max_examples=8)
@given(runs(), st.sampled_from(NAMES), st.sets(FRAME_OF, min_size=1, max_size=8))
def test_failing_more_never_makes_anybody_better(run, who, more):
    values, seconds, failed = run
    worse = failed | {who: failed.get(who, set()) | more}
    before, after = (made(values, seconds, some) for some in (failed, worse))
    (rank, front), (rank_after, front_after) = places(before), places(after)
    assert rank_after[who] >= rank[who]
    assert all(new <= old for new, old in zip(front_after[who], front[who], strict=True))
    said = summarise_run(*after, SETTINGS, ENTRANTS)
    name = ENTRANTS.name(who)
    for start in ("the best method is", "The best control is"):
        assert not any(f"{start} {name} " in text for text in said)
    frontier = [text for text in said if "faster and better" in text]
    assert not any(f"{name} (" in text for text in frontier)


@settings(deadline=None, max_examples=5)
@given(runs(), st.permutations(NAMES))
def test_the_order_of_entrants_changes_nothing(run, order):
    one, other = made(*run), made(*run, order)
    tables = [make_table("extrapolation", some[0], SETTINGS, ENTRANTS) for some in (one, other)]
    first, second = (table.sort_values("method", ignore_index=True) for table in tables)
    pd.testing.assert_frame_equal(first, second)
    texts = [summarise_run(*some, SETTINGS, ENTRANTS) for some in (one, other)]
    assert [sorted(text) for text in texts[0]] == [sorted(text) for text in texts[1]]


@settings(deadline=None, max_examples=8)
@given(runs())
def test_the_best_has_the_highest_mean_of_those_that_delivered_everything(run):
    values, _, failed = run
    whole = [name for name in NAMES if not failed.get(name)]
    # A frame counts once, and here all have two targets.
    means = {name: sum(values[name]) / len(VIEWS) / 100 for name in whole}
    (text,) = (
        text
        for text in summarise_run(*made(*run), SETTINGS, ENTRANTS)
        if text.startswith("By sparse")
    )
    controls = [name for name in whole if name in ("mean-colour", "copy")]
    methods = [name for name in whole if name not in controls]
    for start, some in (("the best method is", methods), ("The best control is", controls)):
        if some:
            ((best, shown),) = re.findall(rf"{start} (.+?) \((-?[\d.]+)", text)
            highest = max(means[name] for name in some)
            assert float(shown) == pytest.approx(highest, abs=0.0051)
            assert best in [ENTRANTS.name(name) for name in some if means[name] > highest - 1e-9]
    if not methods:
        assert "no method is the best, as none delivered all of them" in text
    if methods and controls:
        gain = means[max(methods, key=means.get)] - means[max(controls, key=means.get)]
        ((verb, shown),) = re.findall(r" (gains|loses) ([\d.]+) dB", text)
        assert {"gains": 1, "loses": -1}[verb] * float(shown) == pytest.approx(gain, abs=0.0051)
    for name in NAMES:
        lost = failed.get(name, set())
        if lost:
            assert f"{ENTRANTS.name(name)} (" in text.partition("Not ranked")[2]
            assert f" on {len(VIEWS) - len(lost)} of {len(VIEWS)} views)" in text
