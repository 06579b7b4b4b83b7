"""Stresses, their isolation, and the pixels that the suite tells apart."""

import numpy as np
import pytest

from geoevs import layout
from geoevs.core.files import read_json, write_json
from geoevs.core.images import write_image
from geoevs.methods.tiny import write_tiny_scene
from geoevs.protocol.condition_masks import RawReprojection
from geoevs.protocol.entries import MethodEntry
from geoevs.protocol.pictures import PICTURES, seal_pictures
from geoevs.protocol.records import write_records
from geoevs.protocol.reference import make_references
from geoevs.protocol.rows import protocol_fingerprint
from geoevs.protocol.stability import (
    CLEAN,
    Stress,
    clean_settings,
    groups,
    levels_of,
    render_stresses,
    stability_targets,
    stresses,
    world_options,
)
from geoevs.protocol.stability_scoring import depth_edges, edge_distance, score_stresses
from geoevs.protocol.stressors import STRESSORS, Stressor
from geoevs.protocol.targets import read_targets, write_targets
from geoevs.protocol.truth import write_truth
from geoevs.run import Answers
from geoevs.scenes.scene import SceneRef
from geoevs.scenes.store import Scene

LEVELS = {name: [] for name in STRESSORS} | {
    "support": [0.05, 0.01],
    "motion": [0, 5],
    "lateral": [0, 2],
    "yaw": [0, 45],
    "edges": [4, 1],
}
SETTINGS = {"seeds": 2, "lateral": [1.0], "levels": LEVELS}


def test_groups_and_their_stresses():
    assert groups(SETTINGS) == [CLEAN, "support", "motion"]
    assert [stress.key for stress in stresses("support", SETTINGS)] == [
        "0.05.seed0",
        "0.05.seed1",
        "0.01.seed0",
        "0.01.seed1",
    ]
    assert [stress.key for stress in stresses("motion", SETTINGS)] == [
        "0.seed0",
        "0.seed1",
        "5.seed0",
        "5.seed1",
    ]
    assert [stress.draw for stress in stresses(CLEAN, SETTINGS)] == [0, 1]


def test_a_stressor_that_is_left_out_has_its_own_levels():
    silent = {**SETTINGS, "levels": {"support": [0.02], "motion": []}}
    assert levels_of("support", silent) == [0.02]
    assert levels_of("cameras", silent) == [1, 2, 3, 4]
    assert groups(silent) == [
        CLEAN,
        "support",
        "beams",
        "rotation",
        "translation",
        "cameras",
        "exposure",
    ]
    assert clean_settings(silent, "tiny")["levels"]["lateral"] == [0, 1, 2, 3, 4]


def test_poses_lie_where_they_say(stage):
    targets = stability_targets(stage.store, SETTINGS)
    front = stage.store.camera("front", 0)
    first = [target for target in targets if target.frame == 0]
    assert {t.split for t in first} == {"extrapolation", "lateral", "yaw"}
    for target in first:
        moved = target.camera.centre - front.centre
        if target.split == "lateral":
            assert target.pose_offset == pytest.approx(0, abs=1e-9)
            assert np.linalg.norm(moved) == pytest.approx(abs(target.lateral_shift))
        elif target.split == "yaw":
            assert target.pose_offset == pytest.approx(float(target.camera.name[-5:-3].strip("-")))
    assert len({target.key for target in targets}) == len(targets)
    other = stability_targets(
        stage.store, clean_settings(SETTINGS, Stress("motion", 5).world("tiny"))
    )
    assert {target.split for target in other} == {"extrapolation"}


@pytest.fixture
def folder(tmp_path, tiny_source):
    """A run of the tiny scene that the suite's steps find their files in."""
    place = {"dataset": "d", "scene": "tiny"}
    store = write_tiny_scene(tmp_path / layout.SCENE.format(**place))
    targets = [t for t in stability_targets(store, SETTINGS) if t.frame == 0]
    write_targets(tmp_path / layout.TARGETS.format(**place), targets)
    references = make_references(store, targets, RawReprojection(store), seed=0)
    write_records(tmp_path / layout.REFERENCES.format(**place), references)
    write_records(tmp_path / layout.MASKS.format(**place), {})
    truth = tmp_path / layout.TRUTH.format(**place)
    write_truth(truth, tiny_source, SceneRef("tiny"), targets, lambda: None)
    return tmp_path


