# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of fog and lasers: layers, what each is served by, and that all of it is unbiased."""

from __future__ import annotations

import itertools
import sys
from dataclasses import replace

import numpy as np
import pytest
from scenes import assert_picture_is_sound, box, clouds, floor, place, sphere

from benchmarks.scenes import core
from engine_core import (
    AreaLight,
    Camera,
    Laser,
    Material,
    PointLight,
    Scene,
    Settings,
    Sink,
    SpotLight,
    SunLight,
    Volume,
    World,
    parts,
    render,
)
from engine_core.image.film import LASER, Layer
from engine_core.integration.regions import BIN, RegionTree
from engine_core.part_pictures import SeenPicture, _of_neighbours
from engine_core.parts import parts_of
from engine_core.screen_picture import _overlooked
from engine_core.shading.closures import Emission, Mix, Transparent
from engine_core.transport.around_light import Block
from engine_core.transport.camera_hits import Pixels
from engine_core.transport.direct_light import DirectLight

# A function has its name, too.
picture = sys.modules["engine_core.render"]

CAMERA = Camera.look_at((0.2, -6, 1.2), (0, 0, 0.7), 48, 32, 0.8, clip_start=0.1)
FOG = Volume(scattering=0.12, absorption=0.02, anisotropy=0.3)
OUTSIDE, INSIDE = (-2.0, 1.5, 4.5), (1.3, 1.0, 1.6)


def downwards(position=(0.5, 0.8, 4.0)) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = position
    return matrix


def scene(*lights, volume=FOG, reflectance=0.0, **fields) -> Scene:
    """A block on a floor in fog everywhere."""
    meshes = [floor(8), box((-0.5, -0.5, 0.1), (0.5, 0.5, 1.1))]
    materials = [Material(reflectance)] * 2
    return Scene(CAMERA, meshes, materials, lights, World(volume=0), volumes=[volume], **fields)


LIT = {
    "point": (PointLight(300.0, position=OUTSIDE),),
    "in the picture": (PointLight(60.0, position=INSIDE), PointLight(60.0, position=OUTSIDE)),
    "shadowless": tuple(PointLight(60.0, position=p, casts_shadow=False) for p in (INSIDE, OUTSIDE)),
    "spot": (SpotLight(500.0, light_to_world=downwards(), angle=0.6),),
    "beam in the picture": (SpotLight(500.0, light_to_world=place(INSIDE, (0.4, -1.3, 0)), angle=0.4),),
    "narrow beam": (SpotLight(900.0, light_to_world=place((-2.5, 0.5, 3.5), (0.2, -0.7, 0)), angle=0.03),),
    "ball": (PointLight(300.0, position=OUTSIDE, radius=0.4),),
    "area": (AreaLight(300.0, light_to_world=downwards(), size=1.5),),
    "laser": (Laser(50.0, light_to_world=downwards((0.4, -0.6, 3.5)), radius=0.02),),
}


LENS = {"aperture": 0.4, "focus_distance": 5.0}
BLADES = LENS | {"blades": 5, "blade_rotation": 0.3, "aperture_ratio": 1.6}


@pytest.mark.parametrize(
    "name, lens",
    [*((name, {}) for name in LIT), *((name, LENS) for name in LIT), ("in the picture", BLADES)],
)
def test_pictures_of_fog_are_unbiased(name, lens):
    """The mean over seeds, of the whole picture and of its quarters, is that of plain samples."""
    made = scene(*LIT[name])
    made = replace(made, camera=replace(made.camera, **lens))

    def quarters(film):
        picture = film.volume + film.laser
        return picture.reshape(2, 16, 2, 24, 3).mean(axis=(1, 3, 4), dtype=np.float64)

    plain = np.array(
        [quarters(render(made, Settings(128, integrator="sobol", seed=900 + s))) for s in range(4)]
    )
    ours = np.array([quarters(render(made, Settings(8, seed=s))) for s in range(12)])
    error = np.hypot(ours.std(axis=0, ddof=1) / 12**0.5, plain.std(axis=0, ddof=1) / 2)
    difference = ours.mean(axis=0) - plain.mean(axis=0)
    assert (np.abs(difference) < 4.5 * error + 1e-3 * plain.mean()).all()


