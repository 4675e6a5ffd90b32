# SPDX-License-Identifier: GPL-3.0-or-later
"""Light scattered once by fog: against quadrature and brute force, unbiased, and finite for any input."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scenes import box, sphere
from scipy import integrate

from engine_core import (
    AreaLight,
    Camera,
    Material,
    Mesh,
    PointLight,
    Scene,
    Settings,
    SpotLight,
    SunLight,
    World,
    render,
)
from engine_core.scene import Volume
from engine_core.settings import DISTANCE_SAMPLING
from engine_core.shading.closures import Transparent
from engine_core.transport.camera_hits import Pixels
from engine_core.transport.direct_light import DirectLight
from engine_core.transport.fog_lanes import FogSegments
from engine_core.transport.line_integrals import EVERYWHERE, LineIntegrals, _followed
from engine_core.transport.ray_rule import AlongRay, PointsOfRay, ScatteredAlongRay
from engine_core.transport.scattered_light import ScatteredLight
from engine_core.transport.single_scattering import SingleScattering

EDGE = 32
WHITE = (Material(),)
LIGHT = np.array([1.2, 0.2, -1.5])


def fog(
    lights, volumes, world=-1, meshes=(), sampling="auto", materials=WHITE, sky=None, end=None
) -> SingleScattering:
    """end : of all camera rays, along the view axis, at a wall that casts no shadow; None for none."""
    view = Camera.look_at((0, 0, 0), (0, 0, -1), EDGE, EDGE, 0.9, up=(0, 1, 0))
    if end is not None:
        corners = [(x * end, y * end, -end) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        meshes = [*meshes, Mesh(corners, [(0, 1, 2), (0, 2, 3)], casts_shadow=False)]
    sky = dataclasses.replace(sky or World(), volume=world)
    scene = Scene(view, tuple(meshes), materials, tuple(lights), sky, volumes=tuple(volumes))
    direct = DirectLight(scene)
    return SingleScattering(
        direct.frame,
        direct.media,
        direct.lights,
        direct.surfaces,
        direct.shader,
        direct.stage.rays,
        Settings(distance_sampling=sampling),
    )


def bounds(low, high, volume=0) -> Mesh:
    """A box that holds fog, and is not seen."""
    return box(low, high, volume=volume, surface=False)


def pixels(count=None, seed=0) -> Pixels:
    if count is None:
        y, x = np.divmod(np.arange(EDGE * EDGE), EDGE)
    else:
        x, y = np.random.default_rng(seed).integers(0, EDGE, (2, count))
    return Pixels(x.astype(np.int32), y.astype(np.int32), np.zeros(len(x), np.int32))


def rays_of(integrand, count=60, seed=0):
    chosen = pixels(count, seed)
    return integrand.first(chosen, np.random.default_rng(seed + 1).random((2, count, 1)))


def spot_at(position, target, **fields) -> SpotLight:
    matrix = np.eye(4)
    axis = np.subtract(position, target) / np.linalg.norm(np.subtract(position, target))
    side = np.cross([0.3, 0.2, 1], axis)
    side /= np.linalg.norm(side)
    matrix[:3] = np.stack([side, np.cross(axis, side), axis, position], axis=1)
    return SpotLight(light_to_world=matrix, **fields)


def henyey_greenstein(cosine, g):
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cosine) ** 1.5)


def by_quadrature(scattering, rays, number, value, points=(), accuracy=1e-11) -> float:
    """The integral of ``value`` (position, direction of view, distance), in scene units, along a ray."""
    scale = scattering.frame.scale
    o, d = rays.origin[:, number] / scale, rays.direction[:, number]
    # Rays begin at the first fog, and end at the last.
    rows = slice(*rays.first[number : number + 2])
    start, end = rays.media.start[rows][0] / scale, rays.media.end[rows][-1] / scale
    foot = (LIGHT - o) @ d
    wanted = [p for p in (foot, *(start + np.asarray(points))) if start < p < end]

    def f(t):
        return value(o + t * d, d, t - start)

    return integrate.quad(f, start, end, points=wanted or None, epsabs=0, epsrel=accuracy, limit=400)[0]


# -- against quadrature ------------------------------------------------------------------------------


@pytest.mark.parametrize("g", [-0.8, 0.0, 0.5, 0.8])
@pytest.mark.parametrize("sigma", [1e-9, 0.01, 0.3, 3.0, 20.0])
def test_airlight_of_a_point_light_is_exact(g, sigma):
    volume = Volume(scattering=0.75 * sigma, absorption=0.25 * sigma, anisotropy=g)
    scattering = fog([PointLight(power=4 * np.pi, position=LIGHT)], [volume], world=0, end=6.0)
    integrand = ScatteredAlongRay(scattering)
    rays = rays_of(integrand)
    found, spread = integrand.along(rays, None)
    assert (spread == 0).all()

    def value(p, d, t):
        r = np.linalg.norm(p - LIGHT)
        # Light comes along p - LIGHT and leaves along -d.
        phase = henyey_greenstein((LIGHT - p) @ d / r, g)
        return 0.75 * sigma * phase * np.exp(-sigma * (t + r)) / r**2

    for number in range(0, 60, 4):
        exact = by_quadrature(scattering, rays, number, value, points=np.array([0.1, 0.4, 1, 3, 9]) / sigma)
        assert found[:, number] == pytest.approx(np.full(3, exact), rel=1e-6 + 1e-7 * sigma, abs=1e-30)


def test_coloured_extinction_is_exact_in_every_channel():
    scattering_colour, absorption = np.array([0.3, 0.05, 2.0]), np.array([0.01, 0.0, 3.0])
    volume = Volume(scattering=scattering_colour, absorption=absorption, anisotropy=0.3)
    scattering = fog([PointLight(power=(1, 2, 3), position=LIGHT)], [volume], world=0, end=6.0)
    integrand = ScatteredAlongRay(scattering)
    rays = rays_of(integrand)
    found, _ = integrand.along(rays, None)
    for number in range(0, 60, 5):
        for channel in range(3):
            sigma = (scattering_colour + absorption)[channel]

            def value(p, d, t, sigma=sigma, channel=channel):
                r = np.linalg.norm(p - LIGHT)
                strength = (channel + 1) / (4 * np.pi) * scattering_colour[channel]
                return (
                    strength * henyey_greenstein((LIGHT - p) @ d / r, 0.3) * np.exp(-sigma * (t + r)) / r**2
                )

            exact = by_quadrature(scattering, rays, number, value, points=[0.05, 0.2, 0.6, 1.5])
            assert found[channel, number] == pytest.approx(exact, rel=3e-5)


def test_no_ray_through_a_dense_cloud_is_an_outlier():
    """The far side is lit, too, which a ray sees at the very end of its polynomial. A sample in a thousand
    was 1.4 times its ray's mean, and a speck of ten times that where samples are taken by chance."""
    sun = SunLight(3.0, direction=(0.6, -0.7, -0.5), angle=0.01)
    cloud = sphere((0, 0, -3), 0.9, segments=32, volume=0, surface=False)
    scattering = fog([sun], [Volume(scattering=6.0, anisotropy=0.4)], meshes=[cloud])
    integrand = ScatteredAlongRay(scattering, scattering.small)
    rays, count = rays_of(integrand, 40), 4096
    lane = np.repeat(np.arange(len(rays)), count)
    u = np.random.default_rng(4).random((integrand.rest_dimensions, len(lane)))
    _, values = integrand.rest(rays, lane, u)
    values = values[0].reshape(len(rays), count).astype(float)
    mean = values.mean(axis=1)
    assert len(rays) > 8 and mean.min() > 0
    assert (values.max(axis=1) < 1.15 * mean).all()
    whole = integrand.along(rays, None)[0][0]
    assert np.allclose(whole, mean, rtol=0.01)


