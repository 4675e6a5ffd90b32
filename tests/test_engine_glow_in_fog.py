# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of glowing fog that fog scatters: closed forms, brute force, and that its pictures are unbiased."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scenes import assert_mean, box

from engine_core import Camera, Material, Mesh, Scene, Settings, Volume, World, render
from engine_core.shading.closures import Transparent

SIGMA, ABSORPTION, GLOW = np.array([0.5, 0.2, 0.05]), np.array([0.1, 0.3, 0.05]), np.array([1.0, 2.0, 3.0])
EYE = np.array([0.3, -4.0, 0.4])


def narrow(size: int = 4, direction: tuple = (-0.05, 1.0, -0.1)) -> Camera:
    """All of whose rays are one."""
    return Camera.look_at(tuple(EYE), tuple(EYE + direction), size, size, 1e-4, clip_start=1e-3)


@pytest.mark.parametrize("g", [-0.8, 0.0, 0.8])
@pytest.mark.parametrize("integrator", ["control_variates", "sobol"])
def test_a_fog_without_end_that_glows(integrator: str, g: float) -> None:
    """E / sigma_t comes from everywhere, of which sigma_s / sigma_t is scattered once."""
    fog = Volume(SIGMA, 0.6 - SIGMA, g, GLOW)
    scene = Scene(narrow(), materials=[Material()], world=World(volume=0), volumes=[fog])
    film = render(scene, Settings(2, integrator=integrator, threads=1))
    scattered = GLOW / 0.6 * SIGMA / 0.6
    for found, expected in ((film.volume, scattered), (film.combined[..., :3], GLOW / 0.6 + scattered)):
        np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=1e-4)


