# SPDX-License-Identifier: GPL-3.0-or-later
"""Irradiance on a patch of floor under each kind of light, against closed forms and quadrature."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes import PATCH, WHITE, assert_mean, box, lit_patch, place
from scipy.integrate import quad

from engine_core import (
    AreaLight,
    Light,
    Material,
    Mesh,
    PointLight,
    Scene,
    Settings,
    SpotLight,
    SunLight,
    render,
)

POWER = np.array([30.0, 20.0, 10.0])


def check(scene: Scene, irradiance: Any, samples: int = 256, **choices: Any) -> None:
    """The white patch's radiance, times pi, is the irradiance (3,): for both point sets.

    Irradiance is constant on the patch, so that its pixels are independent estimates of one number.
    """
    for integrator in ("sobol", "monte_carlo"):
        settings = Settings(samples=samples, integrator=integrator, threads=1, **choices)
        pixels = np.pi * render(scene, settings).combined[..., :3].reshape(-1, 3).astype(np.float64)
        assert_mean(pixels, irradiance, rounding=1e-4)


# -- closed forms --------------------------------------------------------------------------------------


def cap_form_factor(cos_axis: float, cos_half: float) -> float:
    """Integral of the cosine over the part above the horizon of a spherical cap whose axis is tilted."""
    tilt, half = np.arccos(np.clip(cos_axis, -1, 1)), np.arccos(cos_half)

    def ring(theta: float) -> float:
        scale = np.sin(theta) * np.sin(tilt)
        width = (cos_half - np.cos(theta) * np.cos(tilt)) / scale if scale > 1e-12 else -2.0
        return 2 * np.arccos(np.clip(width, -1, 1)) * np.cos(theta) * np.sin(theta)

    if tilt < 1e-9:
        return np.pi * np.sin(half) ** 2
    edges = sorted({np.clip(abs(e), 0, np.pi / 2) for e in (0.0, tilt - half, tilt + half, np.pi / 2)})
    return sum(quad(ring, a, b, epsabs=1e-13, limit=200)[0] for a, b in zip(edges, edges[1:], strict=False))


def polygon_form_factor(corners: Any) -> float:
    """Integral of the cosine over the solid angle of a polygon above the horizon (Lambert, 1760)."""
    v = np.asarray(corners, float) - PATCH
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    w = np.roll(v, -1, axis=0)
    axis = np.cross(v, w)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return abs(0.5 * (np.arccos(np.clip((v * w).sum(axis=1), -1, 1)) * axis[:, 2]).sum())


def form_factor(points: np.ndarray, normal: np.ndarray, area: np.ndarray, factor: Any = 1.0) -> float:
    """Sum of factor cos cos' / d^2 over points (3, N) of a surface with areas (N,)."""
    d = points - PATCH[:, None]
    square = (d * d).sum(axis=0)
    cos = np.maximum(d[2], 0) * np.maximum(-(normal * d).sum(axis=0), 0) / square
    return float((cos / square * area * factor).sum())


