"""Fields and heads against values by hand and plain formulas."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from baselines.emernerf.fields import (
    ColourHead,
    DynamicField,
    contract,
    encode_directions,
    to_density,
)

BOX = torch.tensor([[-40.0, -20.0, -10.0], [40.0, 20.0, 10.0]])


def test_the_box_is_the_middle_half_and_infinity_the_border():
    places = contract(torch.tensor([[0.0, 0, 0], [40, 20, -10], [1e9, 0, 0], [80, 0, 0]]), BOX)
    # Twice as far as the border, 2 - 1/2 of the way: 1.5 / 4 + 0.5.
    expected = [[0.5, 0.5, 0.5], [0.75, 0.75, 0.25], [1, 0.5, 0.5], [0.875, 0.5, 0.5]]
    torch.testing.assert_close(places, torch.tensor(expected))


@given(st.tuples(*[st.floats(-1e6, 1e6)] * 3), st.floats(1.01, 10))
def test_what_is_farther_out_stays_farther_out(point, factor):
    near = contract(torch.tensor([point], dtype=torch.float64), BOX.double()) - 0.5
    far = contract(torch.tensor([point], dtype=torch.float64) * factor, BOX.double()) - 0.5
    assert far.abs().max() >= near.abs().max() - 1e-12
    assert far.abs().max() <= 0.5


def test_density_is_exp_and_its_gradient_stays_finite():
    feature = torch.tensor([1.0, 3.0, 100.0], requires_grad=True)
    density = to_density(feature)
    assert density[:2].tolist() == pytest.approx([1, math.exp(2)])
    density.sum().backward()
    assert feature.grad.tolist() == pytest.approx([1, math.exp(2), math.exp(15)])


class Stub(nn.Module):
    """A field that is a formula of its places."""

    def __init__(self, formula):
        super().__init__()
        self.formula = formula

    def forward(self, places):
        return self.formula(places)


def constant_flow(forward, backward):
    flow = torch.tensor([*forward, *backward])
    return Stub(lambda places: flow.expand(len(places), 6))


POSITIONS = torch.tensor([[0.0, 0, 0], [8.0, 0, 0]])  # inside the box, where contraction is linear
TIMES = torch.tensor([0.5, 0.5])


def test_features_are_averaged_along_the_flow():
    # x / 160 + t: 1 m is 1/160 in the contracted box of 80 m.
    content = Stub(lambda places: places[:, :1] + places[:, 3:])
    ahead = DynamicField(content, constant_flow((16.0, 0, 0), (0.0, 0, 0)), BOX, 0.25, 4)
    features, flow = ahead(POSITIONS, TIMES)
    # The times cancel out; of the step ahead, a quarter counts: 16 / 160 / 4.
    expected = 0.5 + POSITIONS[:, 0] / 160 + 0.5 + 0.025
    torch.testing.assert_close(features[:, 0], expected)
    assert flow.tolist() == [[16, 0, 0, 0, 0, 0]] * 2


def test_times_beyond_the_scenes_are_its_first_and_last():
    content = Stub(lambda places: places[:, 3:])
    field = DynamicField(content, constant_flow((0.0, 0, 0), (0.0, 0, 0)), BOX, 0.25, 4)
    features, _ = field(POSITIONS, torch.tensor([0.0, 1.0]))
    # (here + (ahead + behind) / 2) / 2, of which one neighbour is the time itself.
    assert features[:, 0].tolist() == pytest.approx([0.25 / 4, 1 - 0.25 / 4])


def test_a_step_is_no_more_than_a_coarsest_cell():
    content = Stub(lambda places: places[:, 3:])
    still = constant_flow((0.0, 0, 0), (0.0, 0, 0))
    short = DynamicField(content, still, BOX, 0.25, 16)  # 5 frames: a quarter of the time axis
    assert short(POSITIONS, TIMES)[0][:, 0].tolist() == [0.125, 0.125]
    long = DynamicField(content, still, BOX, 1 / 198, 16)  # frames share cells
    assert long(POSITIONS, TIMES)[0][:, 0].tolist() == pytest.approx([0.5, 0.5])


def test_one_neighbour_at_random_has_the_mean_of_both():
    content = Stub(lambda places: places[:, :1])
    field = DynamicField(content, constant_flow((16.0, 0, 0), (0.0, 0, 0)), BOX, 0.25, 4)
    count = 2000
    generator = torch.Generator().manual_seed(0)
    features, _ = field(torch.zeros(count, 3), torch.full((count,), 0.5), generator)
    # Half of the neighbours are ahead, 16 m of 160, and weigh one half.
    ahead = features[:, 0] > 0.51
    assert ahead.float().mean().item() == pytest.approx(0.5, abs=0.05)
    torch.testing.assert_close(features[ahead, 0], torch.full((int(ahead.sum()),), 0.55))
    torch.testing.assert_close(features[~ahead, 0], torch.full((int((~ahead).sum()),), 0.5))


def test_a_flow_that_leads_back_has_no_cycle_loss():
    speed = (2.0, 0.0, 1.0)
    there_and_back = DynamicField(None, constant_flow(speed, [-s for s in speed]), BOX, 0.25, 4)
    flow = there_and_back.flow(POSITIONS)
    assert there_and_back.cycle(POSITIONS, TIMES, flow).item() == 0
    away = DynamicField(None, constant_flow(speed, speed), BOX, 0.25, 4)
    loss = away.cycle(POSITIONS, TIMES, away.flow(POSITIONS))
    # 0.5 * (|2v|^2 + |2v|^2) / 3 axes
    assert loss.item() == pytest.approx(4 * (2**2 + 1**2) / 3)


@pytest.mark.parametrize("sample_features", [5, 0])
def test_the_colour_head_is_a_network_of_all_inputs_side_by_side(sample_features):
    torch.manual_seed(0)
    head = ColourHead(sample_features, 7, 16).double()
    samples, rays = torch.randn(9, sample_features).double(), torch.randn(3, 7).double()
    ray = torch.tensor([0, 2, 1, 1, 0, 2, 2, 1, 0])
    inputs = torch.cat([samples, rays[ray]], dim=1)
    hidden = head.first(inputs).relu()
    hidden = head.second(torch.cat([inputs, hidden], dim=1)).relu()
    torch.testing.assert_close(head(samples, rays, ray), head.last(hidden).sigmoid())


def test_gradients_do_not_depend_on_how_threads_are_scheduled():
    # More threads than any machine here has cores, so that they are scheduled anew each time.
    threads = torch.get_num_threads()
    torch.set_num_threads(16)
    try:
        generator = torch.Generator().manual_seed(0)
        head = ColourHead(16, 40, 64)
        samples = torch.randn(60_000, 16, generator=generator)
        rays = torch.randn(1024, 40, generator=generator, requires_grad=True)
        ray = torch.randint(1024, (60_000,), generator=generator).sort().values
        slope = torch.randn(60_000, 3, generator=generator)
        first, *others = (
            torch.autograd.grad(head(samples, rays, ray), rays, slope)[0] for _ in range(6)
        )
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(first, other) for other in others)


def test_directions_are_encoded_by_sines_of_their_multiples():
    encoded = encode_directions(torch.tensor([[0.6, 0.0, 0.8]]))[0]
    assert encoded.shape == (27,)
    expected = [math.sin(0.6), 0, math.sin(0.8), math.sin(1.2), 0, math.sin(1.6)]
    assert encoded[3:9].tolist() == pytest.approx(expected)
    assert encoded[15 + 9 : 27].tolist() == pytest.approx(
        [math.cos(4.8), 1, math.cos(6.4)], rel=1e-5
    )
