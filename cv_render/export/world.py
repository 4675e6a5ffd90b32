# SPDX-License-Identifier: GPL-3.0-or-later
"""The world: light of one colour, or of an environment texture, from everywhere; and what fills it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...engine_core import Volume, World
from ..versions import node_tree
from .images import read_image
from .material import emitted
from .messages import Messages, named
from .nodes import Socket, constant, described, surface
from .volume import read_fog


def export_world(world: Any | None, messages: Messages, volumes: list[Volume]) -> World:
    """A Blender world's background, no world is black; what fills it is added to ``volumes``."""
    if world is None:
        return World(name="No world")
    visibility = getattr(world, "cycles_visibility", None)
    visible = visibility.camera if visibility else True
    number = -1
    if (fog := read_fog(world, messages)) is not None:
        volume, problems = fog.volume(region=None)
        for problem in problems:
            messages.add(named(world), f"volume: {problem}")
        if volume is not None:
            number = len(volumes)
            volumes.append(volume)
    return World(visible_to_camera=visible, name=world.name, volume=number, **_light(world, messages))


def _light(world: Any, messages: Messages) -> dict[str, np.ndarray]:
    """The fields of `World` that its nodes make."""
    if node_tree(world) is None:
        return {"radiance": np.array(world.color)}
    owner = named(world)
    shader = surface(world)
    if shader is None:
        return {}
    if shader.node.type not in ("BACKGROUND", "EMISSION"):
        messages.add(owner, f"{described(shader)} is not supported, the world is black")
        return {}
    colour = shader.input("Color").source()
    if colour.socket.is_output and colour.node.type == "TEX_ENVIRONMENT":
        return _picture(colour, constant(shader.input("Strength"), owner, messages), owner, messages)
    return {"radiance": emitted(shader, "Color", "Strength", owner, messages)}


def _picture(texture: Socket, strength: np.ndarray, owner: str, messages: Messages) -> dict[str, np.ndarray]:
    """Radiance by direction of an Environment Texture."""
    node = texture.node
    if not strength > 0:
        return {}
    if node.projection != "EQUIRECTANGULAR":
        messages.add(owner, f"the mirror ball of {described(texture)} is not supported, the world is black")
        return {}
    if node.interpolation not in ("Linear", "Smart"):
        messages.add(owner, f"{described(texture)} is interpolated linearly")
    rotation = _rotation(texture, owner, messages)
    image = read_image(node.image, messages, owner)[..., :3] * np.float32(strength)
    if not np.isfinite(image.sum()):
        messages.add(owner, f"{described(texture)} has pixels that are not finite, they are black")
        image[~np.isfinite(image)] = 0
    return {"image": image, "rotation": rotation}


def _rotation(texture: Socket, owner: str, messages: Messages) -> np.ndarray:
    """(3, 3) from directions in the world to those of the picture; a mirror image is one, too."""
    vector = texture.input("Vector").source()
    if not vector.socket.is_output:
        return np.eye(3)
    if vector.node.type != "MAPPING":
        _check_coordinate(vector, owner, messages)
        return np.eye(3)
    mapping = vector
    coordinate = mapping.input("Vector").source()
    if coordinate.socket.is_output:
        _check_coordinate(coordinate, owner, messages)
    else:
        messages.add(owner, f"{described(mapping)} has no coordinate, the direction is taken")
    turn, scale = _turn(constant(mapping.input("Rotation"), owner, messages)), np.ones(3)
    if (size := mapping.input("Scale")) is not None:
        scale = constant(size, owner, messages)
    location = mapping.input("Location")
    if location is not None and constant(location, owner, messages).any():
        messages.add(owner, f"the location of {described(mapping)} is left out")
    if not scale.all() or np.ptp(np.abs(scale)) > 1e-4 * np.abs(scale).max():
        messages.add(owner, f"the scale of {described(mapping)} differs by axis and is left out")
        return turn
    matrix = turn * np.sign(scale)
    return matrix.T if mapping.node.vector_type == "TEXTURE" else matrix


def _check_coordinate(source: Socket, owner: str, messages: Messages) -> None:
    """Say where something else than the direction places the picture."""
    kind, name = source.node.type, source.socket.name
    if kind == "TEX_COORD" and (name == "Generated" or (name == "Object" and source.node.object is None)):
        return
    if kind == "NEW_GEOMETRY" and name == "Position":
        return
    messages.add(owner, f'"{name}" of {described(source)} is not supported yet, the direction is taken')


def _turn(angles: np.ndarray) -> np.ndarray:
    """(3, 3) rotation about X, then Y, then Z."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return z @ y @ x
