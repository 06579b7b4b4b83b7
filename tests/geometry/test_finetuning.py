"""What VGGT learns from, and `geoevs train-geometry`."""

import math
import sys
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import torch

from geoevs.cli import main as cli
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json, write_arrays
from geoevs.core.images import to_uint8
from geoevs.core.networks import read_network
from geoevs.geometry import finetuning
from geoevs.geometry.finetuning import FAR, read_depth_frames
from geoevs.geometry.vggt import VGGT_NANO, load_vggt
from geoevs.methods.tiny import HEIGHT, WIDTH
from geoevs.projection import zbuffer
from geoevs.scenes.depths import read_depths
from geoevs.scenes.store import Scene


def test_truth_supervises_where_it_is(tiny, tiny_depths, tmp_path):
    frames = read_depth_frames([tiny.folder, tiny.folder], [tiny_depths, tmp_path], VGGT_NANO)
    assert frames.images.shape == (4, 3, HEIGHT, WIDTH, 3)
    for number in (0, 1):
        for place, name in enumerate(tiny.cameras):
            dense = read_depths(tiny_depths, number)[name]
            np.testing.assert_allclose(frames.depths[number, place], dense, rtol=1e-3)
            points = tiny.points(number).xyz
            sparse = zbuffer(points, tiny.camera(name, number), visibility="footprint").depth
            np.testing.assert_allclose(frames.depths[2 + number, place], sparse, rtol=1e-3)
            np.testing.assert_array_equal(frames.images[2 + number], frames.images[number])


def test_without_folders_of_truth_it_is_all_lidar(tiny, tmp_path):
    alone = read_depth_frames([tiny.folder], [], VGGT_NANO)
    empty = read_depth_frames([tiny.folder], [tmp_path], VGGT_NANO)
    np.testing.assert_array_equal(alone.depths, empty.depths)


