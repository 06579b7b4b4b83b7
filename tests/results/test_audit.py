"""The audit's tables on rows made by hand, and its page."""

import numpy as np
import pandas as pd
import pytest

from geoevs.protocol.audit import SHARES, SUPPORTS, TWINS
from geoevs.results.audit import agreement, audit_tables, conditioning_gain, harm, support_bias
from geoevs.results.audit_chart import agreement_chart, support_chart
from geoevs.results.audit_page import audit_markdown, write_audit
from geoevs.results.chart_pages import page_png
from geoevs.results.entrants import Entrants, Info
from geoevs.results.settings import TableSettings

SETTINGS = TableSettings([], [], 100, 0.9, "geo-evs")
ENTRANTS = Entrants({"a": Info("A")})
FRAMES = range(4)
DENSE = {"mean-colour": 12.0, "a": 20.0, "b": 22.0, "c": 26.0}


def row(part, method, metric, frame, value, dense, share=1.0):
    return {
        **{"dataset": "d", "scene": "s", "target": "t", "part": part, "method": method},
        **{"variant": "default", "metric": metric, "frame": frame, "share": share},
        **{"support_ratio": 0.06 * share, "value": value, "dense": dense, "pixels": 9},
    }


def agreeing(sparse, metric="sparse_psnr", share=1.0):
    return [
        row("agreement", method, metric, frame, sparse[method], dense, share)
        for method, dense in DENSE.items()
        for frame in FRAMES
    ]


def test_the_same_order_is_a_tau_of_one_whatever_the_bias():
    table = agreement(pd.DataFrame(agreeing({m: d + 3 for m, d in DENSE.items()})), SETTINGS)
    (found,) = table.to_dict("records")
    assert (found["bias"], found["bias_low"], found["bias_high"]) == (3, 3, 3)
    assert (found["tau"], found["tau_low"], found["entrants"]) == (1, 1, 4)
    assert found["gap"] == 2  # the closest two
    assert found["support"] == pytest.approx(0.06)


def test_a_swapped_pair_costs_tau_and_raises_the_gap():
    # Of six pairs one is swapped: (5 - 1) / 6.
    swapped = DENSE | {"a": 22.5, "b": 20.0}
    (found,) = agreement(pd.DataFrame(agreeing(swapped)), SETTINGS).to_dict("records")
    assert found["tau"] == pytest.approx(4 / 6)
    assert found["gap"] == 3.5  # c and a; a and b, 2.5 apart, are in the wrong order


def test_a_metric_that_nothing_has_at_a_share_is_an_empty_row():
    rows = agreeing(DENSE) + agreeing(dict.fromkeys(DENSE, np.nan), share=0.05)
    table = agreement(pd.DataFrame(rows), SETTINGS).set_index("share")
    assert table.loc[0.05, ["bias", "bias_low", "tau", "tau_high", "gap"]].isna().all()
    assert table["entrants"].to_dict() == {1.0: 4, 0.05: 0}


def test_oracles_and_exact_copies_are_left_out():
    rows = agreeing(DENSE) + [
        row("agreement", name, "sparse_psnr", frame, np.inf, 30.0)
        for name in ("truth", "copy")
        for frame in FRAMES
    ]
    (found,) = agreement(pd.DataFrame(rows), SETTINGS).to_dict("records")
    assert found["entrants"] == 4


def test_gain_is_beyond_what_the_floor_gains():
    halves = {"mean-colour": (13.0, 12.0), "copies": (40.0, 30.0), "honest": (26.0, 25.0)}
    rows = [
        row("conditioning", method, "sparse_psnr", frame, *values)
        for method, values in halves.items()
        for frame in FRAMES
    ]
    gain = conditioning_gain(pd.DataFrame(rows), SETTINGS).set_index("method")["mean"]
    assert gain.to_dict() == {"copies": 9.0, "honest": 0.0}


