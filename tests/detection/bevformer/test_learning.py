"""Whether a detector learns at all."""

from dataclasses import replace

import cv2
import numpy as np
import pandas as pd

from geoevs.detection.bevformer.backbone import new_backbone, save_backbone
from geoevs.detection.bevformer.detecting import detect
from geoevs.detection.bevformer.settings import Fitting
from geoevs.detection.bevformer.training import train
from geoevs.detection.task_metrics import image_boxes


def painted(make_frame, scene, seed):
    """A frame of grey cameras in which one or two cars are bright boxes."""
    random = np.random.default_rng(seed)
    frame = make_frame(scene=scene).resized((32, 48))
    count = random.integers(1, 3)
    boxes = np.zeros((count, 7))
    boxes[:, 0], boxes[:, 1] = random.uniform(3, 18, count), random.uniform(-9, 9, count)
    boxes[:, 2:6] = 0.8, 4.2, 1.8, 1.6
    images = np.full(frame.images.shape, 0.3, np.float32)
    for image, projection in zip(images, frame.image_from_vehicle, strict=True):
        for left, top, right, bottom in image_boxes(boxes, projection, *frame.size):
            if right > left:
                corners = [(int(left), int(top)), (int(right), int(bottom))]
                cv2.rectangle(image, *corners, (0.9, 0.8, 0.2), -1)
    return replace(frame, images=images, boxes=boxes, classes=np.zeros(count, int))


def hits(rows, frames):
    """The share of boxes that one of the three best predictions of its frame is within 2 m of."""
    near = []
    for frame in frames:
        best = rows[rows["scene"] == frame.scene][["x", "y"]].to_numpy()[:3]
        near += list(np.linalg.norm(best[:, None] - frame.boxes[:, :2], axis=-1).min(axis=0))
    return np.mean(np.array(near) < 2)


def test_it_learns_where_bright_boxes_are(make_frame, detector, tmp_path):
    frames = [painted(make_frame, f"street-{n}", n) for n in range(6)]
    larger = replace(detector, image=(32, 48), channels=16, history=0)
    backbone, out = tmp_path / "backbone.safetensors", tmp_path / "detector.safetensors"
    save_backbone(backbone, new_backbone(larger, 0))
    fitting = Fitting(steps=1, learning_rate=4e-3, end_to_end=True)
    train(frames, backbone, larger, fitting, 0, tmp_path / "one", out)
    before = hits(detect(out, frames), frames)
    train(frames, backbone, larger, replace(fitting, steps=250), 0, tmp_path / "all", out)
    losses = pd.read_csv(tmp_path / "all/losses.csv")["loss"]
    assert losses.tail(20).mean() < 0.3 * losses.head(20).mean()
    assert hits(detect(out, frames), frames) > max(0.7, before)
