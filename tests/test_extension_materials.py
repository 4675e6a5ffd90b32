# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials as Cycles has them without bounces: a chart of them, and what they do to light around them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from extension_scenes import (
    add_camera,
    add_cube,
    add_floor,
    add_light,
    add_mesh,
    add_monkey,
    like_cycles,
    new_scene,
    render,
    set_world,
    surface,
    tree,
)
from test_extension_cycles import assert_like_cycles

from benchmarks.scenes import material_chart
from benchmarks.scenes.material_chart import CHART, Nodes

BSDFS, TEXTURES = 0.01, 0.003
"""By how much the mean of a material may differ, relatively, beside what the noise explains."""


def means(folder: Path, engine: str, samples: int, seeds: range) -> np.ndarray:
    """(seeds, materials, 3) of the open chart."""
    import bpy

    scene = bpy.context.scene
    like_cycles(scene, samples)
    pictures = (render(scene, folder, engine, seed)[..., :3].astype(np.float64) for seed in seeds)
    return np.array([material_chart.means(picture) for picture in pictures])


def assert_chart_is_that_of_cycles(folder: Path, edge: int, samples: tuple[int, int], seeds: int) -> None:
    """samples : of Cycles and of CV Render."""
    material_chart.build(edge)
    scene_settings()
    theirs = means(folder, "CYCLES", samples[0], range(seeds))
    ours = means(folder, "CV_RENDER", samples[1], range(seeds))
    truth = theirs.mean(axis=0)
    # A channel that is nearly black is measured by the others.
    scale = np.maximum(truth, 0.1 * truth.mean(axis=1, keepdims=True))
    difference = (ours.mean(axis=0) - truth) / scale
    # The noise is much the same in all channels, and in all seeds of an engine.
    variance = (theirs.var(axis=0, ddof=1) + ours.var(axis=0, ddof=1)) / seeds
    noise = np.sqrt((variance / scale**2).mean(axis=1, keepdims=True))
    bound = np.array([[TEXTURES if sample.texture else BSDFS] for sample in CHART])
    wrong = np.flatnonzero((np.abs(difference) > bound + 3 * noise).any(axis=1))
    assert not wrong.size, "\n".join(
        f"{CHART[i].name}: {100 * difference[i]} % off, noise {100 * noise[i, 0]:.2f} %" for i in wrong
    )
    assert np.median(noise) < TEXTURES and np.median(np.abs(difference)) < TEXTURES


def scene_settings() -> None:
    """A 32-bit EXR with alpha, as `render` reads it."""
    import bpy

    settings = bpy.context.scene.render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5
        settings.media_type = "IMAGE"
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGBA"


def test_chart_of_materials(cv: ModuleType, tmp_path: Path) -> None:
    assert_chart_is_that_of_cycles(tmp_path, 20, (48, 8), 2)


@pytest.mark.full
def test_chart_of_materials_with_less_noise(cv: ModuleType, tmp_path: Path) -> None:
    assert_chart_is_that_of_cycles(tmp_path, 32, (128, 16), 4)


# -- what materials do to others -------------------------------------------------------------------


def shader(name: str, make: Callable[[Nodes], Any]) -> Any:
    """A material of the node that ``make`` gives."""
    material = surface(name, "ShaderNodeBsdfDiffuse")
    tree(material).nodes.clear()
    nodes = Nodes(material.node_tree)
    nodes("OutputMaterial", {"Surface": make(nodes).outputs[0]})
    return material


def sheet(scene: Any, material: Any, x: float) -> Any:
    """A square with a UV map, above the floor."""
    corners = [(-0.8, -1, 0), (0.8, -1, 0), (0.8, 1, 0), (-0.8, 1, 0)]
    made = add_mesh(scene, "Sheet", corners, [(0, 1, 2, 3)], material, location=(x, 0, 0.3))
    layer = made.data.uv_layers.new(name="UVMap")
    layer.uv.foreach_set("vector", np.float32([0, 0, 1, 0, 1, 1, 0, 1]))
    return made