@pytest.fixture
def rows():
    """What an audit of one scene gives, with an error of the sparse metrics of 1."""
    made = [
        line
        for metric in TWINS
        for share in SHARES
        for line in agreeing({m: d + 1 for m, d in DENSE.items()}, metric, share)
    ]
    for frame in FRAMES:
        for metric in ("sparse_psnr", "sparse_ssim", "sparse_ssim_zero_fill"):
            made += [row("random-support", "a", metric, frame, 0.5, 0.25, s) for s in SUPPORTS]
        for rule in ("pixel", "footprint"):
            shares = {"wrong": 0.25, "leak": 0.125, "colour": 0.125, "psnr": 28, "psnr_right": 33}
            made += [row("reference", "", f"{rule}_{k}", frame, v, 0) for k, v in shares.items()]
        made.append(row("ceiling", "", "sparse_psnr", frame, 31.0, np.nan) | {"target": "front"})
        for method, value in (("mean-colour", 12.0), ("a", 20.75)):
            made.append(row("conditioning", method, "sparse_psnr", frame, value, DENSE[method]))
    for metric, values in (("x_kd", (0.01, 0.03)), ("x_fd", (9.0, 8.0))):
        for grade, value in zip((1, 2), values, strict=True):
            for scene, shift in (("s", -0.001), ("r", 0.001)):
                made.append(row("harm", "", metric, 0, value + shift, 0.02, grade))
                made[-1] |= {"scene": scene, "target": "blur"}
    return pd.DataFrame(made)


def test_harm_is_a_mean_over_scenes_beside_its_floor(rows):
    table = harm(rows, SETTINGS).set_index(["metric", "harm", "grade"])
    assert table.loc[("x_kd", "blur", 2), "distance"] == pytest.approx(0.03)
    assert table.loc[("x_fd", "blur", 1), "distance"] == pytest.approx(9.0)
    assert (table["floor"] == 0.02).all()
    assert len(table) == 4


def test_the_page_says_what_the_tables_say(rows):
    page = audit_markdown(audit_tables(rows, SETTINGS, ENTRANTS))
    for text in (
        "It ranks 4 entrants as dense PSNR does: Kendall's tau is 1.00 [1.00, 1.00]",
        "sparse PSNR is off by +0.25 dB at a support of 0.05, and at worst by +0.25 dB, at 1.",
        "25.0 % of the reference's pixels are wrong: 12.5 % background",
        "The truth itself scores 28.0 dB against the reference, 33.0 dB on",
        "in dB: front 31.0",
        "A gains 0.75 [0.75, 0.75] dB",
        "With every grade of blur, noise and holes rise: x_kd; do not: x_fd. Beyond the distance "
        "of another instant are x_kd from blur 2 on; x_fd from blur 1 on.",
    ):
        assert text in page


def test_small_biases_have_digits_enough(rows):
    mae = (rows["part"] == "agreement") & (rows["metric"] == "sparse_mae")
    rows.loc[mae, "value"] = rows.loc[mae, "dense"] - 0.0064
    page = audit_markdown(audit_tables(rows, SETTINGS, ENTRANTS))
    assert "| sparse_mae | 0.0600 | -0.0064 [-0.0064, -0.0064] |" in page
    assert "| sparse_psnr | 0.0600 | 1.00 [1.00, 1.00] |" in page


def test_every_metric_of_the_legend_has_its_bias_drawn(rows):
    chart = agreement_chart(audit_tables(rows, SETTINGS, ENTRANTS)["agreement"]).to_dict()
    *bias, tau = (
        {row["metric"] for row in chart["datasets"][panel["data"]["name"]]}
        for panel in chart["vconcat"]
    )
    assert set.union(*bias) == tau == set(TWINS)
    assert {"sparse_mae", "sparse_rmse"} in bias
    chart = support_chart(audit_tables(rows, SETTINGS, ENTRANTS)["support_bias"]).to_dict()
    assert len(chart["vconcat"]) == 2


def test_without_truth_it_speaks_of_the_ceiling_alone(rows):
    tables = audit_tables(rows[rows["part"] == "ceiling"], SETTINGS, ENTRANTS)
    page = audit_markdown(tables)
    assert "Noise ceiling" in page
    assert "Ranks" not in page
    assert page_png(agreement_chart(tables["agreement"]).to_dict()).startswith(b"\x89PNG")
    assert page_png(support_chart(tables["support_bias"]).to_dict()).startswith(b"\x89PNG")