def test_rays_keep_their_light_where_as_many_lanes_are_of_others():
    # Two spots side by side: rays that see both bring as many lanes as there are rays, with those of none.
    spots = [spot_at(LIGHT + [x, 0, 0], (x, 0, -3), power=4 * np.pi, angle=0.8) for x in (0, 0.1)]
    scattering = fog(spots, [Volume(scattering=0.4)], meshes=[bounds((-3, -3, -5), (3, 3, 0.5))])
    integrand = ScatteredAlongRay(scattering)
    rays = rays_of(integrand)
    alone = np.concatenate([integrand.along(rays, np.array([k]))[0] for k in range(len(rays))], axis=1)
    dark, bright = np.flatnonzero(alone[0] == 0), np.flatnonzero(alone[0] > 0.2 * alone[0].max())
    many = min(len(dark), len(bright))
    assert many >= 8
    some = np.stack([dark[:many], bright[:many]], axis=1).ravel()
    np.testing.assert_allclose(integrand.along(rays, some)[0], alone[:, some], rtol=1e-6)


def test_a_spot_in_a_box_of_fog():
    spot = spot_at(LIGHT, (-0.5, 0, -3), power=4 * np.pi, angle=0.8, blend=0.4)
    scattering = fog([spot], [Volume(scattering=0.4)], meshes=[bounds((-3, -3, -5), (3, 3, 0.5))])
    integrand = ScatteredAlongRay(scattering)
    rays = rays_of(integrand)
    found, _ = integrand.along(rays, None)
    axis = spot.light_to_world[:3, 2]
    edge = np.cos(0.4)

    def value(p, d, t):
        r = np.linalg.norm(p - LIGHT)
        x = np.clip(((LIGHT - p) @ axis / r - edge) / ((1 - edge) * 0.4), 0, 1)
        return 0.4 / (4 * np.pi) * x * x * (3 - 2 * x) * np.exp(-0.4 * (t + r)) / r**2

    lit = 0
    for number in range(0, 60, 3):
        exact = by_quadrature(scattering, rays, number, value, np.linspace(0, 6, 40), 1e-8)
        assert found[0, number] == pytest.approx(exact, rel=2e-5, abs=1e-9)
        lit += exact > 1e-6
    assert 5 < lit < 20


def _depth(point, towards, length, boxes):
    """Optical depth along a line through axis-aligned boxes (low, high, sigma)."""
    total = 0.0
    for low, high, sigma in boxes:
        with np.errstate(divide="ignore"):
            a, b = (np.array(low) - point) / towards, (np.array(high) - point) / towards
        near, far = np.minimum(a, b).max(), np.maximum(a, b).min()
        total += sigma * max(min(far, length) - max(near, 0), 0)
    return total


BOXES = (((-1.1, -0.9, -4.0), (0.9, 1.3, -1.0), 0.5), ((-0.3, -2.0, -3.1), (2.5, 2.0, -2.0), 1.2))