def coloured_and_textured_shadows(scene: Any) -> None:
    tinted = shader("Tinted", lambda n: n("BsdfTransparent", {0: (0.9, 0.4, 0.1, 1)}))
    cut = shader(
        "Cut",
        lambda n: n("BsdfPrincipled", {"Alpha": material_chart.image(n, alpha=True).outputs[1]}),
    )
    mixed = shader(
        "Mixed",
        lambda n: n(
            "MixShader",
            {0: n("TexChecker", {"Scale": 4.0}).outputs[1], 1: n("BsdfTransparent").outputs[0]},
        ),
    )
    for x, material in ((-1.8, tinted), (0, cut), (1.8, mixed)):
        sheet(scene, material, x)


def camera_and_shadow_rays_see_another_material(scene: Any) -> None:
    def make(n: Nodes) -> Any:
        path = n("LightPath")
        first = n(
            "MixShader", {0: path.outputs["Is Camera Ray"], 2: n.diffuse((0.9, 0.2, 0.2, 1)).outputs[0]}
        )
        clear = n("BsdfTransparent", {0: (0.2, 0.9, 0.5, 1)})
        return n("MixShader", {0: path.outputs["Is Shadow Ray"], 1: first.outputs[0], 2: clear.outputs[0]})

    sheet(scene, shader("Two-faced", make), 0)


def textured_lamp_over_gloss(scene: Any) -> None:
    glow = shader("Glow", lambda n: n("Emission", {0: material_chart.image(n).outputs[0], 1: 12.0}))
    lamp = sheet(scene, glow, 0)
    lamp.location, lamp.rotation_euler = (0, 1.0, 1.0), (0.8, 0, 0)
    gloss = shader("Gloss", lambda n: n("BsdfAnisotropic", {"Roughness": 0.4}))
    scene.objects["Floor"].data.materials[0] = gloss
    add_monkey(scene, material=shader("Plastic", lambda n: n("BsdfPrincipled", {"Roughness": 0.35})))


def gloss_out_of_focus(scene: Any) -> None:
    add_monkey(scene, material=shader("Plastic", lambda n: n("BsdfPrincipled", {"Roughness": 0.3})))
    dof = scene.camera.data.dof
    dof.use_dof, dof.aperture_fstop, dof.focus_distance, dof.aperture_blades = True, 0.08, 4.5, 5


def leaf_lit_from_behind(scene: Any) -> None:
    leaf = shader("Leaf", lambda n: n("BsdfTranslucent", {"Normal": material_chart.tilted(n)}))
    sheet(scene, leaf, 0).rotation_euler = (1.2, 0, 0.3)
    add_light(scene, "POINT", 200.0, (0.5, 3, 2), shadow_soft_size=0.5)


def glow_behind_glass(scene: Any) -> None:
    """A lamp that the camera sees through transparent surfaces, and that shines through them."""
    glass = shader("Glass", lambda n: n("BsdfTransparent", {0: (0.3, 0.8, 0.9, 1)}))
    sheet(scene, glass, 0).rotation_euler = (1.2, 0, 0.3)
    light = add_light(scene, "AREA", 30.0, (0.2, 1.5, 0.8), size=0.8)
    light.rotation_euler, light.visible_camera = (1.4, 0, 0), True


def holdout_among_closures(scene: Any) -> None:
    add_cube(scene, material=shader("Clear", lambda n: n("BsdfPrincipled", {"Alpha": 0.5}))).location.x = 1
    monkey = add_monkey(scene, material=shader("Gloss", lambda n: n("BsdfAnisotropic", {"Roughness": 0.5})))
    monkey.is_holdout = True
    set_world(scene, (0.2, 0.3, 0.4))


SCENES = {
    made.__name__: made
    for made in (
        coloured_and_textured_shadows,
        camera_and_shadow_rays_see_another_material,
        textured_lamp_over_gloss,
        gloss_out_of_focus,
        leaf_lit_from_behind,
        glow_behind_glass,
        holdout_among_closures,
    )
}


@pytest.mark.parametrize("case", SCENES)
def test_materials_among_others_look_as_in_cycles(cv: ModuleType, tmp_path: Path, case: str) -> None:
    scene = new_scene(64, 48)
    add_camera(scene)
    add_floor(scene)
    add_light(scene, "AREA", size=0.5)
    SCENES[case](scene)
    assert_like_cycles(scene, tmp_path)
