"""Which features a detector learns best from: all backbones, on streets that nothing else uses.

python -m benchmarks.detector_features FOLDER cnn vggt-nano autoencoder efficientnet

FOLDER keeps the streets, features and detectors, so that a run that was ended goes on; names after
it are backbones, all without any. For each: seconds of CPU, and what is found on validation
streets.
"""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd
import torch
from rich.console import Console
from rich.table import Table

from benchmarks.projection import processor
from geoevs.core.errors import did_you_mean
from geoevs.core.images import to_float
from geoevs.detection.bevformer.backbone import load_backbone
from geoevs.detection.bevformer.detecting import detect
from geoevs.detection.bevformer.features import cache_features, read_features
from geoevs.detection.bevformer.inputs import FeatureFrame, RigFrame
from geoevs.detection.bevformer.settings import BACKBONES, Detector, Fitting
from geoevs.detection.bevformer.training import train, train_backbone
from geoevs.detection.labels import scene_labels, world_from_vehicle
from geoevs.detection.metrics import metrics_table
from geoevs.detection.rows import BOX
from geoevs.detection.rules import CENTRE, CLASSES, LET, RANGE, TYPE, Tolerance
from geoevs.detection.scoring import detection_counts
from geoevs.detection.settings import CLASSES as LABELS
from geoevs.detection.task_metrics import image_from_vehicle
from geoevs.projection import colour_frame
from geoevs.scenes.scene import SceneRef, load_source
from geoevs.scenes.store import Scene, write_scene

LAYOUTS = ("straight", "curve", "junction")
TRAINING, VALIDATION = range(3001, 3045), range(3901, 3911)
OPTIONS = {"frames": 4, "interval": 0.5, "samples": 4, "lidar_azimuths": 800}
SENSOR = (1.35, 0.0, 2.0)
"""The mean place of street's cameras in the vehicle's frame."""
SEED = 0

Result = TypeVar("Result")


def spent(action: Callable[[], Result]) -> tuple[Result, float]:
    """What an action gives, and the seconds of CPU that it took."""
    began = time.process_time()
    return action(), time.process_time() - began


def open_streets(numbers: Sequence[int], folder: Path, size: tuple[int, int]) -> Iterator[Scene]:
    """Stores of streets, rendered where they are not there yet."""
    source = load_source("street", *size, OPTIONS)
    for number in numbers:
        name = f"{LAYOUTS[number % 3]}-{number}"
        if not (folder / name).is_dir():
            record = source.open(SceneRef.parse(name))
            write_scene(folder / name, record.info, record.tracks, map(colour_frame, record.frames))
        yield Scene(folder / name)


def read_frames(scene: Scene, detector: Detector) -> tuple[list[RigFrame], pd.DataFrame]:
    """All frames of a street, and its labels that count."""
    labels = scene_labels(scene, scene.info.name, LABELS, detector.range)
    labels = labels[labels["reason"] == ""]
    frames = []
    for number in scene.frames:
        pose, mine = world_from_vehicle(scene, number), labels[labels["frame"] == number]
        cameras = [scene.camera(name, number) for name in scene.cameras]
        frames.append(
            RigFrame(
                scene=scene.info.name,
                frame=number,
                seconds=scene.timestamp(number),
                images=np.stack([to_float(scene.image(name, number)) for name in scene.cameras]),
                image_from_vehicle=np.stack([image_from_vehicle(each, pose) for each in cameras]),
                recorded=np.ones(len(cameras), bool),
                world_from_vehicle=pose,
                boxes=mine[list(BOX)].to_numpy(np.float64),
                classes=pd.Index(CLASSES).get_indexer(mine["class"]).astype(np.int64),
            )
        )
    return frames, labels


def cached(
    frames: Sequence[RigFrame], backbone: Path, detector: Detector, folder: Path
) -> list[FeatureFrame]:
    """Frames with a backbone's features."""
    network, found = load_backbone(backbone), []
    for frame in frames:
        path = folder / frame.scene / f"{frame.frame}.npz"
        cache_features(frame, network, detector.image, path)
        found.append(read_features(path))
    return found


def scores(predictions: pd.DataFrame, labels: pd.DataFrame) -> list[str]:
    """LET-AP of vehicles and of pedestrians, vehicles' AP at 2 m and how many are turned round."""
    let = replace(LET, breakdowns=(TYPE, RANGE), tolerance=Tolerance(sensor=SENSOR))
    cells, flipped = [], np.nan
    for rules, kinds in ((let, ("vehicle", "pedestrian")), (CENTRE, ("vehicle",))):
        counts = detection_counts(predictions, labels, rules)
        table = metrics_table(counts, 1000, 0.95)
        table = table[table["breakdown"] == TYPE].set_index("class")
        for kind in kinds:
            row = table.loc[kind]
            low, high = 100 * row["ap_low"], 100 * row["ap_high"]
            cells.append(f"{100 * row['ap']:.1f} ({low:.0f}-{high:.0f})")
        flipped = table.loc["vehicle", "flipped"]
    return [*cells, f"{flipped:.2f}"]


def measure(kind: str, folder: Path, streets: Path, steps: int) -> list[str]:
    """A row of the table: what a detector upon one backbone costs and finds."""
    detector, fitting = Detector(backbone=kind), Fitting(steps=steps, backbone_steps=steps)
    training, validation = (
        [read_frames(scene, detector) for scene in open_streets(some, streets, detector.image)]
        for some in (TRAINING, VALIDATION)
    )
    frames = [frame for of_scene, _ in training for frame in of_scene]
    unseen = [frame for of_scene, _ in validation for frame in of_scene]
    labels = pd.concat([table for _, table in validation], ignore_index=True)
    backbone, weights = folder / "backbone.safetensors", folder / "detector.safetensors"
    pretrained = Path(__file__).parents[1] / "geoevs/weights"
    _, learned = spent(
        lambda: train_backbone(
            frames, detector, fitting, SEED, folder / "backbone", backbone, pretrained
        )
    )
    seen, caching = spent(lambda: cached([*frames, *unseen], backbone, detector, folder / "seen"))
    some, rest = seen[: len(frames)], seen[len(frames) :]
    _, trained = spent(
        lambda: train(some, backbone, detector, fitting, SEED, folder / "work", weights)
    )
    found, detecting = spent(lambda: detect(weights, rest))
    return [
        kind,
        str(load_backbone(backbone).channels),
        f"{learned:.0f}",
        f"{caching / len(seen):.3f}",
        f"{trained / fitting.steps:.3f}",
        f"{detecting / len(rest):.3f}",
        *scores(found, labels),
    ]


COLUMNS = (
    *("backbone", "channels", "it learns, s", "a frame's\nfeatures, s", "a step, s"),
    *("detection\na frame, s", "LET-AP of\nvehicles", "LET-AP of\npedestrians"),
    *("vehicles'\nAP at 2 m", "flipped"),
)


def main() -> None:
    """Print a table: a row a backbone."""
    folder, kinds = Path(sys.argv[1]), sys.argv[2:] or list(BACKBONES)
    for kind in kinds:
        if kind not in BACKBONES:
            raise SystemExit(f"there is no backbone '{kind}'; {did_you_mean(kind, BACKBONES)}")
    torch.set_num_threads(1)
    console = Console()
    steps = Fitting().steps
    console.print(f"{processor()}; 1 thread, seconds of CPU; {steps} steps, seed {SEED}")
    table = Table(*COLUMNS)
    for kind in kinds:
        table.add_row(*measure(kind, folder / kind, folder / "streets", steps))
    console.print(table)


if __name__ == "__main__":
    main()
