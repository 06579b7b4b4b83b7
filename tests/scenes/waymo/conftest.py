import pytest

from tests.scenes.waymo.world import NAME, make_segment
from tests.scenes.waymo.writers import write_v1, write_v2


@pytest.fixture(scope="session")
def made_segment():
    """Two frames; tests that spoil it take a copy."""
    return make_segment()


@pytest.fixture(scope="session")
def small_segment():
    """The same with sweeps of a few columns, for tests that write it often."""
    segment = make_segment()
    for frame in segment.frames:
        for sweep in frame["sweeps"].values():
            for key, image in sweep.items():
                sweep[key] = None if image is None else image[:, ::20].copy()
    return segment


@pytest.fixture(scope="session")
def v1_folder(made_segment, tmp_path_factory):
    """A folder with the segment as version 1, not to be changed."""
    folder = tmp_path_factory.mktemp("v1")
    write_v1(folder / f"segment-{NAME}_with_camera_labels.tfrecord", made_segment)
    return folder


@pytest.fixture(scope="session")
def v2_folder(made_segment, tmp_path_factory):
    """A folder with the segment as version 2, not to be changed."""
    return write_v2(tmp_path_factory.mktemp("v2"), made_segment)


@pytest.fixture(scope="session", params=["v1", "v2"])
def waymo_folder(request):
    """The folder of either version."""
    return request.getfixturevalue(f"{request.param}_folder")
