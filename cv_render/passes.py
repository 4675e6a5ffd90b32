# SPDX-License-Identifier: GPL-3.0-or-later
"""Render passes: which there are, and how the film's arrays get into them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..engine_core import Film
from ..engine_core.image.nonnegative import raise_negative
from .versions import volume_pass_name

COMBINED = ("Combined", 4, "RGBA", "COLOR")
DEPTH = ("Depth", 1, "Z", "VALUE")
NORMAL = ("Normal", 3, "XYZ", "VECTOR")
VOLUME = (volume_pass_name(), 3, "RGB", "COLOR")
LASER = ("Laser", 3, "RGB", "COLOR")
CONTROL_VARIATE = ("CV", 3, "RGB", "COLOR")
RESIDUAL = ("Residual", 3, "RGB", "COLOR")
SAMPLE_COUNT = ("Sample Count", 1, "X", "VALUE")
STANDARD_ERROR = ("Standard Error", 3, "RGB", "COLOR")

ARRAYS = {
    "Combined": "combined",
    "Depth": "depth",
    "Normal": "normal",
    VOLUME[0]: "volume",
    "Laser": "laser",
    "CV": "control_variate",
    "Residual": "residual",
    "Sample Count": "sample_count",
    "Standard Error": "standard_error",
}
"""By the name of a pass, the array of the film that it shows."""


def register_passes(engine: Any, scene: Any, view_layer: Any) -> None:
    """Tell Blender which passes a view layer gets, under the names that Cycles uses where it has them."""
    engine.register_pass(scene, view_layer, *COMBINED)
    if view_layer.use_pass_z:
        engine.register_pass(scene, view_layer, *DEPTH)
    if view_layer.use_pass_normal:
        engine.register_pass(scene, view_layer, *NORMAL)
    chosen = view_layer.cv_render
    for wanted, render_pass in (
        (chosen.use_pass_volume_direct, VOLUME),
        (chosen.use_pass_laser, LASER),
        (chosen.use_pass_control_variate, CONTROL_VARIATE),
        (chosen.use_pass_residual, RESIDUAL),
        (chosen.use_pass_sample_count, SAMPLE_COUNT),
        (chosen.use_pass_standard_error, STANDARD_ERROR),
    ):
        if wanted:
            engine.register_pass(scene, view_layer, *render_pass)


def write(
    engine: Any, layer: str, view: str, film: Film, x0: int, y0: int, x1: int, y1: int, done: bool = False
) -> None:
    """Pixels [y0:y1, x0:x1] of the film into Blender's result of a layer; row 0 is the bottom in both.

    done : nothing is added to the film any more.
    """
    result = engine.begin_result(x0, y0, x1 - x0, y1 - y0, layer=layer, view=view)
    try:
        # Others may show the same array.
        for render_pass in sorted(result.layers[0].passes, key=lambda a: a.name == COMBINED[0]):
            attribute = ARRAYS.get(render_pass.name)
            if attribute is not None:
                pixels = np.ascontiguousarray(getattr(film, attribute)[y0:y1, x0:x1], np.float32)
                if render_pass.name == COMBINED[0]:
                    # Noise about nothing may be below it, which nodes for compositing take badly. New memory
                    # is dear, so in place if that harms no sample to come.
                    if done:
                        raise_negative(pixels)
                    else:
                        pixels = np.maximum(pixels, 0)
                render_pass.rect.foreach_set(pixels.ravel())
    finally:
        engine.end_result(result)
