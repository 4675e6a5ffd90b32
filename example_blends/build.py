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
SCENES = (
    "soft_shadow", "mixed_lights", "many_lights", "instances", "interior", "slats", "studio_spheres",
    "veach_plates", "violin", "occluder", "pumpkin", "lighthouse", "laser", "fogged_interior", "stage",
    "fog_ball", "fog_area", "two_spots", "leaves", "fence",
)  # fmt: skip

WITH_ASSETS = ("dragon", "green_dragon")
"""Examples whose mesh is no part of the project: they are made where it is at hand."""

sys.path.insert(0, str(FOLDER.parent))


def build(name: str, *arguments: Path) -> None:
    """Leave the example ``name`` as bpy's open file; ``arguments`` are what its model takes."""
    example = importlib.import_module(f"example_blends.{name}")
    if hasattr(example, "model"):
        from example_blends.studio import build_model

        build_model(example.model(*arguments))
    else:
        example.build()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", default=SCENES, metavar="name", help=", ".join(SCENES))
    parser.add_argument("--into", type=Path, default=FOLDER, help="folder of the .blend files")
    parser.add_argument("--assets", type=Path, metavar="FOLDER", help="has the mesh of a dragon")
    options = parser.parse_args()
    if options.assets is None and any(name in WITH_ASSETS for name in options.names):
        parser.error("a dragon needs --assets FOLDER: its mesh is no part of the project")

    import bpy

    bpy.context.preferences.filepaths.save_version = 0
    for name in options.names:
        build(name, *([options.assets] if name in WITH_ASSETS else []))
        path = (options.into / f"{name}.blend").resolve()
        bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)
        print(f"{path.name}: {path.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
