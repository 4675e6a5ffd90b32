# SPDX-License-Identifier: GPL-3.0-or-later
"""Random whole scenes of fog and lasers: finite, without fireflies, the same by one thread and by two.

Nothing here says how long a render may take: pytest.ini stops what hangs, and says where.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes import assert_picture_is_sound, box, floor, place, sphere

from engine_core import (
    AreaLight,
    Camera,
    Film,
    Laser,
    Light,
    Material,
    Mesh,
    PointLight,
    Scene,
    Settings,
    SpotLight,
    SunLight,
    Volume,
    World,
    render,
    screen_picture,
)
from engine_core.scene import Linking
from engine_core.settings import DIRECT_SAMPLING, DISTANCE_SAMPLING, INTEGRATORS
from engine_core.shading.closures import Diffuse, Emission, Glossy, Mix, Translucent, Transparent

SCENES = 60
AT_ONCE = 10
FULL_SCENES = 1000

FINER = 8
"""Pixels of the picture that tells what samples may be worth, in one of the picture that is tested."""

FACTOR = 16
"""By which no pixel is brighter than the brightest of so many samples."""


class Wild:
    """Parts of a scene at one scale, some ordinary, some extreme; light is never negative."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.scale = 10.0 ** self.random.uniform(-4, 4)
        self.eye = self.pick(self.point(3), np.array([0.0, -4, 1.5]), self.point(0.3))

    def pick(self, *values: Any) -> Any:
        return values[self.random.integers(len(values))]

    def chance(self, probability: float) -> bool:
        return bool(self.random.random() < probability)

    def point(self, spread: float = 1.0) -> np.ndarray:
        return self.random.normal(size=3) * spread

    def colour(self, *extremes: Any) -> np.ndarray:
        ordinary = self.random.uniform(0, 1, 3)
        return np.broadcast_to(self.pick(ordinary, ordinary, *extremes), 3)

    def camera(self) -> Camera:
        width, height = self.pick((12, 8), (12, 8), (8, 12), (16, 1), (1, 1))
        towards = self.point(0.3)
        view = Camera.look_at(self.eye * self.scale, towards * self.scale, width, height)
        region = None
        if self.chance(0.1):
            region = (width // 2, 0, width, max(height // 2, 1))
        clip = np.array(self.pick((0.1, 100), (0.1, 100), (0, np.inf), (1e-6, 1e6), (2, 5))) * self.scale
        if self.chance(0.15):
            half = self.pick(1e-3, 2.0, 2.0, 1e3) * self.scale
            plane = (-half, half, -half * height / width, half * height / width)
            return Camera(view.camera_to_world, plane, width, height, region, "orthographic", *clip)
        lens = {}
        if self.chance(0.1):
            lens = {"aperture": self.pick(1e-6, 0.1, 1.0) * self.scale, "focus_distance": 3 * self.scale}
        plane = np.array(view.viewplane) * self.pick(1, 1, 1, 1e-4, 4)
        return replace(view, viewplane=plane, region=region, clip_start=clip[0], clip_end=clip[1], **lens)

    def material(self) -> Material:
        rough = self.pick(0.0, 1e-3, 0.1, 0.5, 1.0)
        return self.pick(
            lambda: Material(self.colour(0.0, 1.0, (1, 0, 0))),
            lambda: Material(self.colour(), self.colour() * self.pick(1e-6, 1.0, 1e6)),
            lambda: Material(surface=Diffuse(self.colour(), rough)),
            lambda: Material(surface=Glossy(self.colour(), rough, self.pick("GGX", "MULTI_GGX", "BECKMANN"))),
            lambda: Material(surface=Mix(0.5, Transparent(self.colour(1.0)), Diffuse(self.colour()))),
            lambda: Material(surface=Mix(0.5, Translucent(self.colour()), Emission(self.colour(), 1.0))),
            lambda: Material(surface=Transparent(self.colour(1.0))),
        )()

    def volume(self) -> Volume:
        """Per scale: thin, ordinary, thick, none, and what no fog should be."""

        def coefficient() -> Any:
            strength = self.pick(0.0, 1e-30, 1e-6, 0.03, 0.3, 0.3, 3.0, 100.0, 1e6, 1e20)
            return self.colour((1, 0, 0), 0.0, 1.0) * strength / self.scale

        g = (0.0, 0.5, -0.8, 0.8, 0.99, -0.999, 1.0, -1.0)
        emission = self.pick(0.0, 0.0, 0.0, 1e-6, 1.0, 1e6) / self.scale
        if self.chance(0.2):
            scattering = np.stack([coefficient(), coefficient()])
            return Volume(scattering, coefficient(), [self.pick(*g), self.pick(*g)], emission)
        return Volume(coefficient(), coefficient(), self.pick(*g), emission)

    def shape(self) -> Mesh:
        """A mesh that should be closed, or is not, about anywhere."""
        at = self.pick(np.zeros(3), np.zeros(3), self.point(), self.eye)
        kind = self.random.integers(12)
        if kind < 3:
            mesh = box(at - self.random.uniform(0.2, 2, 3), at + self.random.uniform(0.2, 2, 3))
        elif kind < 6:
            radius = self.pick(1e-5, 0.3, 1.0, 1.0, 4.0, 1e4)
            mesh = sphere(at, radius, smooth=self.chance(0.3), segments=self.pick(4, 8, 24))
        elif kind == 6:  # without thickness
            mesh = box(at - (1, 1, 0), at + (1, 1, 0))
        elif kind == 7:  # open
            mesh = box(at - 1, at + 1)
            mesh = replace(mesh, triangles=mesh.triangles[self.random.integers(1, 12) :])
        elif kind == 8:  # of no area
            mesh = Mesh([at, at + 1, at + 2], [[0, 0, 0], [0, 1, 2], [0, 1, 1]])
        elif kind == 9:  # needles
            mesh = Mesh(at + self.random.normal(size=(30, 3)) * (1, 1e-6, 1e-6), np.arange(30).reshape(10, 3))
        elif kind == 10:
            mesh = floor(self.pick(1.0, 4.0, 1e5), at[2] - 0.5)
        else:  # a soup
            mesh = Mesh(at + self.random.normal(size=(60, 3)), np.arange(60).reshape(20, 3))
        triangles = mesh.triangles[:, ::-1] if self.chance(0.1) else mesh.triangles
        vertices = np.array(mesh.vertices, np.float64) * self.scale
        if self.chance(0.05):
            vertices[self.random.integers(len(vertices))] = self.pick(np.nan, np.inf, 1e30)
        with np.errstate(over="ignore"):
            return replace(mesh, vertices=vertices.astype(np.float32), triangles=triangles)

    def meshes(self, materials: int, volumes: int) -> list[Mesh]:
        """Each volume in one or two, and as many as four that are surfaces alone."""
        shapes = []
        for volume in range(volumes):
            for _ in range(self.pick(1, 1, 2)):
                bounds = replace(self.shape(), volume=volume, surface=self.chance(0.2))
                shapes.append(bounds)
                if self.chance(0.1):
                    shapes.append(bounds)
        shapes += [self.shape() for _ in range(self.random.integers(0, 5))]
        return [
            replace(
                shape,
                materials=int(self.random.integers(materials)),
                visible_to_camera=not self.chance(0.1),
                casts_shadow=not self.chance(0.1),
                holdout=self.chance(0.05),
            )
            for shape in shapes
        ]

    def light(self) -> Light:
        position = (
            self.pick(self.point(), self.point(), self.point(2), self.eye, np.full(3, 1e4)) * self.scale
        )
        power = self.colour(0.0, (1, 0, 0)) * self.pick(1e-20, 1.0, 100.0, 100.0, 1e10) * self.scale**2
        size = self.pick(0.0, 0.0, 1e-9, 1e-3, 0.3, 0.3, 2.0, 1e3) * self.scale
        matrix = place(position, self.point(), self.pick(1.0, 1.0, 1.0, (2, 0.5, -1), (1, 1, 0), 1e-6))
        common = {
            "casts_shadow": not self.chance(0.1),
            "visible_to_camera": self.chance(0.3),
            "normalize": self.chance(0.8),
        }
        ball = self.chance(0.5)
        kinds: list[Callable[[], Light]] = [
            lambda: PointLight(power, position=position, radius=size, sphere=ball, **common),
            lambda: SpotLight(
                power,
                light_to_world=matrix,
                radius=size,
                sphere=ball,
                angle=self.pick(1e-4, 0.1, 0.8, np.pi),
                blend=self.pick(0.0, 0.15, 1.0),
                **common,
            ),
            lambda: AreaLight(
                power,
                light_to_world=matrix,
                size=(size, self.pick(size, self.scale, 0.0)),
                ellipse=ball,
                spread=self.pick(np.pi, np.pi, 0.0, 1e-3, 1.0),
                **common,
            ),
            lambda: SunLight(
                self.colour() * self.pick(1e-20, 1.0, 1e10),
                direction=self.point(),
                angle=self.pick(0.0, 1e-12, 0.01, 0.5, np.pi),
                **common,
            ),
        ]
        return kinds[self.random.integers(4)]()

    def laser(self) -> Laser:
        """From anywhere, from the camera or along its view, into it, along an axis of the boxes."""
        start = self.pick(self.point(), self.point(2), self.eye)
        away = self.pick(self.point(), -self.eye, self.eye - start, np.eye(3)[self.random.integers(3)])
        length = np.linalg.norm(away)
        back = -away / length if length > 0 else np.array([0.0, 0.0, 1.0])
        side = np.cross(back, np.eye(3)[np.abs(back).argmin()])
        side /= np.linalg.norm(side)
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack([side, np.cross(back, side), back], axis=1)
        matrix[:3, 3] = start * self.scale
        if self.chance(0.05):
            matrix[:3, 2] = 0
        parts = {part: not self.chance(0.15) for part in ("in_fog", "on_surfaces", "beam", "spot")}
        return Laser(
            self.colour(0.0, (0, 1, 0)) * self.pick(1e-20, 1.0, 10.0, 1e10) * self.scale**2,
            light_to_world=matrix,
            radius=self.pick(0.0, 1e-9, 1e-3, 0.01, 0.1, 3.0) * self.scale,
            length=self.pick(0.0, 1e-9, 2.0, np.inf, np.inf, np.inf) * self.scale,
            casts_shadow=not self.chance(0.1),
            **parts,
        )

    def linking(self) -> Linking:
        sets = [None, *(frozenset(s for s in range(3) if self.chance(0.6)) for _ in range(2))]
        return Linking(self.pick(*sets), self.pick(*sets), self.chance(0.9))

    def linked(self, scene: Scene) -> Scene:
        """The same with light and shadow links."""

        def sets(**names: int) -> dict[str, int]:
            return {name: int(self.random.integers(most)) for name, most in names.items()}

        return replace(
            scene,
            lights=[replace(light, linking=self.linking()) for light in scene.lights],
            meshes=[
                replace(mesh, linking=self.linking(), **sets(light_set=3, shadow_set=3))
                for mesh in scene.meshes
            ],
            volumes=[replace(volume, **sets(light_set=self.pick(1, 2))) for volume in scene.volumes],
        )

    def world(self, volumes: int) -> World:
        volume = int(self.random.integers(volumes)) if volumes and self.chance(0.4) else -1
        radiance = self.pick(0.0, 0.0, 0.1, self.colour(), 1e10)
        image = None
        if self.chance(0.2):
            image = self.random.uniform(0, 1, self.pick((1, 1, 3), (4, 9, 3), (16, 32, 3))) ** self.pick(
                1, 20
            )
        return World(radiance, self.chance(0.7), image=image, volume=volume)

    def settings(self, quick: bool) -> Settings:
        """quick : without the integrator that takes as long as it takes."""
        integrators = [name for name in INTEGRATORS if name != "quadrature" or not quick]
        return Settings(
            samples=int(self.pick(1, 2, 3, 4)),
            light_samples=int(self.pick(0, 0, 1)),
            # What users have is tested the most.
            integrator=self.pick("control_variates", *integrators),
            seed=int(self.random.integers(1 << 20)),
            direct_sampling=self.pick("mis", *DIRECT_SAMPLING),
            distance_sampling=self.pick("auto", "auto", *DISTANCE_SAMPLING),
            transparent_bounces=int(self.pick(0, 1, 8)),
            transparent=self.chance(0.3),
            normals=self.chance(0.3),
            standard_error=self.chance(0.5),
        )


def wild_scene(seed: int) -> tuple[Scene, Settings]:
    """Up to 4 volumes, 5 lasers and 6 lights among meshes of every kind."""
    wild = Wild(seed)
    volumes = [wild.volume() for _ in range(wild.pick(0, 1, 1, 1, 2, 3, 4))]
    materials = [wild.material() for _ in range(3)]
    lights = [wild.light() for _ in range(wild.random.integers(0, 7))]
    lasers = [wild.laser() for _ in range(wild.pick(0, 0, 1, 1, 2, 5))]
    scene = Scene(
        wild.camera(),
        wild.meshes(len(materials), len(volumes)),
        materials,
        (*lights, *lasers),
        wild.world(len(volumes)),
        volumes=volumes,
    )
    settings = wild.settings(len(lights) > 3)
    return wild.linked(scene) if wild.chance(0.3) else scene, settings


@pytest.fixture(autouse=True)
def as_in_large_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is spent on a picture however small would be all of it here."""
    monkeypatch.setattr(screen_picture, "FEWEST", 256)


def brightest_sample(scene: Scene, settings: Settings) -> float:
    """Of one sample in each pixel of a picture of the same frame, by points that no polynomial has chosen."""
    camera = scene.camera
    finer = replace(
        camera,
        width=FINER * camera.width,
        height=FINER * camera.height,
        region=FINER * np.array(camera.region),
    )
    alone = replace(
        settings, integrator="sobol", samples=1, light_samples=1, threads=2, distance_sampling="auto"
    )
    return float(render(replace(scene, camera=finer), alone).combined[..., :3].max())


def assert_alike(one: Film, other: Film) -> None:
    for name in ("combined", "depth", "normal", "sample_count", "control_variate", "residual"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def check(seed: int) -> None:
    scene, settings = wild_scene(seed)
    film = render(scene, replace(settings, threads=1))
    assert_picture_is_sound(film)
    assert_alike(film, render(scene, replace(settings, threads=2)))
    if settings.integrator == "cv_only":
        return  # polynomials alone say what they like of fog that is too thick for them
    radiance = film.combined[..., :3]
    # What glows may be seen by one sample and not by another.
    glowing = max(material.emission.max() for material in scene.materials)
    brightest = max(brightest_sample(scene, settings), glowing)
    if radiance.max() > FACTOR * brightest:
        # What is too small to be found so is found on purpose, by every seed.
        again = render(scene, replace(settings, seed=settings.seed + 1, threads=2))
        brightest = max(brightest, again.combined[..., :3].max())
    assert radiance.max() <= FACTOR * brightest, "a firefly"
    assert radiance.min() >= -FACTOR * brightest


@pytest.mark.parametrize("first", range(0, SCENES, AT_ONCE))
def test_wild_scenes_are_sound(first: int) -> None:
    for seed in range(first, first + AT_ONCE):
        try:
            check(seed)
        except Exception as error:
            raise AssertionError(f"wild_scene({seed})") from error


@pytest.mark.parametrize("seed", [267, 273, 357, 461, 596, 608, 703, 9057])
def test_scenes_that_were_not(seed: int) -> None:
    """Quadrature of what no ray of a batch hits, thickest fog, g = -1, endless crossings, one region."""
    check(seed)


@pytest.mark.full
@pytest.mark.parametrize("first", range(SCENES, FULL_SCENES, AT_ONCE))
def test_more_wild_scenes_are_sound(first: int) -> None:
    test_wild_scenes_are_sound(first)
