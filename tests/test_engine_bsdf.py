# SPDX-License-Identifier: GPL-3.0-or-later
"""Lobes: energy, reciprocity, and samplers that do what their pdfs say."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from engine_core.bsdf import energy, fresnel
from engine_core.bsdf.ashikhmin_shirley import AshikhminShirley
from engine_core.bsdf.beckmann import Beckmann
from engine_core.bsdf.diffuse import DiffuseTransmission, Lambert, OrenNayar
from engine_core.bsdf.lobe import Lobe
from engine_core.bsdf.microfacet import GGX, DielectricGGX, MetalGGX
from engine_core.bsdf.normals import tangent_along, valid_reflection_normal

UP = np.array([0, 0, 1.0])


def _rows(v: np.ndarray, count: int) -> np.ndarray:
    return np.repeat(np.asarray(v, np.float32)[:, None], count, axis=1)


def _towards(cosine: float, turn: float = 0.4) -> np.ndarray:
    sine = np.sqrt(1 - cosine * cosine)
    return np.array([sine * np.cos(turn), sine * np.sin(turn), cosine])


def _facets(kind: type, viewer: np.ndarray, x: float, y: float, **more: np.ndarray) -> Lobe:
    """One lane; turned out of the axes so that no component is 0."""
    turn = _rotation()
    tangent = None if x == y else _rows(turn @ [1, 0, 0], 1)
    up, viewer = _rows(turn @ UP, 1), _rows(turn @ viewer, 1)
    return kind.of(
        np.ones((3, 1), np.float32), up, viewer, (np.float32(x), np.float32(y)), tangent, None, **more
    )


def _rotation() -> np.ndarray:
    q, _ = np.linalg.qr(np.array([[1.0, 0.4, 0.2], [-0.3, 1.1, 0.5], [0.2, -0.6, 0.9]]))
    return q * np.sign(np.linalg.det(q))


def _grid(size: int) -> np.ndarray:
    """(2, size^2) cell centres."""
    c = (np.arange(size) + 0.5) / size
    return np.stack([a.ravel() for a in np.meshgrid(c, c)]).astype(np.float32)


def _hemisphere(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (3, N) about the lobes' normal and their solid angles; more of them near the horizon."""
    t, turn = _grid(size)
    cosine = t * t
    sine = np.sqrt(1 - cosine * cosine)
    turn = 2 * np.pi * turn
    local = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine])
    return (_rotation() @ local).astype(np.float32), 2 * np.pi * 2 * t / t.size


def _albedo(lobe: Lobe, size: int = 512) -> np.ndarray:
    """(3,) by quadrature over directions, which knows no sampler."""
    light, angle = _hemisphere(size)
    value, _ = lobe.evaluate(np.zeros(light.shape[1], np.intp), light)
    return value.astype(float) @ angle


KINDS = [GGX, Beckmann, AshikhminShirley]
WIDTHS = [(0.09, 0.09), (0.4, 0.4), (1.0, 1.0), (0.15, 0.6)]


# -- diffuse ---------------------------------------------------------------------------------------


def _oren_nayar(roughness: float, color: float, cosine: float) -> OrenNayar:
    color = np.full((3, 1), color, np.float32)
    up, viewer = _rows(_rotation() @ UP, 1), _rows(_rotation() @ _towards(cosine), 1)
    return OrenNayar.of(color, color, np.float32(roughness), up, viewer, None)


@pytest.mark.parametrize("cosine", [0.05, 0.4, 1.0])
@pytest.mark.parametrize("roughness", [1e-4, 0.3, 1.0])
def test_white_rough_diffuse_surface_loses_nothing(roughness: float, cosine: float):
    assert _albedo(_oren_nayar(roughness, 1, cosine)) == pytest.approx(1, abs=0.004)


@pytest.mark.parametrize("roughness", [0.0, 0.3, 1.0])
def test_coloured_rough_diffuse_surface_is_darker_the_rougher(roughness: float):
    assert _albedo(_oren_nayar(roughness, 0.5, 0.7)).max() <= 0.5001


def test_oren_nayar_without_roughness_is_lambertian():
    light, _ = _hemisphere(16)
    rough = _oren_nayar(0, 0.6, 0.3)
    lambert = Lambert(rough.weight, rough.normal, rough.towards_viewer)
    lanes = np.zeros(light.shape[1], np.intp)
    np.testing.assert_allclose(rough.evaluate(lanes, light)[0], lambert.evaluate(lanes, light)[0], rtol=2e-6)


