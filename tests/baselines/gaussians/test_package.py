"""The package as somebody finds it who wants the rasterizer alone."""

import re
import subprocess
import sys
from pathlib import Path


def test_package_is_cheap_to_import() -> None:
    lines = "import sys, baselines.gaussians; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", lines], check=False).returncode == 0


def test_the_example_of_the_page_runs() -> None:
    page = Path(__file__).parents[3] / "docs" / "gaussians.md"
    names: dict = {}
    exec(re.search(r"```python\n(.*?)```", page.read_text(), re.DOTALL)[1], names)
    assert names["picture"].rgb.shape == (256, 256, 3)
    assert names["picture"].opacity.max() > 0.5
    assert names["means"].grad.abs().sum(1).min() > 0
