"""No box of a detector's scene reaches what renders for it."""

import pytest

from geoevs.core.files import read_json
from geoevs.core.images import read_image
from geoevs.detection.entrant_views import render_views
from geoevs.detection.views import ViewSettings, views_between, write_without_boxes
from geoevs.methods.tiny import write_tiny_scene
from geoevs.protocol.entries import MethodEntry, read_outcomes
from geoevs.protocol.targets import ALL_CAMERAS, write_targets
from geoevs.scenes.store import Scene

NO_LIMITS = {"fit": None, "render": None}


def rendered(folder, entry, tracks=None):
    """The pictures of an entrant of the tiny scene with these boxes, and how it ended."""
    scene = write_tiny_scene(folder / "scene")
    if tracks is not None:
        tracks(scene).to_parquet(scene.folder / "tracks.parquet", index=False)
    scene = Scene(scene.folder)
    targets = views_between(scene, ViewSettings((0.5,), (1.0,)))
    write_targets(folder / "targets.json", targets)
    write_without_boxes(folder / "given", scene)
    logs = (folder / "fit.log", folder / "render.log")
    places = (folder / "given", folder / "targets.json", folder / "model", folder / "views")
    render_views(entry, *places, logs, NO_LIMITS)
    outcome = read_outcomes(folder / "views/render.json")[ALL_CAMERAS]
    keys = [target.key for target in targets]
    found = [folder / f"views/{key}.png" for key in keys]
    return [read_image(path).tobytes() for path in found if path.exists()], outcome


@pytest.mark.slow
def test_who_declares_tracks_renders_the_same_wherever_the_boxes_are(tmp_path):
    entry = MethodEntry("reproject", "all-frames", {"frames": "all"})
    one, outcome = rendered(tmp_path / "one", entry)
    assert outcome["status"] == "ok", outcome
    assert len(one) == 2 * 2
    assert outcome["render_seconds"] > 0

    def moved(scene):
        tracks = scene.tracks.assign(moving=True)
        return tracks.assign(x=tracks["x"] + 1.5 * tracks["frame"])

    other, _ = rendered(tmp_path / "other", entry, moved)
    assert one == other


@pytest.mark.slow
def test_who_fails_leaves_a_reason(tmp_path):
    found, outcome = rendered(tmp_path, MethodEntry("external", options={"folder": "nowhere"}))
    assert found == []
    assert outcome["stage"] == "fit"
    assert "nowhere" in outcome["reason"]
    assert read_json(tmp_path / "views/render.json")[ALL_CAMERAS]["status"] == "failed"
