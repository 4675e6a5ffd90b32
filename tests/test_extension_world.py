# SPDX-License-Identifier: GPL-3.0-or-later
"""Environment textures: their placing and strength, and Cycles beside them."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from extension_scenes import add_camera, add_cube, add_floor, export, like_cycles, new_scene, render


def _picture(folder: Path, height: int = 8, width: int = 16) -> Any:
    import bpy

    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = np.random.default_rng(5).random((height, width, 3)) ** 3
    pixels[5, 10, :3] = (30, 20, 10)
    image = bpy.data.images.new("Sky", width, height, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw, image.file_format = str(folder / "sky.exr"), "OPEN_EXR"
    image.save()
    return image


def _lit_by_picture(scene: Any, folder: Path, strength: float = 1.0, **mapping: Any) -> Any:
    """The world's environment texture, with a Mapping node if there are values for its inputs."""
    tree = scene.world.node_tree
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = _picture(folder)
    background = next(node for node in tree.nodes if node.type == "BACKGROUND")
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    background.inputs["Strength"].default_value = strength
    if mapping:
        node, coordinate = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
        for name, value in mapping.items():
            node.inputs[name].default_value = value
        tree.links.new(coordinate.outputs["Generated"], node.inputs["Vector"])
        tree.links.new(node.outputs["Vector"], texture.inputs["Vector"])
    return texture


def test_environment_texture_is_the_worlds_picture(cv: ModuleType, tmp_path: Path):
    scene = new_scene()
    add_camera(scene)
    _lit_by_picture(scene, tmp_path, strength=2.0, Rotation=(0, 0, 0.5), Scale=(1, -1, 1))
    exported, messages = export(cv)
    assert not messages
    assert exported.world.image.shape == (8, 16, 3)
    assert np.allclose(exported.world.image[5, 10], (60, 40, 20), rtol=1e-3)
    turn = np.array([[np.cos(0.5), -np.sin(0.5), 0], [np.sin(0.5), np.cos(0.5), 0], [0, 0, 1]])
    assert np.allclose(exported.world.rotation, turn @ np.diag([1, -1, 1]), atol=1e-6)
    assert not exported.world.radiance.any()


def test_what_an_environment_texture_cannot_do_is_told(cv: ModuleType, tmp_path: Path):
    scene = new_scene()
    add_camera(scene)
    texture = _lit_by_picture(scene, tmp_path, Location=(1, 0, 0), Scale=(1, 2, 1))
    assert sum("Mapping" in message for message in export(cv)[1]) == 2
    texture.projection = "MIRROR_BALL"
    exported, messages = export(cv)
    assert any("mirror ball" in message for message in messages)
    assert exported.world.image is None


def test_light_of_a_picture_is_that_of_cycles(cv: ModuleType, tmp_path: Path):
    scene = new_scene(32, 24)
    add_camera(scene)
    add_floor(scene)
    add_cube(scene, 1.4, rotation=(0.2, 0.3, 0.5))
    _lit_by_picture(scene, tmp_path, strength=1.3, Rotation=(0.3, 0.2, 0.7))
    like_cycles(scene, 256)
    ours, cycles = (render(scene, tmp_path, engine)[..., :3] for engine in ("CV_RENDER", "CYCLES"))
    assert np.allclose(ours.mean(axis=(0, 1)), cycles.mean(axis=(0, 1)), rtol=8e-3)
    # The background, where there is no noise but that of the pixel filter.
    assert np.abs(ours[-4:] - cycles[-4:]).mean() < 0.02 * cycles[-4:].mean()
