# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures through Blender: borders, passes, layers, animations, settings, cancelling."""

from __future__ import annotations

import sys
from pathlib import Path
from threading import Event
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from extension_scenes import add_cube, diffuse, furnished, load, render, set_world

from engine_core.image.nonnegative import raise_negative


@pytest.fixture
def scene(cv: ModuleType) -> Any:
    return furnished()


def set_border(scene: Any, left: float, right: float, bottom: float, top: float, crop: bool = False) -> None:
    edit = scene.render
    edit.use_border, edit.use_crop_to_border = True, crop
    edit.border_min_x, edit.border_max_x, edit.border_min_y, edit.border_max_y = left, right, bottom, top


def test_picture_is_lit_and_opaque(scene: Any, tmp_path: Path) -> None:
    picture = render(scene, tmp_path)
    assert picture.shape == (24, 32, 4)
    assert (picture[..., 3] == 1).all() and picture[..., :3].mean() > 0.01


def test_borders_join_to_the_whole_picture_bit_for_bit(scene: Any, tmp_path: Path) -> None:
    # Control variates share what they know over the picture: of these, borders join within the noise.
    scene.cv_render.integrator = "sobol"
    whole = render(scene, tmp_path)
    parts = np.zeros_like(whole)
    for x0, x1 in ((0, 11), (11, 32)):
        for y0, y1 in ((0, 7), (7, 24)):
            # The middle of a pixel's fraction: Blender truncates.
            set_border(scene, (x0 + 0.1) / 32, (x1 + 0.1) / 32, (y0 + 0.1) / 24, (y1 + 0.1) / 24, crop=True)
            parts[y0:y1, x0:x1] = render(scene, tmp_path)
    assert np.array_equal(parts, whole)


def test_border_without_crop_keeps_the_frame(scene: Any, tmp_path: Path) -> None:
    scene.cv_render.integrator = "sobol"
    whole = render(scene, tmp_path)
    set_border(scene, 0.25, 0.5, 0.25, 0.75)
    part = render(scene, tmp_path)
    assert part.shape == whole.shape
    assert np.array_equal(part[6:18, 8:16], whole[6:18, 8:16])
    part[6:18, 8:16] = 0
    assert not part[..., :3].any()


def test_transparent_film_has_no_background(scene: Any, tmp_path: Path) -> None:
    set_world(scene, (1, 1, 1))
    scene.render.film_transparent = True
    picture = render(scene, tmp_path)
    sky = picture[-1]
    assert not sky.any() and picture[0, :, 3].all()


def test_passes_of_the_integrator_add_up(scene: Any, tmp_path: Path) -> None:
    import bpy
    import OpenEXR

    chosen = bpy.context.view_layer.cv_render
    for name in ("control_variate", "residual", "sample_count", "standard_error"):
        setattr(chosen, f"use_pass_{name}", True)
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    scene.render.filepath = str(tmp_path / "passes.exr")
    bpy.ops.render.render(write_still=True)
    file = OpenEXR.File(scene.render.filepath, separate_channels=True)
    found = {name: channel.pixels for part in file.parts for name, channel in part.channels.items()}
    sums = [found[f"ViewLayer.CV.{c}"] + found[f"ViewLayer.Residual.{c}"] for c in "RGB"]
    shown = np.stack(sums, axis=-1)
    raise_negative(shown)
    for i, c in enumerate("RGB"):
        assert np.allclose(found[f"ViewLayer.Combined.{c}"], shown[..., i], atol=1e-5)
        assert (found[f"ViewLayer.Standard Error.{c}"] >= 0).all() and found[f"ViewLayer.CV.{c}"].any()
    # Where nothing is left to sample, the polynomials stand alone.
    assert found["ViewLayer.Sample Count.X"].min() >= 0 and found["ViewLayer.Sample Count.X"].max() >= 1


