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
    radiance : (H, W, 3 or more) float32. control_variate, residual, standard_error : (H, W, 3), of it; those
        that nobody asked for are zeros that take no memory and can't be written.
    sample_count : (H, W) int32.
    """

    shows: str
    radiance: np.ndarray
    control_variate: np.ndarray
    residual: np.ndarray
    standard_error: np.ndarray
    sample_count: np.ndarray

    @classmethod
    def empty(
        cls,
        shows: str,
        width: int,
        height: int,
        channels: int = 3,
        terms: bool = True,
        errors: bool = True,
    ) -> Layer:
        """terms : whether control variate and residual are asked for. errors : whether errors are."""
        radiance = np.zeros((height, width, channels), np.float32)
        others = (_zeros(width, height, asked) for asked in (terms, terms, errors))
        return cls(shows, radiance, *others, np.zeros((height, width), np.int32))


def _zeros(width: int, height: int, asked: bool) -> np.ndarray:
    """(H, W, 3) of zeros; only ``asked`` for are they more than one that is read everywhere."""
    shape = (height, width, 3)
    return np.zeros(shape, np.float32) if asked else np.broadcast_to(np.float32(0), shape)


@dataclass(eq=False)
class Film:
    """Arrays of the rendered region, row 0 at the bottom.

    combined : (H, W, 4) float32, linear radiance (premultiplied) and alpha.
    depth : (H, W) float32, distance along the view axis of the pixel's first sample; `FAR` if none.
    normal : (H, W, 3) float32, world-space shading normal, mean over the samples.
    sample_count : (H, W) int32, samples spent, of all integrals; of control variates, those of the residual.
    control_variate, residual : (H, W, 3) float32, the two terms of control variates' radiance; else 0.
    standard_error : (H, W, 3) float32, of the radiance; inf where nothing is known of it.
    Of normals, both terms and errors, those that `Settings` does not ask for are zeros that can't be written.
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
    def empty(
        cls,
        width: int,
        height: int,
        further: Sequence[str] = (),
        surfaces: bool = True,
        terms: bool = True,
        errors: bool = True,
        normals: bool = True,
    ) -> Film:
        """further : what layers show beside the surfaces'. surfaces : whether these are more than black.

        terms, errors : as in `Layer.empty`. normals : whether they are asked for.
        """
        asked = {"terms": terms, "errors": errors}
        whole = surface = Layer.empty(SURFACE, width, height, 4, **asked)
        # A picture of surfaces alone is its only layer.
        if further and surfaces:
            surface = Layer.empty(SURFACE, width, height, 4, **asked)
        elif further:
            count = np.zeros((height, width), np.int32)
            nothing = [_zeros(width, height, False)] * 3
            surface = Layer(SURFACE, np.broadcast_to(OPAQUE, whole.radiance.shape), *nothing, count)
        elif not surfaces:
            whole.radiance[:] = OPAQUE
        if not surfaces and len(further) == 1:
            # As is one of what is before them, but for the counts.
            shared = whole.radiance[..., :3], whole.control_variate, whole.residual, whole.standard_error
            layers = [surface, Layer(further[0], *shared, np.zeros((height, width), np.int32))]
        else:
            layers = [surface, *(Layer.empty(shows, width, height, **asked) for shows in further)]
        return cls(
            whole.radiance,
            np.full((height, width), FAR, np.float32),
            _zeros(width, height, normals),
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

    def compose(self, x0: int, y0: int, x1: int, y1: int) -> None:
        """Sum the layers up in pixels [y0:y1, x0:x1]."""
        first, *further = self.layers
        if not further:
            return
        at = np.s_[y0:y1, x0:x1]
        self.combined[at][..., 3] = first.radiance[at][..., 3]
        names, errors = ["sample_count"], False
        if not np.may_share_memory(further[0].radiance, self.combined):
            for c in range(3):
                # Channel by channel: rows of three are slow where there are four in a pixel.
                before, total = first.radiance[at][..., c], self.combined[at][..., c]
                for layer in further:
                    before = np.add(before, layer.radiance[at][..., c], out=total)
            if self.residual.flags.writeable:
                names += ["control_variate", "residual"]
            errors = self.standard_error.flags.writeable
        for name in names:
            before, total = getattr(first, name)[at], getattr(self, name)[at]
            for layer in further:
                before = np.add(before, getattr(layer, name)[at], out=total)
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
