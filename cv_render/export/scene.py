# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole scene: one walk over the instances of the evaluated dependency graph."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...engine_core import Scene
from ...engine_core.scene import Light
from ..versions import terminator_offset
from .camera import export_camera
from .instances import Looks, Placed, check_memory
from .light import export_light
from .material import Materials
from .mesh import read_mesh
from .messages import Messages, named
from .world import export_world

NOT_YET = {
    "CURVES": "hair curves are",
    "POINTCLOUD": "point clouds are",
    "VOLUME": "volumes are",
    "GPENCIL": "grease pencil is",
    "GREASEPENCIL": "grease pencil is",
}


def export_scene(engine: Any, depsgraph: Any, messages: Messages) -> Scene:
    """All that the engine renders of an evaluated scene; what it leaves out goes to ``messages``."""
    scene, view_layer = depsgraph.scene_eval, depsgraph.view_layer_eval
    camera, origin = export_camera(engine, scene, messages)
    if scene.render.use_motion_blur:
        messages.add(named(scene), "motion blur is not supported yet")
    objects = Objects(view_layer, origin, messages)
    for instance in depsgraph.object_instances:
        objects.add(instance)
    check_memory(objects.groups)
    return Scene(
        camera=camera,
        meshes=tuple(group.placed(origin) for group in objects.groups),
        materials=tuple(objects.materials.exported),
        lights=tuple(objects.lights),
        world=export_world(view_layer.world_override or scene.world, messages),
        origin=origin,
    )


class Objects:
    """Gathers the objects of a view layer: lights, and meshes grouped by what their instances share."""

    def __init__(self, view_layer: Any, origin: np.ndarray, messages: Messages) -> None:
        self._view_layer = view_layer
        self._origin = origin
        self._messages = messages
        self._groups: dict[tuple[Any, ...], Placed | None] = {}
        self._layer_flags: dict[int, tuple[bool, bool]] = {}
        self.lights: list[Light] = []
        self.materials = Materials(messages)

    @property
    def groups(self) -> list[Placed]:
        return [group for group in self._groups.values() if group is not None]

    def add(self, instance: Any) -> None:
        """Take in one instance of the dependency graph; its object lives only until the next one."""
        obj = instance.object
        kind = obj.type
        if not instance.is_instance and len(obj.particle_systems):
            self._check_hair(obj)
        if not instance.show_self:
            return
        if kind == "LIGHT":
            self._add_light(obj, instance)
        elif kind == "MESH":  # curves, surfaces, texts and metaballs come by as the meshes they make, too
            self._add_mesh(obj, instance)
        elif kind in NOT_YET:
            self._messages.add(named(obj), f"{NOT_YET[kind]} not supported yet")

    def _add_light(self, obj: Any, instance: Any) -> None:
        matrix = np.array(instance.matrix_world, np.float64)
        matrix[:3, 3] -= self._origin
        light = export_light(obj, matrix, self._messages)
        if light is not None:
            self.lights.append(light)
        self._check_linking(obj)

    def _add_mesh(self, obj: Any, instance: Any) -> None:
        parent = instance.parent if instance.is_instance else obj
        holdout, indirect_only = self._flags(parent)
        visible = obj.visible_camera and parent.visible_camera and not indirect_only
        casts_shadow = obj.visible_shadow and parent.visible_shadow
        slots = self._slots(obj)
        looks = Looks(visible, casts_shadow, holdout, terminator_offset(obj))
        key = (obj.data.as_pointer(), slots, looks)
        if key not in self._groups:
            mesh = read_mesh(obj.data, self.materials.attributes(slots))
            self._groups[key] = mesh and Placed(obj.name, mesh, looks, np.array(slots, np.int32))
            self._check(obj, self._groups[key])
        group = self._groups[key]
        if group is not None:
            group.matrices.append(instance.matrix_world.copy())

    def _flags(self, obj: Any) -> tuple[bool, bool]:
        """(holdout, indirect only), of the object itself or of its collections in this view layer."""
        pointer = obj.as_pointer()
        if pointer not in self._layer_flags:
            holdout = obj.holdout_get(view_layer=self._view_layer)
            indirect_only = not holdout and obj.indirect_only_get(view_layer=self._view_layer)
            self._layer_flags[pointer] = holdout, indirect_only
        return self._layer_flags[pointer]

    def _slots(self, obj: Any) -> tuple[int, ...]:
        """The scene's number of the material in each slot, at least one."""
        override = self._view_layer.material_override
        slots = [slot.material for slot in obj.material_slots] or [None]
        return tuple(self.materials.number(override or material) for material in slots)

    def _check(self, obj: Any, group: Placed | None) -> None:
        """Name what will not look as it should."""
        if group is None:
            return
        if not group.materials.all():
            self._messages.add(named(obj), "has no material, it is rendered as diffuse grey")
        if obj.is_shadow_catcher:
            self._messages.add(named(obj), "shadow catchers are not supported yet, it is an ordinary object")
        self._check_linking(obj)

    def _check_linking(self, obj: Any) -> None:
        linking = obj.light_linking
        if linking.receiver_collection or linking.blocker_collection:
            self._messages.add(named(obj), "light and shadow linking are not supported yet")

    def _check_hair(self, obj: Any) -> None:
        for system in obj.particle_systems:
            if system.settings.type == "HAIR" and system.settings.render_type == "PATH":
                self._messages.add(named(obj), "hair is not supported yet")