def square_points(matrix: np.ndarray, size: Any, n: int = 1000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Midpoints (3, N), unit normals along -Z, and areas of n x n parts of an area light."""
    x, y = (a.ravel() for a in np.meshgrid(*(2 * [(np.arange(n) + 0.5) / n - 0.5])))
    ex, ey = matrix[:3, 0] * size[0], matrix[:3, 1] * size[1]
    points = matrix[:3, 3][:, None] + ex[:, None] * x + ey[:, None] * y
    facing = -matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
    return points, facing[:, None], np.full(x.size, np.linalg.norm(ex) * np.linalg.norm(ey) / n**2)


def disk_points(matrix: np.ndarray, size: Any, n: int = 800) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same for the inscribed ellipse, by Gauss-Legendre in radius and equal steps in angle."""
    nodes, weights = np.polynomial.legendre.leggauss(n // 4)
    r, phi = (nodes + 1) / 2, 2 * np.pi * np.arange(n) / n
    x, y = (0.5 * np.outer(r, f(phi)).ravel() for f in (np.cos, np.sin))
    ex, ey = matrix[:3, 0] * size[0], matrix[:3, 1] * size[1]
    points = matrix[:3, 3][:, None] + ex[:, None] * x + ey[:, None] * y
    area = np.repeat(weights / 2 * r, n) * (2 * np.pi / n) * np.linalg.norm(ex) * np.linalg.norm(ey) / 4
    return points, (-matrix[:3, 2] / np.linalg.norm(matrix[:3, 2]))[:, None], area


def facing_frame(position: Any) -> np.ndarray:
    """A matrix at ``position`` whose -Z points at the patch."""
    matrix = np.eye(4)
    z = np.asarray(position) - PATCH
    z = z / np.linalg.norm(z)
    x = np.cross(z, [0.6, 0.64, 0.48])
    x /= np.linalg.norm(x)
    matrix[:3] = np.stack([x, np.cross(z, x), z, position], axis=1)
    return matrix


# -- point lights --------------------------------------------------------------------------------------

ABOVE = PATCH + (0.3, -0.2, 1.0)
DISTANCE = float(np.linalg.norm(ABOVE - PATCH))


def test_point_light_falls_off_with_the_square():
    irradiance = POWER / (4 * np.pi) / DISTANCE**3
    check(lit_patch(PointLight(POWER, position=ABOVE)), irradiance)
    check(lit_patch(PointLight(POWER, position=ABOVE, normalize=False)), 4 * irradiance)


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("radius", [1e-8, 1e-4, 0.2, 0.5, 0.9, 0.999, 0.999999])
def test_sphere_light_above_the_horizon_is_the_closed_form(radius, normalize):
    radiance = POWER / (4 * np.pi**2 * radius**2) if normalize else POWER / np.pi
    irradiance = radiance * np.pi * (radius / DISTANCE) ** 2 / DISTANCE
    check(lit_patch(PointLight(POWER, position=ABOVE, radius=radius, normalize=normalize)), irradiance)


@pytest.mark.parametrize(
    ("offset", "radius"),
    [((1.0, 0.3, 0.1), 0.5), ((0.8, 0.0, -0.2), 0.6), ((0.0, 0.6, 0.3), 0.66), ((2.0, 0, 0), 1.99)],
)
def test_sphere_light_partly_below_the_horizon(offset, radius):
    distance = np.linalg.norm(offset)
    factor = cap_form_factor(offset[2] / distance, np.sqrt(1 - (radius / distance) ** 2))
    light = PointLight(POWER, position=PATCH + offset, radius=radius)
    check(lit_patch(light), POWER / (4 * np.pi**2 * radius**2) * factor)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.3), (0.5, 0.2, -0.4), (0.0, 0.0, 0.0)])
def test_inside_of_a_sphere_light_sees_it_everywhere(offset):
    light = PointLight(POWER, position=PATCH + offset, radius=0.8)
    check(lit_patch(light), POWER / (4 * np.pi**2 * 0.8**2) * np.pi)


@pytest.mark.parametrize("radius", [0.2, 0.7, DISTANCE, 2.0])
def test_soft_falloff_light_is_a_disk_that_faces_the_point(radius):
    factor = form_factor(*disk_points(facing_frame(ABOVE), (2 * radius, 2 * radius)))
    light = PointLight(POWER, position=ABOVE, radius=radius, sphere=False)
    check(lit_patch(light), POWER / (4 * np.pi**2 * radius**2) * factor)


# -- spots ---------------------------------------------------------------------------------------------


def spot_attenuation(matrix: np.ndarray, direction: np.ndarray, angle: float, blend: float) -> np.ndarray:
    """Cycles' cone for directions (3, N): smoothstep of the cosine in the light's own space."""
    local = np.linalg.inv(matrix[:3, :3]) @ direction
    cosine = -local[2] / np.linalg.norm(local, axis=0)
    cos = np.cos(angle / 2)
    t = np.clip((cosine - cos) / max((1 - cos) * blend, 1e-12), 0, 1)
    return t * t * (3 - 2 * t)


@pytest.mark.parametrize("scale", [1.0, (1.5, 0.7, 1.0), (1.0, 1.0, 0.4), (-1.0, 2.0, 1.0)])
@pytest.mark.parametrize(("angle", "blend"), [(0.8, 1.0), (1.5, 0.5), (1.2, 0.0), (np.pi, 0.15)])
def test_spot_without_size_is_its_formula(angle, blend, scale):
    matrix = place(ABOVE, (0.45, 0.1, 0.3), scale)
    towards = (PATCH - ABOVE)[:, None]
    factor = spot_attenuation(matrix, towards, angle, blend)[0] / DISTANCE**3
    light = SpotLight(POWER, light_to_world=matrix, angle=angle, blend=blend)
    check(lit_patch(light), POWER / (4 * np.pi) * factor)


def test_spot_lights_what_it_faces_and_nothing_behind():
    lit, dark = (
        render(
            lit_patch(SpotLight(1.0, light_to_world=place(ABOVE, (turn, 0, 0)), angle=1.5)),
            Settings(samples=4),
        )
        for turn in (0.0, np.pi)
    )
    assert lit.combined[..., 0].min() > 0 and dark.combined[..., :3].max() == 0


