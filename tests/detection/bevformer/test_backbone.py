"""Backbones: features at stride 8 of each view by itself, and where pretrained ones come from."""

from pathlib import Path

import pytest
import torch

import geoevs
from geoevs.core import efficientnet
from geoevs.core.errors import GeoEvsError
from geoevs.core.networks import read_network, save_network
from geoevs.detection.bevformer.backbone import (
    KINDS,
    Backbone,
    load_backbone,
    new_backbone,
    pretrained_backbone,
    save_backbone,
)

PRETRAINED = sorted(KINDS)
WEIGHTS = Path(geoevs.__file__).parent / "weights"


def pretrained(kind):
    if kind == "efficientnet" and efficientnet.missing():
        pytest.skip(efficientnet.missing())
    return pretrained_backbone(kind, WEIGHTS)


@pytest.mark.parametrize("kind", ["cnn", *PRETRAINED])
def test_features_have_stride_8_and_are_of_one_view(kind, detector, tmp_path):
    backbone = new_backbone(detector, 0).eval() if kind == "cnn" else pretrained(kind)
    images = torch.rand(2, 3, 32, 48, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        features = backbone(images)
        assert features.shape == (2, backbone.channels, 4, 6)
        torch.testing.assert_close(backbone(images[1:])[0], features[1], atol=1e-4, rtol=1e-4)
        assert (features[0] - features[1]).abs().max() > 1e-3
        save_backbone(tmp_path / "backbone.safetensors", backbone)
        loaded = load_backbone(tmp_path / "backbone.safetensors")
        torch.testing.assert_close(loaded(images), features, atol=1e-4, rtol=1e-4)
    assert loaded.identity == backbone.identity


@pytest.mark.parametrize("kind", ["vggt-nano", "autoencoder"])
def test_without_pretrained_weights_a_sentence_says_so(kind, tmp_path):
    sentence = f"the backbone '{kind}' of detectors has no weights here: .*{kind}.safetensors is "
    with pytest.raises(GeoEvsError, match=f"{sentence}missing.*'cnn' needs none"):
        pretrained_backbone(kind, tmp_path)


def test_without_the_package_of_efficientnet_a_sentence_says_so(monkeypatch, tmp_path):
    def published():
        raise GeoEvsError("the package is not installed")

    monkeypatch.setattr(efficientnet, "published", published)
    with pytest.raises(GeoEvsError, match="'efficientnet' of detectors has no weights here: the"):
        pretrained_backbone("efficientnet", tmp_path)


def test_another_seed_makes_another_network(detector):
    assert new_backbone(detector, 0).identity == new_backbone(detector, 0).identity
    assert new_backbone(detector, 0).identity != new_backbone(detector, 1).identity


def test_files_of_other_networks_are_refused(detector, tmp_path):
    path = tmp_path / "backbone.safetensors"
    save_network(path, Backbone("cnn", 8), {"kind": "resnet", "channels": 8})
    with pytest.raises(GeoEvsError, match="holds no backbone of a detector; make it with train_ba"):
        load_backbone(path)
    save_network(path, Backbone("cnn", 8), {"kind": "cnn", "channels": 16})
    with pytest.raises(GeoEvsError, match="of shape"):
        load_backbone(path)
    save_network(path, Backbone("cnn", 8), {"kind": "cnn"})
    with pytest.raises(GeoEvsError, match="describes no network of this kind"):
        load_backbone(path)
    assert read_network(path)[0] == {"kind": "cnn"}
