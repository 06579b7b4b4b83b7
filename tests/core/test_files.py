import errno
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from geoevs.core import files
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import (
    link_file,
    new_folder,
    read_arrays,
    read_json,
    whole_file,
    write_arrays,
    write_bytes,
    write_json,
    write_text,
)
from geoevs.core.images import encode_png, read_image, to_float, to_uint8, write_image

FAILURES = {"disk full": errno.ENOSPC, "read-only": errno.EROFS, "no permission": errno.EACCES}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("io")


def names(path: Path) -> list[str]:
    return sorted(entry.name for entry in path.iterdir())


def attempt(read, path: Path):
    """What it reads, and the sentence it is refused with: one of them is None."""
    try:
        return read(path), None
    except GeoEvsError as error:
        return None, str(error)


def fail_with(code: int):
    def failing(*arguments, **keywords):
        raise OSError(code, os.strerror(code))

    return failing


@pytest.mark.parametrize("code", FAILURES.values(), ids=FAILURES.keys())
@pytest.mark.parametrize("step", ["replace", "fsync", "chmod"])
def test_a_write_that_fails_leaves_the_old_file_alone(tmp_path, monkeypatch, step, code):
    path = tmp_path / "value.txt"
    write_text(path, "old")
    monkeypatch.setattr(files.os, step, fail_with(code))
    with pytest.raises(GeoEvsError) as caught:
        write_text(path, "new")
    assert str(caught.value).startswith(f"cannot write {path} ({os.strerror(code)}); ")
    assert path.read_text() == "old"
    assert names(tmp_path) == ["value.txt"]


