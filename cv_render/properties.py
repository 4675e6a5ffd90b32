# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of scenes, view layers and lights, at their ``cv_render``."""

from __future__ import annotations

from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty

from ..engine_core import Settings
from ..engine_core.settings import MAX_SAMPLES

DEFAULTS = Settings()

INTEGRATORS = (
    (
        "control_variates",
        "Control Variates",
        "Light is approximated by polynomials, these are integrated exactly, and samples go where they are "
        "wrong: the least noise for the time in soft shadows. With more than 8 lights, mesh lights or depth "
        "of field, the same as Sobol",
    ),
    (
        "sobol",
        "Sobol",
        "Owen-scrambled Sobol points, as many in every pixel; best with a power of two",
    ),
    (
        "monte_carlo",
        "Monte Carlo",
        "Independent random points: much noisier, a baseline to compare with",
    ),
    (
        "quadrature",
        "Quadrature",
        "Nested adaptive quadrature over the lights: no noise, but slow and slightly wrong; to compare with",
    ),
    (
        "cv_only",
        "CV Only",
        "The polynomials alone: smooth, but blurred at the edges of shadows and objects; for previews",
    ),
)

DIRECT_SAMPLING = (
    (
        "mis",
        "Automatic (MIS)",
        "Multiple importance sampling combines directions towards the lights with directions that the BSDF "
        "reflects, for each lobe that is not rough; what is rough or diffuse needs the lights alone",
    ),
    (
        "light",
        "Lights",
        "Directions lead towards the lights alone: noisy where large lights mirror in smooth surfaces",
    ),
    (
        "bsdf",
        "BSDF",
        "What is not rough takes directions from its BSDF alone: noisy where lights are small. Lights "
        "without size, which no direction meets, are sampled still",
    ),
)

DISTANCE_SAMPLING = (
    ("auto", "Automatic", "The best that is known for each light"),
    (
        "equiangular",
        "Equiangular",
        "Alike in all directions from the light: clean shafts of light, noisy in thick fog",
    ),
    (
        "free_path",
        "Free Path",
        "As light gets out of the fog: for thick fog, noisy about lamps",
    ),
    (
        "mis",
        "Both (MIS)",
        "Equiangular and free path, combined by multiple importance sampling",
    ),
)

TILE_SIZES = (
    ("0", "Automatic", "By the size of the picture"),
    *((str(n), f"{n} px", f"{n} by {n} pixels") for n in (64, 128, 256, 512)),
)


class CVRenderSceneSettings(bpy.types.PropertyGroup):
    """How CV Render renders a scene."""

    samples: IntProperty(
        name="Samples",
        description="Camera rays for each pixel, on average. Twice as many take twice as long and leave "
        "about half the noise. Control Variates is as clean with 4 to 16 as others with 64 and more; "
        "Sobol is best with a power of two",
        default=DEFAULTS.samples,
        min=1,
        max=MAX_SAMPLES,
        soft_max=4096,
    )
    viewport_samples: IntProperty(
        name="Viewport Samples",
        description="Camera rays for each pixel in a rendered viewport",
        default=16,
        min=1,
        max=MAX_SAMPLES,
        soft_max=1024,
    )
    light_samples: IntProperty(
        name="Light Samples",
        description="Shadow rays for each camera ray; 0 lets the lights decide. "
        "More make soft shadows and many lights cleaner, each for a third of the cost of a camera ray. "
        "Control Variates always takes one for each light",
        default=DEFAULTS.light_samples,
        min=0,
        max=1024,
        soft_max=16,
    )
    integrator: EnumProperty(
        name="Integrator",
        description="How the light is integrated over pixels and lights",
        items=INTEGRATORS,
        default=DEFAULTS.integrator,
    )
    direct_sampling: EnumProperty(
        name="Direct Light",
        description="How directions are chosen in which light reaches a surface that is not diffuse",
        items=DIRECT_SAMPLING,
        default=DEFAULTS.direct_sampling,
    )
    distance_sampling: EnumProperty(
        name="Distance Sampling",
        description="How the points of a camera ray are chosen at which fog is lit",
        items=DISTANCE_SAMPLING,
        default=DEFAULTS.distance_sampling,
    )
    transparent_bounces: IntProperty(
        name="Transparent Bounces",
        description="Maximum number of transparent surfaces that a camera or shadow ray passes straight "
        "through. What is behind more of them is black, and in shadow",
        default=DEFAULTS.transparent_bounces,
        min=0,
        max=1024,
        soft_max=64,
    )
    seed: IntProperty(
        name="Seed",
        description="Another seed gives another pattern of noise, the same one the same picture, bit for bit",
        default=DEFAULTS.seed,
        min=0,
        max=2**31 - 1,
    )
    use_animated_seed: BoolProperty(
        name="Animate Seed",
        description="Change the pattern of noise from frame to frame. If off, it stands still",
        default=False,
    )
    noise_threshold: FloatProperty(
        name="Noise Threshold",
        description="Stop sampling a block of pixels when its estimated error, relative to the square root "
        "of its brightness, falls below this; 0 takes all samples everywhere. Lower is cleaner and slower",
        default=DEFAULTS.noise_threshold,
        min=0.0,
        soft_max=0.1,
        max=1.0,
        precision=4,
        step=0.1,
    )
    min_samples: IntProperty(
        name="Min Samples",
        description="Samples that every pixel gets before the noise threshold may stop it. "
        "Too few may miss what is small or rarely lit",
        default=DEFAULTS.min_samples,
        min=1,
        max=MAX_SAMPLES,
        soft_max=1024,
    )
    time_limit: FloatProperty(
        name="Time Limit",
        description="Seconds after which no further pass over the picture begins; 0 is no limit",
        default=DEFAULTS.time_limit,
        min=0.0,
        soft_max=3600.0,
        step=100,
        precision=1,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
    )
    tile_size: EnumProperty(
        name="Tile Size",
        description="Edge of the squares that threads work on, in pixels. Small ones share out the work "
        "better, large ones cost less bookkeeping",
        items=TILE_SIZES,
        default=str(DEFAULTS.tile_size),
    )


