"""Images: PNG and JPEG by content, in (H, W, 3) RGB."""

import io
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import check_file, write_bytes
from geoevs.core.text import clean

MAX_PIXELS = 2**26
"""Most pixels of an image: twice those of an 8K one."""


def read_image(path: Path) -> np.ndarray:
    """Read a PNG or JPEG file (see `decode_image`).

    Raises:
        GeoEvsError: the file is missing, or holds no such image.
    """
    path = check_file(path)
    return decode_image(path, path)


def decode_image(file: Path | io.BytesIO, where: Path | str) -> np.ndarray:
    """Decode a PNG or JPEG to (H, W, 3) uint8 RGB, turned as its EXIF says.

    Grey, palettes and 16 bits are converted. What would be scored as something else than it shows
    is refused: transparency, floats, CMYK.

    Args:
        file: the image.
        where: it stands, for errors.

    Raises:
        GeoEvsError: it is truncated, is neither by its content, has another meaning, or more than
            MAX_PIXELS.
    """
    try:
        with Image.open(file, formats=("PNG", "JPEG")) as image:
            if image.width * image.height > MAX_PIXELS:
                raise GeoEvsError(
                    f"{where} has {image.height} x {image.width} pixels, more than any camera; "
                    "make it smaller"
                )
            image.verify()  # a PNG's checksums, which decoding leaves out
        if isinstance(file, io.BytesIO):
            file.seek(0)
        with Image.open(file, formats=("PNG", "JPEG")) as image:
            return _rgb(ImageOps.exif_transpose(image), where)
    except GeoEvsError:
        raise
    except Exception as error:  # decoders raise anything at damaged files
        raise GeoEvsError(
            f"{where} is not a whole PNG or JPEG image ({clean(str(error))}); make or download it "
            "again"
        ) from error


def _rgb(image: Image.Image, path: Path | str) -> np.ndarray:
    """(H, W, 3) uint8 of an image whose mode says what its pixels mean."""
    if image.mode.startswith("I;16"):
        grey = np.rint(np.asarray(image, np.float64) / 257.0).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=2)
    if image.mode in ("LA", "PA", "RGBA") or "transparency" in image.info:
        rgba = np.asarray(image.convert("RGBA"))
        if (rgba[..., 3] < 255).any():
            raise GeoEvsError(f"{path} has transparent pixels; save it without an alpha channel")
        return np.ascontiguousarray(rgba[..., :3])
    if image.mode not in ("1", "L", "P", "RGB"):
        raise GeoEvsError(f"{path} has pixels of mode {image.mode}; save it as 8-bit RGB")
    return np.asarray(image.convert("RGB"))


def write_image(path: Path, image: np.ndarray) -> None:
    """Write (H, W, 3) uint8, or float in [0, 1], as PNG, whole or not at all."""
    write_bytes(path, encode_png(image))


def encode_png(image: np.ndarray) -> bytes:
    """(H, W, 3) uint8, or float in [0, 1] (clipped, rounded to nearest), as PNG bytes."""
    buffer = io.BytesIO()
    Image.fromarray(to_uint8(image)).save(buffer, format="png", compress_level=3)
    return buffer.getvalue()


def to_uint8(image: np.ndarray) -> np.ndarray:
    """Float image in [0, 1] to uint8, clipped and rounded to nearest; uint8 passes through."""
    if image.dtype == np.uint8:
        return image
    return np.rint(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)


def to_float(image: np.ndarray) -> np.ndarray:
    """uint8 image to float32 in [0, 1]; float images become float32."""
    if image.dtype == np.uint8:
        return image.astype(np.float32) / np.float32(255.0)
    return image.astype(np.float32)