def spans(low: np.ndarray, high: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(2, N) from where to where rays (N, 3) are in a block."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (low - origin) / direction, (high - origin) / direction
    start = np.maximum(np.minimum(one, other).max(axis=1), 0)
    return np.stack([start, np.maximum(np.maximum(one, other).min(axis=1), start)])


BLOCKS = [
    ((-1, -1, -1), (1, 1, 1)),
    ((-0.6, -0.4, -0.5), (0.2, 0.5, 0.3)),
    ((0.1, -0.3, -0.8), (1.4, 0.6, 0.9)),
]
FOGS = [
    Volume([SIGMA, SIGMA[::-1] / 2], ABSORPTION, [0.8, -0.5]),
    Volume(0.3, 0.2, 0.3, emission=GLOW),
    Volume(0.0, 0.4, 0.0, emission=GLOW[::-1] / 2),
]
PLATE = np.array([(-0.9, -0.9, 0.35), (0.5, -0.9, 0.35), (0.5, 0.9, 0.35), (-0.9, 0.9, 0.35)])


def along(origin: np.ndarray, direction: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What arrives of blocks' glow along rays (N, 3), and the optical depth, (N, 3) each, to ``end`` (N,)."""
    inside = np.minimum([spans(*np.array(block, float), origin, direction) for block in BLOCKS], end)
    cuts = np.sort(inside.reshape(-1, len(direction)), axis=0)
    depth, light = np.zeros((2, len(direction), 3))
    for start, stop in zip(cuts[:-1], cuts[1:], strict=True):
        middle = (start + stop) / 2
        within = (inside[:, 0] < middle) & (middle < inside[:, 1])
        extinction, glow = (
            sum(w[:, None] * np.broadcast_to(x, 3) for w, x in zip(within, of, strict=True))
            for of in ([fog.extinction for fog in FOGS], [fog.emission for fog in FOGS])
        )
        own = extinction * (stop - start)[:, None]
        light += np.exp(-depth) * glow * -np.expm1(-own) / np.maximum(extinction, 1e-9)
        depth += own
    return light, depth


def blocked_at(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(N,) where rays meet the plate."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (PLATE[0, 2] - origin[2]) / direction[:, 2]
    x, y = (origin[:2] + t[:, None] * direction[:, :2]).T
    met = (t > 0) & (PLATE[0, 0] < x) & (x < PLATE[1, 0]) & (PLATE[0, 1] < y) & (y < PLATE[2, 1])
    return np.where(met, t, np.inf)


def brute_force(direction: np.ndarray) -> np.ndarray:
    """(3,) what is scattered once along a ray from `EYE`: the double integral, point by point."""
    cosine = (np.arange(160) + 0.5) / 80 - 1
    angle = (np.arange(320) + 0.5) / 160 * np.pi
    cosine, angle = (a.ravel() for a in np.meshgrid(cosine, angle))
    sine = np.sqrt(1 - cosine * cosine)
    towards = np.stack([sine * np.cos(angle), sine * np.sin(angle), cosine], axis=1)
    cosine = towards @ direction
    inside = [spans(*np.array(block, float), EYE, direction[None])[:, 0] for block in BLOCKS]
    cuts = np.sort(np.concatenate(inside))
    total = np.zeros(3)
    for start, stop in zip(cuts[:-1], cuts[1:], strict=True):
        nodes, weights = np.polynomial.legendre.leggauss(12)
        for t, weight in zip((start + stop) / 2 + nodes * (stop - start) / 2, weights, strict=True):
            scattered = np.zeros((len(towards), 3))
            for (low, high), fog in zip(inside, FOGS, strict=True):
                for sigma, g in zip(fog.scattering, fog.anisotropy, strict=True):
                    phase = (1 - g * g) / (4 * np.pi) / (1 + g * g - 2 * g * cosine) ** 1.5
                    scattered += (low < t < high) * phase[:, None] * sigma
            point = EYE + t * direction
            arriving = along(point, towards, blocked_at(point, towards))[0]
            passed = np.exp(-along(EYE, direction[None], np.array([t]))[1][0])
            total += weight * (stop - start) / 2 * passed * (scattered * arriving).mean(axis=0) * 4 * np.pi
    return total


def among_blocks(camera: Camera, **fields) -> Scene:
    meshes = [box(low, high, volume=i, surface=False) for i, (low, high) in enumerate(BLOCKS)]
    plate = Mesh(PLATE, np.array([(0, 1, 2), (0, 2, 3)]))
    return Scene(camera, [*meshes, plate], [Material(0.0)], volumes=FOGS, **fields)


@pytest.mark.parametrize("integrator", ["control_variates", "sobol"])
def test_fogs_that_overlap_light_each_other(integrator: str) -> None:
    """Of several phase functions and colours, with an opaque plate between."""
    direction = np.array([-0.05, 1.0, -0.1]) / np.linalg.norm([-0.05, 1.0, -0.1])
    scene = among_blocks(narrow())
    settings = Settings(256, integrator=integrator, threads=1)
    found = [render(scene, replace(settings, seed=s)).volume.mean(axis=(0, 1)) for s in range(6)]
    assert_mean(np.array(found), brute_force(direction), rounding=1e-3)


def fires(camera: Camera) -> Scene:
    """More of them in fog than samples look for, one of which has no inside."""
    corner = np.indices((4, 3)).reshape(2, -1).T[:, [0, 0, 1]] * (0.6, 0.1, 0.5) + (-1, 0, -0.6)
    meshes = [box(low, low + 0.2, volume=1, surface=False) for low in corner]
    flat = box((0, 0, 0), (0.5, 0.5, 0), volume=1, surface=False)
    volumes = [Volume(0.2, 0.1, 0.5), Volume(0.0, 1.0, emission=GLOW)]
    return Scene(camera, [*meshes, flat], [Material(0.0)], volumes=volumes, world=World(volume=0))


@pytest.mark.parametrize("made", [among_blocks, fires])
def test_pictures_lit_by_glowing_fog_are_unbiased(made: Callable[[Camera], Scene]) -> None:
    """The mean over seeds, of the whole picture and of its quarters, is that of plain samples."""
    scene = made(Camera.look_at((0.3, -4, 1.0), (0, 0, 0), 48, 32, 0.6))

    def quarters(settings: Settings, seeds: range) -> np.ndarray:
        films = [render(scene, replace(settings, seed=s)).volume for s in seeds]
        return np.array(films).reshape(-1, 2, 16, 2, 24, 3).mean(axis=(2, 4, 5), dtype=np.float64)

    plain, ours = (
        quarters(Settings(64, integrator="sobol"), range(900, 906)),
        quarters(Settings(8), range(12)),
    )
    error = np.hypot(ours.std(axis=0, ddof=1) / 12**0.5, plain.std(axis=0, ddof=1) / 6**0.5)
    difference = ours.mean(axis=0) - plain.mean(axis=0)
    assert (np.abs(difference) < 4.5 * error + 1e-3 * plain.mean()).all()


def test_a_pane_before_glowing_fog_leaves_a_part_of_it() -> None:
    """What it lets through is a part of what fog scatters, too, and no more of it: the pane is outside."""
    scene = among_blocks(narrow())
    corners = np.array([(-2, -2.5, -2), (2, -2.5, -2), (2, -2.5, 2), (-2, -2.5, 2)])
    pane = Mesh(corners, np.array([(0, 1, 2), (0, 2, 3)]), materials=1)
    dimmed = replace(
        scene,
        meshes=[*scene.meshes, pane],
        materials=[Material(0.0), Material(surface=Transparent((0.5, 0.25, 1.0)))],
    )
    found, clear = (
        render(made, Settings(64, threads=1)).volume.mean(axis=(0, 1)) for made in (dimmed, scene)
    )
    np.testing.assert_allclose(found, clear * (0.5, 0.25, 1.0), rtol=2e-2)


def test_fog_that_does_not_scatter_is_seen_alone() -> None:
    scene = Scene(narrow(), [box(volume=0, surface=False)], [Material()], volumes=[Volume(0, 0.5, 0, 1.0)])
    film = render(scene, Settings(2, threads=1))
    assert film.combined[..., :3].min() > 0.5 and not film.volume.any()
