"""What is to be found, and how wrong a detector is: by hand and beside twins."""

import itertools
import math

import numpy as np
import pytest
import torch

from geoevs.detection.bevformer.boxes import decoded, encoded
from geoevs.detection.bevformer.decoder import Found
from geoevs.detection.bevformer.losses import (
    detection_losses,
    focal_loss,
    heat_loss,
    match,
    wanted,
)
from geoevs.detection.labels import inside

CPU = torch.device("cpu")


@pytest.fixture
def found():
    random = torch.Generator().manual_seed(0)
    logits = torch.randn(2, 1, 6, 2, generator=random)
    codes = torch.randn(2, 1, 6, 8, generator=random) + torch.tensor([8.0, 0, 0, 1, 1, 0, 0, 0])
    return Found(logits, codes)


def test_boxes_are_what_they_were_after_their_code(make_frame):
    boxes = make_frame().boxes
    code = encoded(boxes[:1])[0]
    by_hand = [8, 1, math.log(1.8), math.log(4.2), 0.8, math.log(1.5), math.sin(0.3), math.cos(0.3)]
    np.testing.assert_allclose(code, by_hand)
    np.testing.assert_allclose(decoded(encoded(boxes)), boxes)


def test_boxes_without_sides_have_finite_codes():
    assert np.isfinite(encoded(np.zeros((1, 7)))).all()


def test_only_centres_in_range_are_to_be_found(make_frame, detector):
    boxes = np.repeat(make_frame().boxes[:1], 3, axis=0)
    boxes[1, 0], boxes[2, 2] = 20.1, 2.7
    assert inside(boxes, detector.range).tolist() == [True, False, False]
    target = wanted(boxes, np.zeros(3, int), detector, 2, CPU)
    assert len(target.classes) == len(target.codes) == 1
    assert (target.heat == 1).sum() == 1


def test_a_heat_map_has_a_gaussian_of_its_class_at_a_centre(detector):
    # Cells of 4 m along x and 4.8 m along y; the centre lies in the middle of column 2 and row 1.
    box = np.array([[-4 + 2.5 * 4, -12 + 1.5 * 4.8, 0.5, 4, 2, 1, 0]])
    heat = wanted(box, np.array([1]), detector, 2, CPU).heat
    assert heat.shape == (2, 5, 6)
    assert not heat[0].any()
    assert heat[1, 1, 2] == 1
    assert heat[1, 2, 2] == pytest.approx(math.exp(-1 / (2 * 0.8**2)))
    assert heat[1, 2, 4] == pytest.approx(math.exp(-5 / (2 * 0.8**2)))


def test_focal_and_heat_losses_by_hand():
    p = 1 / (1 + math.exp(-0.5))
    hit = focal_loss(torch.tensor([[0.5]]), torch.tensor([[1.0]])).item()
    assert hit == pytest.approx(-0.25 * (1 - p) ** 2 * math.log(p))
    missed = focal_loss(torch.tensor([[0.5]]), torch.tensor([[0.0]])).item()
    assert missed == pytest.approx(-0.75 * p**2 * math.log(1 - p))
    heat = heat_loss(torch.tensor([[0.5, 0.5]]), torch.tensor([[1.0, 0.6]])).item()
    near = 0.4**4 * p**2 * math.log(1 - p)
    assert heat == pytest.approx(-((1 - p) ** 2 * math.log(p)) - near)


def cost(logit, code, kind, box):
    """A twin of a pair's cost."""
    p = 1 / (1 + math.exp(-logit[kind]))
    focal = 0.25 * (1 - p) ** 2 * -math.log(p) - 0.75 * p**2 * -math.log(1 - p)
    return 2 * focal + 0.25 * np.abs(code - box).sum()


def test_matches_are_the_cheapest_of_all(found, make_frame, detector):
    frame = make_frame()
    target = wanted(frame.boxes, frame.classes, detector, 2, CPU)
    logits, codes = found.logits[0, 0].numpy(), found.codes[0, 0].numpy()

    def total(queries):
        pairs = zip(queries, target.classes, target.codes.numpy(), strict=True)
        return sum(cost(logits[q], codes[q], int(kind), box) for q, kind, box in pairs)

    query, box = match(found.logits[0, 0], found.codes[0, 0], target)
    best = min(itertools.permutations(range(6), 2), key=total)
    assert tuple(query[box.argsort()].tolist()) == best


def test_losses_are_their_twins(found, make_frame, detector):
    frame = make_frame()
    target = wanted(frame.boxes, frame.classes, detector, 2, CPU)
    losses = detection_losses(found, torch.zeros(1, 2, 5, 6), [target])
    classes = boxes = 0.0
    for layer in range(2):
        query, box = match(found.logits[layer, 0], found.codes[layer, 0], target)
        truth = torch.zeros(6, 2)
        for q, b in zip(query, box, strict=True):
            truth[q, target.classes[b]] = 1
            boxes += 0.25 * (found.codes[layer, 0, q] - target.codes[b]).abs().sum().item() / 2
        classes += 2 * focal_loss(found.logits[layer, 0], truth).item() / 2
    assert losses["classes"].item() == pytest.approx(classes)
    assert losses["boxes"].item() == pytest.approx(boxes)
    parts = losses["classes"] + losses["boxes"] + losses["heat"]
    assert losses["loss"].item() == pytest.approx(parts.item())


def test_mirrored_findings_of_a_mirrored_frame_are_as_wrong(found, make_frame, detector):
    frame = make_frame()
    mirror = torch.tensor([1.0, -1, 1, 1, 1, 1, -1, 1])
    heat = torch.randn(1, 2, 5, 6, generator=torch.Generator().manual_seed(1))
    pairs = [(frame, found, heat), (frame.mirrored(), Found(found.logits, found.codes * mirror),
                                    heat.flip(2))]  # fmt: skip
    losses = [
        detection_losses(what, hot, [wanted(one.boxes, one.classes, detector, 2, CPU)])
        for one, what, hot in pairs
    ]
    for name, value in losses[0].items():
        assert losses[1][name].item() == pytest.approx(value.item(), rel=1e-5)


def test_a_frame_without_boxes_has_losses(found, detector):
    target = wanted(np.zeros((0, 7)), np.zeros(0, int), detector, 2, CPU)
    losses = detection_losses(found, torch.zeros(1, 2, 5, 6), [target])
    assert losses["boxes"].item() == 0
    assert losses["classes"].item() > 0


def test_matching_leaves_nan_to_the_loss(found, make_frame, detector):
    frame = make_frame()
    target = wanted(frame.boxes, frame.classes, detector, 2, CPU)
    broken = Found(found.logits, found.codes * math.nan)
    assert not torch.isfinite(detection_losses(broken, torch.zeros(1, 2, 5, 6), [target])["loss"])
