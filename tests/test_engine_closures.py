# SPDX-License-Identifier: GPL-3.0-or-later
"""Closures: the lobes and weights that shader nodes become, as in Cycles."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

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
from engine_core.shading.points import ShadingPoints
from engine_core.shading.terms import SurfaceTerms
from engine_core.shading.values import Value

COLOR = (0.8, 0.3, 0.1)
WHITE = (1.0, 1.0, 1.0)
BENT = tuple(np.array([0.3, 0.2, 0.9]) / np.sqrt(0.94))
NORMAL = np.array([-0.5206656, -0.1206663, 0.8451905])
SUN = np.array([-0.8619375, -0.0899935, 0.4989638])
GENERATED = np.array([0.6897627, 0.9461687, 0.5])

CYCLES = [
    (Diffuse(COLOR), (0.22444, 0.084164, 0.028055)),
    (Diffuse(COLOR, 0.3), (0.20478, 0.072445, 0.023945)),
    (Diffuse(COLOR, 1.0), (0.16817, 0.051048, 0.01649)),
    (Diffuse(WHITE, 0.5), (0.25712, 0.25712, 0.25712)),
    (Diffuse(COLOR, 0.7, BENT), (0.047737, 0.017487, 0.0058102)),
    (Glossy(COLOR, 0.15), (1.0061, 0.37717, 0.1257)),
    (Glossy(COLOR, 0.7), (0.38699, 0.12046, 0.03756)),
    (Glossy(COLOR, 0.5, anisotropy=0.5, rotation=0.1), (1.0737, 0.38219, 0.1249)),
    (Glossy(COLOR, 0.5, anisotropy=-0.7, rotation=0.1), (0.38412, 0.13673, 0.044683)),
    (Glossy(COLOR, 0.4, "GGX"), (1.9837, 0.74389, 0.24796)),
    (Glossy(COLOR, 0.7, "BECKMANN"), (0.30987, 0.1162, 0.038733)),
    (Glossy(COLOR, 0.5, "BECKMANN", 0.5, 0.1), (1.094, 0.41026, 0.13675)),
    (Glossy(COLOR, 0.4, "ASHIKHMIN_SHIRLEY"), (2.2852, 0.85697, 0.28566)),
    (Glossy(COLOR, 0.5, "ASHIKHMIN_SHIRLEY", 0.5, 0.1), (0.98985, 0.37119, 0.12373)),
    (Glossy(COLOR, 0.4, normal=BENT), (0.0042618, 0.0015694, 0.00051946)),
    (Principled(COLOR), (0.26843, 0.13382, 0.07998)),
    (Principled(COLOR, distribution="GGX"), (0.26706, 0.13302, 0.079409)),
    (Principled(COLOR, roughness=0.2), (0.33409, 0.19977, 0.14604)),
    (Principled(COLOR, roughness=1.0), (0.22453, 0.086466, 0.03124)),
    (Principled(COLOR, metallic=1.0), (1.1006, 0.39271, 0.12848)),
    (Principled(COLOR, metallic=1.0, roughness=0.8, distribution="GGX"), (0.16941, 0.063536, 0.021185)),
    (
        Principled(COLOR, metallic=0.4, roughness=0.3, specular_tint=(0.2, 0.5, 0.9)),
        (1.4603, 0.58897, 0.26996),
    ),
    (Principled(COLOR, roughness=0.3, ior=2.5), (0.93504, 0.82065, 0.7749)),
    (Principled(COLOR, ior=0.7), (0.27194, 0.13637, 0.082137)),
    (Principled(COLOR, ior=1.0), (0.22444, 0.084164, 0.028055)),
    (Principled(COLOR, specular_ior_level=1.0), (0.31203, 0.18267, 0.13093)),
    (Principled(COLOR, specular_ior_level=0.2, specular_tint=(0.9, 0.2, 0.4)), (0.24041, 0.088092, 0.036932)),
    (Principled(COLOR, specular_tint=(0.9, 0.2, 2.0)), (0.25511, 0.089896, 0.13037)),
    (Principled(COLOR, ior=0.7, specular_ior_level=0.8), (0.31128, 0.17837, 0.1252)),
    (Principled(COLOR, diffuse_roughness=0.8), (0.22343, 0.10724, 0.070689)),
    (
        Principled(COLOR, roughness=0.4, anisotropic=0.6, anisotropic_rotation=0.2),
        (0.3284, 0.19404, 0.1403),
    ),
    (Principled(COLOR, metallic=1.0, roughness=0.3, anisotropic=0.9), (0.4358, 0.16253, 0.054071)),
    (Principled(COLOR, coat_weight=1.0), (0.25718, 0.12826, 0.076699)),
    (Principled(COLOR, coat_weight=0.5, coat_roughness=0.4, coat_ior=2.0), (0.39442, 0.26732, 0.21648)),
    (
        Principled(COLOR, coat_weight=1.0, coat_roughness=0.3, coat_tint=(0.2, 0.9, 0.5)),
        (0.21439, 0.28294, 0.20495),
    ),
    (
        Principled(COLOR, metallic=0.5, coat_weight=0.4, coat_roughness=0.3, coat_tint=(0.2, 0.0, 0.5)),
        (0.51918, 0.22266, 0.14838),
    ),
    (
        Principled(
            COLOR,
            coat_weight=0.8,
            coat_roughness=0.2,
            coat_tint=(0.2, 0.9, 0.5),
            emission_color=(1, 0.5, 0.2),
            emission_strength=2.0,
        ),
        (0.84679, 1.0973, 0.36474),
    ),
    (
        Principled(
            COLOR,
            metallic=0.3,
            alpha=0.6,
            specular_tint=(0.3, 0.6, 0.9),
            anisotropic=0.4,
            coat_weight=0.5,
            coat_roughness=0.25,
            emission_strength=0.1,
        ),
        (0.37948, 0.21745, 0.15876),
    ),
    (Principled(COLOR, normal=BENT, coat_weight=1.0, coat_roughness=0.3), (0.20996, 0.18429, 0.17403)),
    (Principled(COLOR, coat_weight=1.0, coat_roughness=0.3, coat_normal=BENT), (0.25765, 0.12849, 0.076825)),
    (Principled((1.5, 0.5, 0.1), metallic=0.5), (0.93085, 0.42751, 0.10423)),
]
"""What Cycles 4.5.15 renders of a plane of each: with NORMAL, seen along -z, lit by a sun of strength 1 and
angle 0 towards SUN, at zero bounces. 5.2.3 renders the same."""


def _rows(v: Any, count: int) -> np.ndarray:
    return np.repeat(np.asarray(v, np.float32)[:, None], count, axis=1)


def _points(count: int = 1, normal: Any = NORMAL, viewer: Any = (0, 0, 1)) -> ShadingPoints:
    """normal, viewer : (3,) or (3, count)."""
    normal, viewer = (_rows(v, count) if np.ndim(v) == 1 else v.astype(np.float32) for v in (normal, viewer))

    def attributes(name: str, width: int) -> np.ndarray:
        return _rows(GENERATED, count) if name == "generated" else np.zeros((width, count), np.float32)

    return ShadingPoints(normal, normal, normal, viewer, np.zeros(count, bool), attributes)


def _shaded(closure: Closure, points: ShadingPoints, weight: Any = 1.0, lobes: bool = True) -> SurfaceTerms:
    terms = SurfaceTerms(lobes)
    closure.shade(points, np.asarray(weight, np.float32), terms)
    return terms


def _seen(terms: SurfaceTerms, light: np.ndarray) -> np.ndarray:
    """(3, N) of a light of irradiance 1."""
    seen = np.zeros_like(light) + terms.emission
    for lobe in terms.lobes:
        seen += lobe.evaluate(None, light)[0]
    return seen


@pytest.mark.parametrize("closure, wanted", CYCLES, ids=lambda x: type(x).__name__)
def test_pixels_of_cycles(closure: Closure, wanted: tuple[float, ...]):
    seen = _seen(_shaded(closure, _points()), _rows(SUN, 1))[:, 0]
    assert seen == pytest.approx(wanted, rel=1e-3)


# -- energy ----------------------------------------------------------------------------------------


def _albedo(closure: Closure, cosine: float, size: int = 64) -> np.ndarray:
    """(3,) reflected of an even white world: by each lobe's own samples, cosine-weighted for smooth ones."""
    viewer = np.array([np.sqrt(1 - cosine**2), 0, cosine])
    terms = _shaded(closure, _points(1, (0, 0, 1), viewer))
    c = (np.arange(size) + 0.5) / size
    u = np.stack([a.ravel() for a in np.meshgrid(c, c)]).astype(np.float32)
    lanes = np.zeros(size * size, np.intp)
    radius, turn = np.sqrt(u[0]), 2 * np.pi * u[1]
    around = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - u[0])]).astype(np.float32)
    total = np.zeros(3)
    for lobe in terms.lobes:
        light = around if lobe.smooth else lobe.sample(lanes, u)
        value, pdf = lobe.evaluate(lanes, light)
        pdf = around[2] / np.pi if lobe.smooth else pdf
        total += np.where(pdf > 0, value / np.maximum(pdf, 1e-30), 0).astype(float).mean(axis=1)
    return total


