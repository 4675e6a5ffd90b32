# SPDX-License-Identifier: GPL-3.0-or-later
"""Expressions over surface points: textures, arithmetic, colours and normals against what they must be."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from engine_core import Camera, Mesh, Scene, SceneError
from engine_core.geometry.frame import frame_of
from engine_core.geometry.triangles import gather_triangles
from engine_core.shading import coordinates, fresnel, normal_map, ramps
from engine_core.shading.arithmetic import MATH, VECTOR_MATH, map_range, unit
from engine_core.shading.closures import Diffuse, Emission, Mix
from engine_core.shading.colour import (
    BLEND,
    FROM_RGB,
    TO_RGB,
    blackbody,
    hue_saturation,
    linear_to_srgb,
    luminance,
    srgb_to_linear,
)
from engine_core.shading.points import ShadingPoints
from engine_core.shading.textures import (
    ImagePixels,
    box_texture,
    checker,
    gradient,
    image_texture,
    on_sphere,
    on_tube,
)
from engine_core.shading.values import Attribute, Value, attributes_of, compute, value_at

N = 1000


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def directions(rng: np.random.Generator, n: int = N) -> np.ndarray:
    return unit(rng.normal(size=(3, n)).astype(np.float32))


def points(n: int = N, attributes=None, normal=None, back=False) -> ShadingPoints:
    """Points seen head-on whose attributes are given by name."""
    normal = np.tile(np.float32([[0], [0], [1]]), n) if normal is None else normal
    known = attributes or {}
    return ShadingPoints(
        np.zeros((3, n), np.float32),
        normal,
        normal,
        normal,
        np.full(n, back),
        lambda name, width: known.get(name, np.zeros((width, n), np.float32)),
    )


# Expressions


def test_what_depends_on_constants_alone_is_a_constant() -> None:
    total = compute(np.add, 2.0, compute(np.multiply, (1.0, 2.0, 3.0), 0.5))
    assert isinstance(total, np.ndarray) and total.shape == (3, 1) and total.dtype == np.float32
    assert np.allclose(total[:, 0], (2.5, 3, 3.5))


def test_an_expression_is_evaluated_once_a_batch() -> None:
    calls = []

    def count(x: np.ndarray) -> np.ndarray:
        calls.append(len(x))
        return x

    shared = compute(count, Attribute("x", 3))
    total = compute(np.add, compute(np.multiply, shared, 2.0), shared)
    here = points(attributes={"x": np.ones((3, N), np.float32)})
    assert np.all(value_at(total, here) == 3) and len(calls) == 1
    value_at(total, points())
    assert len(calls) == 2


def test_attributes_that_a_closure_asks_for() -> None:
    grey = compute(luminance, compute(np.add, Attribute("color:A", 4), Attribute("uv:", 2)))
    closure = Mix(grey, Diffuse(Attribute("object")), Mix(0.5, None, Emission(1.0, grey)))
    assert attributes_of(closure) == {"color:A", "uv:", "object"}
    assert attributes_of(None) == set()


# Attributes of meshes


def triangle_soup(rng: np.random.Generator, count: int, **fields) -> Mesh:
    vertices = rng.uniform(-1, 1, (3 * count, 3)) + (0, 5, 0)
    return Mesh(vertices, np.arange(3 * count).reshape(-1, 3), **fields)


def gathered(*meshes: Mesh):
    scene = Scene(Camera.look_at((0, 0, 0), (0, 1, 0), 8, 8), meshes=list(meshes))
    return gather_triangles(scene.meshes, frame_of(scene))[0]


def test_attributes_are_linear_over_triangles_and_zero_where_a_mesh_has_none(rng) -> None:
    corners = rng.uniform(size=(4, 3, 2)).astype(np.float32)
    number = rng.uniform(size=(3, 1, 1)).astype(np.float32)
    triangles = gathered(
        triangle_soup(rng, 2),
        triangle_soup(rng, 4, attributes={"uv:": corners}),
        triangle_soup(rng, 3, attributes={"number": number, "uv:": corners[:3]}),
    )
    which = rng.integers(0, 9, N).astype(np.int32)
    u = rng.uniform(0, 0.5, N).astype(np.float32)
    v = rng.uniform(0, 0.5, N).astype(np.float32)
    found = triangles.attribute("uv:", 2, which, u, v)
    every = np.concatenate([np.zeros((2, 3, 2)), corners, corners[:3]])[which]
    wanted = every[:, 0] * (1 - u - v)[:, None] + every[:, 1] * u[:, None] + every[:, 2] * v[:, None]
    assert np.allclose(found, wanted.T, atol=1e-6)
    alone = triangles.attribute("number", 1, which, u, v)
    assert np.allclose(alone[0], np.concatenate([np.zeros(6), number.ravel()])[which])
    assert not triangles.attribute("no such", 3, which, u, v).any()


def test_attributes_stay_with_their_triangles_where_some_are_left_out(rng) -> None:
    mesh = triangle_soup(rng, 5)
    vertices = mesh.vertices.copy()
    vertices[4] = np.nan
    values = np.arange(5, dtype=np.float32).reshape(5, 1, 1)
    triangles = gathered(Mesh(vertices, mesh.triangles, attributes={"row": values}))
    zero = np.zeros(4, np.float32)
    found = triangles.attribute("row", 1, np.arange(4, dtype=np.int32), zero, zero)
    assert found.tolist() == [[0, 2, 3, 4]]


def test_attribute_of_wrong_shape_is_named(rng) -> None:
    with pytest.raises(SceneError, match=r'attributes has "uv:" of shape \(2, 3, 2\)'):
        triangle_soup(rng, 3, attributes={"uv:": np.zeros((2, 3, 2))})


# Images


INTERPOLATIONS = ("Closest", "Linear", "Cubic")


def noise(rng: np.random.Generator, height: int = 5, width: int = 7) -> ImagePixels:
    return ImagePixels(rng.uniform(size=(height, width, 4)).astype(np.float32))


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("extension", ["REPEAT", "EXTEND", "MIRROR"])
def test_white_image_is_white_everywhere(rng, interpolation: str, extension: str) -> None:
    white = ImagePixels(np.full((3, 4, 4), 255, np.uint8))
    found = image_texture(
        white, interpolation, extension, True, rng.uniform(-3, 3, (2, N)).astype(np.float32)
    )
    assert np.allclose(found, 1, atol=1e-6)


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_repeated_and_mirrored_images_have_their_periods(rng, interpolation: str) -> None:
    image, p = noise(rng), rng.uniform(-1, 1, (2, N)).astype(np.float32)

    def look(extension: str, at: np.ndarray) -> np.ndarray:
        return image_texture(image, interpolation, extension, True, at)

    away = np.abs(p * [[7], [5]] * 2 % 1 - 0.5).min(axis=0) < 0.49  # closest texels jump at borders
    for extension, moved in (("REPEAT", p + 1), ("MIRROR", p + 2), ("MIRROR", -p)):
        assert np.allclose(look(extension, p)[:, away], look(extension, moved)[:, away], atol=1e-4)
    beyond = look("EXTEND", np.float32([[-9, -9, 9, 9], [-9, 9, -9, 9]]))
    assert np.allclose(beyond.T, image.pixels[[0, -1, 0, -1], [0, 0, -1, -1]])
    assert not look("CLIP", np.float32([[-1, 2, 0.5], [0.5, 0.5, 9]])).any()


def test_texels_are_met_at_their_centres_row_0_at_the_bottom(rng) -> None:
    image = noise(rng)
    y, x = np.divmod(np.arange(35), 7)
    centres = np.stack([(x + 0.5) / 7, (y + 0.5) / 5]).astype(np.float32)
    for interpolation in ("Closest", "Linear"):
        found = image_texture(image, interpolation, "EXTEND", True, centres)
        assert np.allclose(found.T, image.pixels.reshape(-1, 4), atol=1e-5)


def test_linear_and_cubic_interpolation_reproduce_slopes() -> None:
    ramp = np.tile((np.arange(32, dtype=np.float32)[None, :, None] + 0.5) / 32, (32, 1, 4))
    p = np.random.default_rng(2).uniform(0.1, 0.9, (2, N)).astype(np.float32)
    for interpolation in ("Linear", "Cubic"):
        found = image_texture(ImagePixels(ramp), interpolation, "EXTEND", True, p)
        assert np.allclose(found, p[0], atol=1e-6)


def test_coded_colours_are_decoded_after_interpolation_and_alpha_is_not() -> None:
    pixels = np.array([[[0, 0, 0, 0], [255, 255, 255, 255]]], np.uint8)
    found = image_texture(ImagePixels(pixels, True), "Linear", "EXTEND", True, np.float32([[0.5], [0.5]]))
    assert np.allclose(found[:3], srgb_to_linear(np.float32(0.5))) and found[3] == pytest.approx(0.5)
    assert np.allclose(ImagePixels(pixels, True).linear(), pixels / 255)


def test_premultiplied_colours_are_divided_by_alpha_only_where_alpha_is_asked_for() -> None:
    pixels = np.full((1, 1, 4), 0.25, np.float32)
    image, p = ImagePixels(pixels, premultiplied=True), np.float32([[0.3], [0.3]])
    assert np.allclose(image_texture(image, "Closest", "REPEAT", True, p), 0.25)
    assert np.allclose(image_texture(image, "Closest", "REPEAT", False, p)[:, 0], (1, 1, 1, 0.25))


def test_places_that_are_no_numbers_have_some_colour(rng) -> None:
    p = np.float32([[np.nan, np.inf, -np.inf, 1e30], [0, np.nan, 3e38, -1e30]])
    for interpolation in INTERPOLATIONS:
        for extension in ("REPEAT", "EXTEND", "CLIP", "MIRROR"):
            look = partial(image_texture, noise(rng), interpolation, extension, True)
            assert np.isfinite(compute(look, p)).all()


@pytest.mark.parametrize("blend", [0.0, 0.2, 1.0])
def test_sides_of_a_box_share_what_is_there(rng, blend: float) -> None:
    white = ImagePixels(np.ones((1, 1, 4), np.float32))
    p = rng.uniform(-1, 1, (3, N)).astype(np.float32)
    found = compute(partial(box_texture, white, "Linear", "REPEAT", True, blend), p, directions(rng))
    assert np.allclose(found, 1, atol=1e-5)
    image = noise(rng)
    up = np.tile(np.float32([[0], [0], [-1]]), N)
    along_z = image_texture(image, "Linear", "REPEAT", True, p[[1, 0]])
    found = compute(partial(box_texture, image, "Linear", "REPEAT", True, blend), p, up)
    assert np.allclose(found, along_z, atol=1e-6)


def test_sphere_and_tube_projections(rng) -> None:
    angle, height = rng.uniform(-np.pi, np.pi, N), rng.uniform(-0.9, 0.9, N)
    p = np.stack([np.sin(angle), np.cos(angle), height]) / 2 + 0.5
    assert np.allclose(on_tube(p), [0.5 - angle / (2 * np.pi), (height + 1) / 2], atol=1e-6)
    latitude = np.arctan2(height, 1)
    assert np.allclose(on_sphere(p), [0.5 - angle / (2 * np.pi), 0.5 + latitude / np.pi], atol=1e-6)
    assert not on_sphere(np.full((3, 1), 0.5)).any() and not on_tube(np.full((3, 1), 0.5)).any()


# Patterns and ramps


def test_half_of_a_checker_is_dark_and_neighbours_differ(rng) -> None:
    p = rng.uniform(-8, 8, (3, 100 * N)).astype(np.float32)
    found = checker(p, np.float32(1))
    assert abs(found.mean() - 0.5) < 4 * 0.5 / np.sqrt(100 * N) + 1e-3
    inside = np.abs(p % 1 - 0.5).max(axis=0) < 0.499
    for step in np.eye(3, dtype=np.float32):
        assert (checker(p + step[:, None], np.float32(1)) != found)[inside].all()
    assert checker(np.float32([[0.5], [0.5], [0.5]]), np.float32(1)) == 0


def test_gradients() -> None:
    p = np.float32([[0.6], [0.3], [0.0]])
    wanted = {
        "LINEAR": 0.6,
        "QUADRATIC": 0.36,
        "EASING": 3 * 0.36 - 2 * 0.216,
        "DIAGONAL": 0.45,
        "RADIAL": np.arctan2(0.3, 0.6) / (2 * np.pi) + 0.5,
        "SPHERICAL": 1 - np.hypot(0.6, 0.3),
        "QUADRATIC_SPHERE": (1 - np.hypot(0.6, 0.3)) ** 2,
    }
    for kind, value in wanted.items():
        assert gradient(kind, p) == pytest.approx(value, abs=1e-5)
        assert gradient(kind, p).shape == ()


def test_ramps_interpolate_hold_and_go_on(rng) -> None:
    table = np.stack([np.linspace(0, 1, ramps.ENTRIES), np.linspace(3, 1, ramps.ENTRIES)]).astype(np.float32)
    x = rng.uniform(-1, 2, N).astype(np.float32)
    inside = np.clip(x, 0, 1)
    assert np.allclose(ramps.look_up(table, True, x), [inside, 3 - 2 * inside], atol=1e-6)
    assert np.allclose(ramps.look_up_beyond(table, x), [x, 3 - 2 * x], atol=1e-4)
    stepped = ramps.look_up(table, False, x)[0] * 255
    assert np.allclose(stepped, np.round(stepped), atol=1e-3)
    through = ramps.curves(table[[0, 0, 0]], -1.0, 1.0, True, np.float32(1), np.float32([[-1], [0], [3]]))
    assert np.allclose(through[:, 0], (0, 0.5, 2), atol=1e-4)


# Arithmetic and colour


def test_arithmetic_at_its_edges() -> None:
    zero, one, two = np.float32(0), np.float32(1), np.float32(2)
    with np.errstate(all="ignore"):
        assert MATH["DIVIDE"](one, zero, zero) == 0 and MATH["POWER"](zero, zero, zero) == 1
        assert MATH["POWER"](-two, np.float32(0.5), zero) == 0 and MATH["POWER"](-two, two, zero) == 4
        assert MATH["LOGARITHM"](-one, two, zero) == 0 and MATH["LOGARITHM"](np.float32(8), two, 0) == 3
        assert MATH["MODULO"](-one, zero, zero) == 0 and MATH["MODULO"](np.float32(-5), two, 0) == -1
        assert MATH["FLOORED_MODULO"](np.float32(-5), two, zero) == 1
        assert MATH["WRAP"](np.float32(2.5), two, one) == 1.5 and MATH["WRAP"](one, two, two) == 2
        assert MATH["PINGPONG"](np.float32(2.5), one, zero) == pytest.approx(0.5)
        assert MATH["SMOOTH_MIN"](one, one, zero) == 1 and MATH["SMOOTH_MIN"](one, one, one) < 1
        null = np.zeros((3, 1), np.float32)
        assert not VECTOR_MATH["NORMALIZE"](null, null, null, zero).any()
        assert not VECTOR_MATH["PROJECT"](null + 1, null, null, zero).any()


def test_every_operation_gives_finite_float32_for_any_finite_input(rng) -> None:
    a, b, c = rng.choice([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 3.0], (3, 3, N)).astype(np.float32)
    for operation in MATH.values():
        found = compute(operation, a[0], b[0], c[0])
        assert found.dtype == np.float32 and np.isfinite(found).all()
    for operation in VECTOR_MATH.values():
        found = compute(operation, a, b, c, a[0])
        assert found.dtype == np.float32 and np.isfinite(found).all()
    for blend in BLEND.values():
        assert np.isfinite(compute(blend, np.abs(c[0]) / 3, np.abs(a), np.abs(b))).all()


def test_operations_of_constants_and_of_arrays_agree(rng) -> None:
    a, b, c = rng.uniform(-2, 2, (3, 3, 4)).astype(np.float32)
    for name, operation in VECTOR_MATH.items():
        found = np.broadcast_to(compute(operation, a, b, c, np.float32(0.7)), np.shape(a))[..., 1]
        alone = compute(operation, a[:, 1], b[:, 1], c[:, 1], 0.7)
        assert np.allclose(found, np.broadcast_to(alone, (3, 1))[:, 0], rtol=1e-5, atol=1e-6), name


def test_map_range_meets_its_ends() -> None:
    for kind in ("LINEAR", "STEPPED", "SMOOTHSTEP", "SMOOTHERSTEP"):
        ends = (np.float32(x) for x in (2, 6, 5, -1, 4))
        low, high, to_low, to_high, steps = ends
        value = np.float32([2, 6, 4])
        found = map_range(kind, True, value, low, high, to_low, to_high, steps)
        assert np.allclose(found, (5, -1, 2), atol=1e-6)


@pytest.mark.parametrize("space", ["HSV", "HSL"])
def test_colour_spaces_invert_each_other(rng, space: str) -> None:
    rgb = rng.uniform(size=(3, N)).astype(np.float32)
    with np.errstate(all="ignore"):
        assert np.allclose(TO_RGB[space](FROM_RGB[space](rgb)), rgb, atol=1e-5)
        grey = np.float32([[0.3], [0.3], [0.3]])
        assert np.allclose(TO_RGB[space](FROM_RGB[space](grey)), grey)
        green = FROM_RGB[space](np.float32([[0], [1], [0]]))
    assert green[0] == pytest.approx(1 / 3)


def test_srgb_codes_invert_each_other() -> None:
    code = np.linspace(0, 1, N, dtype=np.float32)
    assert np.allclose(linear_to_srgb(srgb_to_linear(code)), code, atol=1e-5)
    assert srgb_to_linear(np.float32(0.5)) == pytest.approx(0.21404, abs=1e-5)


def test_blend_modes_leave_the_first_colour_at_factor_0(rng) -> None:
    a, b = rng.uniform(0.05, 1, (2, 3, N)).astype(np.float32)
    for name, blend in BLEND.items():
        assert np.allclose(compute(blend, np.float32(0), a, b), a, atol=1e-5), name


def test_blend_modes_at_factor_1(rng) -> None:
    a, b = rng.uniform(0.05, 0.95, (2, 3, N)).astype(np.float32)
    wanted = {
        "MIX": b,
        "MULTIPLY": a * b,
        "SCREEN": a + b - a * b,
        "OVERLAY": np.where(a < 0.5, 2 * a * b, 1 - 2 * (1 - a) * (1 - b)),
        "DIFFERENCE": abs(a - b),
        "EXCLUSION": a + b - 2 * a * b,
        "DODGE": np.minimum(a / (1 - b), 1),
        "BURN": np.maximum(1 - (1 - a) / b, 0),
        "LINEAR_LIGHT": a + 2 * b - 1,
    }
    for name, value in wanted.items():
        assert np.allclose(compute(BLEND[name], 1.0, a, b), value, atol=1e-4), name


def test_hue_half_way_changes_nothing_and_turns_by_thirds(rng) -> None:
    rgb = rng.uniform(size=(3, N)).astype(np.float32)
    half, one = np.float32(0.5), np.float32(1)
    assert np.allclose(compute(hue_saturation, half, one, one, one, rgb), rgb, atol=1e-5)
    turned = compute(hue_saturation, half + np.float32(1 / 3), one, one, one, rgb)
    assert np.allclose(turned, rgb[[2, 0, 1]], atol=1e-5)


def test_black_bodies_have_luminance_1_and_turn_from_red_to_blue() -> None:
    kelvin = np.float32([1000, 2000, 3000, 5000, 6500, 10000])
    colour = blackbody(kelvin)
    lit = (colour > 0).all(axis=0)
    assert np.allclose(np.dot((0.2126, 0.7152, 0.0722), colour)[lit], 1, atol=2e-3)
    assert (np.diff(colour[0]) < 0).all() and (np.diff(colour[2][1:]) > 0).all()
    assert np.allclose(blackbody(np.float32(6504))[:, 0], 1, atol=0.06)


# Coordinates and normals


def test_texture_mapping_inverts_point_mapping(rng) -> None:
    vector = rng.normal(size=(3, N)).astype(np.float32)
    how = [np.float32(x)[:, None] for x in ((1, -2, 0.5), (0.3, 1.2, -0.7), (2, -0.5, 3))]
    there = coordinates.mapping("POINT", vector, *how)
    assert np.allclose(coordinates.mapping("TEXTURE", there, *how), vector, atol=1e-5)
    columns = np.stack([c[:, 0] for c in coordinates.rotation(how[1])], axis=1)
    assert np.allclose(columns @ columns.T, np.eye(3), atol=1e-6) and np.linalg.det(columns) > 0


def test_rotation_about_an_axis_keeps_it_and_inverts(rng) -> None:
    v, axis = rng.normal(size=(3, N)).astype(np.float32), np.float32([[1], [2], [-0.5]])
    centre, angle = np.float32([[0.1], [0.2], [0.3]]), np.float32(0.8)
    turned = coordinates.rotate_about(False, v, centre, axis, angle)
    assert np.allclose(coordinates.rotate_about(True, turned, centre, axis, angle), v, atol=1e-5)
    assert np.allclose(coordinates.rotate_about(False, centre + axis, centre, axis, angle), centre + axis)


@pytest.mark.parametrize("mirror", [1, -1])
def test_normals_stay_perpendicular_and_outside_under_any_matrix(rng, mirror: int) -> None:
    matrix = rng.normal(size=(3, 3))
    matrix *= mirror * np.sign(np.linalg.det(matrix))
    columns = matrix.T.reshape(9, 1).astype(np.float32)
    normal, tangent = directions(rng), directions(rng)
    tangent = tangent - normal * (normal * tangent).sum(axis=0)
    world = coordinates.normal_to_world(columns, normal)
    assert np.allclose((world * coordinates.to_world(columns, tangent)).sum(axis=0), 0, atol=1e-4)
    assert ((world * coordinates.to_world(columns, normal)).sum(axis=0) > 0).all()
    assert np.allclose(coordinates.normal_to_object(columns, world), normal, atol=1e-3)
    vector = rng.normal(size=(3, N)).astype(np.float32)
    assert np.allclose(coordinates.to_object(columns, matrix @ vector), vector, atol=1e-2)


IDENTITY = np.eye(3, dtype=np.float32).reshape(9, 1)


def frames(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Tangent frames of handedness 1, and their normals."""
    normal = directions(rng)
    tangent = coordinates.perpendicular(directions(rng), normal)
    return np.concatenate([tangent, np.ones((1, N)), normal]).astype(np.float32), normal


