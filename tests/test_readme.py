# SPDX-License-Identifier: GPL-3.0-or-later
"""What the README promises."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np

import dev

README = (dev.ROOT / "README.md").read_text("utf-8")


def test_example_renders_a_box_without_blender(tmp_path: Path):
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    result = subprocess.run(
        [sys.executable, "-c", "import sys; sys.modules['bpy'] = None\n" + example],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(dev.ROOT)},
        timeout=120,
    )
    assert result.returncode == 0, result.stderr

    from engine_core.image.exr import read_exr

    picture = read_exr(tmp_path / "box.exr")
    red, green = picture["Combined.R"], picture["Combined.G"]
    assert red.shape == (256, 256) and np.isfinite(red).all()
    assert red[128, 20] > 2 * green[128, 20] > 0  # the red wall
    assert green[128, -20] > 2 * red[128, -20] > 0  # the green wall


def test_first_lines_are_the_two_commands():
    first, second = README.splitlines()[:2]
    assert first.strip() == "python3 dev.py render example_blends/soft_shadow.blend"
    assert second.strip() == "python3 dev.py test"


def test_what_it_links_to_exists():
    links = re.findall(r"\]\(([^)#]+)\)", README)
    missing = [link for link in links if "://" not in link and not (dev.ROOT / link).exists()]
    assert not missing
