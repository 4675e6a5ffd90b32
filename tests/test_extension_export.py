# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a Blender scene arrives in `engine_core.Scene`, and what is said about the rest."""

from __future__ import annotations

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
    export,
    new_scene,
    set_world,
    tree,
)


@pytest.fixture
def scene(cv: ModuleType) -> Any:
    scene = new_scene()
    add_camera(scene)
    return scene


def corners(mesh: Any) -> np.ndarray:
    """(T, 3, 3) float64 vertices of each triangle."""
    return mesh.vertices[mesh.triangles].astype(float)


def geometric_normals(mesh: Any) -> np.ndarray:
    a, b, c = corners(mesh).transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_instances_of_a_mesh_are_read_once_and_placed_together(cv: ModuleType, scene: Any) -> None:
    import bpy

    cube = add_cube(scene)
    places = np.random.default_rng(1).uniform(-9, 9, (50, 3))
    for place in places:
        add(scene, "Copy", cube.data, place)
    bpy.context.view_layer.update()
    exported, messages = export(cv)
    (mesh,) = exported.meshes
    assert len(mesh.triangles) == 12 * 51 and not messages
    centres = mesh.vertices.reshape(51, 8, 3).mean(axis=1) + exported.origin
    wanted = np.array([(0, 0, 0), *places])
    for centre in wanted:
        assert np.abs(centres - centre).max(axis=1).min() < 1e-5


def test_mirrored_and_sheared_objects_face_outwards(cv: ModuleType, scene: Any) -> None:
    parent = add(scene, "Parent", None)
    parent.scale = (1.5, 0.5, -1)
    cube = add_cube(scene, rotation=(0.4, 0.5, 0.6))
    cube.parent = parent
    cube.data.polygons.foreach_set("use_smooth", [True] * 6)
    exported, _ = export(cv)
    (mesh,) = exported.meshes
    outwards = corners(mesh) - mesh.vertices.mean(axis=0)
    assert (np.einsum("tk,tk->t", geometric_normals(mesh), outwards.mean(axis=1)) > 0).all()
    assert (np.einsum("tck,tck->tc", mesh.normals, outwards) > 0).all()
    assert np.allclose(np.linalg.norm(mesh.normals, axis=2), 1, atol=1e-5)


def test_sheared_normals_stay_perpendicular_to_the_surface(cv: ModuleType, scene: Any) -> None:
    import bpy

    parent = add(scene, "Parent", None)
    parent.scale = (3, 0.5, -1)
    floor = add_floor(scene)
    floor.rotation_euler = (0.4, 0.5, 0.6)
    floor.parent = parent
    floor.data.polygons.foreach_set("use_smooth", [True])
    bpy.context.view_layer.update()
    (mesh,) = export(cv)[0].meshes
    assert np.allclose(mesh.normals, geometric_normals(mesh)[:, None], atol=1e-5)


def test_flat_faces_have_no_normals_of_their_own(cv: ModuleType, scene: Any) -> None:
    add_cube(scene)
    (mesh,) = export(cv)[0].meshes
    assert mesh.normals is None


def test_positions_far_away_keep_their_precision(cv: ModuleType, scene: Any) -> None:
    far = 2.0**20
    add_cube(scene, location=(far, 0, 0))
    scene.camera.location.x += far
    exported, _ = export(cv)
    (mesh,) = exported.meshes
    assert np.abs(mesh.vertices).max() < 10
    assert np.allclose(np.unique(mesh.vertices[:, 0]), [-0.5, 0.5])


