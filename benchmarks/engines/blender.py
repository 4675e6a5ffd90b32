# SPDX-License-Identifier: GPL-3.0-or-later
"""The engines inside Blender, Cycles and CV Render, set to the same task."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from engine_core import Settings
from engine_core.image.exr import read_exr
from engine_core.settings import INTEGRATORS
from example_blends.studio import direct_light_only


@dataclass(frozen=True)
class BlenderEngine:
    """An engine of the running Blender with its settings.

    name : what tables call it.
    engine : Blender's name of it.
    light_tree : Cycles' choice of lights by a tree (its default), or by their power.
    noise_threshold : of Cycles' adaptive sampling; 0 is without it.
    denoise : by OpenImageDenoise in Cycles, as it comes (with albedo and normals, prefiltered).
    integrator : CV Render's.
    """

    name: str
    engine: str
    light_tree: bool = True
    noise_threshold: float = 0.0
    denoise: bool = False
    integrator: str = Settings().integrator

    @property
    def family(self) -> str:
        """Whose converged picture it shares."""
        return self.engine.lower()

    def render(self, samples: int, seed: int, path: Path) -> float:
        """Render the open scene into a 32-bit EXR; seconds from the scene in Blender to the closed file."""
        scene = bpy.context.scene
        if self.engine == "CYCLES":
            direct_light_only(scene)
            cycles = scene.cycles
            cycles.samples, cycles.seed = samples, seed
            cycles.use_light_tree = self.light_tree
            cycles.use_adaptive_sampling = self.noise_threshold > 0
            cycles.adaptive_threshold = self.noise_threshold
            cycles.use_denoising = self.denoise
            if self.denoise:
                cycles.denoiser = "OPENIMAGEDENOISE"
        else:
            scene.render.engine = self.engine
            scene.cv_render.samples, scene.cv_render.seed = samples, seed
            scene.cv_render.integrator = self.integrator
        scene.render.filepath = str(path)
        start = time.perf_counter()
        bpy.ops.render.render(write_still=True)
        return time.perf_counter() - start


CYCLES = BlenderEngine("Cycles", "CYCLES")
CYCLES_WITHOUT_TREE = BlenderEngine("Cycles, no light tree", "CYCLES", light_tree=False)
CYCLES_ADAPTIVE = BlenderEngine("Cycles, adaptive (0.01)", "CYCLES", noise_threshold=0.01)
CYCLES_DENOISED = BlenderEngine("Cycles, OpenImageDenoise", "CYCLES", denoise=True)
CV_RENDER = BlenderEngine("CV Render", "CV_RENDER")
INTEGRATORS = {
    name: BlenderEngine(f"CV Render, {name.replace('_', ' ')}", "CV_RENDER", integrator=name)
    for name in INTEGRATORS
}
"""CV Render with each of its integrators."""


def set_output(width: int, height: int) -> None:
    """Let the open scene render ``width`` x ``height`` pixels into a 32-bit EXR."""
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.use_border = False
    if hasattr(render.image_settings, "media_type"):  # Blender 5
        render.image_settings.media_type = "IMAGE"
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    render.image_settings.color_mode = "RGB"


def read_picture(path: Path) -> np.ndarray:
    """(H, W, 3) float64 radiance of an EXR that an engine wrote."""
    channels = read_exr(path)
    return np.stack([channels[name].astype(np.float64) for name in "RGB"], -1)
