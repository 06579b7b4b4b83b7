"""Weights on disk come back exactly, or are refused in one sentence."""

import json

import pytest
import safetensors.torch
import torch
from torch import nn

from geoevs.core.errors import GeoEvsError
from geoevs.core.networks import built_as_described, load_weights, read_network, save_network

SETTINGS = {"sizes": [3, 2], "name": "net"}


def network(fill):
    net = nn.Sequential(nn.Linear(3, 2), nn.BatchNorm1d(2))
    for number, value in enumerate(net.state_dict().values()):
        value.fill_(fill + number / 3)
    return net


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "net.safetensors"
    save_network(path, network(1), SETTINGS)
    return path


def refused(weights, path, advice="name another"):
    with pytest.raises(GeoEvsError) as caught:
        load_weights(network(0), weights, path, advice)
    return str(caught.value)


def test_weights_and_settings_come_back(saved):
    settings, weights = read_network(saved)
    assert settings == SETTINGS
    with torch.device("meta"):
        net = nn.Sequential(nn.Linear(3, 2), nn.BatchNorm1d(2))
    load_weights(net, weights, saved, "")
    expected = network(1).state_dict()
    found = net.state_dict()
    assert list(found) == list(expected)
    assert all(torch.equal(found[name], expected[name]) for name in expected)
    assert found["1.num_batches_tracked"].dtype == torch.int64


def test_half_precision_halves_floats_alone(saved, tmp_path):
    half = tmp_path / "half.safetensors"
    save_network(half, network(1), SETTINGS, torch.float16)
    weights = read_network(half)[1]
    assert weights["0.weight"].dtype == torch.float16
    assert weights["1.num_batches_tracked"].dtype == torch.int64
    net = network(0)
    load_weights(net, weights, half, "")
    assert net[0].bias.dtype == torch.float32
    # One and a third, to the eleven bits of a half.
    assert net[0].bias[0].item() == 1.3330078125


def test_a_missing_weight_is_named(saved):
    weights = read_network(saved)[1]
    del weights["0.bias"]
    assert refused(weights, saved) == f"{saved} lacks '0.bias'; name another"


def test_an_unknown_weight_is_named(saved):
    weights = read_network(saved)[1] | {"2.weight": torch.zeros(1)}
    sentence = f"{saved} has '2.weight', which this network has not; name another"
    assert refused(weights, saved) == sentence


def test_a_weight_of_another_shape_is_named(saved):
    weights = read_network(saved)[1] | {"0.weight": torch.zeros(2, 4)}
    assert refused(weights, saved) == (
        f"{saved} has '0.weight' of shape (2, 4) where this network's is (2, 3); name another"
    )


def test_a_refused_network_is_left_alone(saved):
    net = network(0)
    weights = read_network(saved)[1] | {"2.weight": torch.zeros(1)}
    with pytest.raises(GeoEvsError):
        load_weights(net, weights, saved, "")
    expected = network(0).state_dict()
    assert all(torch.equal(value, expected[name]) for name, value in net.state_dict().items())


def test_files_of_others_have_no_settings(tmp_path):
    path = tmp_path / "theirs.safetensors"
    safetensors.torch.save_file({"a": torch.ones(2)}, path)
    settings, weights = read_network(path)
    assert settings is None
    assert torch.equal(weights["a"], torch.ones(2))


def test_a_missing_or_damaged_file_is_one_sentence(saved, tmp_path):
    missing = tmp_path / "none.safetensors"
    with pytest.raises(GeoEvsError, match=f"^{missing} is missing; make or copy it there$"):
        read_network(missing)
    saved.write_bytes(saved.read_bytes()[:-4])
    with pytest.raises(GeoEvsError, match=f"^{saved} is not whole .*; delete it and make it again"):
        read_network(saved)


def test_settings_are_json_and_no_pickle(saved):
    raw = saved.read_bytes()
    header = json.loads(raw[8 : 8 + int.from_bytes(raw[:8], "little")])
    assert json.loads(header["__metadata__"]["settings"]) == SETTINGS


def test_the_same_network_is_the_same_bytes(saved, tmp_path):
    again = tmp_path / "again.safetensors"
    save_network(again, network(1), SETTINGS)
    assert again.read_bytes() == saved.read_bytes()


@pytest.mark.parametrize(
    "lie",
    [
        {"depth": 10**9},
        {"layers_per_block": [2, 500]},
        {"width": 2**40},
        {"eps": float("nan")},
        [3],
    ],
)
def test_settings_beyond_what_the_weights_hold_are_refused_at_once(tmp_path, lie):
    path = tmp_path / "net.safetensors"
    save_network(path, network(1), lie)
    with pytest.raises(GeoEvsError, match=r"net\.safetensors is not whole \(.*\); delete it"):
        read_network(path)


@pytest.mark.parametrize("settings", [{}, {"width": "wide"}, {"width": 3, "colour": 1}])
def test_settings_that_describe_no_network_are_one_sentence(tmp_path, settings):
    path = tmp_path / "net.safetensors"
    message = r"net\.safetensors describes no network of this kind \(.*\); name another"
    with (
        pytest.raises(GeoEvsError, match=message),
        built_as_described(path, "name another"),
    ):
        (lambda width: nn.Linear(width, 2))(**settings)


def test_weights_that_are_not_finite_are_refused(saved):
    _, weights = read_network(saved)
    weights["0.bias"][0] = torch.nan
    assert "'0.bias' with NaN or infinite weights; name another" in refused(weights, saved)


@pytest.mark.parametrize("kind", [torch.int32, torch.complex64, torch.bool])
def test_weights_of_another_type_are_refused(saved, kind):
    _, weights = read_network(saved)
    weights["0.bias"] = weights["0.bias"].to(kind)
    assert f"'0.bias' of type {kind} where this network's is torch.float32" in refused(
        weights, saved
    )
