# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces of all kinds through the whole renderer: sampling modes agree, layers multiply, alpha is exact."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scenes import (
    PATCH,
    area_light,
    assert_picture_is_sound,
    blocks,
    box,
    floor,
    patch_camera,
    pictures,
    place,
    sphere,
    studio,
)

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
from engine_core.shading.closures import (
    Add,
    Diffuse,
    Emission,
    Glossy,
    Holdout,
    Mix,
    Principled,
    Translucent,
    Transparent,
)
from engine_core.shading.values import Value
from engine_core.transport.direct_light import DirectLight, DirectLightOverTile, Pixels

GLOSSY = (
    Material(surface=Glossy(0.7, 0.4)),
    Material(
        surface=Principled((0.2, 0.5, 0.8), metallic=0.3, roughness=0.4, coat_weight=0.5, coat_roughness=0.3)
    ),
    Material(0.0, 3.0),
)
LIGHTS = {
    "sphere": [PointLight(100.0, position=(1, -1, 3), radius=0.5)],
    "disk": [PointLight(100.0, position=(1, -1, 3), radius=0.5, sphere=False)],
    "rectangle": [area_light()],
    "ellipse": [area_light(ellipse=True)],
    "grid": [area_light(spread=1.0)],
    "spot": [SpotLight(300.0, light_to_world=place((0, -1, 4)), radius=0.4, angle=1.0, blend=0.3)],
    "sun": [SunLight(3.0, direction=(0.3, 0.2, -1), angle=0.3)],
    "world": [],
    "mesh": [],
}
TOGETHER = ("rectangle", "mesh", "sphere ellipse", "disk grid", "spot sun world")
"""Alone, and chosen among; each alone with --full."""


def glossy_studio(names: str, edge: int) -> Scene:
    lights = [light for name in names.split() for light in LIGHTS[name]]
    world = World(0.5 if "world" in names else 0.0, visible_to_camera=False)
    scene = studio(edge, edge, lights, world=world)
    meshes = scene.meshes
    if "mesh" in names:
        lamp = box((-0.3, -1, 2.5), (0.3, -0.5, 2.6), materials=2, visible_to_camera=False)
        meshes = (*meshes, lamp)
    return replace(scene, meshes=meshes, materials=GLOSSY)


def assert_modes_agree(scene: Scene, seeds: int) -> None:
    ways = (
        {"samples": 16, "integrator": "control_variates"},
        {"samples": 16, "integrator": "sobol"},
        {"samples": 32, "integrator": "sobol", "direct_sampling": "light"},
        {"samples": 64, "integrator": "sobol", "direct_sampling": "bsdf"},
    )
    estimates = [blocks(pictures(scene, seeds, **way)).mean(axis=-1) for way in ways]
    means = [e.mean(axis=(0, 1, 2)) for e in estimates]
    errors = [e.mean(axis=(1, 2)).std(ddof=1) / np.sqrt(len(e)) for e in estimates]
    for mean, error in zip(means, errors, strict=True):
        assert abs(mean - means[1]) < 4 * np.hypot(error, errors[1]) + 1e-4 * mean
    # The heavy tails of lobes that are sampled alone hide in single blocks.
    by_block = [(e.mean(axis=0), e.std(axis=0, ddof=1) / np.sqrt(len(e))) for e in estimates[:2]]
    (a, da), (b, db) = by_block
    assert (np.abs(a - b) < 5 * np.sqrt(da**2 + db**2) + 1e-3 * b).all()
    # That both combined are the better for it is what the bounds above live on.
    assert errors[1] < 1e-2 * means[1]


@pytest.mark.parametrize("names", TOGETHER)
def test_lights_and_lobes_alone_and_together_converge_to_one_picture(names):
    assert_modes_agree(glossy_studio(names, 16), 8)


@pytest.mark.full
@pytest.mark.parametrize("name", LIGHTS)
def test_they_converge_to_one_picture_with_less_noise(name):
    assert_modes_agree(glossy_studio(name, 32), 24)