@pytest.mark.parametrize("kind", ["point", "sun"])
def test_two_fogs_that_overlap(kind):
    """Each with a phase function of its own; the way to the light leads through both, and neither."""
    towards = np.array([0.4, 1.0, 0.3]) / np.linalg.norm([0.4, 1.0, 0.3])
    lights = {
        "point": PointLight(power=4 * np.pi, position=LIGHT),
        "sun": SunLight(power=1.0, direction=-towards),
    }
    volumes = [
        Volume(scattering=0.5, anisotropy=0.4),
        Volume(scattering=0.3, absorption=0.9, anisotropy=-0.6),
    ]
    meshes = [bounds(low, high, i) for i, (low, high, _) in enumerate(BOXES)]
    scattering = fog([lights[kind]], volumes, meshes=meshes)
    integrand = ScatteredAlongRay(scattering)
    rays = rays_of(integrand, 40)
    found, _ = integrand.along(rays, None)

    def value(p, d, t):
        if kind == "sun":
            to_light, reach, falloff = towards, np.inf, 1.0
        else:
            reach = np.linalg.norm(LIGHT - p)
            to_light, falloff = (LIGHT - p) / reach, 1 / reach**2
        inside = [all(np.array(low) <= p) and all(p <= np.array(high)) for low, high, _ in BOXES]
        cosine = to_light @ d
        scattered = inside[0] * 0.5 * henyey_greenstein(cosine, 0.4)
        scattered += inside[1] * 0.3 * henyey_greenstein(cosine, -0.6)
        leg = _depth(p, to_light, reach, BOXES)
        return scattered * falloff * np.exp(-leg - _depth(np.zeros(3), d, np.linalg.norm(p), BOXES))

    assert len(rays.media.ray) > len(rays)
    for number in range(0, len(rays), 6):
        rows = slice(*rays.first[number : number + 2])
        kinks = (
            np.unique(np.concatenate([rays.media.start[rows], rays.media.end[rows]])) / scattering.frame.scale
        )
        kinks -= kinks[0]
        points = np.unique(np.concatenate([kinks, np.linspace(0, kinks[-1], 12)]))
        exact = by_quadrature(scattering, rays, number, value, points, 1e-5)
        # Where the way to the light passes a box's edge, there is a kink.
        assert found[0, number] == pytest.approx(exact, rel=2e-2)
    reference = _dense(integrand, rays, 4000)
    assert found == pytest.approx(reference, rel=2e-2)
    assert found.sum() == pytest.approx(reference.sum(), rel=2e-3)


# -- shadows -----------------------------------------------------------------------------------------


class Peaks:
    """n lines of one peak, which no polynomial follows; with what is seen, by an edge on its slope."""

    lit = turn = None
    edge = 0.4

    def __init__(self, n: int) -> None:
        self.breaks, self.shift = np.zeros((0, n)), np.linspace(0, 1, n, endpoint=False, dtype=np.float32)

    def __len__(self) -> int:
        return len(self.shift)

    def take(self, rows: np.ndarray) -> Peaks:
        return Peaks(len(rows))

    def smooth(self, s: np.ndarray) -> np.ndarray:
        s = np.broadcast_to(s, (*s.shape[:-1], len(self)))
        return (1 / (1e-3 + np.square(s - 0.37))).astype(np.float32)[None, None]

    def seen(self, s: np.ndarray, before: float, after: float, fade: float) -> np.ndarray:
        s = np.broadcast_to(s, (*s.shape[:-1], len(self)))
        part = np.where(s < self.edge, before, after) + fade * s
        return np.stack([part, 0.5 * part, 1 - part]).astype(np.float32)


@pytest.mark.parametrize(("nodes", "checks"), [(33, 32), (2, 2)])
@pytest.mark.parametrize("parts", [(0.3, 0.9, 0.0), (0.9, 0.3, 0.0), (0.0, 0.5, 0.01)])
def test_lines_that_see_parts_are_unbiased(parts, nodes, checks):
    """What is believed of a bracket is compared with the polynomial there, too."""
    lines = Peaks(60_000)
    u = np.random.default_rng(3).random((2, len(lines)), np.float32)
    found, *_ = LineIntegrals(10).integral(lines, lambda of, s: of.seen(s, *parts), (nodes, checks), u)
    every = Peaks(400_000)
    s = (np.arange(len(every)) + 0.5) / len(every)
    wanted = (every.smooth(s)[0] * every.seen(s, *parts)).mean(axis=1, dtype=np.float64)
    error = found[0].std(axis=1, dtype=np.float64) / len(lines) ** 0.5
    assert (np.abs(found[0].mean(axis=1, dtype=np.float64) - wanted) < 4 * error).all()
    assert (error < 0.02 * wanted).all()