def test_objects_of_every_kind_with_a_surface_are_meshes_once(cv: ModuleType, scene: Any) -> None:
    import bpy

    curve = bpy.data.curves.new("Curve", "CURVE")
    curve.dimensions, curve.bevel_depth = "3D", 0.1
    curve.splines.new("BEZIER").bezier_points.add(2)
    curve.splines[0].bezier_points.foreach_set("co", np.arange(9.0))
    text = bpy.data.curves.new("Text", "FONT")
    text.body = "CV"
    ball = bpy.data.metaballs.new("Ball")
    ball.elements.new()
    bpy.ops.surface.primitive_nurbs_surface_torus_add()
    materials = {}
    for data in (curve, text, ball, bpy.context.object.data):
        data.materials.append(diffuse(data.name, (0.1, 0.2, 0.3)))
        materials[data.name] = data
        if data.name != bpy.context.object.data.name:
            add(scene, data.name, data)
    bpy.context.view_layer.update()
    exported, messages = export(cv)
    names = [exported.materials[np.max(mesh.materials)].name for mesh in exported.meshes]
    assert sorted(names) == sorted(materials) and not messages


def test_material_slots_of_faces_and_of_objects(cv: ModuleType, scene: Any) -> None:
    cube = add_cube(scene, material=diffuse("First", (1, 0, 0)))
    cube.data.materials.append(diffuse("Second", (0, 1, 0)))
    cube.data.polygons.foreach_set("material_index", [0, 1, 5, 0, 0, 0])  # 5 is beyond the last slot
    cube.material_slots[0].link = "OBJECT"
    cube.material_slots[0].material = diffuse("Own", (0, 0, 1))
    add(scene, "Other", cube.data)
    exported, _ = export(cv)
    found = [sorted(exported.materials[i].name for i in mesh.materials) for mesh in exported.meshes]
    assert sorted(found) == sorted([["Own"] * 8 + ["Second"] * 4, ["First"] * 8 + ["Second"] * 4])


def test_view_layer_overrides_materials_and_samples(cv: ModuleType, scene: Any) -> None:
    import bpy

    add_cube(scene, material=diffuse("Own", (1, 0, 0)))
    layer = bpy.context.view_layer
    layer.material_override = diffuse("Override", (0, 1, 0))
    layer.samples = 7
    exported, _ = export(cv)
    assert exported.materials[exported.meshes[0].materials].name == "Override"
    assert cv.cv_render.properties.engine_settings(scene, layer).samples == 7


def test_object_without_material_is_grey(cv: ModuleType, scene: Any) -> None:
    add_cube(scene).data.materials.clear()
    exported, messages = export(cv)
    assert np.allclose(exported.materials[exported.meshes[0].materials].reflectance, 0.8)
    assert messages == ['Object "Cube": has no material, it is rendered as diffuse grey']


def test_visibility_of_objects_and_collections(cv: ModuleType, scene: Any) -> None:
    import bpy

    def cube_in(name: str) -> Any:
        cube = add_cube(scene)
        cube.name = name
        collection = bpy.data.collections.new(name)
        scene.collection.children.link(collection)
        collection.objects.link(cube)
        scene.collection.objects.unlink(cube)
        return cube, bpy.context.view_layer.layer_collection.children[name]

    cube_in("unseen")[0].visible_camera = False
    cube_in("unshadowed")[0].visible_shadow = False
    cube_in("hole")[0].is_holdout = True
    cube_in("hole by layer")[1].holdout = True
    cube_in("indirect")[1].indirect_only = True
    cube_in("excluded")[1].exclude = True
    cube_in("plain")
    bpy.context.view_layer.update()
    seen = {m.name: (m.visible_to_camera, m.casts_shadow, m.holdout) for m in export(cv)[0].meshes}
    assert seen == {
        "unseen": (False, True, False),
        "unshadowed": (True, False, False),
        "hole": (True, True, True),
        "hole by layer": (True, True, True),
        "indirect": (False, True, False),
        "plain": (True, True, False),
    }


def closure(material: Any) -> tuple[Any, Any]:
    nodes = tree(material).nodes
    return nodes, material.node_tree.links.new


def exported_material(cv: ModuleType, scene: Any, material: Any) -> tuple[Any, list[str]]:
    add_cube(scene, material=material)
    exported, messages = export(cv)
    return exported.materials[exported.meshes[0].materials], messages


