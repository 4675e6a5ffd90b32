# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels, drawn into a layout that only checks: all they show exists in this Blender."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from extension_scenes import add_cube, add_light, furnished, render

LIGHTS = ("POINT", "SPOT", "SUN", "AREA")


@pytest.fixture
def scene(cv: ModuleType) -> Any:
    return furnished()


class CheckingLayout:
    """A layout whose properties and icons must exist."""

    def __init__(self, shown: list[str]) -> None:
        self.shown = shown

    def _part(self, **_: Any) -> CheckingLayout:
        return CheckingLayout(self.shown)

    row = column = box = split = grid_flow = column_flow = _part

    def operator(self, *_: Any, **__: Any) -> SimpleNamespace:
        return SimpleNamespace()

    def separator(self, **_: Any) -> None:
        pass

    def prop(self, data: Any, name: str, **_: Any) -> None:
        assert name in data.bl_rna.properties, f"{data!r} has no {name}"
        self.shown.append(name)

    def label(self, *, text: str = "", **_: Any) -> None:
        self.shown.append(text)

    def template_node_view(self, tree: Any, node: Any, socket: Any) -> None:
        assert node.id_data == tree and socket.node == node
        self.shown.append(socket.name)


def draw(panel: type, context: Any) -> list[str]:
    """What a panel shows, if it shows at all."""
    import bpy

    methods: dict[str, Any] = {}
    for base in reversed(panel.__mro__):
        if base is not object and not issubclass(bpy.types.Panel, base):
            methods |= vars(base)
    shown: list[str] = []
    if not panel.poll(context):
        return shown
    own = {k: v for k, v in methods.items() if not k.startswith("__")}
    if "draw_header" in own:
        type("Panel", (), own | {"layout": CheckingLayout(shown)})().draw_header(context)
    type("Panel", (), own | {"layout": CheckingLayout(shown)})().draw(context)
    return shown


def panels(cv: ModuleType) -> list[type]:
    import bpy

    own = cv.cv_render.panels.__name__
    return [p for p in bpy.types.Panel.__subclasses__() if p.__module__.startswith(own)]


def context_of(scene: Any, **data: Any) -> Any:
    system = SimpleNamespace(ui_scale=1.0)
    shared = {
        "scene": scene,
        "view_layer": scene.view_layers[0],
        "engine": "CV_RENDER",
        "preferences": SimpleNamespace(system=system),
        "region": SimpleNamespace(width=300),
    }
    nothing = {"light": None, "world": None, "material": None, "object": None}
    return SimpleNamespace(**nothing | shared | data)


def test_render_panels_show_every_setting(cv: ModuleType, scene: Any) -> None:
    shown = [name for panel in panels(cv) for name in draw(panel, context_of(scene))]
    settings = {p.identifier for p in scene.cv_render.bl_rna.properties} - {"rna_type", "name"}
    assert settings - set(shown) <= {"use_animated_seed"}


@pytest.mark.parametrize("kind", LIGHTS)
def test_light_panels_show_what_the_light_has(cv: ModuleType, scene: Any, kind: str) -> None:
    obj = add_light(scene, kind)
    shown = [n for p in panels(cv) for n in draw(p, context_of(scene, light=obj.data, object=obj))]
    assert {"energy", "color", "use_shadow", "visible_camera"} <= set(shown)
    sizes = {"POINT": "shadow_soft_size", "SPOT": "spot_blend", "SUN": "angle", "AREA": "spread"}
    assert sizes[kind] in shown


def test_object_material_and_world_panels_are_there(cv: ModuleType, scene: Any) -> None:
    import bpy

    obj = add_cube(scene)
    material = bpy.data.materials.new("Paint")
    world = bpy.data.worlds.new("Sky")
    for datablock in (material, world):
        if bpy.app.version < (5, 0, 0):  # since then they always have nodes
            datablock.use_nodes = True
    shown = [
        n for p in panels(cv) for n in draw(p, context_of(scene, object=obj, material=material, world=world))
    ]
    assert {"hide_render", "is_holdout", "visible_camera", "visible_shadow", "Surface"} <= set(shown)


def test_nothing_shows_for_another_engine(cv: ModuleType, scene: Any) -> None:
    other = context_of(scene)
    other.engine = "CYCLES"
    assert not any(draw(panel, other) for panel in panels(cv))


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("DATA_PT_camera_dof", "camera"),
        ("DATA_PT_camera_dof_aperture", "camera"),
        ("DATA_PT_lens", "camera"),
        ("DATA_PT_uv_texture", "mesh"),
        ("DATA_PT_vertex_colors", "mesh"),
        ("DATA_PT_mesh_attributes", "mesh"),
        ("DATA_PT_texture_space", "mesh"),
    ],
)
def test_blenders_panels_show_for_what_is_rendered(cv: ModuleType, scene: Any, name: str, data: str) -> None:
    """They would not if a panel, or the one it stands in, were not open to the engine."""
    import bpy

    obj = scene.camera if data == "camera" else add_cube(scene)
    context = context_of(scene, **{data: obj.data, "object": obj})
    while name:
        panel = getattr(bpy.types, name)
        assert panel.poll(context), name
        name = getattr(panel, "bl_parent_id", "")


def test_depth_of_field_can_be_set(cv: ModuleType, scene: Any) -> None:
    """All that the exporter reads of it."""
    import bpy

    dof = scene.camera.data.dof
    context = SimpleNamespace(camera=scene.camera.data)
    shown: list[str] = []
    for name in ("DATA_PT_camera_dof", "DATA_PT_camera_dof_aperture"):
        panel = getattr(bpy.types, name)
        for method in ("draw_header", "draw"):
            if hasattr(panel, method):
                getattr(panel, method)(SimpleNamespace(layout=CheckingLayout(shown)), context)
    wanted = {"use_dof", "focus_object", "focus_distance", "aperture_fstop", "aperture_blades"}
    assert wanted | {"aperture_rotation", "aperture_ratio"} <= set(shown) <= set(dof.bl_rna.properties.keys())


@pytest.mark.parametrize("sampling", ("mis", "light", "bsdf"))
def test_direct_light_and_transparency_reach_the_engine(cv: ModuleType, scene: Any, sampling: str) -> None:
    settings = cv.cv_render.properties.engine_settings
    plain = settings(scene, scene.view_layers[0])
    assert (plain.direct_sampling, plain.transparent_bounces) == ("mis", 8)
    scene.cv_render.direct_sampling, scene.cv_render.transparent_bounces = sampling, 3
    chosen = settings(scene, scene.view_layers[0])
    assert (chosen.direct_sampling, chosen.transparent_bounces) == (sampling, 3)


def test_debug_prints_what_a_render_took(
    cv: ModuleType, scene: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    import bpy

    add_light(scene, "AREA")
    render(scene, tmp_path)
    sys.stdout.flush()
    assert "camera rays" not in capfd.readouterr().out
    bpy.app.debug = True
    try:
        render(scene, tmp_path)
    finally:
        bpy.app.debug = False
    sys.stdout.flush()
    lines = capfd.readouterr().out.splitlines()
    first = lines.index('CV Render: statistics of view layer "ViewLayer"')
    table = dict(line.strip().split("  ", 1) for line in lines[first + 1 :] if line.startswith("  "))
    for name in ("control variate", "volume", "camera rays", "shadow rays", "regions", "nodes", "samples"):
        assert name in table
    stages = [float(v) for k, v in table.items() if k.startswith("seconds") and k != "seconds in all"]
    assert all(0 <= seconds <= float(table["seconds in all"]) for seconds in stages)
    assert {"seconds export", "seconds building", "seconds sampling"} <= set(table)
