"""The pictures of a run that its page compares, within a budget of bytes."""

import base64
import hashlib
import io
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from geoevs.core.images import read_image, to_uint8
from geoevs.protocol.reference import SparseReference
from geoevs.protocol.targets import Target
from geoevs.results.figures import mask_picture, truth_picture, validity_picture
from geoevs.run import Answers

WIDEST = 384
"""Pixels; wider pictures are shrunk to this."""

QUALITIES = (80, 60, 40, 30)
"""Of WebP; the first that the budget allows is taken."""

SAMPLED = 96
"""Renders that say what all will take."""

TRUTH, REFERENCE, OVERLAY = "truth", "sparse reference", "overlay"


@dataclass(frozen=True)
class View:
    """A target of a scene, with the answers and the renders of all of them."""

    answers: Answers
    target: Target

    def render(self, label: str) -> Path:
        """The file of an entrant's render, which need not exist."""
        return self.answers.renders(label) / f"{self.target.key}.png"


def comparison(
    run: Path,
    scenes: Sequence[tuple[str, str]],
    labels: Sequence[str],
    budget: int,
    threads: int = 1,
) -> dict[str, Any]:
    """Every target's truth, reference, overlay and renders as `data:` addresses.

    If all of them take more than the budget at the lowest quality, frames are left out evenly.

    Args:
        run: the run's folder.
        scenes: (dataset, scene) pairs.
        labels: the entrants.
        budget: bytes that the addresses may take together, about.
        threads: that compress the pictures.

    Returns:
        `images`, a list of addresses; `views`, one dictionary a target, with its names and the
        numbers of its pictures in that list; `quality` of the pictures; `frames` and `all_frames`:
        how many of the run's frames the page has.
    """
    views = [
        View(answers, target)
        for answers in (Answers(run, *place) for place in scenes)
        for target in answers.targets
    ]
    with ThreadPoolExecutor(threads) as pool:
        quality, share = _fit(views, labels, budget, pool)
        kept = _thinned(views, share)
        pictures = pool.map(lambda view: _pictures(view, labels, quality), kept)
        images: dict[str, int] = {}
        shown = [
            _described(view, addresses, images)
            for view, addresses in zip(kept, pictures, strict=True)
        ]
    frames, all_frames = (
        len({(view.answers, view.target.frame) for view in some}) for some in (kept, views)
    )
    counts = {"frames": frames, "all_frames": all_frames}
    return {"images": list(images), "views": shown, "quality": quality, **counts}


def _thinned(views: list[View], share: float) -> list[View]:
    """The views of a share of each scene's frames, evenly spaced, of one at least."""
    frames: dict[Answers, list[int]] = {}
    for view in views:
        frames.setdefault(view.answers, []).append(view.target.frame)
    kept = {}
    for scene, found in frames.items():
        some = sorted(set(found))
        count = max(1, int(share * len(some)))
        kept[scene] = {some[k * len(some) // count] for k in range(count)}
    return [view for view in views if view.target.frame in kept[view.answers]]


def _fit(
    views: list[View], labels: Sequence[str], budget: int, pool: Executor
) -> tuple[int, float]:
    """The best quality, and the largest share of frames, that a sample says will fit."""
    files = _unlike(
        path for view in views for label in labels if (path := view.render(label)).is_file()
    )
    sample = files[:SAMPLED]
    if not sample:
        return QUALITIES[0], 1.0
    # What compresses badly as PNG does so as WebP. Truth, reference and overlay come to about two
    # more pictures a view.
    times = sum(map(_bytes, files)) / sum(map(_bytes, sample)) * (1 + 2 * len(views) / len(files))
    needed = 0.0
    for quality in QUALITIES:
        needed = times * sum(map(len, pool.map(_address, sample, repeat(quality))))
        if needed <= budget:
            return quality, 1.0
    return QUALITIES[-1], budget / needed


def _unlike(files: Iterable[Path]) -> list[Path]:
    """One file of every content, in an order that has nothing to do with what it shows."""
    found = {hashlib.sha256(path.read_bytes()).digest(): path for path in files}
    return [path for _, path in sorted(found.items())]


def _bytes(file: Path) -> int:
    return file.stat().st_size


def _pictures(view: View, labels: Sequence[str], quality: int) -> dict[str, str]:
    """The address of every picture of a view, by name."""
    answers, target, found = view.answers, view.target, {}
    truth = truth_picture(answers, target)
    if truth is not None:
        found[TRUTH] = _address(truth, quality)
    if not target.recorded:
        reference = answers.reference(target)
        found[REFERENCE] = _address(_with_mask(reference), None)
        if not target.masked:
            found[OVERLAY] = _address(validity_picture(reference), None)
    if target.masked:
        found[OVERLAY] = _address(mask_picture(answers.mask(target)), None)
    for label in labels:
        path = view.render(label)
        if path.is_file():
            found[label] = _address(path, quality)
    return found


def _described(view: View, addresses: dict[str, str], images: dict[str, int]) -> dict[str, Any]:
    """A view's names and the numbers of its pictures, which are added to the images."""
    numbers = {name: images.setdefault(address, len(images)) for name, address in addresses.items()}
    overlay = numbers.pop(OVERLAY, None)
    target = view.target
    name = {"split": target.split, "frame": target.frame, "view": target.camera.name}
    return {**view.answers.place, **name, "overlay": overlay, "pictures": numbers}


def _with_mask(reference: SparseReference) -> np.ndarray:
    """(H, W, 4) uint8: a sparse reference, transparent where it is invalid."""
    opaque = np.where(reference.mask(), 255, 0).astype(np.uint8)
    return np.dstack([to_uint8(reference.image()), opaque])


def _address(picture: np.ndarray | Path, quality: int | None) -> str:
    """A picture as the address of a WebP; without a quality it is exact, pixel by pixel."""
    image = Image.fromarray(read_image(picture) if isinstance(picture, Path) else picture)
    if image.width > WIDEST:
        how = Image.Resampling.NEAREST if quality is None else Image.Resampling.BOX
        image = image.resize((WIDEST, round(WIDEST * image.height / image.width)), how)
    buffer = io.BytesIO()
    if quality is None:
        image.save(buffer, "webp", lossless=True, method=2)
    else:
        image.save(buffer, "webp", quality=quality, method=2)
    return webp_address(buffer.getvalue())


def webp_address(data: bytes) -> str:
    """The address of a WebP's bytes."""
    return "data:image/webp;base64," + base64.b64encode(data).decode()


def file_address(path: Path, widest: int = 1600) -> str:
    """The address of a picture file, as WebP and no wider than so many pixels."""
    image = Image.fromarray(read_image(path))
    if image.width > widest:
        size = (widest, round(widest * image.height / image.width))
        image = image.resize(size, Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    image.save(buffer, "webp", quality=80)
    return webp_address(buffer.getvalue())