class CVRenderViewLayerSettings(bpy.types.PropertyGroup):
    """What of CV Render's own a view layer keeps."""

    use_pass_volume_direct: BoolProperty(
        name="Volume Direct",
        description="Light that fog scatters towards the camera, but for lasers'",
    )
    use_pass_laser: BoolProperty(
        name="Laser",
        description="Light of lasers: beams, the spots where they end, and what fog scatters out of them",
    )

    use_pass_control_variate: BoolProperty(
        name="CV",
        description="The control variate: what the polynomials alone say of the picture",
    )
    use_pass_residual: BoolProperty(
        name="Residual",
        description="What sampling added to the control variate",
    )
    use_pass_sample_count: BoolProperty(
        name="Sample Count",
        description="Camera rays that each pixel got",
    )
    use_pass_standard_error: BoolProperty(
        name="Standard Error",
        description="How far each pixel may be off: the standard deviation of its noise, as its samples tell",
    )


def _changed(settings: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """Have the light evaluated again: Blender does that by itself for changes in panels, not for scripts'."""
    settings.id_data.update_tag()


class CVRenderLightSettings(bpy.types.PropertyGroup):
    """What makes a spot light a laser."""

    is_laser: BoolProperty(
        name="Laser",
        description="A beam of parallel light that ends at the first surface, instead of a cone. Its power "
        "is that of the whole beam. Other engines show the spot",
        options=set(),
        update=_changed,
    )
    beam_radius: FloatProperty(
        name="Beam Radius",
        description="Radius of the beam where it is seen, and of the spot where it ends",
        default=0.01,
        min=0.0,
        soft_max=1.0,
        precision=4,
        unit="LENGTH",
        subtype="DISTANCE",
        update=_changed,
    )
    length: FloatProperty(
        name="Length",
        description="Where the beam ends if it meets nothing before; 0 is no limit",
        default=0.0,
        min=0.0,
        soft_max=1000.0,
        unit="LENGTH",
        subtype="DISTANCE",
        update=_changed,
    )
    beam: BoolProperty(
        name="Beam",
        description="The beam itself, as fog scatters it to the camera",
        default=True,
        update=_changed,
    )
    spot: BoolProperty(
        name="Spot",
        description="The spot of light on the surface where the beam ends",
        default=True,
        update=_changed,
    )
    in_fog: BoolProperty(
        name="Light in Fog",
        description="Light that fog scatters out of the beam, and once more to the camera: the beam's glow",
        default=True,
        update=_changed,
    )
    on_surfaces: BoolProperty(
        name="Light on Surfaces",
        description="Light that fog scatters out of the beam onto surfaces",
        default=True,
        update=_changed,
    )


def is_laser(light: Any) -> bool:
    """Whether a light is drawn as a laser: the switch counts for spot lights alone."""
    return light.type == "SPOT" and light.cv_render.is_laser


def engine_settings(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> Settings:
    """The engine's settings for the final render of a view layer."""
    chosen, render = scene.cv_render, scene.render
    return Settings(
        samples=view_layer.samples or chosen.samples,
        light_samples=chosen.light_samples,
        integrator=chosen.integrator,
        direct_sampling=chosen.direct_sampling,
        distance_sampling=chosen.distance_sampling,
        transparent_bounces=chosen.transparent_bounces,
        seed=chosen.seed + (scene.frame_current if chosen.use_animated_seed else 0),
        noise_threshold=chosen.noise_threshold,
        min_samples=chosen.min_samples,
        time_limit=chosen.time_limit,
        threads=render.threads if render.threads_mode == "FIXED" else 0,
        transparent=render.film_transparent,
        depth=view_layer.use_pass_z,
        normals=view_layer.use_pass_normal,
        standard_error=view_layer.cv_render.use_pass_standard_error,
        terms=view_layer.cv_render.use_pass_control_variate or view_layer.cv_render.use_pass_residual,
        tile_size=int(chosen.tile_size),
    )


def register() -> None:
    bpy.utils.register_class(CVRenderSceneSettings)
    bpy.utils.register_class(CVRenderViewLayerSettings)
    bpy.utils.register_class(CVRenderLightSettings)
    bpy.types.Light.cv_render = PointerProperty(type=CVRenderLightSettings, name="CV Render")
    bpy.types.ViewLayer.cv_render = PointerProperty(type=CVRenderViewLayerSettings, name="CV Render")
    bpy.types.Scene.cv_render = PointerProperty(type=CVRenderSceneSettings, name="CV Render")


def unregister() -> None:
    del bpy.types.Scene.cv_render
    del bpy.types.ViewLayer.cv_render
    del bpy.types.Light.cv_render
    bpy.utils.unregister_class(CVRenderLightSettings)
    bpy.utils.unregister_class(CVRenderViewLayerSettings)
    bpy.utils.unregister_class(CVRenderSceneSettings)
