"""The words for this machine."""

import platform
import socket

from geoevs.core.machine import machine, processor


def test_a_machine_is_its_host_and_its_processor():
    said = machine()
    assert said["host"] == socket.gethostname()
    assert said["cpu"]


def test_a_processor_is_named_as_linux_names_it(tmp_path):
    info = tmp_path / "cpuinfo"
    info.write_text("processor\t: 0\nmodel name\t: Some CPU @ 3.00GHz: fast\nflags\t: a\n")
    assert processor(info) == "Some CPU @ 3.00GHz: fast"


def test_a_processor_without_a_name_is_its_architecture(tmp_path):
    info = tmp_path / "cpuinfo"
    info.write_text("processor\t: 0\nBogoMIPS\t: 50.00\n")
    assert processor(info) in (platform.processor(), platform.machine())