def test_charts_are_drawn(rows):
    tables = audit_tables(rows, SETTINGS, ENTRANTS)
    assert page_png(agreement_chart(tables["agreement"]).to_dict()).startswith(b"\x89PNG")
    assert page_png(support_chart(tables["support_bias"]).to_dict()).startswith(b"\x89PNG")


def test_the_suite_is_its_tables_two_charts_and_a_page(rows, tmp_path):
    write_audit(tmp_path, rows, SETTINGS, ENTRANTS)
    tables = audit_tables(rows, SETTINGS, ENTRANTS)
    assert {path.name for path in tmp_path.iterdir()} == {
        *(f"{name}.csv" for name in tables),
        "agreement.png",
        "agreement.html",
        "support_bias.png",
        "support_bias.html",
        "audit.md",
    }
    for name, table in tables.items():
        assert (tmp_path / f"{name}.csv").read_text() == table.to_csv(index=False)
    assert (tmp_path / "audit.md").read_text() == audit_markdown(tables)
    assert "bias of support" in (tmp_path / "support_bias.html").read_text()
    assert "tau" in (tmp_path / "agreement.html").read_text()


def test_who_lacks_a_view_is_neither_ranked_nor_takes_its_frame_from_others():
    rows = agreeing({m: d + 3 for m, d in DENSE.items()})
    # It rendered one scene's frames alone, or one of two seeds did.
    other = [row("agreement", "d", "sparse_psnr", frame, 99.0, 1.0) for frame in (0, 1)]
    seeds = [row("agreement", "e", "sparse_psnr", f, 99.0, 1.0) for f in (*FRAMES, *FRAMES[:2])]
    (found,) = agreement(pd.DataFrame([*rows, *other, *seeds]), SETTINGS).to_dict("records")
    assert (found["entrants"], found["left_out"], found["tau"], found["bias"]) == (4, 2, 1, 3)


def test_bias_of_support_is_of_those_that_have_every_view():
    whole = [row("random-support", "a", "sparse_psnr", frame, 2.0, 1.0) for frame in FRAMES]
    partial = row("random-support", "b", "sparse_psnr", 0, 9.0, 1.0)
    table = support_bias(pd.DataFrame([*whole, partial]), SETTINGS)
    assert table["mean"].tolist() == [1.0]


def gaining(**gains):
    """Rows of gains on points that may be read; None is a view without a render."""
    values = {"mean-colour": [0.0, 0.0], **gains}
    return pd.DataFrame(
        [
            row("conditioning", method, "sparse_psnr", frame, 20.0 + gain, 20.0)
            for method, some in values.items()
            for frame, gain in enumerate(some)
            if gain is not None
        ]
    )


def leaks(table):
    ceiling = pd.DataFrame([row("ceiling", "", "sparse_psnr", 0, 31.0, np.nan)])
    page = audit_markdown(audit_tables(pd.concat([ceiling, table]), SETTINGS, ENTRANTS))
    return [line for line in page.splitlines() if "Leaks" in line]


def test_the_most_that_is_gained_is_of_who_has_every_view():
    rows = gaining(a=[1.0, 1.0], b=[9.0, None])
    assert conditioning_gain(rows, SETTINGS).set_index("method")["lacking"].to_dict() == {
        "a": 0,
        "b": 1,
    }
    (text,) = leaks(rows)
    assert "A gains 1.00 [1.00, 1.00] dB over" in text
    assert leaks(gaining(b=[9.0, None], a=[None, 1.0])) == []


def test_a_loss_is_no_gain():
    (text,) = leaks(gaining(a=[-0.5, -0.5], b=[-0.75, -0.75]))
    assert "nobody gains: A has -0.50 [-0.50, -0.50] dB over the split" in text
    assert text.endswith("the median entrant's difference is -0.62.")
