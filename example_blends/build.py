# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds the example .blend files beside it: ``python example_blends/build.py [name ...]``, with bpy 4.2.

A file opens in the Blender that saved it and in all later ones, so the oldest supported one saves them.
Their engine is Cycles without bounces (CV_RENDER has no meaning where the extension is not installed);
choose CV Render in Blender, or pass ``-E CV_RENDER``.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
SCENES = ("soft_shadow", "mixed_lights", "many_lights", "instances", "interior")

sys.path.insert(0, str(FOLDER.parent))


def build(name: str) -> None:
    """Leave the example ``name`` as bpy's open file."""
    importlib.import_module(f"example_blends.{name}").build()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", default=SCENES, metavar="name", help=", ".join(SCENES))
    parser.add_argument("--into", type=Path, default=FOLDER, help="folder of the .blend files")
    options = parser.parse_args()

    import bpy

    bpy.context.preferences.filepaths.save_version = 0
    for name in options.names:
        build(name)
        path = (options.into / f"{name}.blend").resolve()
        bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)
        print(f"{path.name}: {path.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
