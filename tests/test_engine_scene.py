# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene may not hold: every error names whose field it is, its shape and its value."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scenes import box, floor, lit_patch, place, sphere, studio

import engine_core
from engine_core import (
    AreaLight,
    Camera,
    CVRenderError,
    Material,
    Mesh,
    PointLight,
    Scene,
    SceneError,
    Settings,
    SpotLight,
    SunLight,
    World,
    render,
)
from engine_core.geometry import raytracer
from engine_core.geometry.raytracer import RayTracer

CORNERS = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def _camera(**fields) -> Camera:
    return Camera(
        **({"camera_to_world": np.eye(4), "viewplane": (-1, 1, -1, 1), "width": 8, "height": 4} | fields)
    )


WRONG: dict[str, tuple[Callable[[], object], tuple[str, ...]]] = {
    "vertices of 2 numbers": (
        lambda: Mesh(np.zeros((5, 2)), [[0, 1, 2]], name="Cube"),
        ("Cube", "vertices", "(5, 2)", "3"),
    ),
    "vertices of text": (lambda: Mesh("no", [[0, 1, 2]], name="Cube"), ("Cube", "vertices")),
    "triangle out of range": (lambda: Mesh(CORNERS, [[0, 1, 3]], name="Cube"), ("Cube", "triangles", "3")),
    "negative triangle": (lambda: Mesh(CORNERS, [[0, 1, -1]], name="Cube"), ("Cube", "triangles", "-1")),
    "index beyond 32 bits": (lambda: Mesh(CORNERS, [[0, 1, 2**40]], name="Cube"), ("Cube", "triangles")),
    "quads": (lambda: Mesh(CORNERS, [[0, 1, 2, 0]], name="Cube"), ("Cube", "triangles", "(1, 4)")),
    "normals of vertices": (
        lambda: Mesh(CORNERS, [[0, 1, 2]], np.zeros((3, 3)), name="Cube"),
        ("Cube", "normals", "(3, 3)", "(1, 3, 3)"),
    ),
    "materials of another mesh": (
        lambda: Mesh(CORNERS, [[0, 1, 2]], materials=[0, 0], name="Cube"),
        ("Cube", "materials", "(2,)", "(1,)"),
    ),
    "material out of range": (
        lambda: Scene(_camera(), [Mesh(CORNERS, [[0, 1, 2]], materials=3, name="Cube")]),
        ("Cube", "materials", "3"),
    ),
    "terminator offset": (
        lambda: Mesh(CORNERS, [[0, 1, 2]], terminator_offset=2, name="Cube"),
        ("Cube", "terminator_offset", "2", "1"),
    ),
    "scaled camera": (
        lambda: _camera(camera_to_world=np.diag([2.0, 2, 2, 1])),
        ("Camera", "camera_to_world", "2.0"),
    ),
    "camera of NaN": (
        lambda: _camera(camera_to_world=np.full((4, 4), np.nan)),
        ("camera_to_world", "nan", "(4, 4)"),
    ),
    "empty viewplane": (lambda: _camera(viewplane=(1, 1, -1, 1)), ("viewplane", "1.0")),
    "infinite viewplane": (lambda: _camera(viewplane=(-np.inf, 1, -1, 1)), ("viewplane", "inf")),
    "no pixel": (lambda: _camera(width=0), ("width", "0")),
    "text as width": (lambda: _camera(width="wide"), ("width", "wide")),
    "width of NaN": (lambda: _camera(width=np.nan), ("width", "nan")),
    "empty region": (lambda: _camera(region=(2, 0, 2, 4)), ("region", "(2, 0, 2, 4)")),
    "region outside": (lambda: _camera(region=(0, 0, 9, 4)), ("region", "(0, 0, 9, 4)", "8 x 4")),
    "fisheye": (lambda: _camera(projection="fisheye"), ("projection", "fisheye", "perspective")),
    "negative clip start": (lambda: _camera(clip_start=-1.0), ("clip_start", "-1")),
    "clip end before its start": (lambda: _camera(clip_start=2.0, clip_end=1.0), ("clip_end", "1", "2")),
    "power of NaN": (lambda: PointLight(np.nan, name="Lamp"), ("Lamp", "power", "nan")),
    "power of four": (lambda: PointLight((1, 1, 1, 1), name="Lamp"), ("Lamp", "power", "(4,)", "(3,)")),
    "place for normalize": (
        lambda: PointLight(1.0, (0, 0, 2), name="Lamp"),
        ("Lamp", "normalize", "(0, 0, 2)", "True or False"),
    ),
    "text as shadow": (lambda: PointLight(1.0, casts_shadow="no", name="Lamp"), ("casts_shadow", "'no'")),
    "negative radius": (lambda: PointLight(1.0, radius=-2, name="Lamp"), ("Lamp", "radius", "-2")),
    "text as radius": (lambda: PointLight(1.0, radius="big", name="Lamp"), ("Lamp", "radius", "big")),
    "infinite position": (
        lambda: PointLight(1.0, position=(0, np.inf, 0), name="Lamp"),
        ("Lamp", "position", "inf", "(3,)"),
    ),
    "wide spot": (lambda: SpotLight(1.0, angle=4.0, name="Lamp"), ("Lamp", "angle", "4")),
    "blend over 1": (lambda: SpotLight(1.0, blend=1.5, name="Lamp"), ("Lamp", "blend", "1.5")),
    "matrix of 3 rows": (
        lambda: SpotLight(1.0, light_to_world=np.eye(3), name="Lamp"),
        ("Lamp", "light_to_world", "(3, 3)", "(4, 4)"),
    ),
    "negative size": (lambda: AreaLight(1.0, size=(1, -1), name="Lamp"), ("Lamp", "size", "-1")),
    "negative spread": (lambda: AreaLight(1.0, spread=-0.1, name="Lamp"), ("Lamp", "spread", "-0.1")),
    "sun without direction": (
        lambda: SunLight(1.0, direction=(0, 0, 0), name="Lamp"),
        ("Lamp", "direction", "0.0"),
    ),
    "sun of all around": (lambda: SunLight(1.0, angle=7.0, name="Lamp"), ("Lamp", "angle", "7")),
    "negative reflectance": (lambda: Material((0.5, -0.1, 0)), ("Material", "reflectance", "-0.1")),
    "emission of infinity": (lambda: Material(0.5, np.inf), ("Material", "emission", "inf")),
    "world of NaN": (lambda: World((0, np.nan, 0)), ("World", "radiance", "nan")),
    "no camera": (lambda: Scene(None), ("Scene", "camera", "None")),
    "light among meshes": (lambda: Scene(_camera(), [World()]), ("Scene", "meshes[0]", "World", "Mesh")),
    "origin of two": (lambda: Scene(_camera(), origin=(0, 0)), ("Scene", "origin", "(2,)", "(3,)")),
    "no sample": (lambda: Settings(samples=0), ("Settings", "samples", "0", "1")),
    "samples of NaN": (lambda: Settings(samples=np.nan), ("Settings", "samples", "nan")),
    "unknown integrator": (
        lambda: Settings(integrator="magic"),
        ("Settings", "integrator", "magic", "sobol"),
    ),
    "negative time": (lambda: Settings(time_limit=-1), ("Settings", "time_limit", "-1")),
    "tiles across blocks": (lambda: Settings(tile_size=20), ("Settings", "tile_size", "20", "16")),
    "batch of nothing": (lambda: Settings(batch_size=0), ("Settings", "batch_size", "0", "64")),
}


