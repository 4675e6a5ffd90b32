# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes from Blender: nodes against closed forms and Cycles, what encloses them, and what is told."""

from __future__ import annotations

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
    diffuse,
    emission,
    export,
    like_cycles,
    new_scene,
    render,
    tree,
)

SCATTER, ABSORPTION = "ShaderNodeVolumeScatter", "ShaderNodeVolumeAbsorption"
PRINCIPLED, COEFFICIENTS = "ShaderNodeVolumePrincipled", "ShaderNodeVolumeCoefficients"


@pytest.fixture
def scene(cv: ModuleType) -> Any:
    scene = new_scene()
    add_camera(scene)
    return scene


def fog(kind: str | None = None, name: str = "Fog", options: Any = (), **inputs: Any) -> Any:
    """A material of one volume node and no surface; underscores in names of inputs are spaces."""
    import bpy

    material = bpy.data.materials.new(name)
    tree(material).nodes.clear()
    material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    if kind is not None:
        feed(material, node(material, kind, options, **inputs))
    return material


def node(datablock: Any, kind: str, options: Any = (), **inputs: Any) -> Any:
    made = datablock.node_tree.nodes.new(kind)
    for name, value in dict(options).items():
        setattr(made, name, value)
    for name, value in inputs.items():
        made.inputs[name.replace("_", " ")].default_value = value
    return made


def feed(datablock: Any, source: Any, socket: str = "Volume") -> None:
    output = datablock.node_tree.get_output_node("CYCLES")
    datablock.node_tree.links.new(source.outputs[0], output.inputs[socket])


def link(datablock: Any, source: Any, target: Any, output: Any = 0, socket: Any = 0) -> None:
    datablock.node_tree.links.new(source.outputs[output], target.inputs[socket])


def fogs(cv: ModuleType) -> tuple[list[Any], list[str]]:
    import bpy

    bpy.context.view_layer.update()
    exported, messages = export(cv)
    return list(exported.volumes), messages


def only(cv: ModuleType, scene: Any, material: Any) -> Any:
    """The one volume of a cube of ``material``, of which nothing is told."""
    add_cube(scene, 2.0, material)
    volumes, messages = fogs(cv)
    assert not messages and len(volumes) == 1
    return volumes[0]


def close(found: Any, wanted: Any) -> bool:
    return np.allclose(found, wanted, rtol=1e-5, atol=1e-9)


# -- nodes ----------------------------------------------------------------------------------------


def test_scatter_scatters_its_colour_and_absorbs_nothing(cv: ModuleType, scene: Any) -> None:
    found = only(cv, scene, fog(SCATTER, Color=(0.8, 0.5, 0, 1), Density=0.3, Anisotropy=0.4))
    assert close(found.scattering, [(0.24, 0.15, 0)]) and close(found.anisotropy, [0.4])
    assert not found.absorption.any() and not found.emission.any()


def test_absorption_absorbs_what_its_colour_lacks(cv: ModuleType, scene: Any) -> None:
    found = only(cv, scene, fog(ABSORPTION, Color=(0.9, 0.5, 1, 1), Density=2))
    assert not found.scattering.any() and close(found.absorption, (0.2, 1, 0))


def test_principled_volume(cv: ModuleType, scene: Any) -> None:
    colours = {
        "Color": (0.5, 0.2, 0.9, 1),
        "Absorption_Color": (0.25, 0, 1, 1),
        "Emission_Color": (1, 0.5, 0, 1),
    }
    found = only(cv, scene, fog(PRINCIPLED, Density=0.4, Anisotropy=-0.3, Emission_Strength=3.0, **colours))
    assert close(found.scattering, [(0.2, 0.08, 0.36)]) and close(found.anisotropy, [-0.3])
    # (1 - colour) (1 - sqrt(absorption colour)) density.
    assert close(found.absorption, (0.5 * 0.5 * 0.4, 0.8 * 0.4, 0))
    assert close(found.emission, (3, 1.5, 0))  # whatever the density


def test_blackbody_emission(cv: ModuleType, scene: Any) -> None:
    strength, kelvin = 0.5, 1500.0
    found = only(cv, scene, fog(PRINCIPLED, Density=0, Blackbody_Intensity=strength, Temperature=kelvin))
    radiance = 5.670373e-8 * 1e-6 / np.pi * (1 - strength + strength * kelvin**4)
    luminance = found.emission @ (0.2126, 0.7152, 0.0722)
    assert luminance == pytest.approx(radiance, rel=0.05)
    assert found.emission[0] > 2 * found.emission[1] > 10 * found.emission[2]