@pytest.mark.parametrize("back", [0.0, 1.0])
def test_normal_map_in_tangent_space(rng, back: float) -> None:
    frame, normal = frames(rng)
    surface = -normal if back else normal
    flags = np.full(N, back)

    def bent(colour: tuple[float, float, float], strength: float) -> np.ndarray:
        colour = np.float32(colour)[:, None]
        return normal_map.in_tangent_space(colour, np.float32(strength), frame, IDENTITY, surface, flags)

    side = -1 if back else 1
    assert np.allclose(bent((0.5, 0.5, 1), 1), surface, atol=1e-6)
    assert np.allclose(bent((1, 0.5, 0.5), 1), side * frame[:3], atol=1e-6)
    assert np.allclose(bent((0.5, 1, 0.5), 1), side * np.cross(normal.T, frame[:3].T).T, atol=1e-6)
    assert np.allclose(bent((0.9, 0.3, 0.8), 0), surface, atol=1e-6)
    assert np.allclose(np.linalg.norm(bent((0.9, 0.3, 0.8), 0.7), axis=0), 1, atol=1e-5)
    frame[:4] = 0
    assert np.array_equal(bent((0.9, 0.3, 0.8), 1), surface)


def test_normal_map_in_object_and_world_space(rng) -> None:
    surface, front = directions(rng), np.zeros(N)
    colour = (directions(rng) + 1) / 2
    for object_space in (False, True):
        found = normal_map.in_space(object_space, colour, np.float32(1), IDENTITY, surface, front)
        assert np.allclose(found, 2 * colour - 1, atol=1e-5)
        found = normal_map.in_space(object_space, colour, np.float32(0), IDENTITY, surface, front)
        assert np.allclose(found, surface, atol=1e-5)