@pytest.mark.parametrize("name", WRONG)
def test_error_names_field_and_value(name):
    make, words = WRONG[name]
    with pytest.raises(SceneError) as caught:
        make()
    message = str(caught.value)
    assert all(word in message for word in words), message
    assert "\n" not in message or "array" in message
    assert isinstance(caught.value, CVRenderError) and isinstance(caught.value, ValueError)


def test_scene_cannot_be_changed():
    mesh = Mesh(CORNERS, [[0, 1, 2]])
    with pytest.raises(AttributeError):
        mesh.vertices = None
    with pytest.raises(ValueError):
        mesh.vertices[0] = 1
    assert mesh.vertices.dtype == np.float32 and mesh.triangles.dtype == np.int32


def test_callers_array_stays_writeable_and_is_not_copied():
    vertices = np.array(CORNERS, np.float32)
    mesh = Mesh(vertices, [[0, 1, 2]])
    assert vertices.flags.writeable and np.shares_memory(vertices, mesh.vertices)


def test_grey_is_one_number():
    assert np.array_equal(Material(0.5).reflectance, (0.5, 0.5, 0.5))
    assert np.array_equal(World(2).radiance, (2, 2, 2))


def test_empty_scene_is_its_world():
    film = render(Scene(_camera(), world=World((1, 2, 3))), Settings(samples=2))
    assert np.array_equal(film.combined, np.broadcast_to(np.float32([1, 2, 3, 1]), (4, 8, 4)))
    assert (film.depth == np.float32(1e10)).all() and not film.messages


MESSAGES = {
    "negative power": (PointLight(-1.0, name="Lamp"), "negative power"),
    "no power": (PointLight(0.0, name="Lamp"), "no power"),
    "no area": (AreaLight(1.0, size=0.0, name="Lamp"), "no area"),
    "flat area light": (AreaLight(1.0, light_to_world=place(scale=(1, 0, 1)), name="Lamp"), "no area"),
    "flat spot": (SpotLight(1.0, light_to_world=place(scale=(1, 1, 0)), name="Lamp"), "scale"),
    "closed spot": (SpotLight(1.0, angle=0.0, name="Lamp"), "angle 0"),
}


@pytest.mark.parametrize("name", MESSAGES)
def test_light_that_cannot_be_used_is_left_out_and_named(name):
    light, words = MESSAGES[name]
    good = PointLight(10.0, position=(1, 1, 2))
    film = render(lit_patch(light, good), Settings(samples=4))
    assert np.array_equal(film.combined, render(lit_patch(good), Settings(samples=4)).combined)
    (message,) = film.messages
    assert '"Lamp"' in message and words in message


