"""Each control against expectations derived by hand on the tiny scene."""

import dataclasses

import cv2
import numpy as np
import pytest

from baselines.controls.nearest_view.adapter import infinite_homography
from baselines.controls.reproject_inpaint.adapter import fill_holes
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import read_json, write_json
from geoevs.core.images import to_float, to_uint8, write_image
from geoevs.core.randomness import Rng
from geoevs.methods.contract import Budget, ReadsFiles, Views
from geoevs.methods.finding import make_method
from geoevs.methods.tiny import HEIGHT, MOUNT, WIDTH, tiny_camera, tiny_truth, write_tiny_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_tiny_scene(tmp_path_factory.mktemp("scenes") / "tiny")


def fitted(scene, name, **options):
    method = make_method(name, options)
    method.fit(Views(scene, scene.cameras, method.info.needs), Budget(), Rng(0))
    return method


def psnr(rgb, truth, mask):
    error = (to_float(rgb) - to_float(truth))[mask]
    return -10 * np.log10(np.mean(error**2))


def between(lateral=0.0):
    return tiny_camera("virtual", 22.5, MOUNT + np.array([0.0, lateral, 0.0]))


def test_mean_colour_is_the_mean_of_all_images(scene):
    images = [scene.image(name, frame) for frame in scene.frames for name in scene.cameras]
    rendering = fitted(scene, "mean-colour").render(between(), 0)
    expected = np.mean(images, axis=(0, 1, 2), dtype=np.float64)
    np.testing.assert_allclose(rendering.rgb[0, 0], expected, atol=1e-6)
    assert np.ptp(rendering.rgb, axis=(0, 1)).max() == 0
    assert not rendering.support.any()


@pytest.mark.parametrize("name", ["front", "left", "right"])
def test_nearest_view_copies_a_source_at_its_own_pose(scene, name):
    rendering = fitted(scene, "nearest-view").render(scene.camera(name, 1), 1)
    np.testing.assert_array_equal(to_uint8(rendering.rgb), to_uint8(scene.image(name, 1)))
    assert rendering.support.all()


def test_nearest_view_turns_to_the_nearest_axis(scene):
    # 30 degrees is nearer to the left camera (45) than to the front one (0); the warp is exact
    # because the tiny rig's cameras share one centre.
    camera = tiny_camera("virtual", 30.0, MOUNT)
    rendering = fitted(scene, "nearest-view").render(camera, 0)
    assert psnr(rendering.rgb, tiny_truth(camera).rgb, rendering.support) > 40
    # The left camera's right border lies 45 - atan(36 / 70) degrees to the left of the front.
    edge = np.radians(45) - np.arctan2(WIDTH / 2, 70.0)
    column = WIDTH / 2 + 70.0 * np.tan(np.radians(30) - edge)
    row = HEIGHT // 2
    np.testing.assert_array_equal(rendering.support[row], np.arange(WIDTH) + 0.5 <= column)
    outside = rendering.rgb[row, ~rendering.support[row]]
    np.testing.assert_allclose(outside, outside[:1].repeat(len(outside), 0), atol=0.03)


def test_nearest_view_breaks_ties_by_distance(tmp_path):
    near, far = (tiny_camera(name, 0.0, MOUNT + x) for name, x in [("near", 0.1), ("far", 0.5)])
    method = make_method("nearest-view", {})

    class TwoViews:
        cameras = ("far", "near")

        def camera(self, name, frame):
            return {"near": near, "far": far}[name]

        def image(self, name, frame):
            return np.full((HEIGHT, WIDTH, 3), 1.0 if name == "near" else 0.0, np.float32)

    method.fit(TwoViews(), Budget(), Rng(0))
    assert method.render(tiny_camera("target", 0.0, MOUNT), 0).rgb.min() == 1.0


