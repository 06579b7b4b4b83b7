"""Features of pictures, made once for all detectors that see them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import whole_file
from geoevs.core.images import to_uint8
from geoevs.core.mapped import Stack, read_mapped, write_mapped
from geoevs.detection.bevformer.backbone import Backbone
from geoevs.detection.bevformer.inputs import FeatureFrame, RigFrame

GEOMETRY = ("image_from_vehicle", "recorded", "world_from_vehicle", "boxes", "classes")
"""What stands in a file as it is in a frame."""

LARGEST = 60_000.0
"""Of a feature; float16 ends at 65,504."""


@torch.inference_mode()
def cache_features(frame: RigFrame, backbone: Backbone, size: tuple[int, int], path: Path) -> None:
    """Write a frame's features, its geometry and labels, whole or not at all.

    Args:
        frame: of any views; those of one frame may lie in several files (see `read_features`).
        backbone: on the device to compute on.
        size: height and width that pictures are resized to, those of the detector's `image`.
        path: the file.
    """
    frame = frame.resized(size)
    device = next(backbone.parameters(), torch.zeros(())).device
    images = np.ascontiguousarray(frame.images.transpose(0, 3, 1, 2), np.float32)
    features = backbone(torch.from_numpy(images).to(device))
    arrays = {name: np.asarray(getattr(frame, name)) for name in GEOMETRY}
    write_mapped(
        path,
        {
            **arrays,
            "features": features.clamp(-LARGEST, LARGEST).half().cpu().numpy(),
            "pictures": to_uint8(frame.images[frame.recorded]),
            "names": np.array([frame.scene, backbone.identity]),
            "numbers": np.array([frame.frame, *size], np.int64),
            "seconds": np.array([frame.seconds], np.float64),
        },
    )


def read_features(*paths: Path) -> FeatureFrame:
    """What `cache_features` wrote of one frame, the views of all files together.

    Features are read when they are asked for. Labels are the first file's.

    Raises:
        GeoEvsError: a file is missing or damaged, or files are of different frames or backbones.
    """
    parts = [_read(path) for path in paths]
    first = parts[0]
    for part, path in zip(parts, paths, strict=True):
        same = (part.scene, part.frame, part.size, part.backbone)
        if same != (first.scene, first.frame, first.size, first.backbone):
            raise GeoEvsError(
                f"{path} has features of another frame or backbone than {paths[0]}; make both again"
            )
    return FeatureFrame(
        scene=first.scene,
        frame=first.frame,
        seconds=first.seconds,
        image_from_vehicle=np.concatenate([part.image_from_vehicle for part in parts]),
        recorded=np.concatenate([part.recorded for part in parts]),
        world_from_vehicle=first.world_from_vehicle,
        boxes=first.boxes,
        classes=first.classes,
        stack=Stack.join([part.stack for part in parts]),
        size=first.size,
        pictures=Stack.join([part.pictures for part in parts]),
        backbone=first.backbone,
    )


def _read(path: Path) -> FeatureFrame:
    arrays = read_mapped(path)
    with whole_file(path):
        scene, backbone = (str(name) for name in np.asarray(arrays["names"]))
        frame, height, width = (int(number) for number in np.asarray(arrays["numbers"]))
        geometry = {name: np.asarray(arrays[name]) for name in GEOMETRY}
        stack, count = arrays["features"], len(geometry["recorded"])
        if stack.ndim != 4 or len(stack) != count or stack.dtype != np.float16:
            raise ValueError(f"it has features of the shape {stack.shape} for {count} views")
        return FeatureFrame(
            **geometry,
            scene=scene,
            frame=frame,
            seconds=float(np.asarray(arrays["seconds"])[0]),
            stack=stack,
            size=(height, width),
            pictures=arrays["pictures"],
            backbone=backbone,
        )


def check_features(frames: Sequence[RigFrame | FeatureFrame], backbone: Backbone) -> None:
    """Refuse features that another backbone made.

    Raises:
        GeoEvsError: there are such; the first frame is named.
    """
    identity = ""
    for frame in frames:
        if isinstance(frame, FeatureFrame):
            identity = identity or backbone.identity
            if frame.backbone != identity:
                raise GeoEvsError(
                    f"{frame.name} has features of another backbone than the detector's; make them "
                    "again with the detector's"
                )
