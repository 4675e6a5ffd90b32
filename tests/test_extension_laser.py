# SPDX-License-Identifier: GPL-3.0-or-later
"""Lasers from Blender: made, exported, animated, duplicated, drawn, and gone without a trace."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from extension_scenes import add, add_camera, add_light, export, new_scene, tree


@pytest.fixture
def scene(cv: ModuleType) -> Any:
    scene = new_scene()
    add_camera(scene, (0, 0, 0), (0, 0, 0))
    return scene


@pytest.fixture
def laser(scene: Any) -> Any:
    import bpy

    assert bpy.ops.object.cv_render_laser_add(location=(1, 2, 3), rotation=(0, math.radians(-90), 0)) == {
        "FINISHED"
    }
    return bpy.context.object


def lasers(cv: ModuleType) -> list[Any]:
    import bpy

    bpy.context.view_layer.update()
    exported, messages = export(cv)
    assert not messages
    return [light for light in exported.lights if isinstance(light, cv.engine_core.Laser)]


def test_the_operator_makes_a_spot_light_that_is_a_laser(cv: ModuleType, laser: Any) -> None:
    light = laser.data
    assert (light.type, light.cv_render.is_laser, laser.select_get()) == ("SPOT", True, True)
    (found,) = lasers(cv)
    assert np.allclose(found.power, 10) and found.name == "Laser" and found.length == np.inf
    assert found.radius == pytest.approx(0.01)
    assert found.in_fog and found.on_surfaces and found.beam and found.spot
    assert np.allclose(found.light_to_world[:3, 3], (1, 2, 3))
    assert np.allclose(-found.light_to_world[:3, 2], (1, 0, 0), atol=1e-6)


def test_power_colour_exposure_and_nodes(cv: ModuleType, laser: Any) -> None:
    light = laser.data
    light.energy, light.color = 4.0, (1, 0.5, 0.25)
    if hasattr(light, "normalize"):
        light.exposure, light.normalize = 1.0, False
        light.energy = 2.0
    tree(light).nodes["Emission"].inputs["Strength"].default_value = 0.5
    (found,) = lasers(cv)
    assert np.allclose(found.power, (2, 1, 0.5)) and found.normalize


def test_properties(cv: ModuleType, laser: Any) -> None:
    chosen = laser.data.cv_render
    chosen.beam_radius, chosen.length = 0.25, 7.0
    chosen.beam = chosen.on_surfaces = False
    laser.data.use_shadow = False
    (found,) = lasers(cv)
    assert (found.radius, found.length, found.casts_shadow) == (0.25, 7.0, False)
    assert (found.in_fog, found.on_surfaces, found.beam, found.spot) == (True, False, False, True)


def test_the_switch_counts_for_spot_lights_alone(cv: ModuleType, scene: Any, laser: Any) -> None:
    laser.data.type = "POINT"
    assert not lasers(cv)
    laser.data.type = "SPOT"
    assert len(lasers(cv)) == 1
    laser.data.cv_render.is_laser = False
    assert not lasers(cv)
    assert not add_light(scene, "SPOT").data.cv_render.is_laser


def test_duplicates_and_instances(cv: ModuleType, scene: Any, laser: Any) -> None:
    import bpy

    bpy.ops.object.duplicate(linked=False)
    copy = bpy.context.object
    assert copy.data != laser.data and copy.data.cv_render.is_laser
    copy.data.energy = 3.0
    add(scene, "Linked", laser.data, (5, 5, 5))
    assert [light.power[0] for light in lasers(cv)] == [10, 3, 10]


def test_animation(cv: ModuleType, scene: Any, laser: Any) -> None:
    light = laser.data
    for frame, radius, power in ((1, 0.1, 1.0), (11, 0.3, 5.0)):
        light.cv_render.beam_radius, light.energy = radius, power
        light.keyframe_insert("cv_render.beam_radius", frame=frame)
        light.keyframe_insert("energy", frame=frame)
    scene.frame_set(6)
    (found,) = lasers(cv)
    assert found.radius == pytest.approx(0.2, abs=1e-3) and found.power[0] == pytest.approx(3, abs=1e-2)


def test_undo(cv: ModuleType, scene: Any) -> None:
    import bpy

    bpy.ops.ed.undo_push(message="before")
    bpy.ops.object.cv_render_laser_add("EXEC_DEFAULT", True)
    assert len(lasers(cv)) == 1
    bpy.ops.ed.undo()
    assert not bpy.data.lights
    bpy.ops.ed.redo()
    assert bpy.data.lights[0].cv_render.is_laser


def test_a_laser_survives_its_file(cv: ModuleType, laser: Any, tmp_path: Any) -> None:
    import bpy

    laser.data.cv_render.length = 3.5
    path = str(tmp_path / "laser.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    (found,) = lasers(cv)
    assert found.length == 3.5


def drawn(cv: ModuleType, engine: str) -> list[str]:
    """Names of the operators that the extension puts into Add > Light."""
    names: list[str] = []
    layout = SimpleNamespace(operator=lambda name, **_: names.append(name))
    cv.cv_render.lasers._draw_menu(SimpleNamespace(layout=layout), SimpleNamespace(engine=engine))
    return names


def test_the_menu_has_it_for_this_engine_only(cv: ModuleType) -> None:
    assert drawn(cv, "CV_RENDER") == ["object.cv_render_laser_add"] and not drawn(cv, "CYCLES")


def test_the_outline_is_the_beam_whatever_the_scale(cv: ModuleType, laser: Any) -> None:
    import bpy

    laser.scale = (2, 3, 4)
    bpy.context.view_layer.update()
    points = np.array(cv.cv_render.lasers.outline(laser.matrix_world, 0.5, 10.0))
    assert len(points) % 2 == 0 and np.allclose(points[:2], [(1, 2, 3), (11, 2, 3)], atol=1e-5)
    at_start, at_end = (points[np.isclose(points[:, 0], x, atol=1e-4)][1:] for x in (1, 11))
    for ring, centre in ((at_start, (1, 2, 3)), (at_end, (11, 2, 3))):
        assert np.allclose(np.linalg.norm(ring - centre, axis=1), 0.5, atol=1e-5)


OVERLAY = """
cv = sys.modules[dev.MODULE].cv_render
calls = []
view = type("View", (), {
    "draw_handler_add": staticmethod(lambda *a: calls.append("add") or "handle"),
    "draw_handler_remove": staticmethod(lambda *a: calls.append("remove " + a[0])),
})
app = type("App", (), {"background": sys.argv[1] == "background"})
class Types:
    SpaceView3D = view
    def __getattr__(self, name):
        return getattr(bpy.types, name)