def _dense(integrand: ScatteredAlongRay, rays, count: int) -> np.ndarray:
    """Brute force (3, N): ``count`` points a lane, each with its own shadow ray."""
    segments = FogSegments.of(rays, None, integrand._scattering.media)
    total = np.zeros((3, len(rays)))
    s = (np.arange(count) + 0.5) / count
    for _, lanes in integrand._lanes(segments, integrand._bare):
        part = 0.0
        for some in np.array_split(s, max(1, count * len(lanes) // 200_000)):
            values = lanes.smooth(some[:, None]) * integrand._seen(lanes, some[:, None])
            part = part + values.sum(axis=2, dtype=np.float64)
        for out, channel in zip(total, lanes.radiance(part / count), strict=True):
            out += np.bincount(segments.ray.take(lanes.segment), channel, len(rays))
    return total


THIN = Volume(scattering=0.15, anisotropy=0.3)
OCCLUDER = sphere((0.2, 0.1, -2.5), 0.5, segments=48)
CASES = {
    "point": ([PointLight(power=50, position=(1.2, 1.2, -1.5))], 0, ()),
    "spot": ([spot_at((1.2, 1.2, -1.5), (0, 0, -3), power=50, angle=1.0)], 0, ()),
    "sun in a box": ([SunLight(power=1, direction=(-0.4, -1, -0.2))], -1, (bounds((-2, -2, -5), (2, 2, 1)),)),
    "three lights, two of them": (
        [
            PointLight(power=20, position=(1.2, 1.2, -1.5)),
            PointLight(power=(3, 30, 9), position=(-1.2, 1.0, -2.5)),
            spot_at((0, 2, -2), (0, 0, -2.5), power=20, angle=0.6),
        ],
        0,
        (),
    ),
    "one strong and many weak, of all kinds": (
        [
            PointLight(power=100, position=(0.3, 0.2, -3.4)),
            SunLight(power=0.1, direction=(-0.4, -1, -0.2)),
            *(PointLight(power=5, position=(np.cos(i), 1.2, -2.5 + np.sin(i))) for i in range(8)),
            *(
                spot_at((1.5 * np.cos(i), -1.2, -2.5 + np.sin(i)), (0, 0, -2.5), power=9 / (i + 1), angle=0.8)
                for i in range(8)
            ),
        ],
        -1,
        (bounds((-2, -2, -5), (2, 2, 1)),),
    ),
}


@pytest.mark.parametrize("lights, world, meshes", CASES.values(), ids=CASES)
def test_whole_rays_are_unbiased_and_the_rule_is_near(lights, world, meshes):
    scattering = fog(lights, [THIN], world, [OCCLUDER, *meshes], end=5.0)
    integrand = ScatteredAlongRay(scattering)
    rays = rays_of(integrand, 64)
    exact = _dense(integrand, rays, 3000)
    rule, (spread, _) = integrand.along(rays, None)
    assert rule.mean() == pytest.approx(exact.mean(), rel=0.01)
    assert np.sqrt(np.square(rule - exact).mean()) < 0.03 * exact.mean()
    each = 256
    u = np.random.default_rng(4).random((2, len(rays), each))
    values = integrand.rest(rays, None, u)[1].reshape(3, len(rays), each)
    deviation = values.std(axis=2)
    # The rule says generously what deviation a sample has, but for shadows that no node saw.
    assert np.square(spread).mean() > 0.0025 * np.square(deviation.sum(axis=0)).mean()
    for channel in range(3):
        error = np.sqrt((np.square(deviation[channel]) / each).sum()) + 1e-5 * exact[channel].sum()
        assert abs(values[channel].mean(axis=1).sum() - exact[channel].sum()) < 4 * error
    assert integrand.counts["non-finite samples"] == 0


@pytest.mark.parametrize("lights, world, meshes", CASES.values(), ids=CASES)
def test_a_few_points_of_a_ray_are_unbiased(lights, world, meshes):
    scattering = fog(lights, [THIN], world, [OCCLUDER, *meshes], end=5.0)
    integrand = PointsOfRay(scattering)
    rays = rays_of(integrand, 64)
    exact = _dense(ScatteredAlongRay(scattering), rays, 3000)
    before, each = integrand.counts["shadow rays"], 256
    u = np.random.default_rng(4).random((1, len(rays), each))
    values = integrand.rest(rays, None, u)[1].reshape(3, len(rays), each)
    assert 0 < integrand.counts["shadow rays"] - before <= integrand.shadow_rays * len(rays) * each
    for channel in range(3):
        error = np.sqrt((values[channel].var(axis=1) / each).sum()) + 1e-5 * exact[channel].sum()
        assert abs(values[channel].mean(axis=1).sum() - exact[channel].sum()) < 4 * error
    last = integrand.rest(rays, None, np.full((1, len(rays), 1), np.nextafter(np.float32(1), 0)))[1]
    assert np.isfinite(last).all() and integrand.counts["non-finite samples"] == 0


@pytest.mark.parametrize("g", [-0.9, 0.95])
@pytest.mark.parametrize("case", ["point", "spot", "sun in a box"])
def test_few_points_follow_peaks_of_the_phase_function(case, g):
    lights, world, meshes = CASES[case]
    scattering = fog(lights, [Volume(scattering=0.15, anisotropy=g)], world, [OCCLUDER, *meshes], end=5.0)
    integrand = PointsOfRay(scattering)
    rays = rays_of(integrand, 64)
    exact = _dense(ScatteredAlongRay(scattering), rays, 3000)
    u = np.random.default_rng(4).random((1, len(rays), 256))
    values = integrand.rest(rays, None, u)[1].reshape(3, len(rays), -1)
    integrand._integrals._peaks = False
    evenly = integrand.rest(rays, None, u)[1].reshape(3, len(rays), -1)
    error = np.sqrt((values.sum(axis=0).var(axis=1) / u.shape[2]).sum()) + 1e-5 * exact.sum()
    assert abs(values.mean(axis=2).sum() - exact.sum()) < 4 * error
    if case == "point":
        assert values.std(axis=2).mean() < 0.7 * evenly.std(axis=2).mean()


@pytest.mark.parametrize("scale", [0.0, 1e-300, 1.0, 1e30])
def test_places_that_follow_have_the_density_that_is_told(scale):
    """The mean of 1 / density is the line's length, between any two places."""

    class Peak:
        def smooth(self, s):
            return np.float64(scale) * np.array(
                [[1 / (0.003 + (np.broadcast_to(s, (len(s), 3)) - 0.3) ** 2)]]
            )

    u = np.broadcast_to(((np.arange(30000) + 0.5) / 30000).astype(np.float32)[:, None], (30000, 3))
    s, weight = _followed(Peak(), u)
    assert (np.diff(s, axis=0) >= 0).all() and s.min() >= 0 and s.max() <= 1
    for low, high in ((0, 0.21), (0.28, 0.31), (0.5, 1)):
        inside = (low <= s) & (s < high)
        np.testing.assert_allclose((weight * inside).mean(axis=0), high - low, atol=2e-4)
    assert weight.max() <= 1 / EVERYWHERE * 1.0001


def test_each_of_many_lights_takes_few_rays():
    taken = []
    for count in (1, 64):
        lights = [PointLight(power=50, position=(np.cos(i), 1.2, -2.5 + np.sin(i))) for i in range(count)]
        integrand = ScatteredAlongRay(fog(lights, [THIN], 0, [OCCLUDER], end=5.0))
        rays = rays_of(integrand, 64)
        integrand.rest(rays, None, np.random.default_rng(4).random((2, len(rays), 16)))
        taken.append(integrand.counts["shadow rays"])
    assert taken[1] < 16 * taken[0]


@pytest.mark.parametrize("sampling", DISTANCE_SAMPLING)
@pytest.mark.parametrize("case", ["point", "sun in a box"])
def test_single_points_agree_with_whole_rays(sampling, case):
    lights, world, meshes = CASES[case]
    scattering = fog(lights, [THIN], world, [OCCLUDER, *meshes], sampling, end=5.0)
    rays = rays_of(ScatteredAlongRay(scattering), 48)
    exact = _dense(ScatteredAlongRay(scattering), rays, 2000)
    mean, error = _mean(ScatteredLight(scattering, scattering.sizeless), rays, 600)
    assert abs(mean.sum() - exact[0].sum()) < 4 * error


def _mean(integrand: ScatteredLight, rays, each: int) -> tuple[np.ndarray, float]:
    """Means (N,) of the first channel, and the standard error of their sum."""
    u = np.random.default_rng(7).random((integrand.rest_dimensions, len(rays), each))
    which, values = integrand.rest(rays, None, u)
    assert np.isfinite(values).all()
    dense = np.bincount(which, values[0], len(rays) * each).reshape(len(rays), each)
    return dense.mean(axis=1), float(np.sqrt(dense.var(axis=1).sum() / each))


def test_an_area_light_by_brute_force():
    """Uniform distances and points, and shadows by arithmetic, against all ways to sample the same."""
    matrix = np.eye(4)
    matrix[:3] = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0], [0.2, 1.5, -2.5]]).T
    light = AreaLight(power=30.0, light_to_world=matrix, size=(1.0, 0.6))
    assert np.allclose(matrix[:3, 2], [0, 1, 0])  # shines down
    scattering = fog([light], [THIN], 0, [OCCLUDER], end=5.0)
    integrand = ScatteredLight(scattering, np.arange(1))
    rays = rays_of(integrand, 48)
    rng = np.random.default_rng(1)
    scale, each = scattering.frame.scale, 4000
    o, d = rays.origin / scale, rays.direction
    length = (rays.media.end - rays.media.start) / scale
    t = rng.random((len(rays), each)) * length[:, None]
    begin = o + d * rays.media.start / scale
    p = begin[:, :, None] + d[:, :, None] * t
    x, y = rng.random((2, len(rays), each)) - 0.5
    on = np.stack([0.2 + x, np.full_like(x, 1.5), -2.5 - 0.6 * y])
    vector = on - p
    r = np.sqrt((vector * vector).sum(axis=0))
    cosine = vector[1] / r
    to_centre = np.array([0.2, 0.1, -2.5])[:, None, None] - p
    along = np.clip((to_centre * vector).sum(axis=0) / (r * r), 0, 1)
    gap = to_centre - along * vector
    free = (gap * gap).sum(axis=0) > 0.25 * 0.996  # of a ball of flat triangles
    phase = henyey_greenstein((vector * d[:, :, None]).sum(axis=0) / r, 0.3)
    radiance = 30.0 / (np.pi * 0.6)
    value = 0.15 * phase * np.exp(-0.15 * (t + r)) * radiance * np.maximum(cosine, 0) / r**2 * 0.6 * free
    value *= length[:, None]
    brute, error = value.mean(axis=1).sum(), np.sqrt((value.var(axis=1) / each).sum())
    for sampling in DISTANCE_SAMPLING:
        scattering.sampling = sampling
        mean, own = _mean(integrand, rays, 400)
        assert abs(mean.sum() - brute) < 4 * np.hypot(error, own) + 2e-3 * brute