@pytest.mark.parametrize("turn", range(4))
def test_what_lobes_meet_of_a_body_that_glows_is_not_behind_it(turn):
    """At their place off its faces, however these and the floor are turned."""

    def turned(mesh, matrix):
        return replace(mesh, vertices=mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3])

    body = box((-0.6, -0.8, -0.25), (0.6, 0.8, 0.25), materials=1)
    body = turned(body, place((1, 1, 0.4), (0.4, 1.1, turn)))
    ground = turned(floor(30.0), place((0, 0, 0), (0.05 * turn, -0.03 * turn, 0)))
    camera = Camera.look_at((0, -6, 3), (1, 2, 0), 24, 16, 0.7)
    materials = Material(surface=Glossy(0.8, 0.5)), Material(0.0, 1.0)
    scene = Scene(camera, (ground, body), materials)
    by_light, by_lobe = (
        pictures(scene, 4, samples=64, integrator="sobol", direct_sampling=sampling)
        for sampling in ("light", "bsdf")
    )
    lit = by_light[..., 0].mean(axis=0) < 0.9
    values = [picture[:, lit, 0].mean(axis=1) for picture in (by_light, by_lobe)]
    error = np.sqrt(sum(value.var(ddof=1) for value in values) / 4)
    assert abs(values[0].mean() - values[1].mean()) < 4 * error + 2e-3 * values[0].mean()
    assert error < 1.2e-2 * values[0].mean()


def seen(closure, *lights, above=(), world=0.0, samples=64, **settings) -> np.ndarray:
    """(4,) mean of a small patch of floor of a closure, with further meshes (z, closure) over it."""
    materials = [Material(surface=closure)] + [Material(surface=c) for _, c in above]
    meshes = [floor()] + [floor(5.0, z, materials=i + 1) for i, (z, _) in enumerate(above)]
    camera = patch_camera()
    matrix = camera.camera_to_world.copy()
    matrix[2, 3] = 4
    scene = Scene(replace(camera, camera_to_world=matrix), meshes, materials, lights, World(world))
    film = render(scene, Settings(samples=samples, integrator="sobol", **settings))
    return film.combined.reshape(-1, 4).mean(axis=0)


OVERHEAD = SunLight(1.0, direction=(0, 0, -1))


@pytest.mark.parametrize("sheets", [1, 2, 5])
def test_sheets_of_glass_dim_the_view_and_the_light(sheets):
    above = [(0.5 + 0.5 * i, Transparent((0.9, 0.5, 0.2))) for i in range(sheets)]
    got = seen(Diffuse(0.8), OVERHEAD, above=above)
    wanted = 0.8 / np.pi * np.array([0.9, 0.5, 0.2]) ** (2 * sheets)
    assert np.allclose(got[:3], wanted, rtol=1e-5) and got[3] == pytest.approx(1, abs=1e-6)


def test_no_more_sheets_are_crossed_than_allowed():
    above = [(0.5 + 0.25 * i, Transparent(1.0)) for i in range(3)]
    assert seen(Diffuse(0.8), OVERHEAD, above=above, transparent_bounces=3)[0] > 0
    assert seen(Diffuse(0.8), OVERHEAD, above=above, transparent_bounces=2)[0] == 0


def test_half_transparent_emitters_add_along_the_view():
    half = Mix(0.25, Transparent(1.0), Emission((1.0, 2.0, 3.0), 2.0))
    got = seen(Emission(1.0, 10.0), above=[(1, half), (2, half)])
    own = np.array([2.0, 4.0, 6.0]) * 0.25
    assert np.allclose(got[:3], own + 0.75 * (own + 0.75 * 10), rtol=1e-6)


def test_alpha_is_what_is_not_transparent():
    half = Principled(0.0, alpha=0.25, specular_ior_level=0.0)
    scene = Scene(patch_camera(), [floor()], [Material(surface=half)], (), World(1.0))
    film = render(scene, Settings(samples=4, transparent=True))
    assert np.allclose(film.combined, (0, 0, 0, 0.25), atol=1e-6)


def test_a_holdout_shader_cuts_alpha():
    got = seen(Holdout(), OVERHEAD)
    assert np.array_equal(got, (0, 0, 0, 0))
    assert seen(Mix(0.25, Diffuse(0.8), Holdout()), OVERHEAD)[3] == pytest.approx(0.75)


@pytest.mark.parametrize("closure", [Translucent(0.6), Add(Translucent(0.6), Diffuse(0.3))])
def test_translucent_sheets_glow_from_behind(closure):
    from_below = SunLight(2.0, direction=(0, 0, 1), angle=0.2)
    got = seen(closure, from_below)
    assert np.allclose(got[:3], 0.6 * 2 / np.pi, rtol=1e-3)
    below = seen(Translucent(0.6), PointLight(100.0, position=PATCH - (0, 0, 2), radius=0.5))
    assert np.allclose(below[:3], 0.6 / np.pi * 100 / (4 * np.pi * 4), rtol=3e-3)