EYE = np.array([0.2, -6, 1.2])
AMIDST = {
    "in a ball": (PointLight(300.0, position=EYE + (0.2, 0.3, 0), radius=1.0, visible_to_camera=True),),
    "in a ball that faces": (PointLight(300.0, position=EYE + (0.2, 0.3, 0), radius=1.0, sphere=False),),
    "at a point": (PointLight(100.0, position=EYE),),
    "in a beam": (Laser(50.0, light_to_world=downwards(EYE + (0, 0, 3)), radius=0.5),),
    "before a beam": (Laser(50.0, light_to_world=place(EYE, (np.pi / 2, 0, 0)), radius=0.02),),
}


@pytest.mark.parametrize("name", AMIDST)
def test_a_camera_in_a_light_sees_fog_lit_by_it(name):
    """What it sees is finite, and the mean over seeds that of plain samples."""
    made = scene(*AMIDST[name], reflectance=0.5)

    def means(seeds, settings):
        films = [render(made, replace(settings, seed=seed)) for seed in seeds]
        for film in films:
            assert_picture_is_sound(film)
        return np.array([film.combined[..., :3].mean(dtype=np.float64) for film in films])

    plain = means(range(900, 904), Settings(64, integrator="sobol"))
    ours = means(range(8), Settings(4))
    error = np.hypot(ours.std(ddof=1) / 8**0.5, plain.std(ddof=1) / 2)
    assert plain.min() > 0
    assert abs(ours.mean() - plain.mean()) < 5 * error + 1e-4 * plain.mean()