def _towards_camera(kind: str):
    """A wide light in front of the camera, as lights and a sky."""
    matrix = np.diag([-1.0, 1.0, -1.0, 1.0])
    matrix[:3, 3] = 0.3, 0.1, -3.0
    gradient = np.linspace(0.5, 1.5, 8)[:, None, None] * np.ones((8, 16, 3))
    lights = {
        "area": [AreaLight(power=30.0, light_to_world=matrix, size=(1.0, 0.8))],
        "ellipse": [AreaLight(power=30.0, light_to_world=matrix, size=(1.0, 0.8), ellipse=True)],
        "spread": [AreaLight(power=30.0, light_to_world=matrix, size=(1.0, 0.8), spread=1.5)],
        "ball": [PointLight(power=30.0, position=(0.3, 0.1, -3.0), radius=0.5)],
        "disk": [PointLight(power=30.0, position=(0.3, 0.1, -3.0), radius=0.5, sphere=False)],
        "inside": [PointLight(power=30.0, position=(0, 0, 0), radius=9.0)],
    }.get(kind, [])
    return lights, {"sky": World((0.7, 0.8, 1.0)), "picture": World(image=gradient)}.get(kind)


@pytest.mark.parametrize("kind", ["area", "ellipse", "spread", "ball", "disk", "inside", "sky", "picture"])
@pytest.mark.parametrize("g", [0.8, -0.7])
def test_directions_by_the_phase_function_are_unbiased(kind, g):
    lights, sky = _towards_camera(kind)
    volumes = [Volume(scattering=(0.15, 0.12, 0.1), anisotropy=g)]
    # What is infinitely far needs a fog that ends.
    box_of_fog = [bounds((-4, -4, -5), (4, 4, 1))] if sky else []
    scattering = fog(lights, volumes, -1 if sky else 0, [OCCLUDER, *box_of_fog], sky=sky, end=5.0)
    shares = scattering.shares_of_phase(np.ones(1))
    assert scattering.is_peaked and 0 < shares[0] < 1
    by_light, by_both = (ScatteredLight(scattering, np.arange(1), by_phase=p) for p in (None, shares))
    rays = rays_of(by_both, 48)
    (a, error), (b, less) = (_mean(f, rays, 8000) for f in (by_both, by_light))
    assert abs(a.sum() - b.sum()) < 4 * np.hypot(error, less)
    # Neither is all noise, or they would agree whatever they were.
    assert max(error / a.sum(), less / b.sum()) < 0.04