def test_translucency_is_lambertian_on_the_other_side():
    light, angle = _hemisphere(128)
    lobe = DiffuseTransmission(np.ones((3, 1), np.float32), _rows(_rotation() @ UP, 1), _rows(UP, 1))
    lanes = np.zeros(light.shape[1], np.intp)
    assert lobe.evaluate(lanes, -light)[0] @ angle == pytest.approx(1, rel=1e-3)
    assert not lobe.evaluate(lanes, light)[0].any()


# -- microfacets -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [GGX, Beckmann])
@pytest.mark.parametrize("x, y", WIDTHS)
def test_facets_reflect_no_more_than_falls_on_them(kind: type, x: float, y: float):
    for cosine in (0.1, 0.5, 0.98):
        assert _albedo(_facets(kind, _towards(cosine), x, y)).max() < 1.002


@pytest.mark.parametrize("kind", [*KINDS, OrenNayar])
def test_reflection_is_reciprocal(kind: type):
    rng = np.random.default_rng(5)
    a, b = (np.abs(v / np.linalg.norm(v, axis=0)) for v in rng.normal(size=(2, 3, 200)))
    up, ones = _rows(UP, 200), np.ones((3, 200), np.float32)

    def bsdf(v: np.ndarray, light: np.ndarray) -> np.ndarray:
        v, light = v.astype(np.float32), light.astype(np.float32)
        if kind is OrenNayar:
            lobe = OrenNayar.of(ones, ones * 0.7, np.float32(0.8), up, v, None)
        else:
            lobe = kind.of(ones, up, v, (np.float32(0.3), np.float32(0.7)), _rows([1, 0, 0], 200), None)
        return lobe.evaluate(None, light)[0][0] / light[2]

    np.testing.assert_allclose(bsdf(a, b), bsdf(b, a), rtol=3e-4, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("x, y", WIDTHS)
@pytest.mark.parametrize("cosine", [0.12, 0.8])
def test_samples_are_distributed_as_the_pdf_says(kind: type, x: float, y: float, cosine: float):
    """Chi-square over 10 x 20 cells of the hemisphere, with one more for all that is below it."""
    rings, turns, fine, count = 10, 20, 48, 100_000
    lobe = _facets(kind, _towards(cosine), x, y)
    lanes = np.zeros(count, np.intp)
    u = np.random.default_rng(17).random((2, count), np.float32)
    local = _rotation().T @ lobe.sample(lanes, u)
    assert np.abs(np.linalg.norm(local, axis=0) - 1).max() < 1e-5
    up = local[2] > 0
    ring = (np.sqrt(np.abs(local[2])) * rings).astype(int).clip(0, rings - 1)
    turn = (np.arctan2(local[1], local[0]) % (2 * np.pi) / (2 * np.pi) * turns).astype(int).clip(0, turns - 1)
    found = np.bincount((ring * turns + turn)[up], minlength=rings * turns).astype(float)
    # t = sqrt(cos) by rows of the fine grid.
    t = np.repeat((np.arange(rings * fine) + 0.5) / (rings * fine), turns * fine)
    phi = np.tile((np.arange(turns * fine) + 0.5) / (turns * fine), rings * fine) * 2 * np.pi
    z = t * t
    light = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z])
    _, pdf = lobe.evaluate(np.zeros(t.size, np.intp), (_rotation() @ light).astype(np.float32))
    mass = pdf * (2 * np.pi * 2 * t / t.size)
    wanted = count * mass.reshape(rings, fine, turns, fine).sum((1, 3)).ravel()
    found, wanted = np.append(found, count - found.sum()), np.append(wanted, count - wanted.sum())
    assert wanted[-1] > -0.002 * count
    order = np.argsort(wanted)
    # Cells in which few are wanted are joined.
    few = order[np.cumsum(wanted[order]) < 20]
    rest = np.setdiff1d(order, few)
    found = np.append(found[rest], found[few].sum())
    wanted = np.append(wanted[rest], max(wanted[few].sum(), 20))
    statistic = ((found - wanted) ** 2 / wanted).sum()
    freedom = len(rest)
    # Five standard deviations, and what quadrature of the pdf errs by.
    assert statistic < freedom + 5 * np.sqrt(2 * freedom) + 10


