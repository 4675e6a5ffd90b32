# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes that tests share: simple meshes, cameras over a small patch, and a generator of nasty ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine_core import (
    AreaLight,
    Camera,
    Film,
    Light,
    Material,
    Mesh,
    PointLight,
    Scene,
    SceneError,
    Settings,
    SpotLight,
    SunLight,
    Volume,
    World,
    render,
)
from engine_core.geometry.triangles import Triangles
from engine_core.settings import DIRECT_SAMPLING, INTEGRATORS
from engine_core.shading.closures import (
    Add,
    Closure,
    Diffuse,
    Emission,
    Glossy,
    Holdout,
    Mix,
    Principled,
    Translucent,
    Transparent,
)
from engine_core.shading.coordinates import GENERATED, NORMAL, TOWARDS_VIEWER
from engine_core.shading.values import Value, value_at
from engine_core.transport.emitters.mesh_pieces import Pieces

WHITE = Material(1.0)

# A patch of the floor that lies on no edge of it.
PATCH = np.array([0.13, 0.07, 0.0])


def place(position: Any = (0, 0, 0), rotation: Any = (0, 0, 0), scale: Any = 1.0) -> np.ndarray:
    """(4, 4) matrix: scale, then rotation about X, Y, Z (radians), then translation."""
    x, y, z = rotation
    cx, sx, cy, sy, cz, sz = np.cos(x), np.sin(x), np.cos(y), np.sin(y), np.cos(z), np.sin(z)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    matrix = np.eye(4)
    matrix[:3, :3] = about_z @ about_y @ about_x * np.broadcast_to(scale, 3)
    matrix[:3, 3] = position
    return matrix


def floor(half: float = 5.0, z: float = 0.0, **fields: Any) -> Mesh:
    """A square of two triangles in the plane z, facing up."""
    corners = [[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]]
    return Mesh(corners, [[0, 1, 2], [0, 2, 3]], name="Floor", **fields)


def box(low: Any = (-1, -1, -1), high: Any = (1, 1, 1), shared: bool = True, **fields: Any) -> Mesh:
    """A closed box of 12 triangles that face outwards; ``shared``: of 8 vertices, else of 36."""
    unit = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    vertices = np.asarray(low) + unit * (np.asarray(high, float) - low)
    triangles = []
    for axis in range(3):
        for side in (0, 1):
            face = [i for i in range(8) if unit[i, axis] == side]
            a, b, c, d = face[0], face[1], face[3], face[2]
            normal = np.cross(unit[b] - unit[a], unit[c] - unit[a])[axis]
            if (normal > 0) != (side == 1):
                a, b, c, d = a, d, c, b
            triangles += [[a, b, c], [a, c, d]]
    triangles = np.array(triangles)
    if not shared:
        vertices, triangles = vertices[triangles.ravel()], np.arange(36).reshape(12, 3)
    return Mesh(vertices, triangles, name="Box", **fields)


def picture_of_sky() -> np.ndarray:
    """Brighter towards the window of `walls_with_window`, and with a sun that few directions meet."""
    image = np.full((16, 32, 3), (0.3, 0.5, 0.9), np.float32)
    image[10, 14:18] = 12.0
    return image


def walls_with_window(window: tuple[float, float]) -> list[Mesh]:
    """Of a room of 6 x 6 x 3, and a hole in the one to the right: from where to where in y and z."""
    low, high = window
    corners = [
        ((-3, -3, -0.2), (3, 3, 0)),
        ((-3, -3, 3), (3, 3, 3.2)),
        ((-3.2, -3, 0), (-3, 3, 3)),
        ((-3, 3, 0), (3, 3.2, 3)),
        ((-3, -3.2, 0), (3, -3, 3)),
        ((3, -3, 0), (3.2, low, 3)),
        ((3, high, 0), (3.2, 3, 3)),
        ((3, low, 0), (3.2, high, low)),
        ((3, low, high), (3.2, high, 3)),
    ]
    return [box(*ends) for ends in corners]