def test_broken_vertices_are_left_out_and_named():
    whole = floor(3.0)
    vertices = np.concatenate([whole.vertices, [[np.nan, 0, 0], [np.inf, 0, 0]]])
    broken = Mesh(vertices, np.concatenate([whole.triangles, [[0, 1, 4], [1, 2, 5]]]), name="Sheet")
    lights = [PointLight(10.0, position=(0, 0, 3))]
    camera = Camera.look_at((0, -4, 3), (0, 0, 0), 16, 16)
    film, expected = (
        render(Scene(camera, [mesh], lights=lights), Settings(samples=4)) for mesh in (broken, whole)
    )
    (message,) = film.messages
    assert '"Sheet"' in message and "2 of 4" in message
    assert np.allclose(film.combined, expected.combined, rtol=1e-3)
    assert not expected.messages


def test_unused_broken_vertices_are_no_matter():
    mesh = Mesh(np.concatenate([floor().vertices, [[np.nan] * 3]]), floor().triangles)
    film = render(
        Scene(studio().camera, [mesh], lights=[PointLight(9.0, position=(0, 0, 2))]), Settings(samples=1)
    )
    assert not film.messages and film.combined[..., 0].max() > 0


def test_invisible_shadowless_and_holdout_meshes():
    camera = Camera(place((0, 0, 5)), (-1, 1, -1, 1), 16, 16, projection="orthographic")
    sun = [SunLight(1.0, direction=(0, 0, -1))]

    def picture(**fields) -> np.ndarray:
        cover = box((-3, -3, 1), (3, 3, 1.5), **fields)
        return render(Scene(camera, [floor(), cover], lights=sun), Settings(samples=1)).combined

    lit = 0.8 / np.pi
    assert np.allclose(picture()[..., 0], lit)
    assert (picture(visible_to_camera=False)[..., :3] == 0).all()  # the floor in its shadow
    assert np.allclose(picture(visible_to_camera=False, casts_shadow=False)[..., 0], lit)
    held = picture(holdout=True)
    assert (held == 0).all()


VISIBLE = {
    "sphere": PointLight(100.0, position=(0, 10, 0), radius=3.0, visible_to_camera=True),
    "disk": PointLight(100.0, position=(0, 10, 0), radius=3.0, sphere=False, visible_to_camera=True),
    "area": AreaLight(
        100.0, light_to_world=place((0, 10, 0), (-np.pi / 2, 0, 0)), size=6.0, visible_to_camera=True
    ),
}
RADIANCE = {"sphere": 100 / (36 * np.pi**2), "disk": 100 / (36 * np.pi**2), "area": 100 / (36 * np.pi)}


@pytest.mark.parametrize("kind", VISIBLE)
def test_visible_light_is_seen_between_the_clipping_planes(kind):
    def seen(**clip: float) -> float:
        camera = Camera.look_at((0, 0, 0), (0, 10, 0), 3, 3, 0.1, **clip)
        return render(Scene(camera, lights=[VISIBLE[kind]]), Settings(samples=1)).combined[1, 1, 0]

    assert seen() == pytest.approx(RADIANCE[kind], rel=1e-5)
    assert seen(clip_start=1.0, clip_end=20.0) == pytest.approx(RADIANCE[kind], rel=1e-5)
    assert seen(clip_end=5.0) == 0
    assert seen(clip_start=15.0) == 0


@pytest.mark.parametrize("many", [0, 1 << 20])
def test_ray_tracer_takes_indices_however_they_lie(many, monkeypatch):
    """As rows of an array, and as the tuples that embreex reads sooner."""
    monkeypatch.setattr(raytracer, "MANY", many)
    mesh = sphere((0, 0, 0), 1.0)
    vertices, indices = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.triangles, np.int32)
    origins = 3 * vertices[indices].mean(axis=1)
    for form in (
        indices,
        np.asfortranarray(indices),
        np.repeat(indices, 2, axis=0)[::2],
        indices.astype(int),
    ):
        found = RayTracer(vertices, form).closest_hit(origins, -origins)
        assert np.array_equal(found.triangle, np.arange(len(indices)))


def test_missing_ray_tracer_is_one_clear_error():
    code = f"""
import sys
sys.modules["embreex"] = sys.modules["embreex.mesh_construction"] = None
sys.path.insert(0, {str(Path(engine_core.__file__).parents[1])!r})
from engine_core import Camera, Mesh, RenderError, Scene, render
scene = Scene(Camera.look_at((0, -3, 0), (0, 0, 0), 4, 4), [Mesh([[0,0,0],[1,0,0],[0,1,0]], [[0,1,2]])])
try:
    render(scene)
except RenderError as error:
    print(error)
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stderr
    assert "embreex" in result.stdout and result.stdout.count("\n") == 1
