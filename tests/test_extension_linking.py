# SPDX-License-Identifier: GPL-3.0-or-later
"""Light linking and shadow linking from Blender: which sets the exporter makes, and Cycles' own picture."""

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
    surface,
    tree,
)


def linked(obj: Any, kind: str, include: tuple[Any, ...] = (), exclude: tuple[Any, ...] = ()) -> Any:
    """Make a collection of what is included and excluded, and ``obj`` linked to it."""
    import bpy

    collection = bpy.data.collections.new(f"{obj.name}'s {kind}")
    for state, members in (("INCLUDE", include), ("EXCLUDE", exclude)):
        for member in members:
            at = len(collection.objects), len(collection.children)
            if isinstance(member, bpy.types.Collection):
                collection.children.link(member)
                collection.collection_children[at[1]].light_linking.link_state = state
            else:
                collection.objects.link(member)
                collection.collection_objects[at[0]].light_linking.link_state = state
    setattr(obj.light_linking, f"{kind}_collection", collection)
    return collection


@pytest.fixture
def scene(cv: ModuleType) -> Any:
    """Two cubes on a floor under a point and a sun."""
    scene = new_scene(32, 24)
    add_camera(scene, (0, -7, 4), (1.05, 0, 0))
    add_floor(scene, z=0.0)
    add_cube(
        scene, 1.0, diffuse("Red", (0.8, 0.3, 0.2)), location=(-1, 0, 0.6), rotation=(0, 0, 0.4)
    ).name = "A"
    add_cube(scene, 1.0, diffuse("Blue", (0.2, 0.4, 0.8)), location=(1, 0.3, 0.6)).name = "B"
    return scene


def named(exported: Any, name: str) -> Any:
    (found,) = (item for item in (*exported.lights, *exported.meshes) if item.name == name)
    return found


def lights(exported: Any, light: str, mesh: str) -> bool:
    return named(exported, light).linking.lights(named(exported, mesh).light_set)


def test_what_is_included_alone_is_lit(cv: ModuleType, scene: Any) -> None:
    lamp, other = add_light(scene, "POINT"), add_light(scene, "SUN")
    objects = scene.objects
    linked(lamp, "receiver", include=(objects["A"],))
    linked(lamp, "blocker", exclude=(objects["B"], objects["Floor"]))
    exported, messages = export(cv)
    assert not messages
    assert [lights(exported, "Point", name) for name in ("A", "B", "Floor")] == [True, False, False]
    assert all(lights(exported, "Sun", name) for name in ("A", "B", "Floor"))
    blockers = named(exported, "Point").linking.blockers
    assert [named(exported, n).shadow_set in blockers for n in ("A", "B", "Floor")] == [True, False, False]
    assert named(exported, other.name).linking.blockers is None


def test_child_collections_come_first_and_all_the_way_down(cv: ModuleType, scene: Any) -> None:
    import bpy

    lamp, empty = add_light(scene, "POINT"), add_light(scene, "AREA")
    child, grandchild = (bpy.data.collections.new(name) for name in ("Child", "Grandchild"))
    grandchild.objects.link(scene.objects["A"])
    child.children.link(grandchild)
    linked(lamp, "receiver", include=(scene.objects["B"],), exclude=(child,))
    linked(empty, "receiver")
    exported, _ = export(cv)
    assert [lights(exported, "Point", name) for name in ("A", "B", "Floor")] == [False, True, False]
    # What is said of an object itself overrides that.
    linked(lamp, "receiver", include=(scene.objects["A"],), exclude=(child,))
    exported, _ = export(cv)
    assert [lights(exported, "Point", name) for name in ("A", "B", "Floor")] == [True, False, False]
    assert all(lights(exported, "Area", name) for name in ("A", "B", "Floor"))


def test_instances_take_the_link_of_what_makes_them(cv: ModuleType, scene: Any) -> None:
    import bpy

    lamp = add_light(scene, "POINT")
    made = bpy.data.collections.new("Made")
    made.objects.link(scene.objects["A"])
    scene.collection.objects.unlink(scene.objects["A"])
    for name in ("One", "Two"):
        empty = add(scene, name, None)
        empty.instance_type, empty.instance_collection = "COLLECTION", made
    linked(lamp, "receiver", exclude=(scene.objects["Two"],))
    exported, _ = export(cv)
    lit = [named(exported, "Point").linking.lights(m.light_set) for m in exported.meshes if m.name == "A"]
    assert sorted(lit) == [False, True]


