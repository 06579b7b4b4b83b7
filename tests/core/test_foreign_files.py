"""Files of others: what is no file, swells, or means something else is refused in one sentence."""

import multiprocessing
import os
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest
from PIL import Image

from geoevs.core import files
from geoevs.core.errors import GeoEvsError
from geoevs.core.files import (
    new_folder,
    read_arrays,
    read_json,
    whole_file,
    write_arrays,
    write_bytes,
    write_files,
    write_json,
)
from geoevs.core.images import read_image

READERS = {"json": read_json, "image": read_image, "arrays": read_arrays}
COLOUR = np.random.default_rng(0).integers(0, 256, (6, 5, 3), np.uint8)


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "link to a device", "loop"])
def test_what_is_no_file_is_refused_at_once(tmp_path, read, kind):
    path = tmp_path / "x"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "link to a device":
        path.symlink_to("/dev/zero")
    else:
        path = "/dev/zero"
    began = time.monotonic()
    with pytest.raises(GeoEvsError, match=rf"{path} (is|cannot be read)"):
        read(path)
    assert time.monotonic() - began < 2


def test_a_block_that_decodes_a_pipe_never_begins(tmp_path):
    os.mkfifo(tmp_path / "x")
    with pytest.raises(GeoEvsError, match="is a pipe or a device"), whole_file(tmp_path / "x"):
        raise AssertionError("the block began")


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a":' * 5_000, "1" * 10_000, '"\ud800"', "NaN,", "\0"]
)
def test_json_that_swells_or_is_none(tmp_path, text):
    (tmp_path / "x.json").write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(GeoEvsError, match=r"x\.json is not valid JSON .*restore or remake it"):
        read_json(tmp_path / "x.json")


def test_json_larger_than_any_of_ours_is_not_read(tmp_path):
    with (tmp_path / "x.json").open("wb") as file:
        file.truncate(files.MAX_JSON_BYTES + 1)
    with pytest.raises(GeoEvsError, match=r"x\.json has more than 256 MiB"):
        read_json(tmp_path / "x.json")


def test_arrays_that_swell_are_not_unpacked(tmp_path, monkeypatch):
    write_arrays(tmp_path / "x.npz", {"a": np.zeros(2**20), "b": np.zeros(2**20)})
    monkeypatch.setattr(files, "MAX_ARRAY_BYTES", 2**23)
    with pytest.raises(GeoEvsError, match=r"x\.npz unpacks to more than"):
        read_arrays(tmp_path / "x.npz")


def test_arrays_whose_header_lies_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive, archive.open("a.npy", "w") as member:
        np.lib.format.write_array_header_1_0(
            member, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
        )
    with pytest.raises(GeoEvsError, match=r"x\.npz is not whole"):
        read_arrays(tmp_path / "x.npz")


def saved(path, image, **how):
    image.save(path, **how)
    return path


@pytest.mark.parametrize(
    "mode", ["L", "P", "RGB", "1", "RGBA opaque", "LA opaque", "P with opaque transparency"]
)
def test_modes_that_mean_what_they_show(tmp_path, mode):
    image = Image.fromarray(COLOUR).convert(mode.split()[0])
    how = {"transparency": bytes([255] * 256)} if "transparency" in mode else {}
    path = saved(tmp_path / "x.png", image, **how)
    np.testing.assert_array_equal(read_image(path), np.asarray(image.convert("RGB")))


def test_16_bits_are_divided_and_not_cut(tmp_path):
    grey = np.array([[0, 256, 257, 32767, 65535]], np.uint16)
    path = saved(tmp_path / "x.png", Image.fromarray(grey))
    assert read_image(path)[0, :, 0].tolist() == [0, 1, 1, 127, 255]


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P"])
def test_transparency_is_refused(tmp_path, mode):
    image = Image.fromarray(COLOUR).convert(mode)
    how = {"transparency": 0} if mode == "P" else {}
    if mode == "P":
        image.putdata([0] * 30)
    else:
        image.putalpha(254)
    path = saved(tmp_path / "x.png", image, **how)
    with pytest.raises(GeoEvsError, match=r"x\.png has transparent pixels"):
        read_image(path)


@pytest.mark.parametrize("kind", ["tiff", "eps", "gif", "bmp", "webp", "ppm"])
def test_the_content_decides_what_a_png_is(tmp_path, kind):
    path = tmp_path / "x.png"
    Image.fromarray(COLOUR).save(path, format=kind)
    with pytest.raises(GeoEvsError, match=r"x\.png is not a whole PNG or JPEG image"):
        read_image(path)


def test_four_inks_are_refused(tmp_path):
    path = saved(tmp_path / "x.jpg", Image.fromarray(COLOUR).convert("CMYK"))
    with pytest.raises(GeoEvsError, match=r"x\.jpg has pixels of mode CMYK"):
        read_image(path)