def test_mix_and_add_of_shaders(cv: ModuleType, scene: Any) -> None:
    material = diffuse("Mixed", (0.8, 0.4, 0.0))
    nodes, link = closure(material)
    glow, mix, total = (nodes.new(f"ShaderNode{kind}") for kind in ("Emission", "MixShader", "AddShader"))
    glow.inputs["Strength"].default_value = 3
    mix.inputs["Fac" if "Fac" in mix.inputs else "Factor"].default_value = 0.25
    link(nodes["Diffuse BSDF"].outputs[0], mix.inputs[1])
    link(glow.outputs[0], mix.inputs[2])
    link(mix.outputs[0], total.inputs[0])
    link(glow.outputs[0], total.inputs[1])
    link(total.outputs[0], nodes["Material Output"].inputs["Surface"])
    found, messages = exported_material(cv, scene, material)
    assert np.allclose(found.reflectance, (0.6, 0.3, 0)) and np.allclose(found.emission, 3.75)
    assert not messages


def test_colours_through_groups_reroutes_and_muted_nodes(cv: ModuleType, scene: Any) -> None:
    import bpy

    group = bpy.data.node_groups.new("Paint", "ShaderNodeTree")
    group.interface.new_socket("Tint", in_out="INPUT", socket_type="NodeSocketColor")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    start, shader, end = (
        group.nodes.new(kind) for kind in ("NodeGroupInput", "ShaderNodeBsdfDiffuse", "NodeGroupOutput")
    )
    group.links.new(start.outputs["Tint"], shader.inputs["Color"])
    group.links.new(shader.outputs[0], end.inputs["Shader"])
    material = diffuse("Painted", (0, 0, 0))
    nodes, link = closure(material)
    paint, reroute = nodes.new("ShaderNodeGroup"), nodes.new("NodeReroute")
    gamma, colour = nodes.new("ShaderNodeGamma"), nodes.new("ShaderNodeRGB")
    paint.node_tree = group
    gamma.mute = True
    colour.outputs[0].default_value = (0.1, 0.5, 0.9, 1)
    link(colour.outputs[0], gamma.inputs["Color"])
    link(gamma.outputs[0], reroute.inputs[0])
    link(reroute.outputs[0], paint.inputs["Tint"])
    link(paint.outputs["Shader"], nodes["Material Output"].inputs["Surface"])
    found, messages = exported_material(cv, scene, material)
    assert np.allclose(found.reflectance, (0.1, 0.5, 0.9)) and not messages


def test_material_without_anything_at_its_output_is_black(cv: ModuleType, scene: Any) -> None:
    material = diffuse("Bare", (1, 1, 1))
    tree(material).links.clear()
    found, _ = exported_material(cv, scene, material)
    assert not found.reflectance.any() and not found.emission.any()


def test_lights_in_the_units_of_cycles(cv: ModuleType, scene: Any) -> None:
    add_light(scene, "POINT", 10, shadow_soft_size=0.2, use_soft_falloff=False, color=(1, 0.5, 0))
    add_light(scene, "SPOT", 10, shadow_soft_size=0.2, spot_size=1.0, spot_blend=0.4)
    add_light(scene, "AREA", 10, shape="ELLIPSE", size=2, size_y=0.5)
    add_light(scene, "SUN", 3, angle=0.1, use_shadow=False)
    point, spot, area, sun = export(cv)[0].lights
    assert np.allclose(point.power, (10, 5, 0)) and point.radius == pytest.approx(0.2) and point.sphere
    assert not spot.sphere and spot.angle == pytest.approx(1) and spot.blend == pytest.approx(0.4)
    assert area.ellipse and np.allclose(area.size, (2, 0.5)) and area.spread == pytest.approx(np.pi)
    assert np.allclose(sun.power, 3) and not sun.casts_shadow and sun.angle == pytest.approx(0.1)
    assert not any(light.visible_to_camera for light in (point, spot, area, sun))