def test_the_phase_function_is_followed_into_the_edges_of_a_light():
    """Rays that run into a wide light beside its centre, in fog that scatters forwards."""
    (light,), _ = _towards_camera("area")
    scattering = fog([light], [Volume(scattering=(0.15,) * 3, anisotropy=0.9)], 0, end=2.99)
    integrand = ScatteredLight(scattering, np.arange(1))
    every = rays_of(integrand, 2000)
    x, y = every.direction[:2] * (3.0 / -every.direction[2])
    beside = np.flatnonzero((np.abs(x - 0.3) < 0.5) & (np.abs(y - 0.1) < 0.4) & (np.abs(x - 0.3) > 0.4))
    assert len(beside) > 20
    u = np.random.default_rng(7).random((3, len(every), 400))
    which, values = integrand.rest(every, None, u)
    f = np.bincount(which, values[0], len(every) * 400).reshape(len(every), 400)[beside]
    assert (np.square(f).mean(axis=1) / np.square(f.mean(axis=1))).mean() < 12


def test_a_choice_among_many_lights_is_unbiased():
    lights = [
        PointLight(
            power=10 + 5 * i, position=(2 * np.cos(i), 2 * np.sin(i), -2 - 0.1 * i), radius=0.1 * (i % 2)
        )
        for i in range(12)
    ]
    scattering = fog(lights, [THIN], -1, [OCCLUDER, bounds((-3, -3, -5), (3, 3, 1))])
    cell = np.zeros(1, np.int32)
    choice = scattering.choice_of_cells(np.arange(12), cell, cell)
    assert choice is not None and scattering.choice_of_cells(np.arange(8), cell, cell) is None
    chosen, every = (ScatteredLight(scattering, np.arange(12), c) for c in (choice, None))
    rays = rays_of(chosen, 48)
    (a, error), (b, less) = _mean(chosen, rays, 800), _mean(every, rays, 100)
    assert abs(a.sum() - b.sum()) < 4 * np.hypot(error, less)
    assert every.counts["shadow rays"] > chosen.counts["shadow rays"]
    bare = ScatteredAlongRay(scattering)
    sized = ScatteredLight(scattering, scattering.sized)
    c, more = _mean(sized, rays, 200)
    assert (
        abs(bare.along(rays, None)[0][0].sum() + c.sum() - b.sum())
        < 4 * np.hypot(more, less) + 0.01 * b.sum()
    )


@pytest.mark.parametrize("boxes", [1, 2])
def test_lights_whose_cones_a_ray_misses_would_bring_it_nothing(boxes, monkeypatch):
    """Of spots and soft boxes with a grid, in fog in one piece and in two."""
    rng, lights = np.random.default_rng(5), []
    for position in rng.uniform((-2, -2, -5), (2, 2, -1), (8, 3)):
        spot = spot_at(position, rng.uniform((-2, -2, -5), (2, 2, -1)), power=20.0, radius=0.3, angle=0.5)
        lights += [
            spot,
            AreaLight(power=20.0, light_to_world=spot.light_to_world, size=(0.5, 0.2), spread=0.9),
        ]
    ends = [((-3, -3, -6), (3, 3, 1)), ((-1, -1, -4), (1, 1, -2))][:boxes]
    scattering = fog(lights, [THIN], -1, [OCCLUDER, *(bounds(*end) for end in ends)])
    integrand = ScatteredLight(scattering, np.arange(len(lights)))
    rays = rays_of(integrand, 200)
    u = rng.random((integrand.rest_dimensions, 200, 16))
    lit = integrand.lit_rays(rays)
    assert 0.02 < lit.mean() < 0.9

    def dense() -> np.ndarray:
        which, values = integrand.rest(rays, None, u)
        return np.stack([np.bincount(which, channel, 3200) for channel in values])

    found, shadow_rays = dense(), integrand.counts["shadow rays"]
    monkeypatch.setattr(integrand, "lit_rays", lambda rays: np.ones_like(lit))
    every = dense()
    assert np.allclose(found, every, rtol=1e-6, atol=1e-9 * every.max()) and every.any()
    assert integrand.counts["shadow rays"] >= 2 * shadow_rays


