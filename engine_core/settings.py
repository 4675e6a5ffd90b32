# SPDX-License-Identifier: GPL-3.0-or-later
"""How a scene is rendered."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import SceneError
from .scene.validation import set_integer, set_number

INTEGRATORS = ("control_variates", "sobol", "monte_carlo", "quadrature", "cv_only")
DIRECT_SAMPLING = ("mis", "light", "bsdf")
DISTANCE_SAMPLING = ("auto", "equiangular", "free_path", "mis", "free_path_untruncated")
MAX_SAMPLES = 1 << 20


@dataclass(frozen=True)
class Settings:
    """Choices of the render; every default is what a user would want.

    samples : camera rays a pixel, at most; powers of two serve the Sobol sequence best. Control variates
        take more of surfaces beside fog that costs more and is less noisy, unless there is a noise threshold.
    light_samples : shadow rays for each camera ray, 0 to choose by the lights; control variates, and up to
        16 lights none of which has a size, take one for each light.
    integrator : "control_variates" (polynomials, and Sobol points where these are wrong; surfaces with more
        than 8 lights, mesh lights of many triangles, depth of field or only points as "sobol"), "sobol"
        (Owen-scrambled Sobol points), "monte_carlo" (pseudo-random points), "quadrature" (nested adaptive
        quadrature over the lights: no noise, but an error of its own), "cv_only" (the polynomials alone: no
        noise, and biased).
    seed : another seed is another, independent estimate of the same picture.
    noise_threshold : stop a block of pixels when its estimated standard error, relative to the
        square root of its brightness (as in Cycles), falls below this; 0 never stops early.
    min_samples : samples every pixel gets before the noise threshold may stop it.
    time_limit : seconds after which no further pass begins; 0 is none.
    threads : worker threads, 0 for one a processor.
    direct_sampling : of surfaces that are not diffuse: "mis" (lights and BSDF sampled, combined by the
        power heuristic; where a surface is rough the lights alone), "light" or "bsdf" (one of them alone).
    distance_sampling : where along a camera ray fog is sampled: "equiangular" (about the light), "free_path"
        (as light gets out of the fog), "mis" (both, combined by the balance heuristic), "auto" (the best
        that is known for each light), "free_path_untruncated" (the thesis' eq. 6.3-6.4, for study).
    transparent_bounces : how many transparent surfaces a ray may pass straight through.
    transparent : the background has alpha 0 and no radiance.
    depth : fill `Film.depth`, even if nothing in sight reflects and rays are traced for it alone.
    normals : fill `Film.normal` too. standard_error : fill `Film.standard_error` too. terms : fill
        `Film.control_variate` and `Film.residual` too.
    tile_size : edge in pixels of the tiles that workers take (a multiple of 16), 0 to choose by the
        picture's size.
    batch_size : samples traced together. Of fewer, threads wait for one another; more leave the cache.
    """

    samples: int = 16
    light_samples: int = 0
    integrator: str = "control_variates"
    seed: int = 0
    noise_threshold: float = 0.0
    min_samples: int = 16
    time_limit: float = 0.0
    threads: int = 0
    direct_sampling: str = "mis"
    distance_sampling: str = "auto"
    transparent_bounces: int = 8
    transparent: bool = False
    depth: bool = True
    normals: bool = False
    standard_error: bool = False
    terms: bool = True
    tile_size: int = 0
    batch_size: int = 1 << 16

    def __post_init__(self) -> None:
        if self.integrator not in INTEGRATORS:
            raise SceneError(f"Settings: integrator is {self.integrator!r}, wanted one of {INTEGRATORS}")
        for field, choices in (
            ("direct_sampling", DIRECT_SAMPLING),
            ("distance_sampling", DISTANCE_SAMPLING),
        ):
            value = getattr(self, field)
            if value not in choices:
                raise SceneError(f"Settings: {field} is {value!r}, wanted one of {choices}")
        for field, low, high in (
            ("transparent_bounces", 0, 1024),
            ("samples", 1, MAX_SAMPLES),
            ("light_samples", 0, 1024),
            ("seed", -(2**31), 2**32 - 1),
            ("min_samples", 1, MAX_SAMPLES),
            ("threads", 0, 1024),
            ("tile_size", 0, 4096),
            ("batch_size", 64, 1 << 22),
        ):
            set_integer(self, field, low, high)
        if self.tile_size % 16:
            raise SceneError(f"Settings: tile_size is {self.tile_size}, wanted a multiple of 16")
        set_number(self, "noise_threshold", 0.0)
        set_number(self, "time_limit", 0.0)