def test_passes_have_the_names_and_values_of_cycles(scene: Any, tmp_path: Path) -> None:
    import bpy
    import OpenEXR

    layer = bpy.context.view_layer
    layer.use_pass_z = layer.use_pass_normal = True
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    channels = {}
    scene.cycles.samples = 64
    scene.cv_render.samples = 64
    scene.cycles.pixel_filter_type = "BOX"
    for engine in ("CYCLES", "CV_RENDER"):
        scene.render.engine = engine
        scene.render.filepath = str(tmp_path / f"{engine}.exr")
        bpy.ops.render.render(write_still=True)
        file = OpenEXR.File(scene.render.filepath, separate_channels=True)
        channels[engine] = {
            name: channel.pixels for part in file.parts for name, channel in part.channels.items()
        }
    ours, theirs = channels["CV_RENDER"], channels["CYCLES"]
    assert set(ours) <= set(theirs) and {"ViewLayer.Depth.Z", "ViewLayer.Normal.X"} <= set(ours)
    for axis in "XYZ":
        assert np.abs(ours[f"ViewLayer.Normal.{axis}"] - theirs[f"ViewLayer.Normal.{axis}"]).mean() < 0.02
    # Depth is that of one sample somewhere in the pixel: edges differ.
    close = np.isclose(ours["ViewLayer.Depth.Z"], theirs["ViewLayer.Depth.Z"], rtol=0.05)
    assert close.mean() > 0.85 and (ours["ViewLayer.Depth.Z"] == 1e10).any()


def test_each_view_layer_is_a_picture_of_its_own(cv: ModuleType, scene: Any, tmp_path: Path) -> None:
    import bpy
    import OpenEXR

    layer = scene.view_layers.new("Red")
    layer.material_override = diffuse("Red", (1, 0, 0))
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.filepath = str(tmp_path / "layers.exr")
    bpy.ops.render.render(write_still=True)
    file = OpenEXR.File(scene.render.filepath, separate_channels=True)
    channels = {name: channel.pixels for part in file.parts for name, channel in part.channels.items()}
    assert channels["ViewLayer.Combined.G"].any() and channels["ViewLayer.Combined.R"].any()
    assert not channels["Red.Combined.G"].any() and channels["Red.Combined.R"].any()


def test_each_eye_has_a_picture_of_its_own(scene: Any, tmp_path: Path) -> None:
    import bpy
    import OpenEXR

    scene.render.use_multiview = True
    scene.render.image_settings.views_format = "INDIVIDUAL"
    scene.render.filepath = str(tmp_path / "eye")
    bpy.ops.render.render(write_still=True)
    files = (OpenEXR.File(str(tmp_path / f"eye_{side}.exr"), separate_channels=True) for side in "LR")
    left, right = (file.channels()["R"].pixels for file in files)
    assert left.any() and right.any() and not np.allclose(left, right, atol=0.01)


def test_animation_is_its_single_frames_bit_for_bit(scene: Any, tmp_path: Path) -> None:
    import bpy

    cube = scene.objects["Cube"]
    for frame, x in ((1, -1.0), (3, 1.0)):
        cube.location.x = x
        cube.keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end = 1, 3
    scene.render.filepath = str(tmp_path / "frame_")
    bpy.ops.render.render(animation=True)
    frames = [load(tmp_path / f"frame_{i:04d}.exr") for i in (1, 2, 3)]
    assert not np.array_equal(frames[0], frames[2])
    for i, frame in enumerate(frames):
        scene.frame_set(i + 1)
        assert np.array_equal(render(scene, tmp_path), frame)


def test_same_seed_same_picture_and_another_seed_another(scene: Any, tmp_path: Path) -> None:
    first = render(scene, tmp_path, seed=3)
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.cv_render.tile_size = "64"
    assert np.allclose(render(scene, tmp_path, seed=3), first, rtol=1e-5, atol=1e-6)
    assert not np.array_equal(render(scene, tmp_path, seed=4), first)