def test_light_that_casts_no_shadow_is_seen_through_everything():
    """Through fog, too: closed by quadrature, without a term for its way to where it is scattered."""
    sigma = 0.9
    thick = Volume(scattering=0.75 * sigma, absorption=0.25 * sigma, anisotropy=0.4)
    free = PointLight(power=4 * np.pi, position=LIGHT, casts_shadow=False)
    with_ball, without = (fog([free], [thick], 0, m, end=1.9) for m in ([OCCLUDER], []))
    assert without.sizeless.size == with_ball.small.size == 0
    integrands = [ScatteredLight(s, s.sized) for s in (with_ball, without)]
    of_each = [rays_of(integrand) for integrand in integrands]
    means, errors = zip(*map(_mean, integrands, of_each, (400, 400)), strict=True)
    assert np.allclose(*means, rtol=1e-3)
    assert all(integrand.counts["shadow rays"] == 0 for integrand in integrands)

    def value(p, d, t):
        r = np.linalg.norm(p - LIGHT)
        phase = henyey_greenstein((LIGHT - p) @ d / r, 0.4)
        return 0.75 * sigma * phase * np.exp(-sigma * t) / r**2

    rays = of_each[1]
    exact = sum(by_quadrature(without, rays, number, value) for number in range(len(rays)))
    assert abs(means[0].sum() - exact) < 4 * errors[0] + 1e-3 * exact


@pytest.mark.parametrize("clear", [False, True])
@pytest.mark.parametrize("glow", [0.0, 0.05])
def test_the_far_plane_hides_all_but_the_worlds_fog(glow, clear):
    """Of bodies of fog what is behind it; surfaces there still cast shadows."""
    surface = Material(surface=Transparent((0.5, 0.6, 0.7))) if clear else Material()
    behind = sphere((0.2, 0.1, -3.0), 0.4, materials=1)
    unseen = dataclasses.replace(behind, visible_to_camera=False)
    whole, half = (bounds((-0.9, -0.9, low), (0.7, 0.6, -1.0), 1) for low in (-2.5, -1.5))
    far = bounds((-0.9, -0.9, -3.5), (0.7, 0.6, -2.0), 1)
    # What glows would light fog before the plane from behind it.
    body = Volume(absorption=0.4, emission=glow) if glow else Volume(scattering=0.6)
    volumes = Volume(scattering=(0.3, 0.1, 0.2), emission=glow), body
    lights = PointLight(power=50, position=LIGHT), PointLight(20, position=(-1, 0, -4), radius=0.2)
    materials = Material(), surface

    def seen(meshes, world, end=np.inf, lights=lights):
        view = Camera.look_at((0, 0, 0), (0, 0, -1), 8, 8, 0.9, up=(0, 1, 0), clip_end=end)
        scene = Scene(view, meshes, materials, lights, World(volume=world), volumes=volumes)
        return render(scene, Settings(samples=16, seed=3, threads=1)).combined.mean(axis=(0, 1), dtype=float)

    for clipped, wanted in (((), ()), ((behind,), (unseen,))):
        assert seen(clipped, 0, 1.5) == pytest.approx(seen(wanted, 0), rel=0.02)
    # What the first lamp lights before the plane has no fog from behind it in its way.
    near = lights[:1]
    assert seen((whole,), -1, 1.5, near) == pytest.approx(seen((half,), -1, lights=near), rel=0.02)
    assert not seen((far,), -1, 1.5)[:3].any()


@pytest.mark.parametrize("shadow", [False, True])
def test_fog_behind_a_pane_is_seen_through_it(shadow):
    """And lit through it, if it casts a shadow."""
    colour = np.array([0.25, 0.5, 1.0])
    corners = np.array([[-9, -9, -2], [9, -9, -2], [9, 9, -2], [-9, 9, -2]], np.float32)
    pane = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), materials=1, casts_shadow=shadow)
    lights = [PointLight(power=50, position=LIGHT)]
    materials = *WHITE, Material(surface=Transparent(colour))
    before, everything = (
        ScatteredAlongRay(fog(lights, [THIN], 0, end=end))
        .along(rays_of(ScatteredAlongRay(fog(lights, [THIN], 0, end=end))), None)[0]
        .sum(axis=1)
        for end in (2.0, 4.0)
    )
    scattering = fog(lights, [THIN], 0, [pane], materials=materials, end=4.0)
    wanted = before + colour ** (2 if shadow else 1) * (everything - before)
    integrand = ScatteredAlongRay(scattering)
    rays = rays_of(integrand)
    assert integrand.counts["transparent crossings"] == 60
    assert integrand.along(rays, None)[0].sum(axis=1) == pytest.approx(wanted, rel=1e-3 if shadow else 1e-5)
    integrand = ScatteredLight(scattering, np.arange(1))
    rays = rays_of(integrand)
    u = np.random.default_rng(5).random((3, len(rays), 800))
    which, values = integrand.rest(rays, None, u)
    for channel in range(3):
        mean = np.bincount(which, values[channel], len(rays) * 800).reshape(-1, 800)
        error = np.sqrt((mean.var(axis=1) / 800).sum())
        assert abs(mean.mean(axis=1).sum() - wanted[channel]) < 4 * error