@pytest.mark.parametrize("kind, share", [(GGX, lambda s: s / (1 + s)), (Beckmann, lambda s: 1 - np.exp(-s))])
@pytest.mark.parametrize("alpha", [1e-3, 0.02])
def test_narrow_lobes_keep_their_slopes(kind: type, share: Callable, alpha: float):
    """Seen straight on, the slopes' distribution is known: it makes them uniform (Kolmogorov and Smirnov)."""
    count = 20_000
    viewer = _rows(UP, 1)
    lobe = kind.of(np.ones((3, 1), np.float32), viewer, viewer, (np.float32(alpha),) * 2, None, None)
    u = np.random.default_rng(8).random((2, count), np.float32)
    light = lobe.sample(np.zeros(count, np.intp), u).astype(float)
    half = light + UP[:, None]
    uniform = np.sort(share((half[0] ** 2 + half[1] ** 2) / (half[2] * alpha) ** 2))
    assert np.abs(uniform - (np.arange(count) + 0.5) / count).max() < 1.95 / np.sqrt(count)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("x, y", [(0.0, 0.0), (1e-3, 1e-3), (0.09, 0.09), (0.15, 0.6)])
def test_weights_of_samples_are_bounded_and_integrate_to_the_albedo(kind: type, x: float, y: float):
    for cosine in (0.3, 0.95):
        lobe = _facets(kind, _towards(cosine), x, y)
        lanes = np.zeros(128**2, np.intp)
        value, pdf = lobe.evaluate(lanes, lobe.sample(lanes, _grid(128)))
        weight = np.where(pdf > 0, value[0] / np.maximum(pdf, 1e-30), 0)
        if kind is not AshikhminShirley:
            assert weight.max() < 1.001
        if x < 0.01:
            assert weight.mean() == pytest.approx(1, abs=0.01)
        else:
            assert weight.mean() == pytest.approx(_albedo(lobe)[0], abs=0.004)


def test_mirror_reflects_the_viewer():
    viewer = _rows(_towards(0.3), 1)
    lobe = GGX.of(np.ones((3, 1), np.float32), _rows(UP, 1), viewer, (np.float32(0),) * 2, None, None)
    light = lobe.sample(np.zeros(64**2, np.intp), _grid(64))
    off = np.linalg.norm(light - viewer * [[-1], [-1], [1]], axis=0)
    assert np.median(off) < 3e-4


def test_a_lobe_seen_from_behind_is_black():
    lobe = _facets(GGX, _towards(-0.2), 0.5, 0.5)
    assert not _albedo(lobe, 32).any()


def test_a_tangent_along_the_normal_is_as_good_as_none():
    """What is left of it is what was rounded off, which leads anywhere."""
    random = np.random.default_rng(3)
    normal = random.normal(size=(3, 4000)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=0)
    for off in (0.0, 1e-7, 1e-6, 1e-3):
        direction = (normal * (1 + off * random.normal(size=normal.shape))).astype(np.float32)
        tangent = tangent_along(direction, normal, np.float32(0.0))
        assert np.abs((tangent * normal).sum(axis=0)).max() < 1e-5
        assert np.abs(np.linalg.norm(tangent, axis=0) - 1).max() < 1e-5


@pytest.mark.parametrize("kind", KINDS)
def test_everything_is_finite(kind: type):
    rng = np.random.default_rng(2)
    n = 20_000
    normal, viewer, light, tangent = (v / np.linalg.norm(v, axis=0) for v in rng.normal(size=(4, 3, n)))
    # Exactly opposite, alike, and grazing.
    light[:, :500], light[:, 500:1000] = -viewer[:, :500], viewer[:, 500:1000]
    viewer[:, 1000:2000] = np.cross(normal[:, 1000:2000], tangent[:, 1000:2000], axis=0)
    normal, viewer, light, tangent = (v.astype(np.float32) for v in (normal, viewer, light, tangent))
    alpha = np.float32(10) ** rng.uniform(-7, 0, (2, n)).astype(np.float32)
    tangent = tangent_along(tangent, normal, np.float32(0.3))
    for t in (None, tangent):
        width = (alpha[0], alpha[1] if t is not None else alpha[0])
        lobe = kind.of(np.ones((3, n), np.float32), normal, viewer, width, t, normal)
        with np.errstate(all="raise", under="ignore"):
            sampled = lobe.sample(None, rng.random((2, n), np.float32))
            for direction in (light, sampled):
                value, pdf = lobe.evaluate(None, direction)
                assert np.isfinite(value).all() and np.isfinite(pdf).all()
                assert value.min() >= 0 and pdf.min() >= 0
                assert value.dtype == pdf.dtype == sampled.dtype == np.float32


