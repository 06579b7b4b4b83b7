"""Features that are made once, in files."""

import numpy as np
import pytest
import torch

from geoevs.core.errors import GeoEvsError
from geoevs.core.images import to_uint8
from geoevs.core.mapped import read_mapped, write_mapped
from geoevs.detection.bevformer.backbone import new_backbone
from geoevs.detection.bevformer.features import cache_features, check_features, read_features


@pytest.fixture(scope="module")
def backbone(detector):
    return new_backbone(detector, 0).eval()


def test_a_frame_is_read_as_it_was_seen(make_frame, detector, backbone, tmp_path):
    frame = make_frame(7)
    cache_features(frame, backbone, detector.image, tmp_path / "frame.npz")
    read = read_features(tmp_path / "frame.npz")
    assert (read.name, read.seconds, read.size) == (frame.name, frame.seconds, detector.image)
    for name in ("image_from_vehicle", "recorded", "world_from_vehicle", "boxes", "classes"):
        np.testing.assert_array_equal(getattr(read, name), getattr(frame, name))
    with torch.no_grad():
        features = backbone(torch.from_numpy(frame.images.transpose(0, 3, 1, 2)))
    assert read.features.dtype == np.float16
    np.testing.assert_allclose(read.features, features, atol=2e-3)
    np.testing.assert_array_equal(read.pictures, to_uint8(frame.images[:5]))


def test_pictures_are_resized_before(make_frame, backbone, tmp_path):
    cache_features(make_frame(), backbone, (8, 16), tmp_path / "frame.npz")
    read = read_features(tmp_path / "frame.npz")
    assert read.features.shape == (5, 8, 1, 2)
    frame = make_frame().resized((8, 16))
    np.testing.assert_array_equal(read.image_from_vehicle, frame.image_from_vehicle)


def test_views_of_several_files_are_one_frames(make_frame, detector, backbone, tmp_path):
    paths = [tmp_path / "recorded.npz", tmp_path / "generated.npz"]
    frames = [make_frame(), make_frame(6, recorded=np.zeros(6, bool))]
    for frame, path in zip(frames, paths, strict=True):
        cache_features(frame, backbone, detector.image, path)
    both, parts = read_features(*paths), [read_features(path) for path in paths]
    np.testing.assert_array_equal(both.features, np.concatenate([one.features for one in parts]))
    assert both.recorded.tolist() == [True] * 5 + [False] * 6
    assert both.image_from_vehicle.shape == (11, 3, 4)
    assert len(both.pictures) == 5
    cache_features(make_frame(frame=1), backbone, detector.image, paths[1])
    with pytest.raises(GeoEvsError, match=r"generated.npz has features of another frame"):
        read_features(*paths)


def test_features_of_another_backbone_are_refused(make_frame, detector, backbone, tmp_path):
    cache_features(make_frame(), backbone, detector.image, tmp_path / "frame.npz")
    frames = [read_features(tmp_path / "frame.npz")]
    check_features(frames, backbone)
    with pytest.raises(GeoEvsError, match="street/0 has features of another backbone"):
        check_features(frames, new_backbone(detector, 1))


def test_damaged_files_are_refused(make_frame, detector, backbone, tmp_path):
    path = tmp_path / "frame.npz"
    cache_features(make_frame(), backbone, detector.image, path)
    arrays = {name: np.asarray(value) for name, value in read_mapped(path).items()}
    write_mapped(path, arrays | {"features": arrays["features"][:4]})
    with pytest.raises(GeoEvsError, match=r"it has features of the shape .* for 5 views"):
        read_features(path)
    write_mapped(path, arrays | {"boxes": arrays["boxes"] * np.nan})
    with pytest.raises(GeoEvsError, match="boxes has NaN"):
        read_features(path)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(GeoEvsError, match="is not whole"):
        read_features(path)
    with pytest.raises(GeoEvsError, match="is missing"):
        read_features(tmp_path / "none.npz")