@pytest.mark.parametrize("roughness", [0.0, 0.1, 0.32, 0.5, 0.77, 1.0])
@pytest.mark.parametrize("cosine", [0.1, 0.35, 0.7, 1.0])
def test_white_furnace_of_multiscattering_facets(roughness: float, cosine: float):
    assert _albedo(Glossy(WHITE, roughness), cosine) == pytest.approx(1, abs=0.01)
    assert _albedo(Principled(WHITE, metallic=1.0, roughness=roughness), cosine) == pytest.approx(1, abs=0.01)
    assert _albedo(Glossy(WHITE, roughness, "GGX"), cosine).max() < 1.002


@pytest.mark.parametrize("distribution", ["MULTI_GGX", "GGX"])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"ior": 2.5},
        {"metallic": 0.5},
        {"coat_weight": 1.0, "coat_ior": 2.0, "coat_roughness": 0.3},
        {"diffuse_roughness": 1.0, "specular_tint": (0.2, 1.0, 1.0)},
        {"anisotropic": 0.8, "alpha": 0.9, "coat_weight": 0.5},
    ],
    ids=lambda o: " ".join(o) or "default",
)
def test_white_principled_surface_reflects_at_most_all(distribution: str, options: dict[str, Any]):
    for roughness in (0.05, 0.5, 1.0):
        for cosine in (0.2, 0.9):
            closure = Principled(WHITE, roughness=roughness, distribution=distribution, **options)
            albedo = _albedo(closure, cosine)
            # Layers are weighed by tabulated albedos, which are mean Fresnel factors, masking aside.
            assert albedo.max() < 1.02
            assert albedo.max() > (0.9 if distribution == "MULTI_GGX" else 0.6) * options.get("alpha", 1)