def test_rays_from_behind_the_source_are_unsupported():
    source, target = tiny_camera("s", 0.0, MOUNT), tiny_camera("t", 180.0, MOUNT)
    place, support = infinite_homography(source, target)
    assert not support.any()
    assert place.min() >= 0
    assert place[..., 0].max() <= WIDTH - 1
    # Straight left of the target is straight right of the source.
    assert place[HEIGHT // 2, 0, 0] == WIDTH - 1


def test_reproject_matches_truth_where_supported(scene):
    camera = between(lateral=1.0)
    truth = tiny_truth(camera)
    rendering = fitted(scene, "reproject").render(camera, 0)
    assert rendering.support.mean() > 0.95
    assert psnr(rendering.rgb, truth.rgb, rendering.support) > 27
    assert (rendering.rgb[~rendering.support] == 0).all()
    np.testing.assert_array_equal(rendering.depth > 0, rendering.support)
    error = np.abs(rendering.depth / truth.depth - 1)[rendering.support]
    assert np.median(error) < 0.01


def test_inpainting_fills_holes_and_nothing_else(scene):
    camera = between(lateral=1.0)
    plain = fitted(scene, "reproject").render(camera, 0)
    filled = fitted(scene, "reproject-inpaint").render(camera, 0)
    np.testing.assert_array_equal(filled.support, plain.support)
    seen = plain.support
    np.testing.assert_array_equal(filled.rgb[seen], to_uint8(plain.rgb)[seen])
    assert (filled.rgb[~seen].sum(axis=-1) > 0).all()


def test_all_frames_explain_more_and_better(scene, tmp_path):
    camera = between(lateral=0.5)
    truth = tiny_truth(camera)
    own = fitted(scene, "reproject").render(camera, 0)
    method = fitted(scene, "reproject", frames="all")
    every = method.render(camera, 0)
    assert every.support[own.support].all()
    assert psnr(every.rgb, truth.rgb, own.support) > psnr(own.rgb, truth.rgb, own.support) + 2
    inpaint = fitted(scene, "reproject-inpaint", frames="all")
    filled = inpaint.render(camera, 0)
    np.testing.assert_array_equal(filled.support, every.support)
    inpaint.save(tmp_path)
    np.testing.assert_array_equal(type(inpaint).load(tmp_path).render(camera, 0).rgb, filled.rgb)


def test_masks_hide_what_was_reprojected(scene):
    camera = between(lateral=1.0)
    keep = np.ones((HEIGHT, WIDTH), bool)
    keep[10:20, 30:50] = False
    method = fitted(scene, "reproject")
    plain, masked = method.render(camera, 0), method.render_masked(camera, 0, keep)
    np.testing.assert_array_equal(masked.support, plain.support & keep)
    np.testing.assert_array_equal(masked.rgb[keep], plain.rgb[keep])
    np.testing.assert_array_equal(masked.depth[keep], plain.depth[keep])
    assert masked.rgb[~keep].max() == masked.depth[~keep].max() == 0


def test_inpainting_never_reads_hidden_pixels(scene):
    camera = between(lateral=1.0)
    keep = np.ones((HEIGHT, WIDTH), bool)
    keep[10:20, 30:50] = False
    filled = fitted(scene, "reproject-inpaint").render_masked(camera, 0, keep)
    seen = fitted(scene, "reproject").render_masked(camera, 0, keep)
    np.testing.assert_array_equal(filled.support, seen.support)
    np.testing.assert_array_equal(filled.rgb[seen.support], to_uint8(seen.rgb)[seen.support])
    assert (filled.rgb[~keep].sum(axis=-1) > 0).all()
    other = np.where(keep[..., None], seen.rgb, 0.9)  # what was there before would not matter
    np.testing.assert_array_equal(filled.rgb, fill_holes(other, seen.support, "telea"))


@pytest.mark.parametrize("name", ["mean-colour", "nearest-view"])
def test_controls_without_a_condition_map_ignore_masks(scene, name):
    method, nothing = fitted(scene, name), np.zeros((HEIGHT, WIDTH), bool)
    plain, masked = method.render(between(), 0), method.render_masked(between(), 0, nothing)
    np.testing.assert_array_equal(masked.rgb, plain.rgb)
    np.testing.assert_array_equal(masked.support, plain.support)


@pytest.mark.parametrize("inpaint", ["telea", "navier-stokes", "fsr-fast", "fsr-best"])
def test_every_inpainting_continues_a_flat_colour(inpaint):
    image = np.full((20, 20, 3), [0.2, 0.4, 0.6], np.float32)
    support = np.ones((20, 20), bool)
    support[8:12, 8:12] = False
    filled = fill_holes(image * support[..., None], support, inpaint)
    assert np.abs(filled.astype(int) - to_uint8(image)).max() <= 2


def test_inpainting_leaves_an_unsupported_image_black():
    nothing = np.zeros((4, 4, 3), np.float32)
    assert fill_holes(nothing, np.zeros((4, 4), bool), "telea").max() == 0


def test_unknown_inpainting_is_refused():
    with pytest.raises(GeoEvsError, match="did you mean 'telea'"):
        make_method("reproject-inpaint", {"inpaint": "tela"})


@pytest.mark.parametrize("name", ["reproject", "reproject-inpaint"])
def test_unknown_frames_are_refused(name):
    with pytest.raises(GeoEvsError, match=r"'al' for its option 'frames'; did you mean 'all'"):
        make_method(name, {"frames": "al"})


def test_external_reads_the_targets_png(scene, tmp_path):
    truth = tiny_truth(between()).rgb
    write_image(tmp_path / "tiny/virtual/000001.png", truth)
    method = fitted(scene, "external", folder=str(tmp_path))
    np.testing.assert_array_equal(method.render(between(), 1).rgb, truth)
    with pytest.raises(GeoEvsError, match=r"virtual/000000\.png is missing"):
        method.render(between(), 0)
    with pytest.raises(GeoEvsError, match=r"000001\.png is 48 x 72 but its target is 24 x 36"):
        method.render(between().resized(24, 36), 1)


def test_external_names_what_it_reads(tmp_path):
    method = make_method("external", {"folder": str(tmp_path)})
    assert isinstance(method, ReadsFiles)
    assert list(method.files("tiny")) == [tmp_path / "tiny"]
    assert not isinstance(make_method("mean-colour", {}), ReadsFiles)


def test_external_reads_nothing_outside_its_folder(scene, tmp_path):
    (tmp_path / "images" / scene.info.name).mkdir(parents=True)
    method = fitted(scene, "external", folder=str(tmp_path / "images"))
    camera = dataclasses.replace(scene.camera("front", 0), name="../../secret")
    with pytest.raises(GeoEvsError, match=r"target '../../secret' is not an allowed name"):
        method.render(camera, 0)
    method.save(tmp_path)
    for change in ({"scene": "../secret"}, {"scene": None}, {"folder": 5}):
        place = read_json(tmp_path / "external.json")
        write_json(tmp_path / "external.json", place | change)
        with pytest.raises(GeoEvsError, match=r"external\.json"):
            type(method).load(tmp_path)
        write_json(tmp_path / "external.json", place)


def test_external_needs_its_folder(scene, tmp_path):
    with pytest.raises(GeoEvsError, match="needs the option 'folder'"):
        make_method("external", {})
    with pytest.raises(GeoEvsError, match="tiny is missing"):
        fitted(scene, "external", folder=str(tmp_path))


def test_cv2_maps_have_integer_centres():
    # `infinite_homography` subtracts half a pixel for this convention.
    image = np.arange(4, dtype=np.float32)[None]
    place = np.array([[[2.0, 0.0]]], np.float32)
    assert cv2.remap(image, place, None, cv2.INTER_LINEAR)[0, 0] == 2.0