def render(folder, method, group, scenes):
    place = {"dataset": "d", "scene": "tiny"}
    renders = folder / layout.STABILITY_RENDERS.format(group=group, label=method, **place)
    targets, masks = (folder / p.format(**place) for p in (layout.TARGETS, layout.MASKS))
    entry = MethodEntry(method)
    pairs = list(zip(stresses(group, SETTINGS), scenes, strict=True))
    render_stresses(entry, pairs, targets, masks, renders, folder / "method.log")
    return renders


def test_one_failing_stress_does_not_end_the_others(folder, toy):
    method = toy("picky", fit="assert len(views.lidar(0)) > 0", render="pass")
    scene = folder / layout.SCENE.format(dataset="d", scene="tiny")
    # It declares no LiDAR, so that reading it fails; without the scene everything fails.
    renders = render(folder, method, "support", [scene, folder / "nowhere", scene, scene])
    endings = [read_json(renders / s.key / "outcome.json") for s in stresses("support", SETTINGS)]
    assert {ending["status"] for ending in endings} == {"failed"}
    assert "without declaring it" in endings[0]["reason"]
    assert "nowhere" in endings[1]["reason"]
    rows = score_stresses(MethodEntry(method), "support", Answers(folder, "d", "tiny"), SETTINGS)
    assert set(rows["status"]) == {"failed"}
    assert set(rows["level"]) == {0.05, 0.01}


def test_a_process_that_dies_fails_what_it_had_not_done(folder, toy):
    method = toy("dies", render="if camera.name.startswith('extrapolation-right'): os._exit(3)")
    scene = folder / layout.SCENE.format(dataset="d", scene="tiny")
    renders = render(folder, method, "support", [scene] * 4)
    for stress in stresses("support", SETTINGS):
        outcome = read_json(renders / stress.key / "outcome.json")
        assert outcome["status"] == "failed"
        assert "exit code 3" in outcome["reason"]


@pytest.mark.parametrize(
    ("draw", "fits"), [("pass", 2), ("rng.numpy.random()", 4), ("rng.torch.initial_seed()", 4)]
)
def test_a_fit_without_randomness_stands_for_all_draws_of_its_scene(
    folder, toy, tmp_path, draw, fits
):
    done = tmp_path / "done"
    write = f"open({str(done)!r}, 'a').write"
    method = toy("counted", fit=f"{write}('fit ')\n{draw}", render=f"{write}('view ')")
    world = folder / layout.SCENE.format(dataset="d", scene="tiny")
    other = write_tiny_scene(tmp_path / "other").folder
    renders = render(folder, method, "motion", [world, world, other, other])
    assert done.read_text() == "fit view view " * fits  # nothing is timed: no view twice
    for stress in stresses("motion", SETTINGS):
        assert read_json(renders / stress.key / "outcome.json")["status"] == "ok"
        assert len(list((renders / stress.key).rglob("*.png"))) == 2


def test_clean_renders_score_poses_edges_and_spread(folder, toy):
    method = toy("noisy")
    scene = folder / layout.SCENE.format(dataset="d", scene="tiny")
    renders = render(folder, method, CLEAN, [scene, scene])
    # Another draw gives other pictures.
    for target in read_targets(folder / layout.TARGETS.format(dataset="d", scene="tiny")):
        picture = np.full((48, 72, 3), 0.5 + 0.1, np.float32)
        write_image(renders / Stress(CLEAN, draw=1).key / f"{target.key}.png", picture)
    ending = renders / Stress(CLEAN, draw=1).key / "outcome.json"
    listed = read_targets(folder / layout.TARGETS.format(dataset="d", scene="tiny"))
    write_json(ending, {**read_json(ending), PICTURES: seal_pictures(ending.parent, listed)})
    rows = score_stresses(MethodEntry(method), CLEAN, Answers(folder, "d", "tiny"), SETTINGS)
    assert set(rows["stressor"]) == {CLEAN, "lateral", "yaw", "edges"}
    assert set(rows[rows["stressor"] == "yaw"]["level"]) == {0.0, 45.0}
    edges = rows[rows["stressor"] == "edges"].groupby("level")["valid_pixels"].sum()
    assert edges[1] < edges[4]
    spread = rows[rows["metric"] == "seed_spread_supported"]["value"]
    assert len(spread) == 2
    # 128 and 153 of 255: the standard deviation of two draws is their distance over root 2.
    assert spread.to_list() == pytest.approx([25 / 255 / np.sqrt(2)] * 2)