# -- mixing, and what is not a lobe ----------------------------------------------------------------


class Given(Value):
    """What it is told."""

    def __init__(self, array: Any) -> None:
        self.array = np.asarray(array, np.float32)

    def evaluate(self, points: ShadingPoints) -> np.ndarray:
        return self.array


def test_mix_and_add_are_linear():
    first, second = Diffuse(COLOR), Glossy(WHITE, 0.5)
    light, points = _rows(SUN, 1), _points()
    a, b = (_seen(_shaded(c, points), light) for c in (first, second))
    np.testing.assert_allclose(
        _seen(_shaded(Mix(0.3, first, second), points), light), 0.7 * a + 0.3 * b, 1e-5
    )
    np.testing.assert_allclose(_seen(_shaded(Add(first, second), points), light), a + b, 1e-5)
    np.testing.assert_allclose(_seen(_shaded(Mix(2.0, first, second), points), light), b, 1e-5)
    np.testing.assert_allclose(_seen(_shaded(Mix(0.3, None, second), points), light), 0.3 * b, 1e-5)
    assert _seen(_shaded(Add(None, None), points), light).max() == 0


def test_transparency_emission_and_holdout():
    points = _points(2)
    mixed = Mix(Given([0.25, 0.5]), Transparent((1, 0.5, 0)), Add(Emission((1, 2, 3), 2.0), Holdout()))
    for lobes in (True, False):
        terms = _shaded(mixed, points, lobes=lobes)
        assert not terms.lobes
        np.testing.assert_allclose(terms.transparency, [[0.75, 0.5], [0.375, 0.25], [0, 0]])
        np.testing.assert_allclose(terms.emission, np.outer([2, 4, 6], [0.25, 0.5]))
        np.testing.assert_allclose(terms.holdout, [0.25, 0.5])
    assert _shaded(Holdout(), points, np.full((3, 2), 0.3)).holdout == pytest.approx(0.3)


def test_emission_and_alpha_need_no_lobes():
    glowing = Principled(
        COLOR, alpha=Given([0.2, 0.9]), coat_weight=0.7, coat_tint=COLOR, emission_strength=Given([0, 3])
    )
    points = _points(2)
    every, few = (_shaded(glowing, points, 0.5, lobes) for lobes in (True, False))
    assert len(every.lobes) == 3 and not few.lobes
    np.testing.assert_allclose(few.emission, every.emission)
    np.testing.assert_allclose(few.transparency, [[0.4, 0.05]] * 3, rtol=1e-6)
    assert (few.emission[:, 0] == 0).all() and (few.emission[:, 1] > 0.5 * np.array(COLOR)).all()


