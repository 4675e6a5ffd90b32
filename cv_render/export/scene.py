# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole scene: one walk over the instances of the evaluated dependency graph."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...engine_core import Scene, Volume
from ...engine_core.scene import Light
from ..versions import terminator_offset
from .camera import export_camera
from .instances import Looks, Placed, check_memory
from .light import export_light
from .linking import LightLinks
from .material import Materials
from .mesh import MeshData, read_mesh
from .messages import Messages, named
from .volume import Region
from .world import export_world

NOT_YET = {
    "CURVES": "hair curves are",
    "POINTCLOUD": "point clouds are",
    "GPENCIL": "grease pencil is",
    "GREASEPENCIL": "grease pencil is",
}


def export_scene(engine: Any, depsgraph: Any, messages: Messages) -> Scene:
    """All that the engine renders of an evaluated scene; what it leaves out goes to ``messages``."""
    scene, view_layer = depsgraph.scene_eval, depsgraph.view_layer_eval
    camera, origin = export_camera(engine, scene, messages)
    if scene.render.use_motion_blur:
        messages.add(named(scene), "motion blur is not supported yet")
    objects = Objects(
        view_layer, origin, LightLinks(id for id in depsgraph.ids if id.id_type == "OBJECT"), messages
    )
    for instance in depsgraph.object_instances:
        objects.add(instance)
    check_memory(objects.groups, objects.lights)
    world = export_world(view_layer.world_override or scene.world, messages, objects.volumes)
    return Scene(
        camera=camera,
        meshes=tuple(mesh for group in objects.groups for mesh in group.meshes(origin)),
        materials=tuple(objects.materials.exported),
        lights=tuple(objects.lights),
        world=world,
        origin=origin,
        volumes=tuple(objects.volumes),
    )


class Objects:
    """Gathers the objects of a view layer: lights, and meshes grouped by what their instances share."""

    def __init__(self, view_layer: Any, origin: np.ndarray, links: LightLinks, messages: Messages) -> None:
        self._view_layer = view_layer
        self._origin = origin
        self._links = links
        self._messages = messages
        self._groups: dict[tuple[Any, ...], list[Placed]] = {}
        self._layer_flags: dict[int, tuple[bool, bool]] = {}
        self._volumes: dict[tuple[int, int], tuple[int, list[str]]] = {}
        self.lights: list[Light] = []
        self.materials = Materials(messages)
        self.volumes: list[Volume] = []

    @property
    def groups(self) -> list[Placed]:
        return [group for parts in self._groups.values() for group in parts]

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
        elif kind == "VOLUME":
            slot = obj.active_material
            material = f' of material "{slot.name}"' if slot else ""
            self._messages.add(
                named(obj), f"OpenVDB volumes are not supported yet, its fog{material} is left out"
            )
        elif kind in NOT_YET:
            self._messages.add(named(obj), f"{NOT_YET[kind]} not supported yet")

    def _add_light(self, obj: Any, instance: Any) -> None:
        matrix = np.array(instance.matrix_world, np.float64)
        matrix[:3, 3] -= self._origin
        light = export_light(obj, matrix, self._links.linking(obj), self._messages)
        if light is not None:
            self.lights.append(light)

    def _add_mesh(self, obj: Any, instance: Any) -> None:
        parent = instance.parent if instance.is_instance else obj
        holdout, indirect_only = self._flags(parent)
        visible = obj.visible_camera and parent.visible_camera and not indirect_only
        casts_shadow = obj.visible_shadow and parent.visible_shadow
        slots = self._slots(obj)
        sets = self._links.sets(obj, parent)
        linking = self._links.linking(obj)
        looks = Looks(visible, casts_shadow, holdout, terminator_offset(obj), *sets, linking)
        key = (obj.data.as_pointer(), slots, looks)
        if key not in self._groups:
            mesh = read_mesh(obj.data, self.materials.attributes(slots))
            self._groups[key] = self._parts(obj, instance.matrix_world, mesh, slots, looks) if mesh else []
            if mesh:
                self._check(obj, self._groups[key])
        for group in self._groups[key]:
            group.matrices.append(instance.matrix_world.copy())

    def _parts(
        self, obj: Any, matrix: Any, mesh: MeshData, slots: tuple[int, ...], looks: Looks
    ) -> list[Placed]:
        """The mesh; in parts where some of its materials have volumes, as what each material bounds."""
        whole = Placed(obj.name, mesh, looks, np.array(slots, np.int32))
        if not any(self.materials.fogs[number] for number in slots):
            return [whole]
        numbers = np.asarray(whole.materials)
        used = [int(number) for number in np.unique(numbers)]
        foggy = [number for number in used if self.materials.fogs[number] is not None]
        if not foggy:
            return [whole]
        if len(used) == 1:
            parts = [(mesh, used[0])]
        else:
            parts = [(mesh.part(numbers == number), number) for number in foggy]
        placed = []
        for part, number in parts:
            volume = self._volume(obj, matrix, part, number, looks)
            surface = self.materials.surfaces[number]
            if volume >= 0 or surface:
                placed.append(replace(whole, mesh=part, volume=volume, surface=surface, matrices=[]))
        if len(used) > len(foggy):
            placed.append(replace(whole, mesh=mesh.part(~np.isin(numbers, foggy)), matrices=[]))
        return placed

    def _volume(self, obj: Any, matrix: Any, mesh: MeshData, number: int, looks: Looks) -> int:
        """Which of `volumes` the material of this ``number`` fills an object's mesh with; -1 for none."""
        fog = self.materials.fogs[number]
        owner = f'volume of material "{fog.name}"'

        def tell(problem: str) -> None:
            self._messages.add(named(obj), f"{owner}: {problem}")

        if any(modifier.type == "FLUID" and modifier.fluid_type == "DOMAIN" for modifier in obj.modifiers):
            tell("smoke of a fluid simulation is not supported yet, it is left out")
            return -1
        key = number, looks.light_set
        if key not in self._volumes or fog.varies:
            volume, problems = fog.volume(Region.of(mesh.vertices, matrix))
            if volume is not None:
                self.volumes.append(replace(volume, light_set=looks.light_set))
            self._volumes[key] = -1 if volume is None else len(self.volumes) - 1, problems
        found, problems = self._volumes[key]
        for problem in problems:
            tell(problem)
        if found >= 0:
            if not looks.visible_to_camera:
                tell("the camera does not see it, it is left out")
                return -1
            if not looks.casts_shadow:
                tell("it takes light from what lies behind it, although the object casts no shadow")
            if looks.holdout:
                tell("fog that is a holdout is not supported yet, it is ordinary fog")
        return found

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

    def _check(self, obj: Any, parts: list[Placed]) -> None:
        """Name what will not look as it should."""
        if not all(part.materials.all() for part in parts):
            self._messages.add(named(obj), "has no material, it is rendered as diffuse grey")
        if obj.is_shadow_catcher:
            self._messages.add(named(obj), "shadow catchers are not supported yet, it is an ordinary object")

    def _check_hair(self, obj: Any) -> None:
        for system in obj.particle_systems:
            if system.settings.type == "HAIR" and system.settings.render_type == "PATH":
                self._messages.add(named(obj), "hair is not supported yet")