def test_an_interrupted_write_leaves_no_litter(tmp_path, monkeypatch):
    def interrupt(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(files.os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_bytes(tmp_path / "value", b"new")
    assert names(tmp_path) == []


def test_a_file_where_a_folder_should_be_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(GeoEvsError, match=r"cannot write .*file/value \((File exists|Not a dir)"):
        write_text(tmp_path / "file/value", "new")


FULL_DISK = """
import os, subprocess, sys
from pathlib import Path
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import new_folder, write_bytes

disk = Path(sys.argv[1])
subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", disk], check=True)
write_bytes(disk / "file", b"old")
with new_folder(disk / "folder") as partial:
    write_bytes(partial / "file", b"old")

def refused(action):
    try:
        action()
    except GeoEvsError as error:
        assert "No space left on device" in str(error), error
        return
    raise AssertionError("a full disk took it")

def folder():
    with new_folder(disk / "folder") as partial:
        write_bytes(partial / "first", b"fits")
        write_bytes(partial / "second", bytes(200_000))

refused(lambda: write_bytes(disk / "file", bytes(200_000)))
refused(folder)
files = [path for path in disk.rglob("*") if path.is_file()]
found = {str(path.relative_to(disk)): path.read_bytes() for path in files}
assert found == {"file": b"old", "folder/file": b"old"}, found
assert sorted(path.name for path in disk.iterdir()) == ["file", "folder"]
print("whole")
"""


def test_a_full_disk_leaves_everything_as_it_was(tmp_path):
    private = ["unshare", "--user", "--map-root-user", "--mount"]
    mount = [*private, "mount", "-t", "tmpfs", "tmpfs", str(tmp_path)]
    if shutil.which("unshare") is None or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("no right to mount a small disk")
    command = [*private, sys.executable, "-c", FULL_DISK, str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.stdout == "whole\n", run.stderr


def test_a_new_folder_appears_whole_and_replaces_the_old_one(tmp_path):
    target = tmp_path / "deep" / "folder"
    with new_folder(target) as partial:
        (partial / "old").write_text("1")
        assert not target.exists()
    with new_folder(target) as partial:
        (partial / "new").write_text("2")
        assert names(target) == ["old"]
    assert names(target) == ["new"]
    assert names(target.parent) == ["folder"]
    assert target.stat().st_mode & 0o777 == 0o755


@pytest.mark.parametrize("failure", [ValueError("wrong"), KeyboardInterrupt(), GeoEvsError("so")])
def test_a_block_that_raises_leaves_the_old_folder_and_its_own_error(tmp_path, failure):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder/old").write_text("1")

    def spoil():
        with new_folder(tmp_path / "folder") as partial:
            (partial / "new").write_text("2")
            raise failure

    with pytest.raises(type(failure)) as caught:
        spoil()
    assert caught.value is failure
    assert names(tmp_path) == ["folder"]
    assert names(tmp_path / "folder") == ["old"]


def test_a_block_that_cannot_read_is_not_blamed_on_the_disk(tmp_path):
    with pytest.raises(FileNotFoundError), new_folder(tmp_path / "folder"):
        (tmp_path / "input").read_text()


def test_a_folder_that_cannot_be_moved_leaves_the_old_one(tmp_path, monkeypatch):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder/old").write_text("1")
    replace = os.replace

    def refuse_new(source, destination):
        if Path(source).name.startswith(".folder~") and not str(source).endswith(".old"):
            raise OSError(errno.EROFS, "Read-only file system")
        replace(source, destination)

    monkeypatch.setattr(files.os, "replace", refuse_new)
    message = r"cannot write .*folder \(Read-only file system\)"
    with pytest.raises(GeoEvsError, match=message), new_folder(tmp_path / "folder") as partial:
        (partial / "new").write_text("2")
    assert names(tmp_path) == ["folder"]
    assert names(tmp_path / "folder") == ["old"]


def test_json_by_hand(tmp_path):
    write_json(tmp_path / "a.json", {"b": [1, 2.5, None]})
    assert (tmp_path / "a.json").read_text() == '{\n "b": [\n  1,\n  2.5,\n  null\n ]\n}\n'
    assert read_json(tmp_path / "a.json") == {"b": [1, 2.5, None]}


@pytest.mark.parametrize(
    "text",
    [
        *('{"a": 1', "", "not json", "\xff"),
        *(
            '{"a": 1, "b": 2, "a": 1}',
            '[{"b": {"a": 1, "a": 2}}]',
            r'["\ud83d"]',
            r'{"\uDE00x": 1}',
        ),
    ],
)
def test_broken_json_is_named(tmp_path, text):
    path = tmp_path / "a.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(GeoEvsError, match=r"a\.json is not valid JSON .*; restore or remake it"):
        read_json(path)


def test_letters_of_two_halves_are_read(tmp_path):
    (tmp_path / "a.json").write_text(r'["\ud83d\ude00", "\\ud83d"]')
    assert read_json(tmp_path / "a.json") == ["\U0001f600", r"\ud83d"]


@pytest.mark.parametrize("read", [read_json, read_image, read_arrays])
def test_a_missing_file_is_named(tmp_path, read):
    with pytest.raises(GeoEvsError, match=r"gone is missing; "):
        read(tmp_path / "gone")


IMAGE = np.random.default_rng(0).integers(0, 256, (9, 7, 3), np.uint8)


@settings(max_examples=60, deadline=None)
@given(share=st.floats(0, 1, exclude_max=True), kind=st.sampled_from(["png", "jpeg"]))
def test_a_truncated_image_is_whole_or_refused(folder, share, kind):
    path = folder / f"cut.{kind}"
    Image.fromarray(IMAGE).save(path)
    whole, data = read_image(path), path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    found, refusal = attempt(read_image, path)
    if refusal is None:  # only what follows the pixels may be missing
        np.testing.assert_array_equal(found, whole)
        # PNG's: zlib's checksum 4 bytes, the chunk's 4, the end chunk 12; JPEG's: its end mark 2.
        assert len(data) - int(share * len(data)) <= 20
    else:
        assert re.fullmatch(rf"{path} is not a whole PNG or JPEG image \(.*\); .* again", refusal)


@settings(max_examples=60, deadline=None)
@given(data=st.data(), flip=st.integers(1, 255))
def test_a_png_with_a_changed_byte_is_refused(folder, data, flip):
    path = folder / "flipped.png"
    Image.fromarray(IMAGE).save(path)
    raw = bytearray(path.read_bytes())
    raw[data.draw(st.integers(0, len(raw) - 13))] ^= flip  # before the end mark, 12 bytes
    path.write_bytes(raw)
    with pytest.raises(GeoEvsError, match=r"flipped\.png is not a whole PNG or JPEG image"):
        read_image(path)


@settings(max_examples=60, deadline=None)
@given(data=st.data(), flip=st.integers(1, 255))
def test_damaged_arrays_are_right_or_refused(folder, data, flip):
    path = folder / "arrays.npz"
    arrays = {"xyz": np.arange(30.0).reshape(10, 3), "beam": np.arange(10, dtype=np.uint16)}
    write_arrays(path, arrays)
    spoiled = bytearray(path.read_bytes())
    spoiled[data.draw(st.integers(0, len(spoiled) - 1))] ^= flip
    path.write_bytes(spoiled)
    found, refusal = attempt(read_arrays, path)
    if refusal is None:
        for array in found.values():
            assert any(np.array_equal(array, expected) for expected in arrays.values())
    else:
        assert re.fullmatch(rf"{path} is not whole \(.*\); delete it and make it again", refusal)


def test_arrays_survive_a_round_trip(tmp_path):
    arrays = {"a/b": np.array([np.nan, -0.0, np.inf], np.float32), "c": np.zeros((0, 3), bool)}
    write_arrays(tmp_path / "x.npz", arrays)
    for name, array in read_arrays(tmp_path / "x.npz").items():
        assert array.dtype == arrays[name].dtype
        assert array.shape == arrays[name].shape
        assert array.tobytes() == arrays[name].tobytes()


def test_arrays_of_objects_are_never_unpickled(tmp_path):
    np.savez(tmp_path / "x.npz", a=np.array([{}], object))
    with pytest.raises(GeoEvsError, match=r"x\.npz is not whole"):
        read_arrays(tmp_path / "x.npz")


def test_whatever_a_decoder_raises_names_the_file(tmp_path):
    path = tmp_path / "x"
    path.touch()
    with pytest.raises(GeoEvsError, match=r"x is not whole \(two lines\); d"), whole_file(path):
        raise RuntimeError("two\nlines")
    with pytest.raises(GeoEvsError, match=r"x is not whole \(RuntimeError\); d"), whole_file(path):
        raise RuntimeError


def test_rounding_to_8_bits_by_hand():
    image = np.array([[-1.0, 0.0, 0.49 / 255, 0.51 / 255, 0.5, 1.0, 2.0]])
    # 0.5 * 255 = 127.5, a tie, which NumPy rounds to the even 128.
    assert to_uint8(image).tolist() == [[0, 0, 0, 1, 128, 255, 255]]
    assert to_float(np.array([0, 51, 255], np.uint8)).tolist() == [0, np.float32(0.2), 1]


@given(st.integers(0, 255))
def test_8_bits_survive_a_float(value):
    pixel = np.full((1, 1, 3), value, np.uint8)
    np.testing.assert_array_equal(to_uint8(to_float(pixel)), pixel)


def test_images_survive_a_round_trip(tmp_path):
    write_image(tmp_path / "a" / "b.png", IMAGE)
    np.testing.assert_array_equal(read_image(tmp_path / "a" / "b.png"), IMAGE)
    assert encode_png(IMAGE) == (tmp_path / "a" / "b.png").read_bytes()


def test_grey_images_become_rgb(tmp_path):
    Image.fromarray(IMAGE[..., 0]).save(tmp_path / "grey.png")
    np.testing.assert_array_equal(read_image(tmp_path / "grey.png")[..., 2], IMAGE[..., 0])


def test_what_a_killed_process_left_is_cleared(tmp_path):
    (tmp_path / ".model~x1y2").mkdir()
    (tmp_path / ".model~x1y2/half").write_text("written")
    (tmp_path / ".model.v2~z").mkdir()  # of another folder, perhaps being written now
    with new_folder(tmp_path / "model") as partial:
        (partial / "whole").write_text("written")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".model.v2~z", "model"]


def test_a_linked_file_takes_no_room(tmp_path):
    source, path = tmp_path / "source", tmp_path / "deep/er/path"
    source.write_text("text")
    link_file(source, path)
    assert path.read_text() == "text"
    assert path.stat().st_ino == source.stat().st_ino
    link_file(source, path)
    assert [file.name for file in path.parent.iterdir()] == ["path"]


def test_where_there_are_no_links_a_file_is_copied(tmp_path, monkeypatch):
    source, path = tmp_path / "source", tmp_path / "path"
    source.write_text("text")

    def refuse(*names):
        raise OSError(errno.EXDEV, "another device")

    monkeypatch.setattr(os, "link", refuse)
    link_file(source, path)
    assert path.read_text() == "text"
    assert path.stat().st_ino != source.stat().st_ino


@pytest.mark.parametrize("linked", [True, False])
def test_linking_over_a_link_leaves_what_it_was_linked_to(tmp_path, monkeypatch, linked):
    first, second, path = (tmp_path / name for name in ("first", "second", "path"))
    first.write_text("first")
    second.write_text("second")
    link_file(first, path)
    if not linked:
        monkeypatch.setattr(os, "link", lambda *names: (_ for _ in ()).throw(OSError()))
    link_file(second, path)
    assert (first.read_text(), path.read_text()) == ("first", "second")


def test_a_copy_that_breaks_off_leaves_the_file_that_was_there(tmp_path, monkeypatch):
    source, path = tmp_path / "source", tmp_path / "path"
    source.write_text("new")
    path.write_text("old")

    def break_off(source, target):
        Path(target).write_text("n", encoding="utf-8")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "link", lambda *names: (_ for _ in ()).throw(OSError()))
    monkeypatch.setattr(shutil, "copyfile", break_off)
    with pytest.raises(GeoEvsError, match=f"^cannot write {path} .No space left on device"):
        link_file(source, path)
    assert path.read_text() == "old"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["path", "source"]


def test_a_link_to_nothing_is_one_sentence(tmp_path):
    source = tmp_path / "none"
    with pytest.raises(GeoEvsError, match=f"^{source} is missing; make or copy it there$"):
        link_file(source, tmp_path / "path")
