"""Rules that hold for all code that reads what others wrote, found in its syntax."""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = [path for part in ("geoevs", "baselines") for path in (ROOT / part).rglob("*.py")]


def calls(path: Path) -> Iterator[tuple[str, ast.Call]]:
    """Every call in a file, with the code of what is called."""
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func), node


def found(wrong) -> list[str]:
    return [
        f"{path.relative_to(ROOT)}:{call.lineno}: {name}"
        for path in FILES
        for name, call in calls(path)
        if wrong(name, call)
    ]


def test_text_files_are_utf8_whatever_the_locale():
    def silent(name: str, call: ast.Call) -> bool:
        return name.endswith((".read_text", ".write_text")) and not any(
            word.arg == "encoding" for word in call.keywords
        )

    assert found(silent) == []


def test_one_function_decodes_images():
    opened = found(lambda name, call: name in ("Image.open", "PIL.Image.open"))
    assert {place.split(":")[0] for place in opened} <= {"geoevs/core/images.py"}


def test_no_text_is_run_as_code():
    def runs(name: str, call: ast.Call) -> bool:
        method = name.rpartition(".")[2]
        return method in ("eval", "exec", "query") and len(call.args) + len(call.keywords) == 1

    assert found(runs) == []


def test_no_table_is_read_past_the_checks():
    read = found(lambda name, call: name.endswith(".read_parquet") and name.startswith("pd."))
    stores = {"geoevs/scenes/store.py", "geoevs/scenes/extras.py"}
    assert {place.split(":")[0] for place in read} <= stores


@pytest.mark.parametrize("locale", ["C", "POSIX"])
def test_no_letter_ends_a_command_in_a_locale_that_lacks_it(locale):
    code = "import sys; from geoevs.cli import main; sys.argv = ['geoevs', 'x']\n"
    code += "try:\n main.main()\nexcept SystemExit:\n pass\nprint(chr(0x221E), chr(0xB1))"
    run = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "LC_ALL": locale, "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        capture_output=True,
        check=True,
    )
    assert run.stdout == rb"\u221e \xb1" + b"\n"
