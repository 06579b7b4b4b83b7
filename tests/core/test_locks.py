import os
import subprocess
import sys

import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.core.locks import lock_folder

HOLD = """
import sys
from pathlib import Path
from geoevs.core.locks import lock_folder
release = lock_folder(Path(sys.argv[1]))
print("locked", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, tmp_path / "run"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "locked\n"
    yield process
    process.kill()
    process.communicate()


def test_a_second_process_is_told_who_has_the_folder(tmp_path, holder):
    with pytest.raises(GeoEvsError, match=rf"run is being written by process {holder.pid} on "):
        lock_folder(tmp_path / "run")
    lock_folder(tmp_path / "other")()


def test_a_killed_process_leaves_no_lock(tmp_path, holder):
    holder.kill()
    holder.wait()
    lock_folder(tmp_path / "run")()


def test_a_released_folder_can_be_claimed_again(tmp_path):
    lock_folder(tmp_path)()
    lock_folder(tmp_path)()
    assert f"process {os.getpid()} on" in (tmp_path / ".lock").read_text()