def made_world(folder, name):
    """Give the run the tiny scene again, as another world of it."""
    patterns = (layout.SCENE, layout.TARGETS, layout.REFERENCES, layout.MASKS, layout.TRUTH)
    for pattern in patterns:
        clean, world = (folder / pattern.format(dataset="d", scene=s) for s in ("tiny", name))
        world.symlink_to(clean)
    return folder / layout.SCENE.format(dataset="d", scene=name)


def test_the_metrics_of_motion_tell_moving_cars_apart(folder, toy):
    method = toy("mover")
    worlds = [made_world(folder, f"tiny~traffic_speed={speed}") for speed in (0, 5)]
    render(folder, method, "motion", [world for world in worlds for _ in range(2)])
    rows = score_stresses(MethodEntry(method), "motion", Answers(folder, "d", "tiny"), SETTINGS)
    assert list(dict.fromkeys(rows["metric"])) == ["psnr", "psnr_moving", "psnr_still"]
    assert set(rows["level"]) == {0.0, 5.0}
    assert set(rows["split"]) == {"extrapolation"}


def test_a_stressor_of_another_world_is_added_in_one_place(folder, toy, monkeypatch):
    grain = Stressor("rays of a pixel", kind="world", levels=(8, 2), falling=True, option="samples")
    monkeypatch.setitem(STRESSORS, "grain", grain)
    assert groups(SETTINGS) == [CLEAN, "support", "motion", "grain"]
    assert world_options(Stress("grain", 2).world("tiny")) == ("tiny", {"samples": 2})
    method = toy("grainy")
    worlds = [made_world(folder, f"tiny~samples={samples}") for samples in (8, 2)]
    render(folder, method, "grain", [world for world in worlds for _ in range(2)])
    rows = score_stresses(MethodEntry(method), "grain", Answers(folder, "d", "tiny"), SETTINGS)
    assert set(rows["stressor"]) == {"grain"}
    assert set(rows["level"]) == {8.0, 2.0}
    # Boxes of moving cars are asked for by `motion` alone.
    assert set(rows["metric"]) == {"sparse_psnr", "psnr", "psnr_supported", "psnr_new"}


def test_the_fingerprint_is_of_the_scene_and_the_shifts_of_its_targets(folder, toy):
    method, entry = toy("printed"), MethodEntry("printed")
    scene = folder / layout.SCENE.format(dataset="d", scene="tiny")
    render(folder, method, "support", [scene] * 4)
    (fingerprint,) = set(
        score_stresses(entry, "support", Answers(folder, "d", "tiny"), SETTINGS)["fingerprint"]
    )
    assert fingerprint == protocol_fingerprint(Scene(scene), {"lateral": [1.0]})
    harder = {**SETTINGS, "seeds": 1, "levels": LEVELS | {"support": [0.05], "yaw": [10]}}
    rows = score_stresses(entry, "support", Answers(folder, "d", "tiny"), harder)
    assert set(rows["fingerprint"]) == {fingerprint}


def test_a_plane_at_a_grazing_angle_has_no_edge():
    road = 300.0 / np.arange(2.0, 40.0)[:, None] * np.ones((1, 5))  # inverse depth is linear
    across, down = depth_edges(road)
    assert not across.any()
    assert not down.any()
    road[20:, 2] /= 2  # a post stands on it
    across, _ = depth_edges(road)
    assert across[20:, 1:3].all()
    assert not across[:20].any()
    assert edge_distance(road)[30].tolist() == [1.0, 0.0, 0.0, 0.0, 1.0]


def test_the_sky_is_behind_everything():
    assert edge_distance(np.array([[0.0, 0.0, 50.0, 50.0]])).tolist() == [[1.0, 0.0, 0.0, 1.0]]
