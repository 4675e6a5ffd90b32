# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture while it is made, and when it is done."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

FAR = np.float32(1e10)
"""Depth where the camera ray met nothing, as in Cycles."""

LARGEST = 1e37
"""What no pixel exceeds: a picture holds no Inf, however bright the scene."""


OPAQUE = np.array([0, 0, 0, 1], np.float32)
"""A black pixel."""

SURFACE, VOLUME, LASER = "surface", "volume", "laser"
"""What layers of a picture show: light off surfaces and lamps, out of fog, and of lasers."""


@dataclass(eq=False)
class Layer:
    """What one integral adds to a picture.

    shows : `SURFACE`, `VOLUME` or `LASER`.
    radiance : (H, W, 3 or more) float32. control_variate, residual, standard_error : (H, W, 3), of it.
    sample_count : (H, W) int32.
    """

    shows: str
    radiance: np.ndarray
    control_variate: np.ndarray
    residual: np.ndarray
    standard_error: np.ndarray
    sample_count: np.ndarray

    @classmethod
    def empty(cls, shows: str, width: int, height: int, channels: int = 3) -> Layer:
        radiance, *others = (np.zeros((height, width, c), np.float32) for c in (channels, 3, 3, 3))
        return cls(shows, radiance, *others, np.zeros((height, width), np.int32))


@dataclass(eq=False)
class Film:
    """Arrays of the rendered region, row 0 at the bottom.

    combined : (H, W, 4) float32, linear radiance (premultiplied) and alpha.
    depth : (H, W) float32, distance along the view axis of the pixel's first sample; `FAR` if none.
    normal : (H, W, 3) float32, world-space shading normal, mean over the samples.
    sample_count : (H, W) int32, samples spent, of all integrals; of control variates, those of the residual.
    control_variate, residual : (H, W, 3) float32, the two terms of control variates' radiance; else 0.
    standard_error : (H, W, 3) float32, of the radiance; inf where nothing is known of it.
    layers : what all this is the sum of, the surfaces' first, with alpha.
    messages : what could not be rendered as asked, one sentence each.
    statistics : counts and seconds by stage, for people (docs/development.md says what each is).
    stopped_by : "samples", "noise", "time" or "cancel".
    """

    combined: np.ndarray
    depth: np.ndarray
    normal: np.ndarray
    sample_count: np.ndarray
    control_variate: np.ndarray
    residual: np.ndarray
    standard_error: np.ndarray
    layers: list[Layer]
    messages: list[str] = field(default_factory=list)
    statistics: dict[str, Any] = field(default_factory=dict)
    stopped_by: str = "samples"

    @classmethod
    def empty(cls, width: int, height: int, further: Sequence[str] = (), surfaces: bool = True) -> Film:
        """further : what layers show beside the surfaces'. surfaces : whether these are more than black."""
        surface = Layer.empty(SURFACE, width, height, 4)
        if not surfaces:
            black = np.broadcast_to(OPAQUE, surface.radiance.shape)
            surface.radiance = black if further else black.copy()
        # A picture of surfaces alone is its only layer.
        whole = Layer.empty(SURFACE, width, height, 4) if further else surface
        layers = [surface, *(Layer.empty(shows, width, height) for shows in further)]
        if not surfaces and len(further) == 1:
            # As is one of what is before them, but for the counts.
            only = layers[1]
            only.radiance, only.control_variate = whole.radiance[..., :3], whole.control_variate
            only.residual, only.standard_error = whole.residual, whole.standard_error
        return cls(
            whole.radiance,
            np.full((height, width), FAR, np.float32),
            np.zeros((height, width, 3), np.float32),
            whole.sample_count,
            whole.control_variate,
            whole.residual,
            whole.standard_error,
            layers,
        )

    def of_surfaces(self) -> Film:
        """A film of the first layer alone; depth, normals and messages are this film's own."""
        layer = self.layers[0]
        return Film(
            layer.radiance,
            self.depth,
            self.normal,
            layer.sample_count,
            layer.control_variate,
            layer.residual,
            layer.standard_error,
            [layer],
            self.messages,
        )

    def compose(self, x0: int, y0: int, x1: int, y1: int, errors: bool = True) -> None:
        """Sum the layers up in pixels [y0:y1, x0:x1]. errors : their standard errors too."""
        first, *further = self.layers
        if not further:
            return
        at = np.s_[y0:y1, x0:x1]
        self.combined[at][..., 3] = first.radiance[at][..., 3]
        pairs = [(self.sample_count, "sample_count")]
        if further[0].residual is self.residual:
            errors = False
        else:
            pairs += [(self.combined[..., :3], "radiance"), (self.control_variate, "control_variate")]
            pairs += [(self.residual, "residual")]
        for total, name in pairs:
            before = getattr(first, name)[..., :3] if name == "radiance" else getattr(first, name)
            for layer in further:
                np.add(before[at], getattr(layer, name)[at], out=total[at])
                before = total
        if errors:
            squares = sum(np.square(layer.standard_error[at]) for layer in self.layers)
            self.standard_error[at] = np.sqrt(squares)

    def _showing(self, shows: str) -> np.ndarray:
        layers = [layer.radiance for layer in self.layers if layer.shows == shows]
        return np.sum(layers, axis=0) if layers else np.zeros((*self.depth.shape, 3), np.float32)

    @property
    def volume(self) -> np.ndarray:
        """(H, W, 3) radiance that fog scatters towards the camera, but for lasers'."""
        return self._showing(VOLUME)

    @property
    def laser(self) -> np.ndarray:
        """(H, W, 3) radiance of lasers: beams, the fog and the surfaces that they light."""
        return self._showing(LASER)