def sphere(
    centre: Any = (0, 0, 0),
    radius: float = 1.0,
    smooth: bool = False,
    segments: int = 24,
    grid: float = 0.0,
    **fields: Any,
) -> Mesh:
    """A closed convex sphere of latitudes and longitudes; ``grid`` snaps its vertices to multiples of it."""
    rings = segments // 2
    theta = np.pi * np.arange(1, rings)[:, None] / rings
    phi = 2 * np.pi * np.arange(segments) / segments
    x, y = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)
    ring = np.stack(np.broadcast_arrays(x, y, np.cos(theta)), axis=-1)
    unit = np.concatenate([[[0, 0, 1]], ring.reshape(-1, 3), [[0, 0, -1]]])
    here = 1 + np.arange(rings - 1)[:, None] * segments + np.arange(segments)
    there = 1 + np.arange(rings - 1)[:, None] * segments + (np.arange(segments) + 1) % segments
    last = len(unit) - 1
    top = np.stack([np.zeros(segments, int), here[0], there[0]], -1)
    bottom = np.stack([np.full(segments, last), there[-1], here[-1]], -1)
    upper = np.stack([here[:-1], here[1:], there[1:]], -1).reshape(-1, 3)
    lower = np.stack([here[:-1], there[1:], there[:-1]], -1).reshape(-1, 3)
    triangles = np.concatenate([top, upper, lower, bottom])
    vertices = np.asarray(centre) + radius * unit
    if grid:
        vertices = np.round(vertices / grid) * grid
    return Mesh(vertices, triangles, unit[triangles] if smooth else None, name="Sphere", **fields)


def patch_camera(size: float = 1e-3, pixels: int = 16, at: Any = PATCH) -> Camera:
    """An orthographic camera straight above a patch so small that irradiance is constant on it."""
    matrix = np.eye(4)
    matrix[:3, 3] = np.asarray(at) + (0, 0, 1 / 64)
    half = size / 2
    return Camera(matrix, (-half, half, -half, half), pixels, pixels, projection="orthographic")


def lit_patch(*lights: Light, world: Any = 0.0, meshes: Any = (), materials: Any = (WHITE,)) -> Scene:
    """White floor, seen where `PATCH` lies: radiance times pi is the irradiance there."""
    return Scene(patch_camera(), (floor(), *meshes), materials, lights, World(world, visible_to_camera=False))


def studio(width: int = 48, height: int = 32, lights: Any = (), **fields: Any) -> Scene:
    """A smooth sphere and a box on a floor."""
    camera = fields.pop("camera", None) or Camera.look_at((0, -6, 3), (0, 0, 0.7), width, height)
    ball = sphere((-0.8, 0, 0.8), 0.8, smooth=True, materials=1)
    meshes = (floor(), ball, box((0.5, -0.5, 0), (1.5, 0.5, 1.2)))
    return Scene(camera, meshes, (Material((0.8, 0.7, 0.6)), Material((0.2, 0.5, 0.8))), lights, **fields)


def area_light(power: Any = 100.0, position: Any = (1.5, -1.5, 4.0), **fields: Any) -> AreaLight:
    """An area light of edge 2 above the studio, tilted towards it."""
    fields = {"size": (2.0, 2.0)} | fields
    return AreaLight(power, light_to_world=place(position, (0.35, 0.35, 0)), name="Area", **fields)


def mixed_lights(count: int, seed: int = 7, power: float = 150.0) -> list[Light]:
    """Points, spheres, disks, spots, areas and suns in turn, above the studio."""
    random = np.random.default_rng(seed)
    lights: list[Light] = []
    for i in range(count):
        position = random.uniform((-4, -4, 2.5), (4, 4, 5))
        colour = random.uniform(0.2, 1, 3) * power / count
        down = place(position, random.uniform(-0.5, 0.5, 3))
        lights.append(
            (
                lambda p, c, m: PointLight(c, position=p),
                lambda p, c, m: PointLight(c, position=p, radius=0.4),
                lambda p, c, m: PointLight(c, position=p, radius=0.4, sphere=False),
                lambda p, c, m: SpotLight(c, light_to_world=m, radius=0.2, angle=1.2, blend=0.3),
                lambda p, c, m: AreaLight(c, light_to_world=m, size=(1.0, 0.5)),
                lambda p, c, m: SunLight(c / 100, direction=-p, angle=0.1),
            )[i % 6](position, colour, down)
        )
    return lights


