"""3D Gaussians as data, and the files in which viewers and other tools take them.

`.ply` has the layout that 3DGS published (Kerbl et al. 2023, `GaussianModel.save_ply`), `.spz`
version 3 of Niantic's format (https://github.com/nianticlabs/spz, README, "File Format").
"""

import gzip
import math
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_bytes
from geoevs.scenes.interop import write_ply

SH_COUNTS = (1, 4, 9, 16)
"""Coefficients of the spherical harmonics of degrees 0 to 3."""

SPZ_MAGIC, SPZ_VERSION = 0x5053474E, 3

SPZ_COLOUR = 0.15
"""Of a byte's range for each unit of the constant harmonic, so that colours may leave [0, 1]."""

SPZ_FRACTION = 10
"""Bits behind the point of a coordinate: a millimetre."""

SPZ_REACH = (2**23 - 1) / 2**SPZ_FRACTION
"""Metres from 0 that a coordinate of 24 bits counts: 8 km."""


@dataclass(frozen=True)
class Splats:
    """3D Gaussians in the world, as a method learned them, before any function bounds them.

    Args:
        means: (N, 3) centres in the world, metres.
        quats: (N, 4) rotations as w, x, y, z, of any length but zero.
        log_scales: (N, 3) logarithms of the standard deviations along the rotated axes, metres.
        logit_opacities: (N,) before the sigmoid.
        sh: (N, K, 3) coefficients of real spherical harmonics of the viewing direction about
            mid-grey, K of SH_COUNTS.
        sky: Gaussians far behind all others that stand for a sky which has no place; None where
            there is no such sky.

    Raises:
        GeoEvsError: shapes do not pair up, or something is not finite; the sentence names it.
    """

    means: np.ndarray  # [N, 3] float32
    quats: np.ndarray  # [N, 4] float32
    log_scales: np.ndarray  # [N, 3] float32
    logit_opacities: np.ndarray  # [N] float32
    sh: np.ndarray  # [N, K, 3] float32
    sky: "Splats | None" = None

    def __post_init__(self) -> None:
        shapes = {"means": (3,), "quats": (4,), "log_scales": (3,), "logit_opacities": ()}
        if self.sh.ndim != 3 or self.sh.shape[1] not in SH_COUNTS:
            raise GeoEvsError(
                f"sh of the splats has shape {self.sh.shape}; give it as (N, K, 3), K one of "
                f"{', '.join(map(str, SH_COUNTS))}"
            )
        for name, shape in {**shapes, "sh": (self.sh.shape[1], 3)}.items():
            array = getattr(self, name)
            wanted = (len(self.means), *shape)
            if array.shape != wanted:
                raise GeoEvsError(
                    f"{name} of the splats has shape {array.shape}; give it as {wanted}, one row "
                    "a Gaussian"
                )
            if not np.isfinite(array).all():
                raise GeoEvsError(f"{name} of the splats is not finite somewhere; fit them again")

    def __len__(self) -> int:
        return len(self.means)

    def same(self, other: "Splats") -> bool:
        """Whether others are the same to the bit, their sky aside."""
        names = ("means", "quats", "log_scales", "logit_opacities", "sh")
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in names)


def write_splats_ply(path: Path, splats: Splats, comments: tuple[str, ...] = ()) -> None:
    """Write Gaussians in 3DGS's layout, numbers as they are, the sky left out.

    Args:
        path: of the file, whole or not at all.
        splats: the Gaussians.
        comments: of the header, one line each.
    """
    # Published: all coefficients of red, then of green, then of blue.
    rest = np.swapaxes(splats.sh[:, 1:], 1, 2).reshape(len(splats), -1)
    columns = {
        **_columns("{}", "xyz", splats.means),
        **_columns("n{}", "xyz", np.zeros_like(splats.means)),
        **_columns("f_dc_{}", range(3), splats.sh[:, 0]),
        **_columns("f_rest_{}", range(rest.shape[1]), rest),
        "opacity": splats.logit_opacities,
        **_columns("scale_{}", range(3), splats.log_scales),
        **_columns("rot_{}", range(4), splats.quats),
    }
    vertices = np.zeros(len(splats), [(name, "<f4") for name in columns])
    for name, column in columns.items():
        vertices[name] = column
    write_ply(path, vertices, comments)


def _columns(pattern: str, names: "str | range", array: np.ndarray) -> dict[str, np.ndarray]:
    return {pattern.format(name): array[:, i] for i, name in enumerate(names)}


def write_splats_spz(path: Path, splats: Splats) -> None:
    """Write Gaussians as `.spz`, coordinates as they are, the sky left out.

    A coordinate has 24 bits, a standard deviation, an opacity and a coefficient of the harmonics 8,
    a rotation 32. What a byte cannot hold is written as the nearest that it can. A Gaussian beyond
    SPZ_REACH is brought nearer to the origin and made smaller alike, so that it looks the same from
    there.

    Args:
        path: of the file, whole or not at all.
        splats: the Gaussians.
    """
    degree = SH_COUNTS.index(splats.sh.shape[1])
    numbers = SPZ_MAGIC, SPZ_VERSION, len(splats), degree, SPZ_FRACTION
    header = struct.pack("<IIIBBBB", *numbers, 0, 0)
    means = splats.means.astype(np.float64)
    nearer = np.minimum(1.0, SPZ_REACH / np.maximum(np.abs(means).max(axis=1, keepdims=True), 1.0))
    fixed = np.rint(means * nearer * 2**SPZ_FRACTION).astype("<i4")
    opacities = 1 / (1 + np.exp(-splats.logit_opacities.astype(np.float64)))
    parts = (
        fixed.view(np.uint8).reshape(-1, 4)[:, :3],  # the highest byte only repeats the sign
        _byte(opacities * 255),
        _byte((splats.sh[:, 0] * SPZ_COLOUR + 0.5) * 255),
        _byte((splats.log_scales + np.log(nearer) + 10) * 16),
        _smallest_three(splats.quats),
        _byte(splats.sh[:, 1:] * 128 + 128),
    )
    data = header + b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
    write_bytes(path, gzip.compress(data, mtime=0))


def _byte(values: np.ndarray) -> np.ndarray:
    return np.rint(values).clip(0, 255).astype(np.uint8)


def _smallest_three(
    quats: np.ndarray,  # [N, 4] w, x, y, z
) -> np.ndarray:
    """(N,) 32 bits: which of x, y, z, w is largest, then the others, a sign and 9 bits each.

    A rotation is also that of the opposite quaternion, so the largest is taken as positive; the
    others are at most the root of a half.
    """
    length = np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True)
    xyzw = np.roll(quats, -1, axis=1) / np.where(length > 0, length, 1.0)
    largest = np.abs(xyzw).argmax(axis=1)
    xyzw *= np.where(np.take_along_axis(xyzw, largest[:, None], axis=1) < 0, -1.0, 1.0)
    packed = largest.astype("<u4")
    for i in range(4):
        steps = np.rint(np.abs(xyzw[:, i]) * math.sqrt(2) * 511).astype("<u4")
        bits = np.where(xyzw[:, i] < 0, 512, 0).astype("<u4") | steps
        packed = np.where(largest == i, packed, packed << 10 | bits)
    return packed.astype("<u4")