def test_an_image_is_turned_as_its_exif_says(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 3  # turned by 180 degrees
    image = Image.fromarray(COLOUR)
    path, plain = (
        saved(tmp_path / "x.png", image, exif=exif),
        read_image(saved(tmp_path / "y.png", image)),
    )
    np.testing.assert_array_equal(read_image(path), plain[::-1, ::-1])


def test_more_pixels_than_any_camera_has(tmp_path):
    path = saved(tmp_path / "x.png", Image.new("1", (12_000, 12_000)))
    with pytest.raises(GeoEvsError, match=r"x\.png has 12000 x 12000 pixels"):
        read_image(path)


def test_new_files_and_folders_have_the_rights_of_the_umask(tmp_path):
    script = (
        "from pathlib import Path; from geoevs.core.files import *;"
        f"write_bytes(Path({str(tmp_path / 'file')!r}), b'x')\n"
        f"with new_folder(Path({str(tmp_path / 'folder')!r})): pass"
    )
    subprocess.run(
        [sys.executable, "-c", f"import os; os.umask(0o027)\n{script}"], check=True, timeout=60
    )
    assert (tmp_path / "file").stat().st_mode & 0o777 == 0o640
    assert (tmp_path / "folder").stat().st_mode & 0o777 == 0o750


def test_what_is_linked_elsewhere_is_written_there(tmp_path):
    disk = tmp_path / "disk"
    (disk / "folder").mkdir(parents=True)
    (tmp_path / "folder").symlink_to(disk / "folder")
    (tmp_path / "file").symlink_to(disk / "file")
    with new_folder(tmp_path / "folder") as partial:
        (partial / "new").touch()
    write_bytes(tmp_path / "file", b"new")
    assert (tmp_path / "folder").is_symlink()
    assert (tmp_path / "file").is_symlink()
    assert sorted(path.name for path in disk.rglob("*")) == ["file", "folder", "new"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["disk", "file", "folder"]


def test_files_that_belong_together_are_written_together(tmp_path, monkeypatch):
    first, second = tmp_path / "a.csv", tmp_path / "b.md"
    write_files({first: b"old", second: b"old"})
    count = iter(range(10))
    fsync = os.fsync

    def fail_at_the_second(handle):
        if next(count) == 1:
            raise OSError(28, "No space left on device")
        fsync(handle)

    monkeypatch.setattr(files.os, "fsync", fail_at_the_second)
    with pytest.raises(GeoEvsError, match=r"cannot write .*b\.md .*free space there"):
        write_files({first: b"new", second: b"new"})
    assert (first.read_bytes(), second.read_bytes()) == (b"old", b"old")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "b.md"]


@pytest.mark.parametrize(
    ("name", "advice"), [("x" * 250, "give it a shorter name"), ("file/x", "move the file")]
)
def test_the_advice_fits_the_error(tmp_path, name, advice):
    (tmp_path / "file").touch()
    with pytest.raises(GeoEvsError, match=advice):
        write_json(tmp_path / name, {})


def hold(folder, entered, leave):
    with new_folder(folder) as partial:
        (partial / "first").write_text("of the first")
        entered.set()
        leave.wait(30)
        write_bytes(partial / "deep/second", b"of the first")


def test_nobody_clears_what_a_living_process_fills(tmp_path):
    context = multiprocessing.get_context("spawn")
    entered, leave = context.Event(), context.Event()
    process = context.Process(target=hold, args=(tmp_path / "model", entered, leave))
    process.start()
    assert entered.wait(30)
    with new_folder(tmp_path / "model") as partial:
        (partial / "only").write_text("of the second")
    assert [path.name for path in (tmp_path / "model").iterdir()] == ["only"]
    leave.set()
    process.join(30)
    assert process.exitcode == 0
    assert sorted(path.name for path in (tmp_path / "model").rglob("*")) == [
        "deep",
        "first",
        "second",
    ]


def test_what_a_killed_process_left_of_a_file_is_cleared(tmp_path):
    context = multiprocessing.get_context("spawn")
    entered, leave = context.Event(), context.Event()
    process = context.Process(target=hold, args=(tmp_path / "model", entered, leave))
    process.start()
    assert entered.wait(30)
    process.kill()
    process.join(30)
    (tmp_path / ".model~file").touch()
    assert len(list(tmp_path.iterdir())) == 2
    write_bytes(tmp_path / "model", b"whole")
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


def test_a_folder_that_somebody_clears_meanwhile_never_gets_its_name(tmp_path):
    def clear_and_go_on():
        with new_folder(tmp_path / "model") as partial:
            partial.rmdir()
            write_bytes(partial / "second", b"alone")

    with pytest.raises(GeoEvsError, match="was removed while it was filled"):
        clear_and_go_on()
    assert list(tmp_path.iterdir()) == []
