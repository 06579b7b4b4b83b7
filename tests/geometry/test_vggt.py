"""VGGT against the published network: names, shapes, predictions, and files."""

import hashlib
import pickle
from math import prod

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from geoevs.core.errors import GeoEvsError
from geoevs.geometry import vggt
from geoevs.geometry.depth_loss import depth_loss
from geoevs.geometry.vggt import (
    VGGT_1B,
    VGGT_NANO,
    Vggt,
    VggtConfig,
    load_vggt,
    new_vggt,
    save_vggt,
)
from geoevs.geometry.vggt_layers import rotary_tables, rotate

# As published, only smaller.
TINY = VggtConfig(
    patch_size=14,
    dim=16,
    depth=5,
    heads=2,
    head_layers=(0, 2, 3, 4),
    head_channels=(4, 8, 12, 16),
    head_features=8,
    dino_depth=1,
    dino_grid=3,
)
# As trained here, only smaller.
SMALL = VggtConfig(
    patch_size=8,
    dim=24,
    depth=4,
    heads=2,
    head_layers=(0, 1, 2, 3),
    head_channels=(4, 4, 8, 8),
    head_features=8,
)


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def published_shapes(config):
    """Names and shapes of the public checkpoint, written down from the public code."""
    dim, head_dim = config.dim, config.dim // config.heads
    shapes = {
        "aggregator.camera_token": (1, 2, 1, dim),
        "aggregator.register_token": (1, 2, 4, dim),
        "aggregator.patch_embed.cls_token": (1, 1, dim),
        "aggregator.patch_embed.register_tokens": (1, 4, dim),
        "aggregator.patch_embed.pos_embed": (1, 1 + config.dino_grid**2, dim),
        "aggregator.patch_embed.patch_embed.proj.weight": (dim, 3, 14, 14),
        "aggregator.patch_embed.patch_embed.proj.bias": (dim,),
    }

    def add(name, *shape, bias=True):
        shapes[f"{name}.weight"] = shape
        if bias:
            shapes[f"{name}.bias"] = (shape[0],)

    groups = {"patch_embed.blocks": config.dino_depth}
    groups |= {"frame_blocks": config.depth, "global_blocks": config.depth}
    for group, count in groups.items():
        for number in range(count):
            block = f"aggregator.{group}.{number}"
            add(f"{block}.norm1", dim)
            add(f"{block}.attn.qkv", 3 * dim, dim)
            add(f"{block}.attn.proj", dim, dim)
            if group != "patch_embed.blocks":
                add(f"{block}.attn.q_norm", head_dim)
                add(f"{block}.attn.k_norm", head_dim)
            add(f"{block}.norm2", dim)
            add(f"{block}.mlp.fc1", 4 * dim, dim)
            add(f"{block}.mlp.fc2", dim, 4 * dim)
            shapes[f"{block}.ls1.gamma"] = shapes[f"{block}.ls2.gamma"] = (dim,)
    add("aggregator.patch_embed.norm", dim)

    add("depth_head.norm", 2 * dim)
    features, channels = config.head_features, config.head_channels
    for level, count in enumerate(channels):
        add(f"depth_head.projects.{level}", count, 2 * dim, 1, 1)
        add(f"depth_head.scratch.layer{level + 1}_rn", features, count, 3, 3, bias=False)
    for level, side in ((0, 4), (1, 2), (3, 3)):
        add(f"depth_head.resize_layers.{level}", channels[level], channels[level], side, side)
    for level in range(1, 5):
        fusion = f"depth_head.scratch.refinenet{level}"
        add(f"{fusion}.out_conv", features, features, 1, 1)
        for unit in ("resConfUnit1", "resConfUnit2")[level == 4 :]:
            for conv in ("conv1", "conv2"):
                add(f"{fusion}.{unit}.{conv}", features, features, 3, 3)
    add("depth_head.scratch.output_conv1", features // 2, features, 3, 3)
    add("depth_head.scratch.output_conv2.0", 32, features // 2, 3, 3)
    add("depth_head.scratch.output_conv2.2", 2, 32, 1, 1)
    return shapes


def published_weights(rng):
    """Random weights of TINY under their published names."""
    weights = {}
    for name, shape in sorted(published_shapes(TINY).items()):
        matrix = len(shape) > 1
        spread = prod(shape[1:]) ** -0.5 if matrix else 0.3
        weights[name] = rng.normal(0.0 if matrix else 0.2, spread, shape).astype(np.float32)
    return {name: torch.from_numpy(value) for name, value in weights.items()}


@pytest.fixture
def tiny_is_published(monkeypatch):
    """Files without a config of ours hold TINY, not the 1.2 B parameters."""
    monkeypatch.setattr(vggt, "VGGT_1B", TINY)


def shapes_of(config):
    with torch.device("meta"):
        return {name: tuple(value.shape) for name, value in Vggt(config).state_dict().items()}


def test_the_large_network_has_the_published_weights():
    shapes = shapes_of(VGGT_1B)
    assert shapes == published_shapes(VGGT_1B)
    # Counted in the public code: aggregator and depth head, without the unused mask token.
    assert sum(map(prod, shapes.values())) == 941_766_882 - 1024
    assert shapes["aggregator.patch_embed.pos_embed"] == (1, 1370, 1024)
    assert shapes["depth_head.resize_layers.0.weight"] == (256, 256, 4, 4)


@pytest.mark.parametrize("suffix", [".safetensors", ".pt"])
def test_public_weights_give_the_published_predictions(tmp_path, tiny_is_published, suffix):
    rng = np.random.default_rng(0)
    weights = published_weights(rng)
    images = torch.from_numpy(rng.random((2, 2, 3, 28, 42), np.float32))
    path = tmp_path / f"model{suffix}"
    heads = ("camera_head.a", "point_head.b", "track_head.c", "aggregator.patch_embed.mask_token")
    everything = weights | {name: torch.zeros(1, 16) for name in heads}
    save_file(everything, path) if suffix == ".safetensors" else torch.save(everything, path)

    model = load_vggt(path)
    assert not model.training
    assert all(parameter.requires_grad for parameter in model.parameters())
    with torch.inference_mode():
        depth, confidence = model(images)
    # What the public code of these sizes makes of these weights and images.
    places = ([5, 20], [7, 33])
    np.testing.assert_allclose(
        depth[:, :, *places],
        [
            [[3.336555, 2.649772], [3.461360, 2.636951]],
            [[3.355160, 2.553794], [3.560436, 2.611741]],
        ],
        rtol=1e-5,
    )
    np.testing.assert_allclose(
        confidence[:, :, *places],
        [
            [[4.470589, 5.585681], [4.671430, 5.319652]],
            [[4.630244, 4.933128], [4.882260, 5.291777]],
        ],
        rtol=1e-5,
    )
    np.testing.assert_allclose(
        [depth.min(), depth.max(), confidence.min(), confidence.max()],
        [0.733809, 6.306813, 1.750880, 19.025566],
        rtol=1e-5,
    )


def test_rotation_is_by_row_and_column_as_complex_numbers():
    rows, columns, head_dim = 3, 4, 16
    tables = rotary_tables(rows, columns, 2, head_dim, torch.zeros(0, dtype=torch.float64))
    tokens = torch.randn(1, 1, 2 + rows * columns, head_dim, generator=seeded()).double()
    rotated = rotate(tokens, tables)[0, 0].numpy()
    np.testing.assert_array_equal(rotated[:2], tokens[0, 0, :2])  # special tokens
    value = tokens[0, 0, 2 + 1 * columns + 3].numpy()  # row 1, column 3; they count from 1
    speeds = 100.0 ** -(np.arange(4) / 4)
    expected = []
    for half, place in ((value[:8], 2), (value[8:], 4)):
        turned = (half[:4] + 1j * half[4:]) * np.exp(1j * place * speeds)
        expected += [turned.real, turned.imag]
    np.testing.assert_allclose(rotated[2 + 1 * columns + 3], np.concatenate(expected), rtol=1e-6)


def random_small(seed=0):
    """SMALL with every weight random, also those that start near zero."""
    model = new_vggt(SMALL, seeded(seed)).eval()
    generator = seeded(seed + 1)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter += 0.1 * torch.randn(parameter.shape, generator=generator)
    return model


def test_only_the_first_view_is_special():
    model, images = random_small(), torch.rand(1, 3, 3, 16, 24, generator=seeded())
    with torch.inference_mode():
        depth = model(images).depth
        others_swapped = model(images[:, [0, 2, 1]]).depth
        first_swapped = model(images[:, [1, 0, 2]]).depth
    torch.testing.assert_close(others_swapped, depth[:, [0, 2, 1]], rtol=1e-4, atol=0)
    assert (first_swapped / depth[:, [1, 0, 2]] - 1).abs().max() > 1e-3


def test_views_see_each_other_and_scenes_do_not():
    model, images = random_small(), torch.rand(2, 2, 3, 16, 24, generator=seeded())
    with torch.inference_mode():
        both = model(images).depth
        alone = model(images[:1]).depth
        single = model(images[:1, :1]).depth
    torch.testing.assert_close(both[:1], alone, rtol=1e-4, atol=0)
    assert (single / alone[:, :1] - 1).abs().max() > 1e-3


def test_the_nano_network_is_small_and_starts_at_the_initial_depth(tmp_path):
    model = new_vggt(VGGT_NANO, seeded())
    save_vggt(model, tmp_path / "nano.safetensors", torch.float16)
    assert (tmp_path / "nano.safetensors").stat().st_size <= 8_000_000
    with torch.inference_mode():
        depth, confidence = model(torch.rand(1, 2, 3, 32, 48, generator=seeded()))
    assert depth.shape == confidence.shape == (1, 2, 32, 48)
    assert (depth > 8).all()
    assert (depth < 12.5).all()
    assert (confidence >= 1).all()


def test_a_saved_network_predicts_the_same(tmp_path):
    model, images = random_small(), torch.rand(1, 2, 3, 16, 24, generator=seeded())
    save_vggt(model, tmp_path / "full.safetensors")
    save_vggt(model, tmp_path / "half.safetensors", torch.float16)
    full, half = (load_vggt(tmp_path / f"{name}.safetensors") for name in ("full", "half"))
    assert full.config == half.config == SMALL
    for name, value in model.state_dict().items():
        assert torch.equal(full.state_dict()[name], value)
        assert torch.equal(half.state_dict()[name], value.half().float())
    with torch.inference_mode():
        assert torch.equal(full(images).depth, model(images).depth)


def trained_bytes(path, seed):
    generator = seeded(seed)
    model = new_vggt(SMALL, generator)
    optimiser = torch.optim.AdamW(model.parameters(), 1e-3)
    for _ in range(2):
        images = torch.rand(1, 2, 3, 16, 24, generator=generator)
        depth = 1 + 50 * torch.rand(1, 2, 16, 24, generator=generator)
        optimiser.zero_grad()
        depth_loss(model(images), depth).backward()
        optimiser.step()
    save_vggt(model, path)
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_training_is_a_function_of_the_seed(tmp_path):
    torch.manual_seed(123)
    first = trained_bytes(tmp_path / "a.safetensors", 5)
    torch.manual_seed(321)  # the global generator plays no part
    before = torch.get_rng_state()
    assert trained_bytes(tmp_path / "b.safetensors", 5) == first
    assert torch.equal(torch.get_rng_state(), before)
    assert trained_bytes(tmp_path / "c.safetensors", 6) != first


def test_images_must_divide_into_patches():
    with pytest.raises(GeoEvsError, match=r"30 x 45 .* 8 x 8; resize them to 32 x 48"):
        new_vggt(SMALL, seeded())(torch.zeros(1, 1, 3, 30, 45))


@pytest.mark.parametrize(
    ("config", "size", "shown"),
    [
        (VGGT_NANO, (128, 192), (128, 192)),
        (VGGT_NANO, (64, 96), (64, 96)),  # never enlarged
        (VGGT_NANO, (512, 512), (192, 192)),
        (VGGT_NANO, (1080, 1920), (112, 192)),
        (VGGT_1B, (512, 512), (518, 518)),
        (VGGT_1B, (1080, 1920), (294, 518)),
    ],
)
def test_large_images_are_shown_smaller(config, size, shown):
    assert config.nearest_size(*size) == shown


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"depth_head.norm.bias": None}, "lacks 'depth_head.norm.bias'"),
        (
            {"aggregator.camera_token": torch.zeros(1, 2, 1, 8)},
            r"'aggregator.camera_token' of shape \(1, 2, 1, 8\) .* is \(1, 2, 1, 16\)",
        ),
        ({"depth_head.extra": torch.zeros(1)}, "'depth_head.extra', which this network has not"),
    ],
)
def test_other_weights_are_refused(tmp_path, tiny_is_published, change, sentence):
    weights = published_weights(np.random.default_rng(0)) | change
    path = tmp_path / "model.safetensors"
    save_file({name: value for name, value in weights.items() if value is not None}, path)
    with pytest.raises(GeoEvsError, match=f"model.safetensors .*{sentence}"):
        load_vggt(path)


class Harmful:
    def __reduce__(self):
        return exec, ("raise SystemExit",)


@pytest.mark.parametrize("name", ["none.safetensors", "none.pt"])
def test_a_missing_file_is_named(tmp_path, name):
    with pytest.raises(GeoEvsError, match=f"{name} is missing"):
        load_vggt(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "data", "sentence"),
    [
        ("cut.safetensors", b"\x09\x00", "cut.safetensors is not whole"),
        ("code.pt", pickle.dumps(Harmful(), 2), "code.pt is not whole .*more than plain tensors"),
    ],
)
def test_a_bad_file_is_named_and_runs_nothing(tmp_path, name, data, sentence):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(GeoEvsError, match=sentence):
        load_vggt(tmp_path / name)