@pytest.mark.parametrize("sphere", [True, False])
@pytest.mark.parametrize("blend", [0.3, 1.0])
def test_spot_of_some_size_is_attenuated_along_each_ray(blend, sphere):
    radius, angle = 0.4, 0.9
    matrix = place(ABOVE, (0.4, 0.2, 0.0), (1.0, 0.8, 1.0))
    frame = facing_frame(ABOVE)
    if sphere:  # the disk in which the tangent cone touches the sphere fills the same solid angle
        sin = radius / DISTANCE
        frame[:3, 3] = PATCH + (ABOVE - PATCH) * (1 - sin**2)
        size = 2 * radius * np.sqrt(1 - sin**2)
    else:
        size = 2 * radius
    points, normal, area = disk_points(frame, (size, size), 1200)
    factor = form_factor(
        points, normal, area, spot_attenuation(matrix, PATCH[:, None] - points, angle, blend)
    )
    light = SpotLight(POWER, light_to_world=matrix, radius=radius, sphere=sphere, angle=angle, blend=blend)
    check(lit_patch(light), POWER / (4 * np.pi**2 * radius**2) * factor)


# -- area lights ---------------------------------------------------------------------------------------

TILTED = place(PATCH + (0.4, -0.3, 1.2), (0.3, 0.4, 0.2))


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("size", [(1.0, 1.0), (2.0, 0.3), (0.01, 0.02)])
def test_rectangle_light_is_lamberts_polygon(size, normalize):
    ex, ey = TILTED[:3, 0] * size[0] / 2, TILTED[:3, 1] * size[1] / 2
    corners = TILTED[:3, 3] + np.array([-ex - ey, ex - ey, ex + ey, -ex + ey])
    radiance = POWER / np.pi / (size[0] * size[1] if normalize else 1)
    light = AreaLight(POWER, light_to_world=TILTED, size=size, normalize=normalize)
    check(lit_patch(light), radiance * polygon_form_factor(corners))


@pytest.mark.parametrize("scale", [(2.0, 0.5, 1.0), (1.0, -1.0, 3.0)])
def test_scale_of_the_matrix_is_the_lights_size(scale):
    matrix = TILTED @ np.diag([*scale, 1.0])
    factor = form_factor(*square_points(matrix, (1.0, 1.0)))
    light = AreaLight(POWER, light_to_world=matrix)
    check(lit_patch(light), POWER / np.pi / abs(scale[0] * scale[1]) * factor)


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("size", [(1.0, 1.0), (1.6, 0.5)])
def test_ellipse_light_is_its_quadrature(size, normalize):
    factor = form_factor(*disk_points(TILTED, size))
    radiance = POWER / np.pi / (np.pi / 4 * size[0] * size[1] if normalize else 1)
    light = AreaLight(POWER, light_to_world=TILTED, size=size, ellipse=True, normalize=normalize)
    check(lit_patch(light), radiance * factor)


@pytest.mark.parametrize("ellipse", [False, True])
def test_light_that_cuts_the_horizon_is_lit_by_its_upper_part(ellipse):
    matrix = place(PATCH + (1.0, 0.2, 0.1), (0.0, np.pi / 2, 0.2))
    points = disk_points(matrix, (1.0, 1.0), 2000) if ellipse else square_points(matrix, (1.0, 1.0))
    area = np.pi / 4 if ellipse else 1.0
    light = AreaLight(POWER, light_to_world=matrix, ellipse=ellipse)
    check(lit_patch(light), POWER / np.pi / area * form_factor(*points))


@pytest.mark.parametrize("spread", [0.02, 0.5, 2.0, 3.1])
def test_spread_narrows_the_light_as_a_grid_before_it_does(spread):
    matrix = place(PATCH + (0.1, -0.1, 1.2), (0.05, 0.03, 0.2))
    points, normal, area = square_points(matrix, (1.0, 1.0), 1500)
    towards = PATCH[:, None] - points
    cos = (normal * towards).sum(axis=0) / np.linalg.norm(towards, axis=0)
    half = spread / 2
    grid = np.maximum(np.tan(half) - np.tan(np.arccos(np.minimum(cos, 1))), 0) / (np.tan(half) - half)
    light = AreaLight(POWER, light_to_world=matrix, spread=spread)
    check(lit_patch(light), POWER / np.pi * form_factor(points, normal, area, grid))


def test_area_light_emits_from_one_side():
    behind = place(PATCH + (0, 0, 1.0), (np.pi, 0, 0))
    film = render(lit_patch(AreaLight(POWER, light_to_world=behind)), Settings(samples=16))
    assert film.combined[..., :3].max() == 0