def test_translucent_and_diffuse_see_both_halves_of_the_sky():
    got = seen(Add(Translucent(0.3), Diffuse(0.5)), world=1.0, samples=256)
    assert np.allclose(got[:3], 0.8, rtol=2e-3)


def test_mirrors_show_no_light_without_size():
    assert seen(Glossy(1.0, 0.0), OVERHEAD)[0] == 0
    shown = seen(Glossy(1.0, 0.0), SunLight(1.0, direction=(0, 0, -1), angle=0.01))
    assert shown[0] == pytest.approx(1 / (np.pi * np.sin(0.005) ** 2), rel=0.02)


@dataclass(frozen=True, eq=False)
class Corner(Value):
    """10^6 on a spot of 0.002 x 0.002, else 0."""

    def evaluate(self, points):
        x, y, _ = points.position
        return np.where(
            (np.abs(x - 1.999) < 0.001) & (np.abs(y - 1.999) < 0.001), np.float32(1e6), np.float32(0)
        )


def test_a_spot_that_no_look_at_a_texture_meets_is_a_light_still():
    lamp = replace(floor(2.0, 3.0), materials=1)
    materials = (Material(0.8), Material(surface=Emission(1.0, Corner())))
    direct = DirectLight(Scene(patch_camera(), (floor(), lamp), materials))
    assert len(direct.lights) == 2 and (direct.lights.groups[0].strength > 0).all()


@dataclass(frozen=True, eq=False)
class Stripes(Value):
    """1 and 0 in turn along X, a unit each."""

    def evaluate(self, points):
        return (np.floor(points.position[0]) % 2 == 0).astype(np.float32)


@pytest.mark.parametrize("direct_sampling", ["mis", "light"])
@pytest.mark.parametrize("rough", [True, False])
def test_an_emissive_texture_lights_as_much_as_its_parts(rough, direct_sampling):
    ground = Material(surface=Diffuse(0.8) if rough else Glossy(0.8, 0.5))
    camera = studio(24, 24).camera
    settings = {"samples": 64, "integrator": "sobol", "direct_sampling": direct_sampling}

    def lit_by(*lamps):
        scene = Scene(
            camera,
            (floor(), *(mesh for mesh, _ in lamps)),
            (ground, *(material for _, material in lamps)),
        )
        estimates = pictures(scene, 8, **settings)[..., :3].mean(axis=(1, 2, 3))
        return estimates.mean(), estimates.std(ddof=1) / np.sqrt(8)

    def lamp(low, high, material):
        return box((low, -1, 2.5), (high, 1, 2.6), materials=material, visible_to_camera=False)

    textured = lit_by((lamp(0, 4, 1), Material(surface=Emission(1.0, Stripes()))))
    plain = lit_by(
        *((lamp(x, x + 1, 1 + i), Material(0.0, 1.0)) for i, x in enumerate((0, 2))),
    )
    # The striped box has neither the ends of the two that it stands for, nor an end at X = 4.
    assert textured[0] == pytest.approx(plain[0], rel=0.12)
    assert textured[1] < 0.01 * textured[0]


def test_a_normal_map_tilts_what_is_lit():
    tilted = np.array([np.sin(0.5), 0, np.cos(0.5)], np.float32)
    got = seen(Diffuse(0.8, normal=tuple(tilted)), SunLight(1.0, direction=tuple(-tilted)))
    # The light stands on the bent normal; the bump terminator takes a little.
    assert 0.9 * 0.8 / np.pi < got[0] <= 0.8 / np.pi


def test_area_lights_shine_through_glass():
    glass = [(1.5, Transparent((0.5, 0.5, 0.5)))]
    light = AreaLight(10.0, light_to_world=place((0, 0, 3)), size=(1, 1))
    clear, dim = seen(Diffuse(0.8), light), seen(Diffuse(0.8), light, above=glass)
    assert np.allclose(dim[:3], 0.25 * clear[:3], rtol=1e-3)


# -- what nobody would make on purpose -------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Everywhere(Value):
    """A texture of one value."""

    value: float

    def evaluate(self, points):
        return np.full(len(points), self.value, np.float32)


def test_a_grey_albedo_may_be_one_number():
    grey, colour = (seen(Diffuse(c, roughness=0.5), OVERHEAD) for c in (0.6, (0.6, 0.6, 0.6)))
    assert grey[0] > 0.1 and np.allclose(grey, colour, rtol=1e-6)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", ["roughness", "coat_roughness", "ior", "alpha", "metallic"])