def test_a_metal_has_but_one_lobe():
    assert len(_shaded(Principled(COLOR, metallic=1.0), _points()).lobes) == 1
    assert len(_shaded(Principled(COLOR, ior=1.0), _points()).lobes) == 1
    assert not _shaded(Principled(COLOR), _points(), lobes=False).lobes


@pytest.mark.parametrize(
    "closure",
    [
        Diffuse(COLOR, 0.4),
        Translucent(COLOR),
        Glossy(COLOR, 0.4, "BECKMANN", 0.3),
        Principled(COLOR, 0.3, 0.4, anisotropic=0.2, coat_weight=0.5, coat_tint=COLOR, normal=BENT),
    ],
    ids=lambda c: type(c).__name__,
)
def test_values_at_points_are_as_good_as_constants(closure: Closure):
    points, light = _points(3), _rows(SUN, 3)
    varying = {
        name: Given(_rows(value, 3) if isinstance(value, tuple) else np.full(3, value, np.float32))
        for name, value in vars(closure).items()
        if isinstance(value, tuple | float)
    }
    wanted = _seen(_shaded(closure, points), light)
    np.testing.assert_allclose(_seen(_shaded(replace(closure, **varying), points), light), wanted, rtol=2e-5)
    seen = _seen(_shaded(closure, points, np.full((3, 3), 0.5)), light)
    np.testing.assert_allclose(seen, 0.5 * wanted, rtol=1e-5)


def test_bent_normals_let_no_light_through():
    """Light from below the surface, but above the bent normal's horizon."""
    below = _rows([0.8, 0.0, -0.6], 1)
    leaning = tuple(np.array([1, 0, 1]) / np.sqrt(2))
    points = _points(1, (0, 0, 1), (0, 0, 1))
    for closure in (
        Diffuse(WHITE, normal=leaning),
        Diffuse(WHITE, 0.5, leaning),
        Glossy(WHITE, 1.0, normal=leaning),
    ):
        assert not _seen(_shaded(closure, points), below).any()
    assert not _seen(_shaded(Translucent(WHITE, leaning), points), _rows([-0.8, 0, 0.6], 1)).any()


def test_nasty_parameters_give_finite_terms():
    """Whatever nodes compute: out of range, null vectors, normals seen from behind."""
    n = 4000
    rng = np.random.default_rng(12)

    def unit() -> np.ndarray:
        v = rng.normal(size=(3, n))
        return (v / np.linalg.norm(v, axis=0)).astype(np.float32)

    def number(*often: float) -> Given:
        wild = rng.normal(size=n) * 10.0 ** rng.integers(-6, 4, n)
        return Given(np.where(rng.random(n) < 0.6, rng.choice(often, n), wild))

    def vector() -> Given:
        return Given(unit() * rng.choice([0, 1, 1, 1e-30, 1e6], n))

    def color() -> Given:
        return Given(rng.choice([0, 0.5, 1, 2, -1, 1e4], (3, n)))

    normal, viewer = unit(), unit()
    viewer *= np.where((normal * viewer).sum(0) < 0, -1, 1).astype(np.float32)
    points = _points(n, normal, viewer)
    closures = [
        Diffuse(color(), number(0, 0.5, 1), vector()),
        Translucent(color(), vector()),
        *(
            Glossy(color(), number(0, 0.5, 1), kind, number(0, 1, -1), number(0, 0.5), vector(), vector())
            for kind in ("MULTI_GGX", "GGX", "BECKMANN", "ASHIKHMIN_SHIRLEY")
        ),
        Principled(
            color(),
            number(0, 0.5, 1),
            number(0, 0.5, 1),
            number(0, 1, 1.5),
            number(0, 0.5, 1),
            vector(),
            number(0, 1),
            number(0, 0.5, 1),
            color(),
            number(0, 1),
            number(0, 0.5),
            vector(),
            number(0, 1),
            number(0, 1),
            number(0, 1, 1.5),
            color(),
            vector(),
            color(),
            number(0, 1),
        ),
    ]
    for closure in closures:
        with np.errstate(divide="raise", invalid="raise"):
            terms = _shaded(closure, points)
            assert np.isfinite(terms.emission).all() and np.isfinite(terms.transparency).all()
            for lobe in terms.lobes:
                assert lobe.weight.min() >= 0
                lights = (
                    [unit()] if lobe.smooth else [unit(), lobe.sample(None, rng.random((2, n), np.float32))]
                )
                for light in lights:
                    value, pdf = lobe.evaluate(None, light)
                    assert np.isfinite(value).all() and value.min() >= 0
                    assert pdf is None or (np.isfinite(pdf).all() and pdf.min() >= 0)