def test_coefficients_are_taken_as_they_are(cv: ModuleType, scene: Any) -> None:
    import bpy

    if not hasattr(bpy.types, COEFFICIENTS):
        pytest.skip("this Blender has no such node")
    given = {"Absorption Coefficients": (1, 2, 3), "Scatter Coefficients": (0.1, 0.2, 0.3)}
    found = only(cv, scene, fog(COEFFICIENTS, **given, Emission_Coefficients=(5, 6, 7), Anisotropy=0.2))
    assert close(found.scattering, [(0.1, 0.2, 0.3)]) and close(found.absorption, (1, 2, 3))
    assert close(found.emission, (5, 6, 7)) and close(found.anisotropy, [0.2])


def test_emission_and_colours_glow(cv: ModuleType, scene: Any) -> None:
    assert close(
        only(cv, scene, fog("ShaderNodeEmission", Color=(1, 0.5, 0, 1), Strength=4)).emission, (4, 2, 0)
    )


def test_a_colour_is_emission(cv: ModuleType, scene: Any) -> None:
    material = fog("ShaderNodeRGB")
    rgb = next(node for node in material.node_tree.nodes if node.type == "RGB")
    rgb.outputs[0].default_value = (0.1, 0.2, 0.3, 1)
    assert close(only(cv, scene, material).emission, (0.1, 0.2, 0.3))


def test_what_is_negative_is_nothing(cv: ModuleType, scene: Any) -> None:
    add_cube(scene, 1, fog(SCATTER, Density=-1))
    volumes, _ = fogs(cv)
    assert not volumes
    add_cube(scene, 1, fog(ABSORPTION, "Bright", Color=(2, 0.5, 0.5, 1), Density=1.0))
    volumes, messages = fogs(cv)
    assert close(volumes[0].absorption, (0, 0.5, 0.5))
    assert messages == ['Object "Cube.001": volume of material "Bright": absorbs or emits less than nothing, '
                        "which is nothing"]  # fmt: skip