class Blender:
    types = Types()
    def __getattr__(self, name):
        return app if name == "app" else getattr(bpy, name)
cv.lasers.bpy = Blender()
drawn = bpy.types.VIEW3D_MT_light_add._dyn_ui_initialize
menu = lambda: [f for f in drawn() if f.__module__ == cv.lasers.__name__]
assert len(menu()) == 1
cv.lasers.unregister()
assert not menu() and not hasattr(bpy.types, "OBJECT_OT_cv_render_laser_add")
cv.lasers.register()
cv.lasers.unregister()
assert not menu()
cv.lasers.register()
print("CALLS", calls)
bpy.ops.preferences.addon_disable(module=dev.MODULE)
print("CALLS", calls)
assert not menu() and not hasattr(bpy.types.Light, "cv_render")
assert not hasattr(bpy.types, "CVRenderLightSettings")
"""


@pytest.mark.parametrize(("mode", "calls"), [("background", []), ("window", ["add", "remove handle", "add"])])
def test_what_is_registered_goes_again(run_script: Callable[..., Any], mode: str, calls: list[str]) -> None:
    done = run_script(OVERLAY, mode)
    assert done.returncode == 0, done.stderr
    assert f"CALLS {calls}" in done.stdout
    assert done.stdout.rstrip().endswith(f"CALLS {calls + ['remove handle'] if calls else calls}")