def test_lights_in_instanced_collections_are_linked(cv: ModuleType, scene: Any) -> None:
    """Their objects are in no scene."""
    import bpy

    made = bpy.data.collections.new("Made")
    for kind, name in (("POINT", "A"), ("SPOT", "B")):
        lamp = add_light(scene, kind)
        scene.collection.objects.unlink(lamp)
        made.objects.link(lamp)
        linked(lamp, "receiver", include=(scene.objects[name],))
    empty = add(scene, "Empty", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", made
    exported, messages = export(cv)
    assert not messages
    assert [lights(exported, "Point", name) for name in ("A", "B", "Floor")] == [True, False, False]
    assert [lights(exported, "Spot", name) for name in ("A", "B", "Floor")] == [False, True, False]


def test_lights_that_no_fog_scatters(cv: ModuleType, scene: Any) -> None:
    _world_fog(scene)
    lamp, seen = add_light(scene, "POINT"), add_light(scene, "SPOT")
    lamp.visible_volume_scatter = False
    linked(seen, "receiver", include=(scene.objects["A"],))
    exported, messages = export(cv)
    assert not messages
    for name in ("Point", "Spot"):
        assert not named(exported, name).linking.lights_volume(exported.volumes[0].light_set)


# -- against Cycles -------------------------------------------------------------------------------


def _world_fog(scene: Any) -> None:
    nodes = tree(scene.world).nodes
    made = nodes.new("ShaderNodeVolumeScatter")
    made.inputs["Color"].default_value, made.inputs["Density"].default_value = (0.8, 0.8, 0.8, 1), 0.06
    (output,) = (node for node in nodes if node.type == "OUTPUT_WORLD")
    scene.world.node_tree.links.new(made.outputs[0], output.inputs["Volume"])


def _lamps(scene: Any) -> tuple[Any, ...]:
    point = add_light(scene, "POINT", 400, (-2, -2, 3), shadow_soft_size=0.3, use_soft_falloff=False)
    area = add_light(scene, "AREA", 300, (2, -1, 3), size=1.0)
    area.rotation_euler = (0, 0.5, 0)
    sun = add_light(scene, "SUN", 1.0)
    return point, area, sun


def _receivers(scene: Any) -> None:
    a, b = scene.objects["A"], scene.objects["B"]
    point, area, sun = _lamps(scene)
    linked(point, "receiver", include=(a,))
    linked(area, "receiver", exclude=(b,))
    linked(sun, "receiver", include=(b, scene.objects["Floor"]))


def _blockers(scene: Any) -> None:
    a, b = scene.objects["A"], scene.objects["B"]
    point, area, sun = _lamps(scene)
    linked(point, "blocker", include=(b,))
    linked(area, "blocker", exclude=(b,))
    linked(sun, "receiver", exclude=(a,))
    linked(sun, "blocker", exclude=(a, b))


def _veils(scene: Any) -> None:
    """Half of the light goes through what blocks it."""
    for name in ("A", "B"):
        material = scene.objects[name].data.materials[0]
        nodes, links = material.node_tree.nodes, material.node_tree.links
        mix, clear = nodes.new("ShaderNodeMixShader"), nodes.new("ShaderNodeBsdfTransparent")
        clear.inputs["Color"].default_value = (0.9, 0.7, 0.5, 1)
        (output,) = (node for node in nodes if node.type == "OUTPUT_MATERIAL")
        links.new(output.inputs["Surface"].links[0].from_socket, mix.inputs[1])
        links.new(clear.outputs[0], mix.inputs[2])
        links.new(mix.outputs[0], output.inputs["Surface"])
    _blockers(scene)


def _mesh(scene: Any) -> None:
    a, b = scene.objects["A"], scene.objects["B"]
    for name, x, receivers, blockers in (("L", -2.5, (a,), (b,)), ("M", 0.0, (), (b,))):
        lamp = add_cube(scene, 0.4, emission(name, (20, 16, 10)), location=(x, 0.2, 2.0))
        lamp.name = name
        linked(lamp, "receiver", exclude=receivers)
        linked(lamp, "blocker", exclude=blockers)


def _glossy(scene: Any) -> None:
    _mesh(scene)
    _receivers(scene)
    shiny = surface("Shiny", "ShaderNodeBsdfAnisotropic", Color=(0.8, 0.8, 0.8, 1), Roughness=0.3)
    for name in ("A", "B", "Floor"):
        scene.objects[name].data.materials[0] = shiny


def _fog(scene: Any) -> None:
    _world_fog(scene)
    point, area, sun = _lamps(scene)
    scene.collection.objects.unlink(sun)
    a, b = scene.objects["A"], scene.objects["B"]
    linked(point, "receiver", exclude=(a,))
    linked(point, "blocker", exclude=(b,))
    linked(area, "receiver", include=(b,))
    bare = add_light(scene, "SPOT", 900, (0, -3, 3), shadow_soft_size=0.0, spot_size=1.2)
    bare.rotation_euler = (0.9, 0, 0)
    linked(bare, "blocker", exclude=(a,))
    unseen = add_light(scene, "POINT", 300, (0, 0, 2), shadow_soft_size=0.0)
    unseen.visible_volume_scatter = False


def _foggy_body(scene: Any) -> None:
    """Fog is a receiver as its mesh is."""
    point, area, sun = _lamps(scene)
    scene.collection.objects.unlink(sun)
    body = surface("Body", "ShaderNodeBsdfDiffuse")
    nodes = body.node_tree.nodes
    made = nodes.new("ShaderNodeVolumeScatter")
    made.inputs["Density"].default_value = 0.1
    (output,) = (node for node in nodes if node.type == "OUTPUT_MATERIAL")
    body.node_tree.links.remove(output.inputs["Surface"].links[0])
    body.node_tree.links.new(made.outputs[0], output.inputs["Volume"])
    fog = add_cube(scene, 5.0, body, location=(0, 0, 1.0))
    fog.name = "Fog"
    linked(point, "receiver", include=(fog,))
    linked(area, "receiver", exclude=(fog,))


CASES: dict[str, Callable[[Any], None]] = {
    "receivers": _receivers,
    "blockers": _blockers,
    "veils": _veils,
    "meshes": _mesh,
    "glossy": _glossy,
    "fog": _fog,
    "body": _foggy_body,
}


@pytest.mark.parametrize("name", CASES)
def test_links_as_in_cycles(cv: ModuleType, scene: Any, tmp_path: Path, name: str) -> None:
    CASES[name](scene)
    like_cycles(scene, 256)
    scene.cv_render.samples = 64
    _, messages = export(cv)
    assert not messages
    theirs, ours = (render(scene, tmp_path, engine)[..., :3] for engine in ("CYCLES", "CV_RENDER"))
    assert ours.mean(axis=(0, 1)) == pytest.approx(theirs.mean(axis=(0, 1)), rel=0.01)
    # Each light lights, or leaves dark, whole parts of the picture.
    assert np.abs(ours - theirs).mean() < 0.06 * theirs.mean()
