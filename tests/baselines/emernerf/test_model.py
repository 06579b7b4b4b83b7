"""The whole model: sizes as they are described, and compositing against values by hand."""

import pytest
import torch
from torch import nn

from baselines.emernerf.model import SEEN, EmerNeRF, Rays, Sizes

BOX = torch.tensor([[-40.0, -20.0, -10.0], [40.0, 20.0, 10.0]])
SKY, LIT, OWN = (0.2, 0.4, 0.8), (1.0, 0.5, 0.0), (0.0, 0.25, 1.0)


def new_model(step=0.25):
    sizes = Sizes(levels=8, log2_entries=6, width=8, samples=(8, 4, 4))
    return EmerNeRF(sizes, 3, BOX, step, torch.Generator().manual_seed(0))


def test_the_other_grids_follow_the_static_one():
    model = new_model()
    grids = [model.static.grid, model.dynamic.content.grid, model.dynamic.flow.grid]
    grids += [proposal.grid for proposal in model.proposals]
    assert [len(grid.cells) for grid in grids] == [8, 4, 3, 4, 4]
    assert [grid.offsets[1] for grid in grids] == [64, 64, 32, 16, 16]
    assert [grid.cells[-1] for grid in grids] == [4096, 128, 64, 256, 1024]
    hidden = [model.static, model.dynamic.content, model.dynamic.flow, *model.proposals]
    assert [field.network[0].out_features for field in hidden] == [16, 8, 8, 4, 4]


class Painted(nn.Module):
    """A head that gives a sample of feature 0 one colour, any other another one."""

    def __init__(self, *colours):
        super().__init__()
        self.colours = torch.tensor(colours)

    def forward(self, samples, rays, ray):
        if not samples.shape[1]:
            return self.colours[:1].expand(len(ray), 3)
        return self.colours[samples[:, 0].long()]


class Shade(nn.Module):
    """A shadow head whose shade is a sample's second feature."""

    def forward(self, samples):
        return samples[:, 1:2].logit()


def colours(weights, moving=None, share=None):
    """What one ray sees whose samples weigh so."""
    model = new_model(None if moving is None else 0.25)
    model.sky, model.colour, model.shadow = Painted(SKY), Painted(LIT, OWN), Shade()
    one = torch.zeros(1, 3)
    rays = Rays(one, torch.tensor([[1.0, 0, 0]]), torch.zeros(1), torch.zeros(1, dtype=torch.int64))
    still = torch.zeros(len(weights), 2)
    if moving is not None:
        moving, share = torch.tensor(moving), torch.tensor([share])
    rgb, shadow = model._colours(rays, torch.tensor([weights]), still, moving, share)
    return rgb[0].tolist(), shadow


def mixed(sky, lit, own):
    return pytest.approx(
        [sky * s + lit * c + own * o for s, c, o in zip(SKY, LIT, OWN, strict=True)]
    )


def test_light_that_nothing_stops_is_the_skys():
    rgb, shadow = colours([0.5, 0.25])
    assert rgb == mixed(0.25, 0.75, 0)
    assert shadow is None


def test_shadow_darkens_what_is_still_and_only_that():
    # The samples: the static part of the first half shaded, of the second not at all.
    moving = [[1.0, 0.5], [1.0, 0.0]]
    rgb, shadow = colours([0.5, 0.25], moving, share=[0.2, 0.4])
    # Static: 0.5 * 0.8 * (1 - 0.5) + 0.25 * 0.6; dynamic: 0.5 * 0.2 + 0.25 * 0.4, never shaded.
    assert rgb == mixed(0.25, 0.2 + 0.15, 0.1 + 0.1)
    assert shadow.tolist() == pytest.approx([0.5 * 0.8 * 0.5**2])


def test_shadow_of_a_ray_that_is_all_dynamic_counts_nothing():
    rgb, shadow = colours([0.5, 0.25], [[1.0, 0.5], [1.0, 0.5]], share=[1.0, 1.0])
    assert rgb == mixed(0.25, 0, 0.75)
    assert shadow.tolist() == [0]


def test_samples_that_nobody_would_see_get_no_colour():
    rgb, _ = colours([0.5, SEEN / 2])
    assert rgb == mixed(0.5 - SEEN / 2, 0.5, 0)
    assert rgb != mixed(0.5 - SEEN / 2, 0.5 + SEEN / 2, 0)