def test_radial_tangent_runs_around_the_axis() -> None:
    angle = np.linspace(0.1, 6, N)
    generated = np.stack([np.cos(angle), np.sin(angle), np.zeros(N)]).astype(np.float32) / 2 + 0.5
    outward = np.stack([np.cos(angle), np.sin(angle), np.zeros(N)]).astype(np.float32)
    attributes = {"generated": generated, "object_to_world": np.tile(IDENTITY, N)}
    tangent = value_at(coordinates.radial_tangent("Z"), points(attributes=attributes, normal=outward))
    assert isinstance(coordinates.radial_tangent("Z"), Value)
    assert np.allclose(tangent, [-np.sin(angle), np.cos(angle), 0 * angle], atol=1e-6)


def test_fresnel_head_on_at_the_rim_and_inside() -> None:
    normal = np.float32([[0, 0, 0], [0, 0, 0], [1, 1, 1]])
    cosine = np.float32([1, 1e-4, 0.5])
    viewer = np.stack([np.sqrt(1 - cosine**2), np.zeros(3), cosine]).astype(np.float32)
    front = fresnel.fresnel(np.float32(1.5), normal, viewer, np.zeros(3))
    assert front[0] == pytest.approx(0.04) and front[1] > 0.99
    # From inside, 60 degrees is beyond the critical angle of 41.8.
    back = fresnel.fresnel(np.float32(1.5), normal, viewer, np.ones(3))
    assert back[0] == pytest.approx(0.04) and back[2] == 1
    assert np.allclose(fresnel.facing(np.float32(0.5), normal, viewer), 1 - cosine, atol=1e-6)
