"""The nodes of a scene as named arrays, and back."""

import numpy as np
import torch
from torch import Tensor

from baselines.gaussians.model import Gaussians
from baselines.gaussians.nodes import Actor, Background, SceneGraph, Sky

TRACK = ("size", "centres", "yaws", "shifts", "turns")


def scene_arrays(graph: SceneGraph) -> dict[str, np.ndarray]:
    """All that drawing needs, by names such as `background/means`."""
    arrays: dict[str, np.ndarray | Tensor] = {}
    for node in graph.nodes():
        arrays |= {f"{node.name}/{name}": t for name, t in node.gaussians.named_parameters()}
    for actor in graph.actors:
        arrays |= {f"{actor.name}/{name}": getattr(actor, name) for name in TRACK}
        arrays[f"{actor.name}/frames"] = np.array(actor.frames)
    if graph.sky is not None:
        arrays["sky/colours"] = graph.sky.colours
    arrays["actors"] = np.array([actor.name for actor in graph.actors], dtype=str)
    return {
        name: array.detach().cpu().numpy() if isinstance(array, Tensor) else array
        for name, array in arrays.items()
    }


def scene_from_arrays(arrays: dict[str, np.ndarray], device: str) -> SceneGraph:
    """The nodes that `scene_arrays` described."""

    def tensor(node: str, name: str) -> Tensor:
        return torch.from_numpy(arrays[f"{node}/{name}"]).to(device)

    def gaussians(node: str) -> Gaussians:
        names = Gaussians.__dataclass_fields__
        return Gaussians(**{name: tensor(node, name) for name in names})

    actors = [
        Actor(
            name,
            gaussians(name),
            tuple(arrays[f"{name}/frames"].tolist()),
            **{part: tensor(name, part) for part in TRACK},
        )
        for name in arrays["actors"].tolist()
    ]
    sky = Sky(tensor("sky", "colours")) if "sky/colours" in arrays else None
    return SceneGraph(Background(gaussians("background")), actors, sky)
