"""Files of Gaussians against bytes derived by hand from the formats' descriptions."""

import gzip
import math
from dataclasses import replace

import numpy as np
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.scenes.splats import SPZ_REACH, Splats, write_splats_ply, write_splats_spz

TWO = Splats(
    means=np.float32([[1.5, -2, 0], [0, 0, 8.25]]),
    quats=np.float32([[1, 0, 0, 0], [-2, 2, 2, 2]]),
    log_scales=np.float32([[0, -1, 2], [-30, 30, 0.5]]),
    logit_opacities=np.float32([0, 50]),
    sh=np.arange(24, dtype=np.float32).reshape(2, 4, 3) / 32,
)


def many(count=300):
    draw = np.random.default_rng(0).standard_normal
    parts = (draw((count, 3)) * 40, draw((count, 4)), draw((count, 3)), draw(count))
    return Splats(*(np.float32(part) for part in (*parts, draw((count, 4, 3)) / 4)))


def test_ply_has_the_published_layout(tmp_path):
    write_splats_ply(tmp_path / "a.ply", TWO, ("one", "two\nlines"))
    head, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)
    names = [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
        *(f"f_rest_{i}" for i in range(9)),
        *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]
    assert head.decode().splitlines() == [
        *("ply", "format binary_little_endian 1.0", "comment one", "comment two lines"),
        *("element vertex 2", *(f"property float {name}" for name in names)),
    ]
    first, second = np.frombuffer(body, "<f4").reshape(2, len(names)).tolist()
    red, green, blue = [3, 6, 9], [4, 7, 10], [5, 8, 11]  # of 32: coefficients 1 to 3 of a colour
    rest = [value / 32 for value in (*red, *green, *blue)]
    assert first == [1.5, -2, 0, 0, 0, 0, 0, 1 / 32, 2 / 32, *rest, 0, 0, -1, 2, 1, 0, 0, 0]
    assert second[-8:] == [50, -30, 30, 0.5, -2, 2, 2, 2]


def test_spz_has_the_described_bytes(tmp_path):
    write_splats_spz(tmp_path / "a.spz", TWO)
    data = gzip.decompress((tmp_path / "a.spz").read_bytes())
    # Magic, version 3, 2 Gaussians, degree 1, 10 fractional bits, no flags.
    head = [*b"NGSP", 3, 0, 0, 0, 2, 0, 0, 0, 1, 10, 0, 0]
    places = [0x00, 0x06, 0x00, 0x00, 0xF8, 0xFF, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x00, 0x21, 0x00]
    opacities = [128, 255]
    colours = [128, 129, 130, 142, 143, 144]  # 255 (1/2 + 0.15 k/32), k = 0, 1, 2, 12, 13, 14
    scales = [160, 144, 192, 0, 255, 168]  # 16 (s + 10)
    # w is largest: 3, and nothing else. All alike: 0 for x, then y, z and -w, 361 of 511 steps to
    # the root of a half.
    turns = [*(3 << 30).to_bytes(4, "little")]
    turns += [*(361 << 20 | 361 << 10 | 512 | 361).to_bytes(4, "little")]
    waves = [128 + 4 * k for k in (*range(3, 12), *range(15, 24))]  # 128 + 128 k/32
    assert [*data] == [*head, *places, *opacities, *colours, *scales, *turns, *waves]


def test_spz_turns_as_it_was_told(tmp_path):
    splats = many()
    write_splats_spz(tmp_path / "a.spz", splats)
    data = gzip.decompress((tmp_path / "a.spz").read_bytes())
    packed = np.frombuffer(data, "<u4", len(splats), 16 + len(splats) * (9 + 1 + 3 + 3))
    for word, quat in zip(packed.tolist(), splats.quats, strict=True):
        largest, rest = word >> 30, []
        for shift in (20, 10, 0):
            bits = word >> shift & 1023
            rest.append((-1 if bits & 512 else 1) * (bits & 511) / 511 / math.sqrt(2))
        rest.insert(largest, math.sqrt(1 - sum(value * value for value in rest)))
        x, y, z, w = rest
        cosine = abs(np.dot([w, x, y, z], quat)) / np.linalg.norm(quat)
        assert cosine > math.cos(0.002)  # half a step in each of three


def test_spz_brings_what_is_too_far_nearer_and_makes_it_smaller(tmp_path):
    places = np.float32([[6e4, -8e4, 0], [100, 0, 0]])
    far = replace(TWO, means=places, log_scales=np.full((2, 3), 5, np.float32))
    write_splats_spz(tmp_path / "a.spz", far)
    data = gzip.decompress((tmp_path / "a.spz").read_bytes())
    places = [int.from_bytes(data[i : i + 3], "little", signed=True) for i in range(16, 34, 3)]
    reach = 2**23 - 1
    assert places == [round(reach * 0.75), -reach, 0, 100 * 1024, 0, 0]
    scale = round((5 + math.log(SPZ_REACH / 8e4) + 10) * 16)
    assert [*data[16 + 18 + 2 + 6 :][:6]] == [scale] * 3 + [240] * 3


def test_another_reader_finds_the_same_numbers(tmp_path):
    gsply = pytest.importorskip("gsply", reason="gsply, an independent reader, is not installed")
    spz = pytest.importorskip("gsply.spz")
    splats = many()
    write_splats_ply(tmp_path / "a.ply", splats, ("a comment",))
    write_splats_spz(tmp_path / "a.spz", splats)
    read = gsply.plyread(tmp_path / "a.ply")
    for theirs, ours in (
        (read.means, splats.means),
        (read.quats, splats.quats),
        (read.scales, splats.log_scales),
        (read.opacities, splats.logit_opacities),
        (read.sh0, splats.sh[:, 0]),
        (read.shN, splats.sh[:, 1:]),
    ):
        np.testing.assert_array_equal(theirs, ours)
    read = spz.read_spz(tmp_path / "a.spz")
    unit = splats.quats / np.linalg.norm(splats.quats, axis=1, keepdims=True)
    opacity = 1 / (1 + np.exp(-splats.logit_opacities))
    for theirs, ours, step in (
        (read.means, splats.means, 2**-10),
        (np.abs((read.quats * unit).sum(axis=1)), np.ones(len(splats)), 4e-6),
        (read.scales, splats.log_scales, 1 / 16),
        (1 / (1 + np.exp(-read.opacities)), opacity, 1 / 255),
        (read.sh0, splats.sh[:, 0], 1 / 255 / 0.15),
        (read.shN, splats.sh[:, 1:].clip(-1, 127 / 128), 1 / 128),
    ):
        np.testing.assert_allclose(theirs, ours, rtol=0, atol=step / 2 + 1e-5)


@pytest.mark.parametrize(
    ("part", "value", "words"),
    [
        ("quats", np.zeros((2, 3)), r"quats of the splats has shape \(2, 3\); give it as \(2, 4\)"),
        ("logit_opacities", np.zeros((2, 1)), "logit_opacities of the splats has shape"),
        (
            "sh",
            np.zeros((2, 5, 3)),
            r"sh of the splats has shape \(2, 5, 3\); .*one of 1, 4, 9, 16",
        ),
        ("means", np.full((2, 3), np.nan), "means of the splats is not finite somewhere"),
    ],
)
def test_splats_that_cannot_be_are_refused(part, value, words):
    with pytest.raises(GeoEvsError, match=words):
        Splats(**{**vars(TWO), part: value})
