# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera, with the pixel areas that Cycles gives it: sensor fit, shift, pixel aspect, border."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...engine_core import Camera, SceneError
from .messages import Messages, named

DEFAULT_LENS, DEFAULT_SENSOR = 50.0, 36.0
"""Millimetres, for an object that is looked through without being a camera."""


def export_camera(engine: Any, scene: Any, messages: Messages) -> tuple[Camera, np.ndarray]:
    """The camera in a frame whose origin is its own position, and that position ((3,) float64, world)."""
    obj = engine.camera_override or scene.camera
    if obj is None:
        raise SceneError(f'Scene "{scene.name}" has no camera: add one, or choose one in Scene properties')
    matrix = np.array(engine.camera_model_matrix(obj), np.float64).reshape(4, 4)
    position = matrix[:3, 3].copy()
    width, height = frame_size(scene.render)
    projection, viewplane, clip = _lens(engine, obj, scene.render, width, height, messages)
    camera = Camera(
        camera_to_world=_rigid(matrix, obj, messages),
        viewplane=viewplane,
        width=width,
        height=height,
        region=_region(scene, width, height),
        projection=projection,
        clip_start=clip[0],
        clip_end=clip[1],
        **_lens_size(obj, position, matrix),
        name=obj.name,
    )
    return camera, position


def frame_size(render: Any) -> tuple[int, int]:
    """Pixels of the whole frame, before any border."""
    scale = render.resolution_percentage
    return render.resolution_x * scale // 100, render.resolution_y * scale // 100


def _region(scene: Any, width: int, height: int) -> tuple[int, int, int, int]:
    """(x0, y0, x1, y1) of the border, truncated to pixels in float32 as Blender does."""
    render = scene.render
    if not render.use_border:
        return (0, 0, width, height)
    x0, x1 = (int(np.float32(v) * np.float32(width)) for v in (render.border_min_x, render.border_max_x))
    y0, y1 = (int(np.float32(v) * np.float32(height)) for v in (render.border_min_y, render.border_max_y))
    if x1 <= x0 or y1 <= y0:
        raise SceneError(
            f'Scene "{scene.name}": the render region is less than a pixel; '
            "draw a larger one (Ctrl B), or clear it (Ctrl Alt B)"
        )
    return (x0, y0, x1, y1)


def _lens(
    engine: Any, obj: Any, render: Any, width: int, height: int, messages: Messages
) -> tuple[str, tuple[float, float, float, float], tuple[float, float]]:
    """Projection, viewplane and clip distances of whatever object is looked through."""
    data = obj.data
    x_extent, y_extent = width * render.pixel_aspect_x, height * render.pixel_aspect_y
    if obj.type != "CAMERA":
        lens = DEFAULT_LENS
        if obj.type == "LIGHT" and data.type == "SPOT":
            lens = 16.0 / np.tan(data.spot_size / 2)
        half = _half_extents(x_extent > y_extent, x_extent, y_extent, DEFAULT_SENSOR / 2 / lens)
        return "perspective", (-half[0], half[0], -half[1], half[1]), (1e-5, 1e5)

    if data.type not in ("PERSP", "ORTHO"):
        kind = {"PANO": "panoramic", "CUSTOM": "custom"}.get(data.type, data.type.lower())
        raise SceneError(
            f'Camera "{obj.name}" is {kind}, which CV Render does not know yet: '
            "set its lens type to Perspective or Orthographic"
        )
    horizontal = data.sensor_fit == "HORIZONTAL" or (data.sensor_fit == "AUTO" and x_extent > y_extent)
    if data.type == "ORTHO":
        half_fit = data.ortho_scale / 2
    else:
        sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
        half_fit = sensor / 2 / data.lens
    half_x, half_y = _half_extents(horizontal, x_extent, y_extent, half_fit)
    # Lens shift is a fraction of the fitted side, for x and y alike.
    shift_x, shift_y = 2 * half_fit * engine.camera_shift_x(obj), 2 * half_fit * data.shift_y
    viewplane = (shift_x - half_x, shift_x + half_x, shift_y - half_y, shift_y + half_y)
    projection = "orthographic" if data.type == "ORTHO" else "perspective"
    return projection, viewplane, (data.clip_start, data.clip_end)


def _lens_size(obj: Any, position: np.ndarray, matrix: np.ndarray) -> dict[str, float]:
    """Aperture and focus of a camera with depth of field, as Cycles has them."""
    data = obj.data
    if obj.type != "CAMERA" or not data.dof.use_dof or data.type not in ("PERSP", "ORTHO"):
        return {}
    dof = data.dof
    focal_length = 1.0 if data.type == "ORTHO" else data.lens * 1e-3
    distance = dof.focus_distance
    target = dof.focus_object
    if target is not None:
        place = np.array(target.matrix_world, np.float64)
        if target.type == "ARMATURE" and dof.focus_subtarget in target.pose.bones:
            place = place @ np.array(target.pose.bones[dof.focus_subtarget].matrix, np.float64)
        axis = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
        distance = abs(float((place[:3, 3] - position) @ axis))
    return {
        "aperture": focal_length / (2 * max(dof.aperture_fstop, 1e-5)),
        "focus_distance": max(distance, 1e-5),
        "blades": dof.aperture_blades if dof.aperture_blades >= 3 else 0,
        "blade_rotation": dof.aperture_rotation,
        "aperture_ratio": max(dof.aperture_ratio, 1e-5),
    }


def _half_extents(horizontal: bool, x_extent: float, y_extent: float, half_fit: float) -> tuple[float, float]:
    """Half width and half height of the viewplane whose fitted side is 2 ``half_fit``."""
    if horizontal:
        return half_fit, half_fit * y_extent / x_extent
    return half_fit * x_extent / y_extent, half_fit


def _rigid(matrix: np.ndarray, obj: Any, messages: Messages) -> np.ndarray:
    """The camera's axes without scale (a mirrored one stays mirrored), at the origin."""
    rigid = np.eye(4)
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not (np.isfinite(matrix).all() and (lengths > 0).all()):
        raise SceneError(f'Camera "{obj.name}" has a scale of zero: clear it (Alt S)')
    axes = matrix[:3, :3] / lengths
    if not np.allclose(axes.T @ axes, np.eye(3), atol=1e-4):
        messages.add(named(obj), "is sheared by its parent, which is left out")
        left, _, right = np.linalg.svd(axes)
        axes = left @ right
    rigid[:3, :3] = axes
    return rigid