def test_nodes_of_a_light_multiply_its_power(cv: ModuleType, scene: Any) -> None:
    light = add_light(scene, "POINT", 10).data
    nodes = tree(light).nodes
    glow = next(node for node in nodes if node.type == "EMISSION")
    glow.inputs["Color"].default_value = (1, 0.5, 0, 1)
    glow.inputs["Strength"].default_value = 2
    assert np.allclose(export(cv)[0].lights[0].power, (20, 10, 0))


def test_instances_of_lights(cv: ModuleType, scene: Any) -> None:
    import bpy

    lamps = bpy.data.collections.new("Lamps")
    lamp = add_light(scene, "POINT", 10, location=(0, 0, 1))
    lamps.objects.link(lamp)
    scene.collection.objects.unlink(lamp)
    for x in (0, 5):
        instancer = add(scene, "Lamps", None, (x, 0, 0))
        instancer.instance_type, instancer.instance_collection = "COLLECTION", lamps
    bpy.context.view_layer.update()
    exported, _ = export(cv)
    positions = sorted(tuple(np.round(light.position + exported.origin, 4)) for light in exported.lights)
    assert positions == [(0, 0, 1), (5, 0, 1)]


def test_world_is_its_background(cv: ModuleType, scene: Any) -> None:
    set_world(scene, (0.1, 0.2, 0.3), 2)
    assert np.allclose(export(cv)[0].world.radiance, (0.2, 0.4, 0.6))
    scene.world = None
    assert not export(cv)[0].world.radiance.any()


def test_each_unsupported_thing_is_named_once(cv: ModuleType, scene: Any) -> None:
    import bpy

    scene.render.use_motion_blur = True
    add(scene, "Smoke", bpy.data.volumes.new("Smoke"))
    for name in "ABCDE":
        cube = add_cube(scene)
        cube.name, cube.is_shadow_catcher = name, True
    bpy.context.view_layer.update()
    _, messages = export(cv)
    assert messages == [
        f'Scene "{scene.name}": motion blur is not supported yet',
        'Object "Smoke": OpenVDB volumes are not supported yet, its fog is left out',
        'Object "A", Object "B", Object "C" and 2 more: '
        "shadow catchers are not supported yet, it is an ordinary object",
    ]


def test_what_does_not_fit_into_memory_is_refused_by_name(
    cv: ModuleType, scene: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    add_cube(scene)
    add_monkey(scene)
    monkeypatch.setattr(cv.cv_render.memory, "available", lambda: 100_000)
    with pytest.raises(cv.engine_core.RenderError, match='object "Monkey" .*968 triangles.*Decimate'):
        export(cv)


def test_degenerate_objects_do_no_harm(cv: ModuleType, scene: Any) -> None:
    add_cube(scene).scale = (0, 0, 0)
    flat = add_monkey(scene)
    flat.scale = (1, 1, 0)
    add_mesh(scene, "Empty", [], [])
    add_mesh(scene, "Points", [(0, 0, 0), (1, 0, 0)], [])
    add_mesh(
        scene, "Not a number", [(np.nan, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)], diffuse("Grey", (1, 1, 1))
    )
    add_light(scene, "SUN").scale = (0, 0, 0)
    add_light(scene, "AREA").scale = (0, 0, 0)
    exported, messages = export(cv)
    assert {mesh.name for mesh in exported.meshes} == {"Cube", "Monkey", "Not a number"}
    assert messages == ['Object "Sun": has no direction (a scale of zero) and is left out']


def test_emitting_materials(cv: ModuleType, scene: Any) -> None:
    found, _ = exported_material(cv, scene, emission("Lamp", (1, 0.5, 0.25), 4))
    assert np.allclose(found.emission, (4, 2, 1)) and not found.reflectance.any()
