"""The Gaussians of a saved entrant as files that other tools open, one for each frame."""

from pathlib import Path
from typing import cast

from geoevs.core.errors import GeoEvsError, reason_of
from geoevs.core.files import new_folder, write_json
from geoevs.methods.contract import SplatsAdapter
from geoevs.methods.returned import checked_splats
from geoevs.protocol.saved import SavedScene
from geoevs.scenes.scene import SceneInfo
from geoevs.scenes.splats import Splats, write_splats_ply, write_splats_spz

SKY, ALL_FRAMES, ABOUT = "sky", "all-frames", "about.json"


def export_splats(saved: SavedScene, label: str, out: Path) -> list[str]:
    """Write an entrant's Gaussians as `.ply` and `.spz`: a pair for each frame, and one of the sky.

    Where nothing moves there is one pair for all frames. `about.json` says what the header of each
    `.ply` says, which `.spz` has no place for.

    Args:
        saved: the run's scene.
        label: the entrant.
        out: the folder to write, whole or not at all.

    Returns:
        Sentences for people: what was written, in which coordinates, and where the sky is.

    Raises:
        GeoEvsError: the entrant has no model or no Gaussians, or nothing can be written.
    """
    if not hasattr(saved.method(label), "splats"):
        others = saved.with_part("splats")
        raise GeoEvsError(
            f"'{label}' is not made of Gaussians, so it has none to export; "
            + (f"of this scene, {', '.join(others)} are" if others else "no entrant here is")
        )
    adapter, scene = cast(SplatsAdapter, saved.load(label)), saved.scene()
    frames, first = scene.frames, _splats(adapter, label, scene.frames[0])
    moves = any(not first.same(_splats(adapter, label, frame)) for frame in frames[1:])
    world, sky = _world(scene.info), _sky(label, first.sky)
    about = f"{label} of {saved.dataset}/{saved.name}, made by geoevs export-splats"
    counts = {}
    with new_folder(out) as partial:

        def write(name: str, splats: Splats, when: str) -> None:
            licence = f"licence of the scene: {scene.info.licence}"
            comments = (f"{about}; {when}", world, sky, licence)
            write_splats_ply(partial / f"{name}.ply", splats, comments)
            write_splats_spz(partial / f"{name}.spz", splats)
            counts[name] = len(splats)

        if moves:
            for frame in frames:
                when = f"frame {frame}, {scene.timestamp(frame):g} s"
                write(f"{frame:06d}", _splats(adapter, label, frame), when)
        else:
            write(ALL_FRAMES, first, "all frames, since nothing moves")
        if first.sky is not None:
            write(SKY, first.sky, "the sky of all frames")
        described = {
            **{"entrant": label, "dataset": saved.dataset, "scene": saved.name},
            **{"licence": scene.info.licence, "redistribute": scene.info.redistribute},
            **{"world": world, "origin": scene.info.origin, "sky": sky, "gaussians": counts},
        }
        write_json(partial / ABOUT, described)
    kind = f"{len(frames)} frames" if moves else "all frames in one, since nothing moves"
    return [f"wrote {out}: {label}, {kind}, each as .ply and .spz", world, sky]


def _splats(adapter: SplatsAdapter, label: str, frame: int) -> Splats:
    try:
        return checked_splats(adapter.splats(frame))
    except Exception as error:  # a method may raise anything, at a damaged model too
        raise GeoEvsError(
            f"the model of '{label}' gives no Gaussians of frame {frame} ({reason_of(error)}); "
            "fit it again"
        ) from error


def _world(info: SceneInfo) -> str:
    world = "metres in the world of the scene store, z up"
    if any(info.origin):
        return f"{world}; add {', '.join(f'{v:g}' for v in info.origin)} for its source's own"
    return f"{world}, which is that of its source"


def _sky(label: str, sky: Splats | None) -> str:
    if sky is None:
        return f"{label} has no sky apart: what it shows of one is among these Gaussians"
    return (
        f"the sky is no part of the frames but a shell of {len(sky)} far Gaussians, {SKY}.ply and "
        f"{SKY}.spz, to open with them"
    )