def test_sums_mixtures_reroutes_and_groups(cv: ModuleType, scene: Any) -> None:
    import bpy

    group = bpy.data.node_groups.new("Thick", "ShaderNodeTree")
    group.interface.new_socket("Density", in_out="INPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("Fog", in_out="OUTPUT", socket_type="NodeSocketShader")
    start, inner, end = (group.nodes.new(k) for k in ("NodeGroupInput", SCATTER, "NodeGroupOutput"))
    inner.inputs["Color"].default_value = (1, 1, 1, 1)
    group.links.new(start.outputs[0], inner.inputs["Density"])
    group.links.new(inner.outputs[0], end.inputs[0])

    material = fog()
    grouped = node(material, "ShaderNodeGroup", {"node_tree": group})
    grouped.inputs[0].default_value = 0.8
    dust = node(material, SCATTER, Color=(1, 0.5, 0.5, 1), Density=0.4, Anisotropy=0.7)
    smoke = node(material, ABSORPTION, Color=(0, 0, 0, 1), Density=2.0)
    mix, total, bend = (
        node(material, k) for k in ("ShaderNodeMixShader", "ShaderNodeAddShader", "NodeReroute")
    )
    mix.inputs[0].default_value = 0.25
    link(material, grouped, mix, socket=1)
    link(material, dust, mix, socket=2)
    link(material, mix, bend)
    link(material, bend, total, socket=0)
    link(material, smoke, total, socket=1)
    feed(material, total)
    found = only(cv, scene, material)
    assert close(found.scattering, [(0.6, 0.6, 0.6), (0.1, 0.05, 0.05)])
    assert close(found.anisotropy, [0, 0.7]) and close(found.absorption, 2)

    mix.inputs[0].default_value = 3.0  # held to 1
    assert close(fogs(cv)[0][0].anisotropy, [0.7])
    total.mute = True
    assert len(fogs(cv)[0]) <= 1


PHASES = {
    "RAYLEIGH": ({}, [(1, 0)]),
    "DRAINE": ({"Anisotropy": 0.3, "Alpha": 0.5}, [(1, 0.33041783)]),  # by quadrature
    "FOURNIER_FORAND": ({"Backscatter": 0.1, "IOR": 1.33}, [(1, 0.71546)]),
    "MIE": ({"Diameter": 20}, [(0.501841, 0.99461), (0.498159, 0.94068)]),
}


@pytest.mark.parametrize("phase", PHASES)
def test_other_phase_functions_are_drawn_by_their_mean_cosine(cv: ModuleType, scene: Any, phase: str) -> None:
    import bpy

    if "phase" not in bpy.types.ShaderNodeVolumeScatter.bl_rna.properties:
        pytest.skip("this Blender knows Henyey-Greenstein alone")
    inputs, wanted = PHASES[phase]
    add_cube(scene, 1, fog(SCATTER, options={"phase": phase}, Color=(1, 1, 1, 1), Density=2, **inputs))
    (found,), messages = fogs(cv)
    shares, anisotropies = zip(*wanted, strict=True)
    if phase == "MIE":
        assert np.all(np.abs(found.anisotropy) < 1) and close(found.scattering.sum(axis=0), 2)
        assert found.scattering[0, 0] == pytest.approx(2 * shares[0], rel=1e-4)
        assert found.anisotropy[0] == pytest.approx(anisotropies[0], rel=1e-4)
    else:
        assert np.allclose(found.scattering, 2) and np.allclose(found.anisotropy, anisotropies, atol=1e-4)
    assert len(messages) == 1 and "Henyey-Greenstein of the same mean cosine" in messages[0]
    assert messages[0].startswith('Object "Cube": volume of material "Fog"')


# -- what encloses them ---------------------------------------------------------------------------


def test_a_material_without_surface_only_bounds_its_volume(cv: ModuleType, scene: Any) -> None:
    add_cube(scene, 1, fog(SCATTER))
    exported, messages = export(cv)
    (mesh,) = exported.meshes
    assert mesh.volume == 0 and not mesh.surface and not messages


def test_a_surface_around_a_volume(cv: ModuleType, scene: Any) -> None:
    material = fog(SCATTER)
    feed(material, node(material, "ShaderNodeBsdfTransparent"), "Surface")
    add_cube(scene, 1, material)
    (mesh,) = export(cv)[0].meshes
    assert mesh.volume == 0 and mesh.surface


def test_every_instance_is_a_body_of_its_own(cv: ModuleType, scene: Any) -> None:
    import bpy

    cube = add_cube(scene, 1, fog(SCATTER))
    for x in (0.5, 3.0):
        add(scene, "Copy", cube.data, (x, 0, 0))
    bpy.data.objects["Copy"].scale = (-1, 1, 1)
    bpy.context.view_layer.update()
    exported, _ = export(cv)
    assert len(exported.volumes) == 1 and [mesh.volume for mesh in exported.meshes] == [0, 0, 0]
    for mesh in exported.meshes:
        a, b, c = (mesh.vertices[mesh.triangles[:, k]].astype(np.float64) for k in range(3))
        # Triangles face outwards, mirrored or not: the volume is that of the cube.
        assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(1, rel=1e-5)


def test_many_instances_share_meshes_where_they_keep_clear(cv: ModuleType, scene: Any) -> None:
    import bpy

    cube = add_cube(scene, 1, fog(SCATTER), location=(-1.5, 0, 0))
    for i in range(59):
        add(scene, "Puff", cube.data, (1.5 * (i // 2) + 0.1 * (i % 2), 0, 0))
    bpy.context.view_layer.update()
    exported, _ = export(cv)
    assert [len(mesh.triangles) // 12 for mesh in exported.meshes] == [31, 29]
    assert {(mesh.volume, mesh.surface) for mesh in exported.meshes} == {(0, False)}


def test_an_object_is_parted_where_its_materials_have_volumes(cv: ModuleType, scene: Any) -> None:
    """As in Cycles, where faces of one material bound its volume, whatever the others do."""
    import bpy

    cube = add_cube(scene, 1, fog(SCATTER, Color=(1, 1, 1, 1), Density=0.5))
    mesh = cube.data
    mesh.materials.append(diffuse("Wall", (1, 0, 0)))
    mesh.materials.append(fog(ABSORPTION, "Dark"))
    mesh.polygons.foreach_set("material_index", [0, 0, 1, 1, 1, 2])
    mesh.update()
    bpy.context.view_layer.update()
    exported, messages = export(cv)
    found = [(len(mesh.triangles), len(mesh.vertices), mesh.volume, mesh.surface) for mesh in exported.meshes]
    assert found == [(4, 8, 0, False), (2, 4, 1, False), (6, 8, -1, True)]
    assert [exported.materials[int(np.max(mesh.materials))].name for mesh in exported.meshes] == [
        "Fog", "Dark", "Wall"
    ]  # fmt: skip
    assert [volume.name for volume in exported.volumes] == ["Fog", "Dark"] and not messages


def test_a_slot_that_no_face_has_fills_nothing(cv: ModuleType, scene: Any) -> None:
    cube = add_cube(scene, 1, diffuse("Wall", (1, 0, 0)))
    cube.data.materials.append(fog(SCATTER))
    exported, _ = export(cv)
    (mesh,) = exported.meshes
    assert mesh.volume == -1 and mesh.surface and not exported.volumes


def test_volume_of_the_world(cv: ModuleType, scene: Any) -> None:
    add_cube(scene, 1, fog(SCATTER))
    feed(scene.world, node(scene.world, SCATTER, Color=(1, 1, 1, 1), Density=0.125))
    exported, messages = export(cv)
    assert not messages and [volume.name for volume in exported.volumes] == ["Fog", scene.world.name]
    assert exported.world.volume == 1 and close(exported.volumes[1].scattering, 0.125)


def test_nothing_in_a_volume_is_nothing(cv: ModuleType, scene: Any) -> None:
    add_cube(scene, 1, fog(SCATTER, Density=0))
    add_cube(scene, 1, diffuse("Wall", (1, 1, 1)))
    exported, _ = export(cv)
    assert not exported.volumes and [mesh.name for mesh in exported.meshes] == ["Cube.001"]
    assert exported.world.volume == -1


# -- what is told ---------------------------------------------------------------------------------

VARIES = "varies from place to place, which is not supported yet: "


def test_what_varies_is_drawn_with_its_mean_over_the_object(cv: ModuleType, scene: Any) -> None:
    material = fog(SCATTER, Color=(1, 1, 1, 1))
    scatter = material.node_tree.nodes["Volume Scatter"]
    coordinate, part = node(material, "ShaderNodeTexCoord"), node(material, "ShaderNodeSeparateXYZ")
    link(material, coordinate, part, "Object")
    link(material, part, scatter, "Z", "Density")
    add_cube(scene, 4.0, material)  # z from -2 to 2, where density is 0 below 0
    (found,), messages = fogs(cv)
    assert close(found.scattering, 0.5)
    assert messages == [f'Object "Cube": volume of material "Fog": {VARIES}its mean is drawn']


def test_the_mean_of_a_picture(cv: ModuleType, scene: Any) -> None:
    import bpy

    image = bpy.data.images.new("Two", 2, 1, float_buffer=True)
    image.pixels.foreach_set(np.array([0.2, 0.4, 0.6, 1, 0.6, 0.8, 1.0, 1], np.float32))
    material = fog(ABSORPTION, Density=2.0)
    texture = node(material, "ShaderNodeTexImage", {"image": image, "interpolation": "Closest"})
    link(material, node(material, "ShaderNodeTexCoord"), texture, "Generated", "Vector")
    link(material, texture, material.node_tree.nodes["Volume Absorption"], "Color", "Color")
    add_cube(scene, 1, material)
    (found,), messages = fogs(cv)
    assert close(found.absorption, 2 * (1 - np.array([0.4, 0.6, 0.8]))) and len(messages) == 1


def test_what_varies_is_averaged_for_each_object(cv: ModuleType, scene: Any) -> None:
    material = fog("ShaderNodeEmission")
    geometry = node(material, "ShaderNodeNewGeometry")
    link(material, geometry, material.node_tree.nodes["Emission"], "Position", "Color")
    add_cube(scene, 1, material, location=(1, 2, 3))
    add_cube(scene, 1, material, location=(4, 5, 6))
    volumes, messages = fogs(cv)
    assert close([volume.emission for volume in volumes], [(1, 2, 3), (4, 5, 6)]) and len(messages) == 1


def test_what_a_mesh_has_no_values_of_inside(cv: ModuleType, scene: Any) -> None:
    material = fog(SCATTER, Color=(1, 1, 1, 1))
    attribute = node(material, "ShaderNodeAttribute", {"attribute_name": "density"})
    total = node(material, "ShaderNodeMath")
    total.inputs[1].default_value = 0.25
    link(material, attribute, total, "Fac" if "Fac" in attribute.outputs else "Factor")
    link(material, total, material.node_tree.nodes["Volume Scatter"], 0, "Density")
    add_cube(scene, 1, material)
    (found,), messages = fogs(cv)
    assert close(found.scattering, 0.25)
    assert messages == [
        'Object "Cube": volume of material "Fog": attribute "density" is 0 inside of meshes, as in Cycles'
    ]


def test_nodes_that_nobody_knows_have_the_volume_left_out(cv: ModuleType, scene: Any) -> None:
    material = fog(SCATTER)
    link(
        material,
        node(material, "ShaderNodeTexNoise"),
        material.node_tree.nodes["Volume Scatter"],
        0,
        "Density",
    )
    add_cube(scene, 1, material)
    feed(scene.world, node(scene.world, "ShaderNodeBsdfTransparent"))
    volumes, messages = fogs(cv)
    assert not volumes and messages == [
        'Object "Cube": volume of material "Fog": node "Noise Texture" (Noise Texture), not supported yet, '
        'feeds node "Volume Scatter" (Volume Scatter), which is left out',
        f'World "{scene.world.name}": volume: node "Transparent BSDF" (Transparent BSDF) '
        "is no volume and is left out",
    ]


def test_colours_that_nobody_knows_are_no_shaders(cv: ModuleType, scene: Any) -> None:
    """In either socket a colour would glow."""
    material = fog("ShaderNodeTexNoise")
    feed(material, material.node_tree.nodes["Noise Texture"], "Surface")
    add_cube(scene, 1, material)
    exported, messages = export(cv)
    assert not exported.volumes and len(exported.meshes) == 1
    assert messages == [
        'Material "Fog": node "Noise Texture" (Noise Texture) is not supported yet, it is rendered black',
        'Object "Cube": volume of material "Fog": node "Noise Texture" (Noise Texture) '
        "is not supported yet and is left out",
    ]


def test_what_varies_in_the_world_is_left_out(cv: ModuleType, scene: Any) -> None:
    scatter = node(scene.world, SCATTER, Density=0.5)
    link(scene.world, node(scene.world, "ShaderNodeTexChecker"), scatter, 0, "Color")
    feed(scene.world, scatter)
    volumes, messages = fogs(cv)
    assert not volumes
    assert messages == [f'World "{scene.world.name}": volume: {VARIES}it is left out where it does']


FLAGS: dict[str, Callable[[Any], Any]] = {
    "the camera does not see it, it is left out": lambda obj: setattr(obj, "visible_camera", False),
    "it takes light from what lies behind it, although the object casts no shadow": lambda obj: setattr(
        obj, "visible_shadow", False
    ),
    "fog that is a holdout is not supported yet, it is ordinary fog": lambda obj: setattr(
        obj, "is_holdout", True
    ),
}


@pytest.mark.parametrize("told", FLAGS)
def test_visibility_of_fog(cv: ModuleType, scene: Any, told: str) -> None:
    FLAGS[told](add_cube(scene, 1, fog(SCATTER)))
    volumes, messages = fogs(cv)
    assert messages == [f'Object "Cube": volume of material "Fog": {told}'] and len(volumes) == 1
    exported, _ = export(cv)
    assert len(exported.meshes) == (0 if "camera" in told else 1)


def test_smoke_is_left_out(cv: ModuleType, scene: Any) -> None:
    """Its density is what the simulation says, not the material."""
    cube = add_cube(scene, 1, fog(PRINCIPLED))
    modifier = cube.modifiers.new("Smoke", "FLUID")
    modifier.show_render = modifier.show_viewport = False
    modifier.fluid_type = "DOMAIN"
    volumes, messages = fogs(cv)
    told = "smoke of a fluid simulation is not supported yet, it is left out"
    assert not volumes and messages == [f'Object "Cube": volume of material "Fog": {told}']


# -- against Cycles -------------------------------------------------------------------------------

DEPTH = 2.0
"""Of a slab of fog in front of a bright wall, along an orthographic camera."""


def slab(material: Callable[[], Any], samples: int, size: int = 8) -> Any:
    scene = new_scene(size, size)
    like_cycles(scene, samples)
    add_camera(scene, (0, 0, 9), (0, 0, 0), type="ORTHO", ortho_scale=1.0)
    add_cube(scene, 1.0, material()).scale = (4, 4, DEPTH)
    wall = add_cube(scene, 8.0, emission("Wall", (0.5, 1, 2)), location=(0, 0, -8))
    # Only to be seen: no light on the fog.
    wall.visible_diffuse = wall.visible_volume_scatter = wall.visible_shadow = False
    wall.data.materials[0].cycles.emission_sampling = "NONE"
    return scene


def through(volume: Any) -> np.ndarray:
    """(3,) what the slab leaves of the wall, and what it emits itself."""
    depth = volume.extinction * DEPTH
    length = np.where(depth > 1e-6, -np.expm1(-depth) / np.where(depth > 1e-6, volume.extinction, 1), DEPTH)
    return np.exp(-depth) * (0.5, 1, 2) + volume.emission * length


CYCLES = {
    "absorption": lambda: fog(ABSORPTION, Color=(0.9, 0.5, 0.2, 1), Density=0.6),
    "glowing": lambda: fog(
        PRINCIPLED,
        Color=(0, 0, 0, 1),
        Absorption_Color=(0.25, 0.5, 0.01, 1),
        Density=0.4,
        Emission_Strength=0.3,
        Emission_Color=(1, 0.5, 0.25, 1),
    ),
}


@pytest.mark.parametrize("name", CYCLES)
def test_slabs_as_cycles_draws_them(cv: ModuleType, tmp_path: Path, name: str) -> None:
    scene = slab(CYCLES[name], samples=4)
    (volume,), messages = fogs(cv)
    picture = render(scene, tmp_path, "CYCLES")[..., :3]
    assert not messages and np.allclose(picture, through(volume), rtol=3e-3)


def lit(name: str) -> Any:
    """A scene of fog with a light without size."""
    scene = new_scene(24, 24)
    like_cycles(scene, 256)
    scene.cv_render.samples = 16
    add_camera(scene, (0, -6, 1.5), (1.35, 0, 0))
    lamp = add_light(scene, "POINT", location=(2, 0, 2.5), shadow_soft_size=0)
    lamp.rotation_euler = (0, 0, 0)
    if name == "box":
        add_cube(scene, 3.0, fog(SCATTER, Color=(0.9, 0.8, 0.6, 1), Density=0.2, Anisotropy=0.5))
    elif name == "instances":
        cube = add_cube(scene, 1.2, fog(SCATTER, Density=0.4, Color=(0.9, 0.7, 0.5, 1)))
        add(scene, "Turned", cube.data, (0.6, 0.2, 0.3), (0.1, 0.2, 0.3)).scale = (-1, 1.5, 1)
    else:
        add_floor(scene)
        add_cube(scene, 0.8)
        feed(scene.world, node(scene.world, SCATTER, Color=(0.8, 0.8, 0.8, 1), Density=0.1))
    return scene


@pytest.mark.parametrize("name", ["box", "instances", "world"])
def test_fog_as_cycles_draws_it(cv: ModuleType, tmp_path: Path, name: str) -> None:
    scene = lit(name)
    theirs, ours = (render(scene, tmp_path, engine)[..., :3] for engine in ("CYCLES", "CV_RENDER"))
    assert ours.mean(axis=(0, 1)) == pytest.approx(theirs.mean(axis=(0, 1)), rel=0.008)
    assert np.abs(ours - theirs).mean() < 0.05 * theirs.mean()


def test_passes_of_fog_and_lasers(cv: ModuleType, tmp_path: Path) -> None:
    import bpy
    import OpenEXR

    scene = lit("world")
    layer = bpy.context.view_layer
    layer.cycles.use_pass_volume_direct = layer.cv_render.use_pass_volume_direct = True
    layer.cv_render.use_pass_laser = True
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    found = {}
    for engine in ("CYCLES", "CV_RENDER"):
        scene.render.engine = engine
        scene.render.filepath = str(tmp_path / f"{engine}.exr")
        bpy.ops.render.render(write_still=True)
        parts = OpenEXR.File(scene.render.filepath, separate_channels=True).parts
        found[engine] = {name: channel.pixels for part in parts for name, channel in part.channels.items()}
    ours, theirs = found["CV_RENDER"], found["CYCLES"]
    assert set(ours) - set(theirs) == {f"ViewLayer.Laser.{c}" for c in "RGB"}
    name = "Volume Direct" if bpy.app.version >= (5, 0, 0) else "VolumeDir"
    for c in "RGB":
        a, b = (channels[f"ViewLayer.{name}.{c}"] for channels in (ours, theirs))
        assert a.mean() == pytest.approx(b.mean(), rel=0.01)
        assert not ours[f"ViewLayer.Laser.{c}"].any()