def test_animated_seed_changes_the_noise_of_still_things(scene: Any, tmp_path: Path) -> None:
    still = [render(scene, tmp_path) for scene.frame_current in (1, 2)]
    scene.cv_render.use_animated_seed = True
    moving = [render(scene, tmp_path) for scene.frame_current in (1, 2)]
    assert np.array_equal(*still) and not np.array_equal(*moving)


def test_threads_follow_blenders_own_setting(cv: ModuleType, scene: Any) -> None:
    import bpy

    settings = cv.cv_render.properties.engine_settings
    scene.render.threads_mode = "AUTO"
    assert settings(scene, bpy.context.view_layer).threads == 0
    scene.render.threads_mode, scene.render.threads = "FIXED", 3
    assert settings(scene, bpy.context.view_layer).threads == 3


def test_cancelling_keeps_what_is_there(
    cv: ModuleType, scene: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    polls, begun = [], Event()
    tree = cv.engine_core.integration.regions.RegionTree
    sweep = tree.sweep

    def begin(*arguments: Any) -> int:
        begun.set()  # before that nothing is there
        return sweep(*arguments)

    def cancelled(sink: Any) -> bool:
        polls.extend([sink] * begun.is_set())
        return len(polls) > 3

    monkeypatch.setattr(tree, "sweep", begin)
    monkeypatch.setattr(cv.cv_render.session.BlenderSink, "cancelled", cancelled)
    scene.cv_render.samples = 1 << 20
    picture = render(scene, tmp_path)
    assert 3 < len(polls) < 10 and np.isfinite(picture).all() and picture[..., :3].any()


def open_panels() -> set[str]:
    import bpy

    panels = bpy.types.Panel.__subclasses__()
    return {panel.__name__ for panel in panels if "CV_RENDER" in getattr(panel, "COMPAT_ENGINES", ())}


def test_registering_ten_times_leaves_one_engine(cv: ModuleType, scene: Any, tmp_path: Path) -> None:
    import bpy

    before = render(scene, tmp_path)
    panels = open_panels()
    for _ in range(10):
        cv.unregister()
        assert not hasattr(bpy.types.Scene, "cv_render")
        cv.register()
    assert panels == open_panels() and "RENDER_PT_output" in panels
    scene.cv_render.samples = 4
    assert np.array_equal(render(scene, tmp_path), before)


def test_settings_are_explained(cv: ModuleType, scene: Any) -> None:
    for prop in type(scene.cv_render).bl_rna.properties:
        if prop.identifier not in ("rna_type", "name"):
            assert prop.name and len(prop.description) > 20, prop.identifier


def test_blenders_panels_are_open_to_the_engine(cv: ModuleType, scene: Any) -> None:
    import bpy

    for name in (
        "DATA_PT_lens",
        "DATA_PT_context_light",
        "EEVEE_MATERIAL_PT_context_material",
        "RENDER_PT_format",
        "RENDER_PT_output",
        "RENDER_PT_color_management",
        "WORLD_PT_context_world",
        "VIEWLAYER_PT_layer",
        "DATA_PT_context_mesh",
        "CVRENDER_LIGHT_PT_light",
        "CVRENDER_MATERIAL_PT_surface",
        "CVRENDER_WORLD_PT_surface",
        "CVRENDER_OBJECT_PT_visibility",
    ):
        assert "CV_RENDER" in getattr(bpy.types, name).COMPAT_ENGINES, name


def test_messages_of_the_last_render_are_kept_for_the_panel(
    cv: ModuleType, scene: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    scene.render.use_motion_blur = True
    render(scene, tmp_path)
    (message,) = cv.cv_render.session.last_messages
    assert "motion blur" in message
    sys.stdout.flush()
    assert capfd.readouterr().out.count(f"CV Render: {message}") >= 1
    scene.render.use_motion_blur = False
    add_cube(scene)
    render(scene, tmp_path)
    assert not cv.cv_render.session.last_messages