def test_rays_that_meet_no_fog_cost_nothing():
    scattering = fog([PointLight(power=1, position=LIGHT)], [THIN], -1, [bounds((0, 0, -3), (9, 9, -2))])
    integrand = ScatteredAlongRay(scattering)
    rays = integrand.first(pixels(), np.full((2, EDGE * EDGE, 1), 0.5))
    assert len(rays) == len(rays.lane) == EDGE * EDGE // 4
    away = fog([PointLight(power=1, position=LIGHT)], [THIN], -1, [bounds((0, 0, 2), (9, 9, 3))])
    for integrand in (ScatteredAlongRay(away), ScatteredLight(away, away.sizeless)):
        rays = integrand.first(pixels(), np.full((2, EDGE * EDGE, 1), 0.5))
        assert len(rays) == 0
        which, values = integrand.rest(rays, None, np.zeros((3, 0, 1)))
        assert values.shape == (3, 0)


def test_the_rule_puts_rays_back_where_they_belong():
    scattering = fog([PointLight(power=1, position=LIGHT)], [THIN], -1, [bounds((0, -9, -3), (9, 9, -2))])
    integrand = ScatteredAlongRay(scattering)
    rays = integrand.first(pixels(), np.full((2, EDGE * EDGE, 1), 0.5))
    dense = np.zeros((3, EDGE * EDGE))
    dense[:, rays.lane] = integrand.along(rays, None)[0]

    class Nodes:
        pass

    nodes = Nodes()
    nodes.integrand, nodes.stage, nodes.points = integrand, rays, EDGE * EDGE
    nodes.lanes = np.random.default_rng(0).permutation(EDGE * EDGE)[:300]
    values, spread, evaluations = AlongRay(9).integrate(nodes)
    assert values.shape == (3, 300) and spread.shape == (2, 300) and evaluations == 2700
    assert np.allclose(values, dense[:, nodes.lanes], rtol=1e-6)


# -- hazards -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "position",
    [
        (0, 0, 0), (0, 0, -2), (1e-12, 0, -2), (1e-7, 0, -2), (0, 0, 3), (0, 0, -4), (0, 0, -4 + 1e-9),
        (0, 0, -9), (0, 0, -1e6), (0, 1e8, -2), (0, 0, -1e-9),
    ],
)  # fmt: skip
@pytest.mark.parametrize("sigma", [1e-9, 0.1, 1e4])
def test_a_light_anywhere_is_finite(position, sigma):
    """On the ray, at the camera, behind it, at the ray's end, beyond it, and far off."""
    volume = Volume(scattering=sigma, anisotropy=0.7)
    lights = [PointLight(power=1, position=position), spot_at(position, (0.1, 0, -2), power=1, angle=0.5)]
    scattering = fog(lights, [volume], 0, end=4.0)
    whole = ScatteredAlongRay(scattering)
    middle = Pixels(*np.full((2, 5), EDGE // 2, np.int32), np.zeros(5, np.int32))
    u = np.array([[0, 0, 1e-6, 0.5, 1], [0, 0, 0, 0.3, 1]])[:, :, None]
    rays = whole.first(middle, u)
    rule, spread = whole.along(rays, None)
    assert np.isfinite(rule).all() and np.isfinite(spread).all() and (rule >= 0).all()
    ends = np.array([0, 0.5, 1])
    square = np.broadcast_to(np.stack(np.meshgrid(ends, ends)).reshape(2, 1, 9), (2, 5, 9))
    assert np.isfinite(whole.rest(rays, None, square)[1]).all()
    single = ScatteredLight(scattering, scattering.sizeless)
    u = np.random.default_rng(0).choice([0, 1e-9, 0.3, 1 - 1e-9, 1], (single.rest_dimensions, 5, 40))
    for scattering.sampling in DISTANCE_SAMPLING:
        assert np.isfinite(single.rest(rays, None, u)[1]).all()
    assert whole.counts["non-finite samples"] == single.counts["non-finite samples"] == 0


@pytest.mark.parametrize("depth", 10.0 ** np.arange(-9, 5))
def test_single_points_hold_at_any_optical_depth(depth):
    """The estimate by "auto" stays as near to the exact airlight as it is in thin fog."""
    scattering = fog(
        [PointLight(power=4 * np.pi, position=(0.5, 0.2, -0.02))], [Volume(scattering=depth)], 0, end=1.0
    )
    whole = ScatteredAlongRay(scattering)
    rays = rays_of(whole, 16)
    exact = whole.along(rays, None)[0][0]
    mean, error = _mean(ScatteredLight(scattering, scattering.sizeless), rays, 500)
    assert abs(mean.sum() - exact.sum()) < 4 * error + 1e-5 * exact.sum() + 1e-30


def test_a_larger_scene_is_the_same_picture():
    def picture(s):
        scattering = fog(
            [PointLight(power=50 * s * s, position=s * LIGHT)],
            [Volume(scattering=0.2 / s)],
            0,
            [Mesh(OCCLUDER.vertices * np.float32(s), OCCLUDER.triangles)],
            end=5.0 * s,
        )
        integrand = ScatteredAlongRay(scattering)
        rays = rays_of(integrand)
        return integrand.along(rays, None)[0], ScatteredLight(scattering, scattering.sizeless).rest(
            rays, None, np.random.default_rng(0).random((3, len(rays), 4))
        )[1]

    for s in (2.0**-10, 2.0**13):
        for here, there in zip(picture(1.0), picture(s), strict=True):
            assert np.allclose(here, there, rtol=1e-5)