def test_textures_count_as_0_where_they_are_not_finite(field, value):
    inputs = {"roughness": 0.5, "coat_weight": 0.5, "coat_roughness": 0.2}
    sun = SunLight(1.0, direction=(0, 0.3, -1), angle=0.3)
    got, wanted = (
        seen(Principled(0.6, **inputs | {field: Everywhere(v)}), sun, samples=4) for v in (value, 0.0)
    )
    assert np.array_equal(got, wanted)


def test_alpha_is_not_negative_where_more_than_all_light_passes():
    sheet = Add(Transparent(1.0), Transparent(0.5))
    got = seen(Diffuse(0.8), OVERHEAD, above=[(1.0, sheet)])
    assert got[3] == pytest.approx(1) and got[0] == pytest.approx(1.5**2 * 0.8 / np.pi, rel=1e-4)
    scene = Scene(patch_camera(), [floor()], [Material(surface=sheet)], (), World(1.0))
    assert np.allclose(render(scene, Settings(samples=4, transparent=True)).combined, 0, atol=1e-6)


@pytest.mark.parametrize("integrator", ["control_variates", "sobol", "cv_only"])
@pytest.mark.parametrize(
    "closure", [Emission(1e30, 1e30), Transparent(1e30), Translucent(1e30), Emission(1e30, Everywhere(1e30))]
)
def test_what_overflows_leaves_a_finite_picture(closure, integrator):
    scene = studio(16, 16, [area_light(1e30)], world=World(1e20))
    sheets = [floor(2.0, z, materials=2) for z in (1.5, 1.6, 1.7)]
    materials = (*scene.materials, Material(surface=closure))
    scene = replace(scene, meshes=(*scene.meshes, *sheets), materials=materials)
    film = render(scene, Settings(samples=4, integrator=integrator, standard_error=True))
    assert_picture_is_sound(film)


def test_quadratures_are_asked_often_whether_to_go_on():
    """One has no other pause between its first point and its last."""
    calls = []
    scene = studio(16, 16, [area_light()])
    integrand = DirectLightOverTile(DirectLight(scene), None, lambda: calls.append(1))
    y, x = np.divmod(np.arange(64, dtype=np.int32), 8)
    pixels = Pixels(x, y, np.zeros(64, np.int32))
    hits = integrand.first(pixels, np.full((2, 64, 1), 0.5, np.float32))
    before = len(calls)
    integrand.rest(hits, None, np.full((2, len(hits.points), 1), 0.5, np.float32))
    assert len(calls) == before + 1


@pytest.mark.parametrize("sampling", ["mis", "light", "bsdf"])
@pytest.mark.parametrize("body", [box, sphere])
def test_convex_body_that_glows_does_not_see_itself(body, sampling):
    """Reflected directions start on the very triangle that is not to be met."""
    glossy = Material(surface=Principled(0.0, roughness=0.5, emission_color=1.0, emission_strength=1.0))
    camera = Camera.look_at((0.3, -6, 0.5), (0, 0, 0), 32, 32)
    scene = Scene(camera, (body(),), (glossy,))
    film = render(scene, Settings(samples=16, direct_sampling=sampling, integrator="sobol"))
    assert 0.99 < film.combined[..., :3].max() < 1 + 1e-5


@pytest.mark.parametrize("parts", [1, 8])
@pytest.mark.parametrize("half", [0.003, 3.0, 300.0])
def test_a_plane_that_glows_does_not_light_itself(half, parts):
    """Tilted, so that none of its points lies in it to all digits."""
    turn = place((0.3 * half, 0.2 * half, -0.1 * half), (0.37, 0.21, 0.6), half)[:3]
    grid = np.linspace(-1, 1, parts + 1)
    x, y = (a.ravel() for a in np.meshgrid(grid, grid))
    corner = (np.arange(parts)[:, None] * (parts + 1) + np.arange(parts)).ravel()
    a, b, c, d = corner, corner + 1, corner + parts + 2, corner + parts + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    plane = Mesh(np.stack([x, y, 0 * x], axis=1) @ turn[:, :3].T + turn[:, 3], triangles)
    camera = Camera.look_at(turn[:, 3] + turn[:, 2], turn[:, 3], 16, 16, 0.5)
    film = render(Scene(camera, (plane,), (Material(0.8, 1.0),)), Settings(samples=4))
    assert film.combined[..., :3] == pytest.approx(1.0, abs=1e-5)
