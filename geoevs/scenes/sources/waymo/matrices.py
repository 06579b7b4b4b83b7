"""Waymo's matrices of floats: a protocol buffer of values and sides, compressed with zlib."""

import math
import zlib

import numpy as np

from geoevs.core.errors import GeoEvsError
from geoevs.core.protobuf import Message, damaged
from geoevs.core.text import clean

MOST_MATRIX_BYTES = 32 * 2**20
"""Bytes that a compressed matrix may unpack to; the poses of the top LiDAR's pixels have 4 MB."""


def read_matrix(message: Message, number: int, channels: int) -> np.ndarray | None:
    """(H, W, channels) float32 of a field with a MatrixFloat; None if the message has none.

    Raises:
        GeoEvsError: it unpacks to more than MOST_MATRIX_BYTES or not at all, or its shape is
            another or does not hold its values.
    """
    data = message.chunk(number)
    if not data:
        return None
    matrix = Message(_unpacked(data, message.where), f"{message.where}: a range image")
    return shaped(matrix.floats(1), matrix.message(2).wholes(1), channels, matrix.where)


def _unpacked(data: memoryview, where: str) -> bytes:
    unpacker = zlib.decompressobj()
    try:
        raw = unpacker.decompress(data, MOST_MATRIX_BYTES)
    except zlib.error as error:
        raise damaged(where, clean(f"a range image: {error}")) from error
    if not unpacker.eof:
        if len(raw) < MOST_MATRIX_BYTES:
            raise damaged(where, "a range image is cut off")
        raise GeoEvsError(
            f"{where} has a range image that unpacks to more than {MOST_MATRIX_BYTES // 2**20} "
            "MiB, far beyond a Waymo one; do not open its file, get the original"
        )
    return raw


def shaped(values: np.ndarray, shape: list[int], channels: int, where: str) -> np.ndarray:
    """Flat values as (H, W, channels).

    Raises:
        GeoEvsError: the shape is another, or does not hold the values.
    """
    if len(shape) != 3 or shape[2] != channels or math.prod(shape) != len(values):
        named = " x ".join(clean(str(side), 20) for side in shape[:4])
        raise damaged(
            where, f"{len(values)} values do not fill rows x columns x {channels} of {named or 0}"
        )
    return values.reshape(shape)