def test_lobes_are_taken_and_joined():
    rng = np.random.default_rng(4)
    up, ones = _rows(UP, 5), np.ones((3, 5), np.float32)
    viewer, light = (
        np.abs(v / np.linalg.norm(v, axis=0)).astype(np.float32) for v in rng.normal(size=(2, 3, 5))
    )
    bent = _rows([0.1, 0.2, np.sqrt(0.95)], 5)
    parts = [
        GGX.of(ones, up, viewer, (np.float32(0.3),) * 2, None, None),
        GGX.of(ones, bent, viewer, (np.float32(0.2), np.float32(0.5)), _tangents(bent), up),
    ]
    joined = GGX.concatenate(parts)
    rows = np.array([7, 1, 1, 9])
    taken = joined.take(rows)
    assert len(joined) == 10 and len(taken) == 4
    wanted = np.concatenate([part.evaluate(None, light)[0] for part in parts], axis=1)[:, rows]
    lights = np.concatenate([light, light], axis=1)[:, rows]
    np.testing.assert_allclose(taken.evaluate(None, lights)[0], wanted, rtol=1e-5)
    np.testing.assert_allclose(joined.evaluate(rows, lights)[0], wanted, rtol=1e-5)


def _tangents(normal: np.ndarray) -> np.ndarray:
    return tangent_along(_rows([1, 0, 0], normal.shape[1]), normal, np.float32(0.1))


# -- Fresnel ---------------------------------------------------------------------------------------


def test_dielectric_reflectance_is_fresnels():
    cosine = np.linspace(0.01, 1, 200, dtype=np.float32)
    for ior in (0.6, 1.0, 1.33, 1.5, 4.0):
        c = cosine.astype(complex)
        t = np.sqrt(1 - (1 - c * c) / ior**2)
        s, p = (c - ior * t) / (c + ior * t), (t - ior * c) / (t + ior * c)
        wanted = (np.abs(s) ** 2 + np.abs(p) ** 2) / 2
        np.testing.assert_allclose(fresnel.dielectric(cosine, np.float32(ior)), wanted, atol=2e-6)
    assert fresnel.ior_of(fresnel.normal_reflectance(np.float32(1.7))) == pytest.approx(1.7)


def test_mean_reflectances_are_integrals():
    cosine = ((np.arange(4000) + 0.5) / 4000).astype(np.float32)
    for ior in (0.5, 1.1, 1.5, 3.0):
        mean = (2 * cosine * fresnel.dielectric(cosine, np.float32(ior))).mean()
        assert fresnel.mean_dielectric(np.float32(ior)) == pytest.approx(mean, abs=0.006)
    f0, tint = np.full((3, 1), 0.7, np.float32), np.array([[1], [0.5], [0.2]], np.float32)
    edge = fresnel.edge_tint(f0, tint)
    mean = (2 * cosine * fresnel.metal(cosine, f0, edge)).mean(axis=1)
    np.testing.assert_allclose(fresnel.mean_metal(f0, edge)[:, 0], mean, rtol=1e-3)


def test_edge_tint_scales_schlick_at_82_degrees():
    f0, tint = np.float32([[0.9], [0.5], [0.1]]), np.float32([[0.3], [1], [0.8]])
    at_edge = np.full(1, fresnel.EDGE_COSINE, np.float32)
    schlick = f0 + (1 - f0) * (1 - 1 / 7) ** 5
    np.testing.assert_allclose(
        fresnel.metal(at_edge, f0, fresnel.edge_tint(f0, tint)), schlick * tint, rtol=1e-5
    )