def test_large_frames_are_learned_at_the_networks_own_size(tiny, tiny_depths, tmp_path):
    half = replace(VGGT_NANO, longest=WIDTH // 2)
    height, width = HEIGHT // 2, 32  # 36 pixels are 4.5 patches, and the even number is rounded to
    assert half.nearest_size(HEIGHT, WIDTH) == (height, width)
    frames = read_depth_frames([tiny.folder, tiny.folder], [tiny_depths, tmp_path], half)
    assert frames.images.shape == (4, 3, height, width, 3)
    assert frames.depths.shape == (4, 3, height, width)
    mean = np.mean([tiny.image(name, 0) for name in tiny.cameras])
    assert frames.images[0].mean() / 255 == pytest.approx(mean, abs=0.01)
    for place, name in enumerate(tiny.cameras):
        truth = read_depths(tiny_depths, 0)[name]
        assert np.isin(frames.depths[0, place], truth.astype(np.float16)).all()  # none is mixed
        camera = tiny.camera(name, 0).resized(height, width)
        sparse = zbuffer(tiny.points(0).xyz, camera, visibility="footprint").depth
        np.testing.assert_allclose(frames.depths[2, place], sparse, rtol=1e-3)


def test_a_public_network_learns_from_what_it_is_shown(tiny, tiny_depths, tmp_path, monkeypatch):
    public = replace(VGGT_NANO, patch_size=14, dino_depth=1, longest=140)
    camera = Scene.camera

    def recorded(self, name, frame):  # as if the left camera's image had been half as high
        one = camera(self, name, frame)
        K = one.K.copy()
        K[1, 1] *= 2 if name == "left" else 1
        return replace(one, K=K)

    monkeypatch.setattr(Scene, "camera", recorded)
    frames = read_depth_frames([tiny.folder, tiny.folder], [tiny_depths, tmp_path], public)
    cameras = [tiny.camera(name, 0) for name in tiny.cameras]
    images = [to_uint8(tiny.image(name, 0)) for name in tiny.cameras]
    shown, windows = public.shown(images, cameras)
    np.testing.assert_array_equal(frames.images[0], shown)
    left = tiny.cameras.index("left")
    assert windows[left] == (slice(28, 70), slice(0, 140))  # 42 rows of 98, by hand
    for depths in frames.depths[[0, 2], left]:
        assert (depths[windows[left]] > 0).any()
        depths[windows[left]] = 0
        assert not depths.any()  # nothing is known of the white around it


def test_sky_is_far(tiny, tmp_path):
    depths = {name: np.full((HEIGHT, WIDTH), 5.0, np.float32) for name in tiny.cameras}
    depths["left"][:10] = 0
    depths["left"][10:20] = 1e5
    for number in tiny.frames:
        write_arrays(tmp_path / f"{number:06d}.npz", depths)
    frames = read_depth_frames([tiny.folder], [tmp_path], VGGT_NANO)
    found = frames.depths[0, tiny.cameras.index("left")]
    assert np.all(found[:20] == FAR)
    assert np.all(found[20:] == 5)


def test_truth_is_for_every_scene_or_none(tiny, tiny_depths):
    with pytest.raises(GeoEvsError, match=r"^there are 2 scenes and 1 folders of true depth; give"):
        read_depth_frames([tiny.folder] * 2, [tiny_depths], VGGT_NANO)


@pytest.fixture
def train(monkeypatch, capsys, tiny, tiny_depths, tmp_path):
    """Runs `geoevs train-geometry` on the tiny scene; gives exit code and standard error."""

    def run(*arguments: object, work="work", steps=6):
        monkeypatch.setattr(cli, "_log", None)
        command = ["geoevs", "train-geometry", "--work", tmp_path / work, "--steps", steps]
        command += ["--scenes", tiny.folder, "--depths", tiny_depths, "--batch", 2]
        command += ["--learning-rate", 1e-3, *arguments]
        monkeypatch.setattr(sys, "argv", [str(part) for part in command])
        code = 0
        try:
            cli.main()
        except SystemExit as end:
            code = end.code or 0
        return code, capsys.readouterr().err

    return run


class Killed(BaseException):
    """What no command catches."""


def reporter(losses: list[float], stop: int):
    """Stands in for the bar: keeps the losses, and is killed at the step `stop`."""

    @contextmanager
    def bar(title, steps):
        def report(loss):
            losses.append(loss)
            if len(losses) == stop:
                raise Killed

        yield report

    return bar


def test_a_killed_training_goes_on_to_the_same_bytes(train, small_vggt, tmp_path, monkeypatch):
    whole, resumed = tmp_path / "whole.safetensors", tmp_path / "resumed.safetensors"
    assert train("--start", small_vggt, "--out", whole)[0] == 0

    killed: list[float] = []
    monkeypatch.setattr(finetuning, "training_bar", reporter(killed, stop=4))
    with pytest.raises(Killed):
        train("--start", small_vggt, "--out", resumed, work="killed")
    assert not resumed.exists()
    assert (tmp_path / "killed/state.pt").exists()

    rest: list[float] = []
    monkeypatch.setattr(finetuning, "training_bar", reporter(rest, stop=99))
    assert train("--start", small_vggt, "--out", resumed, work="killed")[0] == 0
    # Three steps were saved before the fourth was killed.
    assert [math.isnan(loss) for loss in rest] == [True] * 3 + [False] * 3
    assert rest[3] == killed[3]
    assert resumed.read_bytes() == whole.read_bytes()
    logs = [(tmp_path / work / "losses.csv").read_text() for work in ("work", "killed")]
    assert logs[0] == logs[1]
    assert logs[0].count("\n") == 7
    assert read_json(tmp_path / "resumed.seconds.json")["training"] > 0
    # Finished, it leaves nothing that other code could take up.
    assert not (tmp_path / "killed/state.pt").exists()
    assert list((tmp_path / "killed/previews").iterdir())


def test_it_says_what_it_does_and_learns(train, small_vggt, tmp_path):
    out = tmp_path / "out.safetensors"
    code, errors = train("--start", small_vggt, "--out", out, steps=20)
    assert code == 0
    assert errors.startswith("VGGT: 2 frames of 3 views, 0.0 M parameters, 20 steps\n")
    rows = np.loadtxt(tmp_path / "work/losses.csv", delimiter=",", skiprows=1)
    assert rows[-5:, 1].mean() < rows[:5, 1].mean()
    before, after = load_vggt(small_vggt), load_vggt(out)
    assert after.config == before.config
    learned = dict(after.named_parameters())
    assert not any(torch.equal(old, learned[name]) for name, old in before.named_parameters())
    assert {value.dtype for value in read_network(out)[1].values()} == {torch.float32}


def test_without_a_start_it_is_a_new_nano_one(train, tmp_path):
    out = tmp_path / "new.safetensors"
    assert train("--out", out, "--half", steps=1)[0] == 0
    assert load_vggt(out).config == VGGT_NANO
    assert {value.dtype for value in read_network(out)[1].values()} == {torch.float16}


def test_a_missing_start_is_one_sentence(train, tmp_path):
    missing = tmp_path / "none.safetensors"
    code, errors = train("--start", missing, "--out", tmp_path / "out")
    assert (code, errors) == (1, f"error: {missing} is missing; make or copy it there\n")