@pytest.mark.parametrize("closure", [None, Mix(0.5, Transparent(1.0), Emission((1, 0.8, 0.6), 2.0))])
def test_a_lamp_that_bounds_fog_is_a_lamp_and_its_fog(closure):
    """One mesh for both, or two of one shape: the same picture."""
    lamp = box((-1, -1, 1.5), (0, 0, 2.2), materials=1)
    materials = [Material(0.6), Material(0.0, (3, 2, 1)) if closure is None else Material(surface=closure)]
    both = [replace(lamp, volume=0)]
    apart = [lamp, replace(lamp, volume=0, surface=False)]
    one, two = (
        render(
            Scene(CAMERA, [floor(8), *meshes], materials, LIT["point"], volumes=[FOG]), Settings(4)
        ).combined
        for meshes in (both, apart)
    )
    assert one[..., :3].max() > 0.1
    np.testing.assert_allclose(one, two, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("power", [2.0**-40, 2.0**40])
def test_power_scales_a_picture_of_fog(power):
    def picture(factor):
        lights = [replace(light, power=light.power * factor) for lights in LIT.values() for light in lights]
        return render(scene(*lights, reflectance=0.5), Settings(2)).combined[..., :3].astype(float)

    np.testing.assert_allclose(picture(power) / power, picture(1.0), rtol=1e-4, atol=1e-7)


def test_a_picture_is_the_sum_of_its_layers():
    made = scene(PointLight(300.0, position=OUTSIDE), *LIT["laser"], reflectance=0.6)
    film = render(made, Settings(4))
    surface = film.layers[0].radiance
    assert film.volume.any() and film.laser.any() and surface.any()
    np.testing.assert_allclose(film.combined[..., :3], surface[..., :3] + film.volume + film.laser, rtol=1e-5)
    np.testing.assert_array_equal(film.combined[..., 3], surface[..., 3])


@pytest.mark.parametrize("name", ["in the picture", "beam in the picture", "ball", "laser"])
def test_fogs_control_variate_and_residual_add_up(name):
    film = render(scene(*LIT[name]), Settings(4))
    both = film.control_variate + film.residual
    np.testing.assert_allclose(film.combined[..., :3], both, atol=1e-6, rtol=1e-5)


def test_fog_before_what_is_black_is_the_whole_picture():
    film = render(scene(PointLight(300.0, position=OUTSIDE)), Settings(2, depth=True))
    assert np.shares_memory(film.combined, film.layers[1].radiance) and film.volume.any()
    np.testing.assert_array_equal(film.combined[..., :3], film.volume)
    np.testing.assert_array_equal(film.combined[..., :3], film.control_variate + film.residual)
    assert (film.combined[..., 3] == 1).all() and (film.layers[0].radiance == (0, 0, 0, 1)).all()
    np.testing.assert_array_equal(film.sample_count, film.layers[1].sample_count + 1)


def test_what_a_scene_lacks_is_never_entered():
    clear = replace(scene(PointLight(300.0, position=OUTSIDE)), world=World(), volumes=())
    assert parts_of(clear, DirectLight(clear), Settings(), lambda: None) == []
    film = render(clear, Settings(1))
    assert len(film.layers) == 1 and film.combined is film.layers[0].radiance and not film.volume.any()
    # A sun is behind a fog that fills all space; black surfaces want no light.
    for made in (scene(SunLight(3.0, angle=0.1)), scene()):
        assert parts_of(made, DirectLight(made), Settings(), lambda: None) == []
    told = render(scene(*LIT["ball"]), Settings(4)).statistics
    assert "no surface reflects" in told["control variate"]
    assert told["fog lit by lights"].startswith("about 32 points")


@pytest.mark.parametrize(
    ("size", "samples"),
    [*itertools.product([(1, 1), (8, 8), (1, 90), (130, 3)], [1, 16]), ((1, 3000), 1), ((3000, 1), 1)],
)
def test_pictures_of_any_size_are_finite(size, samples):
    camera = Camera.look_at((0.2, -6, 1.2), (0, 0, 0.7), *size, 0.8)
    lights = [light for lights in LIT.values() for light in lights]
    made = replace(scene(*lights, reflectance=0.5), camera=camera)
    assert np.isfinite(render(made, Settings(samples, threads=2)).combined).all()


@pytest.mark.parametrize(
    "volume",
    [
        Volume(absorption=0.3),
        Volume(absorption=0.3, emission=(1, 0.5, 0.1)),
        Volume(scattering=0.1, absorption=0.3, emission=(1e30, 0.5, 0)),
        Volume(scattering=(1, 0, 0), absorption=(0, 1, 0), emission=1.0),
        Volume(scattering=1e4),
        Volume(scattering=1e-9),
        Volume(scattering=(1, 0, 0), absorption=(0, 1, 0)),
        Volume(scattering=[[0.1] * 3, [0.3] * 3], anisotropy=[1, -1]),
        Volume(scattering=0.1, anisotropy=-1),
    ],
)
def test_pictures_of_any_fog_are_finite(volume):
    lights = [light for lights in LIT.values() for light in lights]
    for integrator in ("control_variates", "cv_only", "sobol", "quadrature"):
        settings = Settings(2, integrator=integrator, threads=2)
        assert np.isfinite(render(scene(*lights, volume=volume), settings).combined).all()


@pytest.mark.parametrize("integrator", ["control_variates", "sobol"])
def test_a_colour_that_fog_lets_pass_does_not_change_the_others(integrator):
    """In fog without an end, of which nothing bounds the map along a ray in that colour."""
    clear, not_clear = (
        render(
            scene(
                *LIT["area"], *LIT["ball"], volume=Volume(scattering=(0.1, 0, 0), absorption=(0, 0.1, blue))
            ),
            Settings(2, integrator=integrator),
        )
        for blue in (0, 0.1)
    )
    np.testing.assert_allclose(clear.volume, not_clear.volume, rtol=1e-5)
    assert not_clear.volume[..., 0].mean() > 0.05 and not clear.messages


@pytest.mark.parametrize("integrator", ["control_variates", "sobol"])
def test_lights_of_which_some_are_chosen_light_fog(integrator):
    corners = np.indices((4, 3)).reshape(2, -1).T * (1.5, 1.2) + (-3, 1.5)
    lights = [PointLight(20.0, position=(x, 1, z), radius=0.1) for x, z in corners]
    every, one = (
        render(scene(*some), Settings(16, integrator=integrator)).volume.mean()
        for some in (lights, lights[:1])
    )
    assert every > 6 * one > 0


def test_lamps_and_glowing_meshes_light_fog_apart(monkeypatch):
    """A lamp is followed from pixel to pixel, as no point goes to one of many triangles instead."""
    made = scene(*LIT["area"])
    ball = sphere((-1.2, 0.3, 1.4), 0.3, materials=2)
    glow = Material(surface=Emission((8.0, 2.0, 1.0)))
    made = replace(made, meshes=(*made.meshes, ball), materials=(*made.materials, glow))

    def pictures(seeds, settings):
        films = [render(made, replace(settings, seed=seed)) for seed in seeds]
        return np.array([film.volume for film in films], np.float64), films[0].statistics

    def quarters(volumes):
        return volumes.reshape(-1, 2, 16, 2, 24, 3).mean(axis=(2, 4, 5))

    ours, told = pictures(range(8), Settings(1))
    assert {"fog lit by lights", "fog lit by glowing meshes"} <= set(told)
    plain, told = pictures(range(900, 903), Settings(64, integrator="sobol"))
    assert "fog lit by glowing meshes" not in told
    error = np.hypot(*(quarters(a).std(axis=0, ddof=1) / len(a) ** 0.5 for a in (ours, plain)))
    difference = quarters(ours).mean(axis=0) - quarters(plain).mean(axis=0)
    assert (np.abs(difference) < 4.5 * error + 1e-3 * plain.mean()).all()

    monkeypatch.setattr(parts, "EVERY", 10**6)
    together, told = pictures(range(8), Settings(1))
    assert "fog lit by glowing meshes" not in told
    truth = plain.mean(axis=0)
    assert np.square(ours - truth).mean() < 0.7 * np.square(together - truth).mean()


def test_black_fog_is_known_to_be_black_and_costs_little():
    made = scene(*LIT["ball"])
    shut = box(np.array(OUTSIDE) - 0.6, np.array(OUTSIDE) + 0.6, visible_to_camera=False)
    pictures = made, replace(made, meshes=(*made.meshes, shut))
    lit, dark = (render(picture, Settings(1, standard_error=True)) for picture in pictures)
    assert not dark.combined[..., :3].any() and not dark.standard_error.any()
    assert dark.layers[1].sample_count.any()
    assert dark.statistics["shadow rays"] < 0.5 * lit.statistics["shadow rays"]


def test_threads_and_runs_change_nothing():
    made = scene(*LIT["area"], *LIT["in the picture"], reflectance=0.3)
    first, second = (render(made, Settings(4, threads=threads)).combined for threads in (1, 2))
    np.testing.assert_array_equal(first, second)


def test_a_narrow_beam_has_no_specks():
    """Nodes see nothing of it, but it is known where it is."""
    made = scene(*LIT["narrow beam"])
    made = replace(made, camera=Camera.look_at((0.2, -6, 1.2), (0, 0, 0.7), 192, 128, 0.8, clip_start=0.1))
    film = render(made, Settings(128))
    for samples in (1, 4):
        for seed in range(2):
            ours = render(made, Settings(samples, seed=seed + 9))
            assert np.abs(ours.volume - film.volume).max() < 0.15 * film.volume.max()


@pytest.mark.parametrize("name", ["everywhere", "a body in a body"])
def test_what_is_expected_of_rays_is_nearly_what_they_bring(name, monkeypatch):
    """Where nothing shades fog; and nothing is expected of a ray that meets none."""
    monkeypatch.setattr(parts, "MOST_SMALL", 0)
    lights = (
        PointLight(300.0, position=OUTSIDE, radius=0.2),
        SpotLight(800.0, light_to_world=downwards(), angle=0.6, radius=0.1),
    )
    made = replace(scene(*lights), meshes=[], materials=[])
    if name != "everywhere":
        ends = ((-3, -1, 0), (3, 2, 5)), ((-1, 0, 1), (1, 1, 3))
        bodies = [box(*corners, volume=n, surface=False) for n, corners in enumerate(ends)]
        volumes = [FOG, Volume(scattering=0.5)]
        made = replace(made, meshes=bodies, materials=[Material()] * 2, world=World(), volumes=volumes)
    by = parts_of(made, DirectLight(made), Settings(1), lambda: None)[-1].by
    x, y = (a.ravel().astype(np.int32) for a in np.indices((48, 32)))
    pixels = Pixels(x, y, np.zeros(len(x), np.int32))
    rays = by.integrand.first(pixels, np.full((2, len(x), 1), 0.5, np.float32))
    expected = by.expected(rays, len(x))
    u = np.random.default_rng(3).random((3, len(rays), 512), np.float32)
    which, values = by.integrand.rest(rays, None, u)
    lane = np.arange(len(x)) if rays.lane is None else rays.lane
    brought = np.bincount(lane[which // 512], values.sum(axis=0), len(x))
    assert expected.min() >= 0 and not expected[np.setdiff1d(np.arange(len(x)), lane)].any()
    ratio = expected[brought > 0] / brought[brought > 0]
    ratio /= np.median(ratio)
    low, high = np.quantile(ratio, (0.02, 0.98))
    assert low > 1 / 3 and high < 3 and ratio.max() < 20


@pytest.mark.parametrize("size", [(24, 140), (140, 24)])
def test_most_of_a_picture_may_meet_no_fog(size):
    """Not one corner of whole rows of tiles."""
    camera = Camera.look_at((0.2, -6, 1.2), (0, 0, 0.7), *size, 0.8, clip_start=0.1)
    body = box((-0.2, -0.2, 0.6), (0.2, 0.2, 1.0), volume=0, surface=False)
    lamps = [PointLight(300.0, position=(x, 1.5, 4.5), radius=0.4) for x in np.linspace(-2, 2, 12)]
    for lights in (lamps[:1], lamps):
        film = render(Scene(camera, [body], [Material()], lights, volumes=[FOG]), Settings(1))
        assert_picture_is_sound(film)
        assert film.volume.any() and not film.volume.all(axis=-1).any(axis=1).all()


@pytest.mark.parametrize("by_net", [False, True])
def test_fog_behind_a_spot_is_dark(by_net, monkeypatch):
    """A light of some size in the picture, of few points: what they are wrong by in its beam, bright as that
    is, is not shown beside."""
    if by_net:
        monkeypatch.setattr(parts, "MOST_SMALL", 0)
    lamp = SpotLight(500.0, light_to_world=downwards((0.2, 0.5, 1.9)), angle=1.2, blend=0.4, radius=0.05)
    camera = Camera.look_at((0.2, -6, 1.2), (0, 0, 0.7), 96, 64, 0.8, clip_start=0.1)
    made = replace(scene(lamp), camera=camera, meshes=[floor(8)], materials=[Material(0.0)])
    whole = render(made, Settings(64, integrator="sobol")).volume.sum(axis=-1)
    dark = whole == 0
    for axis in (0, 1):
        dark &= np.logical_and.reduce([np.roll(whole, shift, axis) == 0 for shift in range(-5, 6)])
    assert dark.mean() > 0.1
    for seed in range(3):
        made_of_few = render(made, Settings(1, seed=seed)).volume.sum(axis=-1)
        assert np.abs(made_of_few[dark]).max() < 1e-3 * whole.mean()


@pytest.mark.parametrize("radius", [0.0, 0.05])
def test_regions_none_of_whose_nodes_are_lit_make_no_patch(radius):
    """A long one beside a lamp's beam that ends before it and behind it: its neighbours see the light."""
    lamp = SpotLight(500.0, light_to_world=downwards((0.2, 0.5, 1.9)), angle=1.2, blend=0.4, radius=radius)
    camera = Camera.look_at((0.2, -6, 1.2), (0, 0, 0.7), 192, 128, 0.8, clip_start=0.1)
    made = replace(scene(lamp), camera=camera)
    truth = render(made, Settings(16)).volume.sum(axis=-1)
    y, x = np.indices(truth.shape)
    away = np.hypot(y - 107, x - 103) > 8
    for seed in range(3):
        off = np.abs(render(made, Settings(1, seed=seed)).volume.sum(axis=-1) - truth)
        assert off[away].max() < 12 * truth.mean()


@pytest.mark.parametrize("radius", [0.0, 0.02])
def test_narrow_beams_are_sampled_by_themselves(radius):
    def outlines(angle):
        spot = SpotLight(500.0, light_to_world=place(INSIDE, (0.4, -1.3, 0)), angle=angle, radius=radius)
        lit = scene(spot)
        parts = parts_of(lit, DirectLight(lit), Settings(), lambda: None)
        (part,) = [part for part in parts if part.name.startswith("fog lit by")]
        return part.by.outlines(CAMERA.region, lambda function, items: [*map(function, items)])

    narrow, wide = outlines(0.2), outlines(2.0)
    assert (narrow >= wide).all()
    assert np.count_nonzero(narrow & ~wide) > 10


def test_many_lights_in_fog_are_their_sum():
    """In the mean over seeds, where all of their peaks, and beams, are in the picture."""
    random = np.random.default_rng(3)
    spots, points = (random.uniform((-1.5, -0.5, 1.2), (1.5, 1.5, 2.4), (n, 3)) for n in (6, 6))
    lights = [PointLight(random.uniform(1, 20), position=p) for p in points]
    lights += [
        SpotLight(random.uniform(1, 20), light_to_world=place(p, random.uniform(-2, 2, 3)), angle=0.5)
        for p in spots
    ]

    def quarters(made, settings):
        return render(made, settings).volume.reshape(2, 16, 2, 24, 3).mean(axis=(1, 3, 4), dtype=np.float64)

    alone = [[quarters(scene(one), Settings(4, seed=50 + s)) for one in lights] for s in range(3)]
    alone = np.sum(alone, axis=1)
    ours = np.array([quarters(scene(*lights), Settings(2, seed=s)) for s in range(12)])
    error = np.hypot(ours.std(axis=0, ddof=1) / 12**0.5, alone.std(axis=0, ddof=1) / 3**0.5)
    assert (np.abs(ours.mean(axis=0) - alone.mean(axis=0)) < 4.5 * error + 1e-3 * alone.mean()).all()


def test_errors_of_lamps_that_are_alike_even_out():
    """Of four in one place, each with a quarter of the power, by the same net."""

    def deviation(lamps: int) -> float:
        """Over seeds, in the mean of all pixels: what these are wrong by together."""
        lit = scene(*[PointLight(300.0 / lamps, position=OUTSIDE, radius=1.5)] * lamps)
        return np.std([render(lit, Settings(samples=1, seed=seed)).combined.mean() for seed in range(24)])

    # A half if they were independent.
    assert deviation(4) < 0.7 * deviation(1)


def test_a_pixel_has_no_say_in_its_own_samples():
    random = np.random.default_rng(5)
    x, y = np.nonzero(random.random((9, 7)) < 0.7)
    block = Block(0, np.zeros(0, int), np.zeros(2), x + 11, y + 5, np.zeros(len(x), bool))
    square = random.random(len(x))
    around = _of_neighbours(block, square)
    for k in (0, 7, len(x) - 1):
        near = np.maximum(np.abs(x - x[k]), np.abs(y - y[k])) == 1
        assert around[k] == pytest.approx(square[near].mean())
    one = Block(0, np.zeros(0, int), np.zeros(2), *(np.zeros(1, int),) * 2, np.zeros(1, bool))
    assert _of_neighbours(one, np.ones(1)) == 0


def test_more_lights_than_are_weighed_light_fog():
    """Clusters are found while the render is set up."""
    lights = [PointLight(power=10.0, position=(0.1 * i - 2, 0, 2)) for i in range(40)]
    film = render(scene(*lights), Settings(samples=1, threads=1))
    assert np.isfinite(film.combined).all() and film.volume.mean() > 0


def test_pixels_where_neighbours_differ_get_more_samples(monkeypatch):
    """Of surfaces lit by points alone; the mean stays the truth."""
    monkeypatch.setattr(picture, "SHARE_BESIDE", 0.0)
    lit = scene(PointLight(60.0, position=INSIDE), PointLight(60.0, position=OUTSIDE), reflectance=0.6)
    truth = render(lit, Settings(samples=256, seed=99)).layers[0].radiance[..., :3].mean(dtype=float)
    films = [render(lit, Settings(samples=1, seed=seed)) for seed in range(16)]
    counts = films[0].layers[0].sample_count
    assert counts.min() == 1 and 1.1 * counts.size < counts.sum() < 1.4 * counts.size
    means = np.array([film.layers[0].radiance[..., :3].mean(dtype=float) for film in films])
    assert abs(means.mean() - truth) < 4 * means.std(ddof=1) / 4 + 1e-3 * truth


def test_more_samples_of_a_small_picture_are_no_fewer_rays() -> None:
    """What a picture of few samples may spend beyond them does not fall with their number."""
    lit = core.example("fogged_interior", 96, 54)
    rays = [render(lit, Settings(samples=n, seed=3)).statistics["shadow rays"] for n in (1, 4)]
    assert rays[1] > 0.9 * rays[0]


def test_beams_that_are_seen_are_the_more_exact_the_more_samples() -> None:
    lit = scene(*LIT["laser"])

    def deviation(samples):
        pictures = []
        for seed in range(8):
            settings = Settings(samples=samples, seed=seed)
            parts = parts_of(lit, DirectLight(lit), settings, lambda: None)
            (part,) = [part for part in parts if part.name == "lasers seen"]
            layer = Layer.empty(LASER, 48, 32)
            picture = SeenPicture(part.by, settings, CAMERA.region, layer, lambda: None)
            picture.build(lambda function, items: [*map(function, items)], lambda: False)
            pictures.append(layer.radiance)
        return np.std(pictures, axis=0).mean()

    # Edges of beams fall by n^-3/4, an eighth.
    assert deviation(16) < deviation(1) / 3


def test_cancel_while_fog_is_sampled_leaves_what_is_built() -> None:
    class CancelsFog(Sink):
        stage = ""

        def progress(self, fraction, elapsed, remaining, text) -> None:
            self.stage = text

        def cancelled(self) -> bool:
            return self.stage.startswith("Sampling fog")

    made = scene(*LIT["ball"], *LIT["point"], reflectance=0.5)
    film = render(made, Settings(samples=16, standard_error=True, threads=1), CancelsFog())
    assert film.statistics["control variate"] == "built"
    assert film.stopped_by == "cancel"
    assert np.isfinite(film.combined).all() and film.combined[..., :3].max() > 0


@pytest.mark.parametrize("integrator", ["control_variates", "cv_only", "sobol"])
@pytest.mark.parametrize("reflectance", [0.0, 0.5])
def test_what_is_not_asked_for_changes_no_picture(integrator, reflectance):
    """Of a point, a ball, a light in the picture and a laser; what is not asked for takes no memory."""
    lights = (*LIT["point"], *LIT["ball"], *LIT["in the picture"], *LIT["laser"])
    made = scene(*lights, reflectance=reflectance)
    settings = Settings(2, integrator=integrator)
    asked, bare = render(made, settings), render(made, replace(settings, terms=False))
    np.testing.assert_array_equal(bare.combined, asked.combined)
    np.testing.assert_array_equal(bare.sample_count, asked.sample_count)
    assert_picture_is_sound(asked)
    for unasked in (bare.control_variate, bare.residual, bare.standard_error, bare.normal):
        assert unasked.strides == (0, 0, 0) and not unasked.any()
    assert asked.control_variate.any() == (integrator != "sobol")
    full = render(made, replace(settings, standard_error=True, normals=True))
    assert full.standard_error.any(axis=2).mean() > 0.9 or integrator == "sobol"
    assert full.normal.any()


def test_regions_know_of_bodies_that_no_node_sees():
    random = np.random.default_rng(6)

    def rough(place):
        return np.square(np.sin(place * 3e-7)).sum(axis=0, keepdims=True), None

    tree = RegionTree((37, 22), 2, 3, rough, False)
    for _ in range(4):
        tree.sweep(12, 0)
    regions, bodies = tree.leaves(), np.zeros((38, 23), np.uint64)
    for bit in range(3):
        bodies[random.integers(0, 38, 9), random.integers(0, 23, 9)] |= np.uint64(1 << bit)
    expected = []
    for (x, y), (w, h) in zip((regions.start >> BIN).T, 1 << (regions.size.T.astype(int) - BIN), strict=True):
        inside = bodies[x : x + w + 1, y : y + h + 1]
        nodes = inside[np.ix_(*(sorted({0, n // 2 if n > 1 else 0, n}) for n in (w, h)))]
        expected.append(np.bitwise_or.reduce(inside, axis=None) != np.bitwise_or.reduce(nodes, axis=None))
    assert 3 < sum(expected) < len(regions) - 3 and len({*map(tuple, regions.size.T)}) > 3
    np.testing.assert_array_equal(_overlooked(regions, bodies), expected)


def test_small_bodies_of_fog_make_no_specks():
    """They are smaller than what lies between the first nodes."""
    camera = Camera.look_at((0.2, -24, 1.2), (0, 0, 0.7), 192, 128, 0.8, clip_start=0.1)
    films = [render(clouds(camera, 0.3, *LIT["point"]), Settings(1, seed=seed)) for seed in range(3)]
    pictures = np.array([film.volume for film in films], np.float64)
    assert np.sqrt(pictures.var(axis=0, ddof=1).mean()) < 0.05 * pictures.mean()


@pytest.mark.parametrize("times", [2.0**60, 2.0**80, 2.0**100])
def test_fog_of_any_brightness_is_sampled_alike(times):
    """Squares of what is so bright are more than single precision holds."""
    films = [render(scene(PointLight(300.0 * by, position=OUTSIDE)), Settings(1)) for by in (1.0, times)]
    usual, bright = (film.layers[1] for film in films)
    assert np.array_equal(usual.sample_count, bright.sample_count)
    least = 1e-3 * usual.radiance.mean()
    assert np.allclose(bright.radiance / times, usual.radiance, rtol=1e-3, atol=least)


BESIDE = {
    "by polynomials": LIT["ball"],
    "by samples": tuple(PointLight(60.0, position=(x, 1.0, 3.5), radius=0.3) for x in np.linspace(-3, 3, 9)),
}


@pytest.mark.parametrize("name", BESIDE)
def test_surfaces_have_more_samples_beside_fog_that_costs_more(name, monkeypatch):
    """They change nothing but how exact surfaces are; none are taken where a noise threshold stops them."""
    made, settings = scene(*BESIDE[name], reflectance=0.5), Settings(8)

    def surfaces(settings):
        return render(made, settings).layers[0]

    def many(least, share):
        monkeypatch.setattr(picture, "BESIDE", least)
        monkeypatch.setattr(picture, "SHARE_BESIDE", share)
        return [surfaces(replace(settings, seed=seed)) for seed in range(8)]

    few, more = many(np.inf, 1.0), many(0.01, 10.0)
    samples = [np.mean([layer.sample_count for layer in layers]) for layers in (few, more)]
    assert 1.9 * samples[0] < samples[1] < 33 * samples[0]
    assert surfaces(replace(settings, noise_threshold=1e-9)).sample_count.max() <= few[0].sample_count.max()
    few, more = (
        np.array([layer.radiance[..., :3] for layer in layers], np.float64) for layers in (few, more)
    )
    assert more.var(axis=0).mean() < 0.6 * few.var(axis=0).mean()
    means = [pictures.mean(axis=(1, 2, 3)) for pictures in (few, more)]
    error = np.hypot(*(mean.std(ddof=1) / 8**0.5 for mean in means))
    assert abs(means[1].mean() - means[0].mean()) < 4 * error


@pytest.mark.parametrize("integrator", ["control_variates", "sobol"])
def test_a_lens_sees_fog_whose_phase_function_has_a_peak(integrator):
    matrix = np.diag([-1.0, 1.0, -1.0, 1.0])
    matrix[:3, 3] = 0.3, 0.1, -3.0
    light = AreaLight(power=30.0, light_to_world=matrix, size=(1.5, 1.2))
    view = Camera.look_at((0, 0, 0), (0, 0, -1), 24, 16, 0.9, up=(0, 1, 0), aperture=0.05)
    fog = Volume(scattering=0.15, anisotropy=0.85)
    scene = Scene(view, (), (), (light,), World(volume=0), volumes=(fog,))
    film = render(scene, Settings(4, integrator=integrator))
    assert np.isfinite(film.combined).all() and film.volume.mean() > 0.1