def pictures(
    scene: Scene, seeds: int, settings: Settings | None = None, first: int = 1000, **choices: Any
) -> np.ndarray:
    """(seeds, H, W, 3) float64: renders that differ by their seed alone, ``first`` and those after it."""
    base = replace(settings or Settings(), threads=1, **choices)
    films = (render(scene, replace(base, seed=first + i)) for i in range(seeds))
    return np.stack([film.combined[..., :3] for film in films]).astype(np.float64)


def assert_mean(samples: np.ndarray, truth: Any, sigmas: float = 4.0, rounding: float = 2e-5) -> None:
    """The mean of independent estimates (S, ...) is the truth, by their own standard error.

    rounding : relative error of float32 arithmetic, which no number of samples takes away.
    """
    mean = samples.mean(axis=0)
    error = samples.std(axis=0, ddof=1) / np.sqrt(len(samples))
    excess = np.abs(mean - truth) - sigmas * error - rounding * np.abs(truth)
    worst = np.unravel_index(np.argmax(excess), excess.shape)
    wanted = np.broadcast_to(truth, mean.shape)
    assert excess[worst] <= 0, f"at {worst}: {mean[worst]} +- {error[worst]}, wanted {wanted[worst]}"


def assert_picture_is_sound(film: Film) -> None:
    """No NaN, no Inf, no negative radiance but as the residual's noise, alpha within [0, 1]."""
    assert np.isfinite(film.combined).all()
    assert (film.combined[..., :3] >= 0).all() or film.control_variate.any()
    assert (film.combined[..., 3] >= 0).all() and (film.combined[..., 3] <= 1).all()
    assert not np.isnan(film.standard_error).any()
    assert np.isfinite(film.control_variate).all() and np.isfinite(film.residual).all()
    assert np.isfinite(film.depth).all()
    assert np.isfinite(film.normal).all()