# -- suns and the world --------------------------------------------------------------------------------


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("cos", [0.8, 0.05])
@pytest.mark.parametrize("angle", [0.0, 1e-4, 0.0093, 0.5, 2.0, np.pi])
def test_sun_is_its_disk_above_the_horizon(angle, cos, normalize):
    direction = -np.array([np.sqrt(1 - cos**2), 0, cos])
    if angle == 0:
        irradiance = POWER * cos
    else:
        radiance = POWER / (np.pi * np.sin(angle / 2) ** 2 if normalize else 1)
        irradiance = radiance * cap_form_factor(cos, np.cos(angle / 2))
    light = SunLight(POWER, direction=direction, angle=angle, normalize=normalize)
    # The closed form itself loses its digits in the smallest cap.
    check(lit_patch(light), irradiance if angle != 1e-4 or not normalize else POWER * cos)


def test_world_is_pi_times_its_radiance():
    check(lit_patch(world=POWER), np.pi * POWER)


# -- emissive meshes -----------------------------------------------------------------------------------

GLOWING = Material(0.0, POWER)


def test_emissive_triangle_is_its_form_factor():
    corners = PATCH + np.array([[0.8, 0.0, 0.7], [-0.4, 0.5, 1.0], [0.1, -0.6, 0.9]])
    for order in ([0, 1, 2], [2, 1, 0]):  # it emits from both sides
        scene = lit_patch(meshes=[Mesh(corners, [order], materials=1)], materials=(WHITE, GLOWING))
        check(scene, POWER * polygon_form_factor(corners.astype(np.float32)))


@pytest.mark.parametrize("parts", [1, 12])
def test_emissive_mesh_of_many_triangles_is_the_square_that_they_fill(parts):
    step = np.arange(parts + 1) / parts - 0.5
    x, y = (a.ravel() for a in np.meshgrid(step**3 * 4, step))  # of unlike sizes
    vertices = np.stack([x, y, np.zeros_like(x)], axis=1) @ TILTED[:3, :3].T + TILTED[:3, 3]
    corner = (np.arange(parts)[:, None] * (parts + 1) + np.arange(parts)).ravel()
    a, b, c, d = corner, corner + 1, corner + parts + 2, corner + parts + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    scene = lit_patch(meshes=[Mesh(vertices, triangles, materials=1)], materials=(WHITE, GLOWING))
    ex, ey = TILTED[:3, 0] / 2, TILTED[:3, 1] / 2
    corners = TILTED[:3, 3] + np.array([-ex - ey, ex - ey, ex + ey, -ex + ey])
    check(scene, POWER * polygon_form_factor(corners), light_samples=1)


@pytest.mark.parametrize(("height", "thickness"), [(0.5, 0.4), (20.0, 1e-3)])
def test_closed_emissive_mesh_hides_its_own_back(height, thickness):
    low, high = PATCH + (-0.3, -0.2, height), PATCH + (0.3, 0.2, height + thickness)
    bottom = PATCH + np.array(
        [[x, y, height] for x, y in ((-0.3, -0.2), (0.3, -0.2), (0.3, 0.2), (-0.3, 0.2))]
    )
    scene = lit_patch(meshes=[box(low, high, materials=1)], materials=(WHITE, GLOWING))
    check(scene, POWER * polygon_form_factor(bottom))


@pytest.mark.parametrize("height", [1e-2, 0.3])
def test_an_emissive_mesh_next_to_the_floor_does_not_shadow_itself(height):
    corners = np.array([[-3.0, -4.0, height], [3.0, -4.0, height], [3.0, 4.0, height], [-3.0, 4.0, height]])
    mesh = Mesh(PATCH + corners, [[0, 1, 2], [0, 2, 3]], materials=1)
    scene = lit_patch(meshes=[mesh], materials=(WHITE, GLOWING))
    low = np.array(scene.camera.camera_to_world)
    low[2, 3] = height / 2
    scene = replace(scene, camera=replace(scene.camera, camera_to_world=low))
    check(scene, POWER * polygon_form_factor(PATCH + corners))


# -- several at once -----------------------------------------------------------------------------------


@pytest.mark.parametrize("light_samples", [1, 2, 4])
def test_lights_add(light_samples):
    rectangle = AreaLight(POWER, light_to_world=TILTED)
    bulb = PointLight(POWER[::-1], position=ABOVE, radius=0.3)
    sun = SunLight(POWER / 20, direction=(0.3, 0, -1.0))
    lights: list[Light] = [rectangle, bulb, sun]
    ex, ey = TILTED[:3, 0] / 2, TILTED[:3, 1] / 2
    corners = TILTED[:3, 3] + np.array([-ex - ey, ex - ey, ex + ey, -ex + ey])
    irradiance = (
        POWER / np.pi * polygon_form_factor(corners)
        + POWER[::-1] / (4 * np.pi) / DISTANCE**3
        + POWER / 20 / np.sqrt(1.09)
        + np.pi * 0.5
    )
    check(lit_patch(*lights, world=0.5), irradiance, light_samples=light_samples)
