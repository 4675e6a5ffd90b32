# SPDX-License-Identifier: GPL-3.0-or-later
"""The same picture as Cycles without bounces: cameras, shading normals, instances, visibility.

Lights, one by one, are compared in test_against_cycles.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from extension_scenes import (
    add,
    add_camera,
    add_cube,
    add_floor,
    add_light,
    add_mesh,
    add_monkey,
    diffuse,
    emission,
    like_cycles,
    new_scene,
    render,
    tree,
)

SAMPLES = 64


def assert_like_cycles(scene: Any, folder: Path, tolerance: float = 1.2) -> None:
    """Means agree, and pixels differ by no more than the engines differ from themselves."""
    like_cycles(scene, SAMPLES)
    theirs = [render(scene, folder, "CYCLES", seed).astype(float) for seed in (1, 2)]
    ours = [render(scene, folder, "CV_RENDER", seed).astype(float) for seed in (1, 2)]
    assert ours[0].shape == theirs[0].shape
    difference = (ours[0] + ours[1] - theirs[0] - theirs[1]) / 2
    noise = np.sqrt(((theirs[0] - theirs[1]) ** 2 + (ours[0] - ours[1]) ** 2) / 4)
    assert math.sqrt((difference**2).sum()) < tolerance * math.sqrt((noise**2).sum()) + 1e-3
    assert abs(difference.mean()) < 4 * math.sqrt((noise**2).sum()) / noise.size + 1e-4


# -- cameras: a board of glowing patches with edges everywhere -------------------------------------


def board(width: int = 80, height: int = 60, **camera: Any) -> Any:
    scene = new_scene(width, height)
    add_camera(scene, (0.3, -6, 4.2), (1.0, 0.05, 0.1), **camera)
    random = np.random.default_rng(1)
    x, y = np.divmod(np.arange(0, 24 * 24), 24)
    x, y = x[(x + y) % 2 == 0], y[(x + y) % 2 == 0]
    low = np.stack([x - 12, y - 12, np.sin(1.3 * x + y)], axis=1) * 0.37
    vertices = (low[:, None] + 0.37 * np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])).reshape(-1, 3)
    patches = add_mesh(scene, "Board", vertices.tolist(), np.arange(len(vertices)).reshape(-1, 4).tolist())
    for i in range(6):
        patches.data.materials.append(emission(f"Glow {i}", random.random(3)))
    patches.data.polygons.foreach_set("material_index", random.integers(0, 6, len(x)).astype(np.int32))
    return scene


def with_border(crop: bool) -> Callable[[Any], None]:
    def change(scene: Any) -> None:
        edit = scene.render
        edit.use_border, edit.use_crop_to_border = True, crop
        edit.border_min_x, edit.border_max_x = 0.213, 0.777
        edit.border_min_y, edit.border_max_y = 0.11, 0.63

    return change


def with_render(**settings: float) -> Callable[[Any], None]:
    def change(scene: Any) -> None:
        for name, value in settings.items():
            setattr(scene.render, name, value)

    return change


def scaled(scene: Any) -> None:
    scene.camera.scale = (2, 0.5, 3)


def mirrored(scene: Any) -> None:
    scene.camera.scale = (-1, 1, 1)


def with_lens(**fields: Any) -> Callable[[Any], None]:
    """Depth of field: a strong one, in focus somewhere on the board."""

    def change(scene: Any) -> None:
        dof = scene.camera.data.dof
        dof.use_dof, dof.aperture_fstop, dof.focus_distance = True, 0.05, 6.5
        for name, value in fields.items():
            setattr(dof, name, value)

    return change


def focused_on_object(scene: Any) -> None:
    with_lens(focus_object=add(scene, "Focus", None, (0.5, 1, 0)))(scene)


ORTHO = {"type": "ORTHO", "ortho_scale": 5}
CAMERAS = {
    "lens": ((80, 60), {}, with_lens()),
    "blades": ((80, 60), {}, with_lens(aperture_blades=5, aperture_rotation=0.3, aperture_ratio=2)),
    "orthographic lens": ((80, 60), ORTHO, with_lens(aperture_blades=3, aperture_fstop=1.3)),
    "focus object": ((80, 60), {}, focused_on_object),
    "landscape": ((80, 60), {}, None),
    "portrait with shift": ((60, 80), {"shift_x": 0.13, "shift_y": -0.07}, None),
    "shift": ((80, 60), {"shift_x": 0.13, "shift_y": -0.07}, None),
    "vertical fit": ((80, 60), {"sensor_fit": "VERTICAL", "sensor_height": 20, "shift_x": 0.1}, None),
    "horizontal fit": ((60, 80), {"sensor_fit": "HORIZONTAL", "sensor_width": 30, "shift_y": 0.1}, None),
    "wide pixels": ((80, 60), {"shift_x": 0.1}, with_render(pixel_aspect_x=2)),
    "tall pixels": ((80, 60), {"shift_y": 0.1}, with_render(pixel_aspect_y=2)),
    "percentage": ((161, 121), {}, with_render(resolution_percentage=47)),
    "orthographic": ((80, 60), {"type": "ORTHO", "ortho_scale": 5, "shift_x": 0.1, "shift_y": 0.05}, None),
    "orthographic portrait": ((60, 80), {"type": "ORTHO", "ortho_scale": 5, "shift_y": 0.1}, None),
    "clip": ((80, 60), {"clip_start": 5.5, "clip_end": 8}, None),
    "orthographic clip": ((80, 60), {"type": "ORTHO", "clip_start": 5.5, "clip_end": 8}, None),
    "border": ((80, 60), {}, with_border(crop=False)),
    "border and crop": ((80, 60), {}, with_border(crop=True)),
    "scaled": ((80, 60), {}, scaled),
    "mirrored": ((80, 60), {}, mirrored),
    "transparent": ((80, 60), {}, with_render(film_transparent=True)),
}


@pytest.mark.parametrize("case", CAMERAS)
def test_camera_sees_what_that_of_cycles_sees(cv: ModuleType, tmp_path: Path, case: str) -> None:
    size, camera, change = CAMERAS[case]
    scene = board(*size, **camera)
    if change is not None:
        change(scene)
    assert_like_cycles(scene, tmp_path)


# -- surfaces: Suzanne on a floor under an area light ----------------------------------------------


def studio() -> Any:
    scene = new_scene(64, 48)
    add_camera(scene)
    add_floor(scene)
    add_light(scene, "AREA", size=0.5)
    return scene


def flat(scene: Any) -> None:
    add_monkey(scene, smooth=False)


def smooth_and_mirrored(scene: Any) -> None:
    add_monkey(scene).scale = (-1, 1, 1)


def smooth_and_sheared(scene: Any) -> None:
    parent = add(scene, "Parent", None)
    parent.scale = (1.5, -0.6, 1)
    monkey = add_monkey(scene)
    monkey.parent, monkey.rotation_euler = parent, (0.4, 0.5, 0.6)


def flat_and_smooth(scene: Any) -> None:
    mesh = add_monkey(scene).data
    mesh.polygons.foreach_set("use_smooth", [i % 3 > 0 for i in range(len(mesh.polygons))])


def sharp_edges(scene: Any) -> None:
    mesh = add_monkey(scene).data
    mesh.edges.foreach_set("use_edge_sharp", [i % 4 == 0 for i in range(len(mesh.edges))])


def flat_faces_and_sharp_edges(scene: Any) -> None:
    flat_and_smooth(scene)
    mesh = scene.objects["Monkey"].data
    mesh.edges.foreach_set("use_edge_sharp", [i % 4 == 0 for i in range(len(mesh.edges))])


def custom_normals(scene: Any) -> None:
    mesh = add_monkey(scene).data
    normals = np.array([vertex.normal for vertex in mesh.vertices]) + (0.1, -0.1, 0.2)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mesh.normals_split_custom_set_from_vertices(normals.tolist())


def terminator(value: float) -> Callable[[Any], None]:
    def build(scene: Any) -> None:
        monkey = add_monkey(scene)
        owner = monkey if hasattr(monkey, "shadow_terminator_geometry_offset") else monkey.cycles
        owner.shadow_terminator_geometry_offset = value

    return build


def subdivided(scene: Any) -> None:
    modifier = add_monkey(scene).modifiers.new("Subdivision", "SUBSURF")
    modifier.levels, modifier.render_levels = 0, 2


def hidden(scene: Any) -> None:
    add_monkey(scene)
    add_cube(scene).hide_render = True


def unseen(scene: Any) -> None:
    add_monkey(scene).visible_camera = False


def without_shadow(scene: Any) -> None:
    add_monkey(scene).visible_shadow = False


def holdout(scene: Any) -> None:
    add_monkey(scene).is_holdout = True


def collection_instances(scene: Any) -> None:
    import bpy

    monkey = add_monkey(scene)
    collection = bpy.data.collections.new("Monkeys")
    collection.objects.link(monkey)
    scene.collection.objects.unlink(monkey)
    for i in range(3):
        instancer = add(scene, "Instancer", None, (2 * i - 2, 0.5 * i, 0))
        instancer.scale = (0.6, 0.6, -0.6 if i == 1 else 0.6)
        instancer.instance_type, instancer.instance_collection = "COLLECTION", collection


def duplis(kind: str, show_instancer: bool) -> Callable[[Any], None]:
    def build(scene: Any) -> None:
        child = add_cube(scene, 0.3, diffuse("Child", (0.2, 0.9, 0.4)))
        parent = add_monkey(scene, smooth=False)
        parent.instance_type, parent.show_instancer_for_render = kind, show_instancer
        parent.use_instance_vertices_rotation = True
        child.parent = parent

    return build


def geometry_nodes(scene: Any) -> None:
    import bpy

    group = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    grid, cube, paint, instances, end = (
        group.nodes.new(kind)
        for kind in (
            "GeometryNodeMeshGrid",
            "GeometryNodeMeshCube",
            "GeometryNodeSetMaterial",
            "GeometryNodeInstanceOnPoints",
            "NodeGroupOutput",
        )
    )
    for socket, value in zip(grid.inputs, (4, 4, 5, 5), strict=False):
        socket.default_value = value
    cube.inputs["Size"].default_value = (0.4, 0.4, 0.4)
    paint.inputs["Material"].default_value = diffuse("Scattered", (0.2, 0.9, 0.4))
    link = group.links.new
    link(grid.outputs[0], instances.inputs["Points"])
    link(cube.outputs[0], paint.inputs["Geometry"])
    link(paint.outputs[0], instances.inputs["Instance"])
    link(instances.outputs[0], end.inputs[0])
    add_monkey(scene).modifiers.new("Scatter", "NODES").node_group = group


def without_nodes(scene: Any) -> None:
    import bpy

    material = diffuse("Plain", (0.2, 0.4, 0.6))
    if bpy.app.version < (5, 0, 0):
        material.use_nodes, material.diffuse_color = False, (0.6, 0.4, 0.2, 1)
    add_monkey(scene, material=material)


def mixed_shaders(scene: Any) -> None:
    material = diffuse("Mixed", (0.8, 0.4, 0.1))
    nodes, link = tree(material).nodes, material.node_tree.links.new
    glow, mix = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeMixShader")
    glow.inputs["Strength"].default_value = 0.5
    mix.inputs[0].default_value = 0.3
    link(nodes["Diffuse BSDF"].outputs[0], mix.inputs[1])
    link(glow.outputs[0], mix.inputs[2])
    link(mix.outputs[0], nodes["Material Output"].inputs["Surface"])
    add_monkey(scene, material=material)


def unseen_lamp(scene: Any) -> None:
    add_monkey(scene)
    lamp = add_cube(scene, 0.5, emission("Lamp", (1, 0.7, 0.4), 20), location=(0, -1, 1.8))
    lamp.scale, lamp.visible_camera = (2, 1, -1), False


SURFACES = {
    "flat": flat,
    "smooth and mirrored": smooth_and_mirrored,
    "smooth and sheared": smooth_and_sheared,
    "flat and smooth faces": flat_and_smooth,
    "sharp edges": sharp_edges,
    "flat faces and sharp edges": flat_faces_and_sharp_edges,
    "custom normals": custom_normals,
    "terminator offset 0": terminator(0.0),
    "terminator offset 1": terminator(1.0),
    "subdivided": subdivided,
    "hidden": hidden,
    "unseen by the camera": unseen,
    "without shadow": without_shadow,
    "holdout": holdout,
    "collection instances": collection_instances,
    "vertex instances": duplis("VERTS", show_instancer=False),
    "face instances": duplis("FACES", show_instancer=True),
    "geometry nodes": geometry_nodes,
    "without nodes": without_nodes,
    "mixed shaders": mixed_shaders,
    "unseen lamp": unseen_lamp,
}


@pytest.mark.parametrize("case", SURFACES)
def test_surface_looks_as_in_cycles(cv: ModuleType, tmp_path: Path, case: str) -> None:
    scene = studio()
    SURFACES[case](scene)
    assert_like_cycles(scene, tmp_path)