def blocks(picture: np.ndarray, edge: int = 16) -> np.ndarray:
    """Means over squares of ``edge`` pixels of pictures (..., H, W, C)."""
    *rest, height, width, channels = picture.shape
    parted = picture.reshape(*rest, height // edge, edge, width // edge, edge, channels)
    return parted.mean(axis=(-4, -2))


# -- nasty scenes --------------------------------------------------------------------------------------


def nasty_scene(seed: int) -> tuple[Scene, Settings]:
    """A scene that nobody would make on purpose. SceneErrors of its parts are part of the contract."""
    random = np.random.default_rng(seed)
    scale = 10.0 ** random.uniform(-6, 6)
    maker = _Nasty(random, scale)
    scene = Scene(
        maker.camera(),
        [maker.mesh() for _ in range(random.integers(0, 9))],
        [maker.material() for _ in range(3)],
        [light for _ in range(maker.light_count()) if (light := maker.light()) is not None],
        maker.world(),
    )
    # A quadrature takes as long as it takes, and the more lights it meets the longer.
    few = len(scene.lights) <= 5
    settings = Settings(
        samples=int(random.choice([1, 4, 8])),
        light_samples=int(random.choice([0, 1, 3])),
        integrator=str(random.choice([i for i in INTEGRATORS if few or i != "quadrature"])),
        seed=seed,
        direct_sampling=str(random.choice(DIRECT_SAMPLING)),
        transparent_bounces=int(random.choice([0, 1, 8, 64])),
        noise_threshold=float(random.choice([0, 0.1])),
        min_samples=2,
        threads=1,
        transparent=bool(random.integers(2)),
        normals=bool(random.integers(2)),
        standard_error=bool(random.integers(2)),
        batch_size=int(random.choice([64, 1000, 16384])),
    )
    return scene, settings


class _Nasty:
    """Extreme parts at one scale, drawn from one generator."""

    def __init__(self, random: np.random.Generator, scale: float) -> None:
        self.random = random
        self.scale = scale
        self.eye = random.normal(size=3) * 3 * scale

    def chance(self, probability: float) -> bool:
        return bool(self.random.random() < probability)

    def pick(self, *values: Any) -> Any:
        return values[self.random.integers(len(values))]

    def camera(self) -> Camera:
        # Pictures of one pixel, of one row, and ordinary small ones; some of a part of the frame.
        width, height = self.pick((1, 1), (1, 300), (300, 1), (8, 8), (8, 8), (17, 15))
        region = None
        if self.chance(0.2):
            x, y = self.random.integers(width), self.random.integers(height)
            region = (x, y, self.random.integers(x, width) + 1, self.random.integers(y, height) + 1)
        view = Camera.look_at(self.eye, self.random.normal(size=3) * 0.3 * self.scale, 1, 1)
        lens = self.lens()
        if self.chance(0.3):
            half = self.pick(1e-9, 1.0, 1.0, 3.0, 3.0, 1e6) * self.scale
            span = self.scale * 10
            clip = self.pick((0.0, np.inf), (0.0, np.inf), (-span, span), (span, span))
            return Camera(
                view.camera_to_world,
                (-half, half, -half, half),
                width,
                height,
                region,
                "orthographic",
                *clip,
                **lens,
            )
        half = self.pick(1e-9, 1e-3, 0.3, 0.3, 0.3, 1.0, 1e4)
        clip = self.pick((0.0, np.inf), (0.1, 100.0), (0.01, np.inf), (1e-3, 1e-3), (2.0, 6.0), (0.0, 1e30))
        return Camera(
            view.camera_to_world,
            (-half, half, half, -half) if self.chance(0.1) else (-half, half, -half, half),
            width,
            height,
            region,
            clip_start=clip[0] * self.scale,
            clip_end=clip[1] * self.scale,
            **lens,
        )

    def lens(self) -> dict[str, Any]:
        if self.chance(0.7):
            return {}
        return {
            "aperture": self.pick(1e-30, 1e-3, 0.3, 3.0, 1e6) * self.scale,
            "focus_distance": self.pick(1e-6, 1.0, 3.0, 1e9) * self.scale,
            "blades": self.pick(0, 2, 3, 7),
            "blade_rotation": self.pick(0.0, 1.0, 1e6),
            "aperture_ratio": self.pick(1e-3, 1.0, 2.0, 1e3),
        }

    def mesh(self) -> Mesh:
        vertices, triangles, normals = self._shape()
        vertices = np.array(vertices, np.float64).reshape(-1, 3) * self.scale
        triangles = np.array(triangles, np.int64).reshape(-1, 3)
        vertices += self.pick(0, 0, 0, self.random.normal(size=3) * self.scale, self.eye)
        if len(vertices) and self.chance(0.25):
            where = self.random.integers(len(vertices))
            vertices[where, self.random.integers(3)] = self.pick(np.nan, np.inf, -np.inf, 1e30, 3e38, 1e-45)
        if normals is not None and len(normals) and self.chance(0.3):
            normals = np.array(normals)
            normals[self.random.integers(len(normals))] = self.pick(np.nan, 0.0, np.inf, 1e-30, -1.0)
        with np.errstate(over="ignore"):
            return Mesh(
                vertices.astype(np.float32),
                triangles,
                normals,
                self.pick(0, 1, self.random.integers(0, 3, len(triangles))),
                visible_to_camera=not self.chance(0.1),
                casts_shadow=not self.chance(0.15),
                holdout=self.chance(0.15),
                terminator_offset=self.pick(0.0, 0.1, 1.0),
                attributes=self.attributes(len(triangles)),
            )

    def attributes(self, count: int) -> dict[str, np.ndarray]:
        if self.chance(0.5):
            return {}
        rows = count, self.pick(1, 3)
        generated = self.random.uniform(-1, 2, (*rows, 3)) * self.pick(0.0, 1.0, 1e20)
        tangent = self.random.normal(size=(*rows, 4)) * self.pick(0.0, 1.0, 1e20)
        if count and self.chance(0.2):
            generated[self.random.integers(count)] = self.pick(np.nan, np.inf)
        return {"generated": generated, "tangent:": tangent}

    def _shape(self) -> tuple[Any, Any, Any]:
        kind = self.random.integers(8)
        if kind == 0:  # nothing, or vertices without a triangle
            return self.random.normal(size=(self.pick(0, 5), 3)), [], None
        if kind == 1:  # zero area: a point, a line, a repeated vertex
            return [[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 0, 0], [0, 1, 2], [0, 1, 1]], None
        if kind == 2:  # needles
            vertices = self.random.normal(size=(30, 3)) * (1, 1e-7, 1e-7)
            return vertices, np.arange(30).reshape(10, 3), None
        if kind == 3:  # one triangle as large as the world
            return self.random.normal(size=(3, 3)) * 1e6, [[0, 1, 2]], None
        if kind == 4:  # a soup with custom normals that have nothing to do with it
            normals = self.random.normal(size=(20, 3, 3))
            return self.random.normal(size=(60, 3)), np.arange(60).reshape(20, 3), normals
        if kind == 5:
            mesh = box(shared=self.chance(0.5))
        elif kind == 6:
            mesh = floor(self.pick(1.0, 1e5))
        else:
            mesh = sphere(radius=self.pick(1e-6, 1.0, 10.0), smooth=self.chance(0.7), segments=8)
        return mesh.vertices, mesh.triangles, mesh.normals

    def material(self) -> Material:
        if self.chance(0.7):
            return Material(surface=self.closure())
        return Material(
            self.pick(0.8, 0.0, 1.0, 1e10, (1.0, 0.0, 0.5)),
            self.pick(0.0, 0.0, 1.0, 1e-30, 1e20, (0.0, 5.0, -1.0)),
        )

    def number(self, *values: float) -> Any:
        """A constant, or what varies between two, or is what no texture should be."""
        a, b = self.pick(*values), self.pick(*values)
        return a if self.chance(0.7) else _Wild(a, self.pick(b, b, b, b, np.nan, np.inf, 1e30, -1.0))

    def colour(self) -> Any:
        return self.number(0.0, 0.5, 0.8, 1.0, 1e10, 1e-30)

    def vector(self) -> Any:
        return self.pick(None, None, NORMAL, TOWARDS_VIEWER, GENERATED, _WildVector(), (0, 0, 1), (0, 0, 0))

    def closure(self, depth: int = 0) -> Closure | None:
        unit = (0.0, 1e-6, 1e-3, 0.1, 0.5, 1.0)
        roughness, normal, tangent = self.number(*unit), self.vector(), self.vector()
        distribution = self.pick("MULTI_GGX", "GGX", "BECKMANN", "ASHIKHMIN_SHIRLEY")
        kind = self.random.integers(11 if depth < 3 else 7)
        if kind == 0:
            return Diffuse(self.colour(), roughness, normal)
        if kind == 1:
            return Translucent(self.colour(), normal)
        if kind == 2:
            return Transparent(self.colour())
        if kind == 3:
            return Emission(self.colour(), self.number(0.0, 1.0, 1e-30, 1e20, -1.0))
        if kind == 4:
            return self.pick(Holdout(), None)
        if kind == 5:
            anisotropy, rotation = self.number(0.0, 0.0, 0.7, -0.9, 1.0, -1.0), self.number(*unit, 1e6)
            return Glossy(self.colour(), roughness, distribution, anisotropy, rotation, normal, tangent)
        if kind == 6:
            return Principled(
                self.colour(),
                metallic=self.number(*unit),
                roughness=roughness,
                ior=self.number(1.0, 1.5, 1.5, 0.0, 0.5, 1e3, 1e10, 1.0000001),
                alpha=self.number(1.0, *unit),
                normal=normal,
                diffuse_roughness=self.number(0.0, *unit),
                specular_ior_level=self.number(0.5, *unit, 10.0),
                specular_tint=self.colour(),
                anisotropic=self.number(0.0, *unit),
                anisotropic_rotation=self.number(*unit),
                tangent=tangent,
                coat_weight=self.number(0.0, *unit),
                coat_roughness=self.number(*unit),
                coat_ior=self.number(1.0, 1.5, 4.0, 1e6),
                coat_tint=self.colour(),
                coat_normal=self.vector(),
                emission_color=self.colour(),
                emission_strength=self.number(0.0, 0.0, 1.0, 1e20, -1.0),
                distribution=self.pick("MULTI_GGX", "GGX"),
            )
        parts = self.closure(depth + 1), self.closure(depth + 1)
        return Add(*parts) if kind < 9 else Mix(self.number(*unit, 2.0), *parts)

    def world(self) -> World:
        colour, seen = self.pick(0.0, 1.0, 1e-30, 1e20, -1.0), self.chance(0.5)
        if self.chance(0.7):
            return World(colour, seen)
        shape = self.pick((1, 1, 3), (2, 5, 3), (16, 32, 3), (1, 40, 3))
        image = self.random.uniform(-0.2, 1, shape) ** self.pick(1, 9) * self.pick(0.0, 1.0, 1e-30, 1e20)
        return World(colour, seen, image=image, rotation=place(rotation=self.random.normal(size=3))[:3, :3])

    def light_count(self) -> int:
        return int(self.pick(0, 1, 2, 3, 5, 10, 40, 80) if self.chance(0.7) else 1)

    def light(self) -> Light | None:
        power = self.pick(100.0, (1.0, 0.1, 0.0), 0.0, -5.0, (1.0, -1.0, 1.0), 1e-30, 1e10, 1e30)
        power = np.asarray(power) * self.scale**2
        position = self.pick(
            self.eye, np.zeros(3), self.random.normal(size=3) * self.scale, np.full(3, 1e9) * self.scale
        )
        common = {
            "normalize": self.chance(0.7),
            "casts_shadow": not self.chance(0.2),
            "visible_to_camera": self.chance(0.5),
        }
        size = self.pick(0.0, 1e-30, 1e-6, 0.3, 1.0, 5.0, 1e9) * self.scale
        matrix = self._matrix(position)
        sphere_light = self.chance(0.5)
        kind = self.random.integers(4)
        try:
            if kind == 0:
                return PointLight(power, position=position, radius=size, sphere=sphere_light, **common)
            if kind == 1:
                return SpotLight(
                    power,
                    light_to_world=matrix,
                    radius=size,
                    sphere=sphere_light,
                    angle=self.pick(0.0, 1e-3, 0.8, np.pi),
                    blend=self.pick(0.0, 0.15, 1.0),
                    **common,
                )
            if kind == 2:
                return AreaLight(
                    power,
                    light_to_world=matrix,
                    size=(size, self.pick(size, self.scale, 0.0)),
                    ellipse=self.chance(0.5),
                    spread=self.pick(np.pi, 0.0, 1e-3, 1.0),
                    **common,
                )
            return SunLight(
                self.pick(1.0, 1e30, 1e-30),
                direction=self.random.normal(size=3),
                angle=self.pick(0.0, 1e-30, 1e-20, 1e-6, 0.01, np.pi),
                **common,
            )
        except SceneError:
            return None

    def _matrix(self, position: np.ndarray) -> np.ndarray:
        scale = self.pick(1.0, -1.0, (1, 1, 0), (1, 0, 1), 0.0, (1e-12, 1, 1), 1e-9, 1e9, (2, 0.5, -1))
        return place(position, self.random.normal(size=3), scale)


@dataclass(frozen=True, eq=False)
class _Wild(Value):
    """A number that jumps between two from place to place."""

    even: float
    odd: float

    def evaluate(self, points: Any) -> np.ndarray:
        with np.errstate(all="ignore"):
            even = (
                np.floor(points.position.sum(axis=0) / np.abs(points.position).max(initial=1e-30) * 7) % 2
                == 0
            )
        return np.where(even, self.even, self.odd).astype(np.float32)


@dataclass(frozen=True, eq=False)
class _WildVector(Value):
    """Directions that have nothing to do with the surface, and some that are none."""

    def evaluate(self, points: Any) -> np.ndarray:
        with np.errstate(all="ignore"):
            vector = np.sin(points.position * 1e3) + value_at(NORMAL, points)
            return (vector / np.abs(vector).max(axis=0)).astype(np.float32)


def clouds(camera: Camera, radius: float, *lights) -> Scene:
    """Twelve balls of fog before and above one another."""
    random = np.random.default_rng(4)
    balls = [
        sphere(at, radius, volume=0, surface=False)
        for at in random.uniform((-2.5, -1.0, -0.5), (2.5, 3.0, 2.5), (12, 3))
    ]
    return Scene(camera, (box(), *balls), [Material(0.0)] * 13, lights, volumes=[Volume(scattering=2.0)])


def whole_pieces(triangles: Triangles, *rows: np.ndarray) -> Pieces:
    """Triangles as they are, those of each light in ``rows``, seen from both sides."""
    row = np.concatenate(rows)
    corners = triangles.vertices[triangles.indices[row]].astype(np.float64)
    weights = np.tile(np.array([[0, 0], [1, 0], [0, 1]], np.float32), (len(row), 1, 1))
    first = np.cumsum([0, *(len(some) for some in rows)])
    # All in one place, as to codes: parted in the order that they have.
    side, code = np.zeros(len(row), np.int8), np.zeros(len(row), np.int64)
    return Pieces(row.astype(np.int32), corners, weights, side, first, code)