def test_fresnel_lobes_multiply_the_facets():
    viewer, light = _towards(0.6), _rows(_rotation() @ _towards(0.5, 3.0), 1)
    plain = _facets(GGX, viewer, 0.3, 0.3).evaluate(None, light)[0]
    half = viewer + _towards(0.5, 3.0)
    cosine = np.float32([half @ viewer / np.linalg.norm(half)])
    f0 = np.full((3, 1), fresnel.normal_reflectance(np.float32(1.5)), np.float32)
    glass = _facets(DielectricGGX, viewer, 0.3, 0.3, f0=f0, ior=np.float32([1.5]))
    wanted = plain * fresnel.dielectric(cosine, np.float32(1.5))
    np.testing.assert_allclose(glass.evaluate(None, light)[0], wanted, rtol=1e-4)
    f0, edge = np.float32([[0.9], [0.5], [0.1]]), np.zeros((3, 1), np.float32)
    metal = _facets(MetalGGX, viewer, 0.3, 0.3, f0=f0, edge=edge)
    wanted = plain * (f0 + (1 - f0) * (1 - cosine) ** 5)
    np.testing.assert_allclose(metal.evaluate(None, light)[0], wanted, rtol=1e-4)


# -- energy tables, normals ------------------------------------------------------------------------


@pytest.mark.parametrize("node, cosine_node", [(11, 31), (20, 10), (31, 1), (31, 31), (16, 16)])
def test_energy_table_is_the_albedo_of_ggx(node: int, cosine_node: int):
    roughness, cosine = node / 31, cosine_node / 31
    wanted = _albedo(_facets(GGX, _towards(cosine), roughness**2, roughness**2), 1024)[0]
    got = energy.reflected(np.float32([roughness]), np.float32([cosine]))
    assert got == pytest.approx(wanted, abs=0.0015)


@pytest.mark.parametrize("constant", list(itertools.product([False, True], repeat=3)))
def test_what_is_the_same_everywhere_is_looked_up_alike(constant: tuple[bool, ...]):
    random = np.random.default_rng(3)
    given = [np.float32(x) for x in ([0.37], random.random(500), [1.6])]
    roughness, cosine, ior = (x[0] if c else np.resize(x, 500) for x, c in zip(given, constant, strict=True))
    if constant[1]:
        given[1] = given[1][:1]
    got = energy.fresnel_share(roughness, cosine, ior)
    assert np.shape(got) == (() if all(constant) else (500,))
    np.testing.assert_allclose(got, energy.fresnel_share(*(np.resize(x, 500) for x in given)), atol=3e-7)


def test_mean_energy_is_the_tables_mean():
    cosine = ((np.arange(2000) + 0.5) / 2000).astype(np.float32)
    for node in (5, 16, 31):
        roughness = np.full(2000, node / 31, np.float32)
        mean = (2 * cosine * energy.reflected(roughness, cosine)).mean()
        assert energy.mean_reflected(roughness[:1]) == pytest.approx(mean, abs=0.002)


def test_share_of_smooth_glass_is_its_fresnel_curve():
    cosine = np.linspace(0, 1, 16, dtype=np.float32)[1:]
    z = np.float32(4 / 15)
    f0 = z**4
    ior = fresnel.ior_of(f0)
    wanted = (fresnel.dielectric(cosine, ior) - f0) / (1 - f0)
    got = energy.fresnel_share(np.zeros_like(cosine), cosine, np.full_like(cosine, ior))
    np.testing.assert_allclose(got, wanted, atol=2e-4)


def test_normals_are_lifted_until_they_mirror_the_viewer_upwards():
    rng = np.random.default_rng(6)
    n = 5000
    geometric = _rows(_rotation() @ UP, n)
    viewer = rng.normal(size=(3, n))
    viewer /= np.linalg.norm(viewer, axis=0)
    viewer *= np.sign((viewer * geometric).sum(0))
    normal = geometric + rng.normal(size=(3, n))
    normal /= np.linalg.norm(normal, axis=0)
    normal, viewer = normal.astype(np.float32), viewer.astype(np.float32)
    given = normal.copy()
    lifted = valid_reflection_normal(normal, geometric, viewer)

    def mirrored(m: np.ndarray) -> np.ndarray:
        return (2 * (m * viewer).sum(0) * m - viewer)[...].T @ (_rotation() @ UP)

    lowest = np.minimum(0.9 * (viewer * geometric).sum(0), 0.01)
    assert (normal == given).all()
    assert np.abs(np.linalg.norm(lifted, axis=0) - 1).max() < 1e-5
    assert (mirrored(lifted) > lowest - 2e-3).all()
    fine = mirrored(given) > lowest + 1e-5
    assert 500 < fine.sum() < n - 500
    assert (lifted[:, fine] == given[:, fine]).all()
