# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers that no polynomial makes: what rays see of lasers, and fog about lights in the picture."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .image.film import LARGEST, Layer
from .integration.mapping import Map
from .integration.point_sets import PointSet, SobolPoints, staged_points
from .integration.sample_mean import sum_samples
from .integration.sobol import hash_combine
from .parts import AroundLights, Region, Seen, cell_of
from .settings import Settings
from .transport.camera_hits import Pixels

CORE_SAMPLES, MOST_SAMPLES = 64, 4096
"""Of pixels close to a light in fog, for each of `Settings.samples`, and at most."""

FEW_SAMPLES = 4, 128
"""Of other lights there, at least and at most; four for each of `Settings.samples`. Of many lights fewer."""

ROWS = 16
"""Of the picture, whose beams are drawn at once."""


class SeenPicture:
    """An integral over the pixel alone.

    told : what was done, for people. seconds, regions, nodes : as in `ScreenPicture`; there are none.
    """

    told = "seen by camera rays alone"
    regions = nodes = 0

    def __init__(
        self, by: Seen, settings: Settings, region: Region, layer: Layer, check: Callable[[], None]
    ) -> None:
        """region : x0, y0, x1, y1 in the whole frame. check : called before every batch; may raise."""
        self._by, self._settings, self._region, self._layer, self._check = by, settings, region, layer, check
        self.seconds: dict[str, float] = {}

    def build(self, map_: Map, enough: Callable[[], bool]) -> None:
        """Draw all of it. map_ : runs a function over items on the workers. enough : not asked."""
        x0, y0, x1, y1 = self._region
        points = SobolPoints(range(2), self._settings.seed + 3, 0, dtype=np.float64)
        points.prepare(max(self._by.points))
        layer, by = self._layer, self._by

        def draw(low: int) -> None:
            y, x = (a.ravel().astype(np.int32) for a in np.mgrid[low : min(low + ROWS, y1), x0:x1])
            pixels = Pixels(x, y, cell_of(x, y, self._region))
            for touched, means, count in zip(by.touched, by.means, by.points, strict=True):
                rows = touched(pixels)
                step = max(1, self._settings.batch_size // count)
                for chunk in (rows[first : first + step] for first in range(0, len(rows), step)):
                    self._check()
                    some = pixels[chunk]
                    mean, error = means(some, points.points(some.key(), 0, count))
                    at = some.y - y0, some.x - x0
                    layer.radiance[at] += np.clip(mean, -LARGEST, LARGEST).T
                    layer.standard_error[at] += np.minimum(error, LARGEST).T

        map_(draw, range(y0, y1, ROWS))
        layer.control_variate[:] = layer.radiance


class AroundLightsPicture:
    """Pixels about lights in the picture, each integrated by itself.

    told, seconds, regions, nodes : as in `SeenPicture`.
    """

    regions = nodes = 0

    def __init__(
        self, by: AroundLights, settings: Settings, region: Region, layer: Layer, check: Callable[[], None]
    ) -> None:
        """region, check : as in `SeenPicture`; integrands check for themselves."""
        self._by, self._settings, self._region, self._layer = by, settings, region, layer
        self.told = f"sampled around {len(by.blocks)}"
        self.seconds: dict[str, float] = {}

    def build(self, map_: Map, enough: Callable[[], bool]) -> None:
        """Sample all of them; arguments as in `SeenPicture`."""
        by, settings, layer = self._by, self._settings, self._layer
        x0, y0 = self._region[:2]
        close = min(CORE_SAMPLES * by.intensity * settings.samples, MOST_SAMPLES)
        few = int(np.ceil(by.effort * np.clip(4 * settings.samples, *FEW_SAMPLES)))
        some = int(np.ceil(by.effort * close / 2))
        work = [
            (integrand, block, block.core == core, n)
            for block, own, beside, others in zip(by.blocks, by.own, by.beside, by.others, strict=True)
            for integrands, samples in (
                ([own], (close, close // 8)),
                (beside, (some, some)),
                (others, (few, few)),
            )
            for integrand in integrands
            for core, n in zip((True, False), samples, strict=True)
            if (block.core == core).any()
        ]

        # A pixel's samples of each integrand have nets of their own, and pixels keys of theirs.
        nets: dict[int, tuple[PointSet, PointSet]] = {}
        for integrand, _, _, n in work:
            dimensions = integrand.rest_dimensions
            if dimensions not in nets:
                nets[dimensions] = staged_points("sobol", 2, dimensions, 1, settings.seed + 5)
            for group in nets[dimensions]:
                group.prepare(n)

        def sample(number: int) -> np.ndarray:
            integrand, block, which, n = work[number]
            x, y = block.x[which], block.y[which]
            pixels = Pixels(x.astype(np.int32), y.astype(np.int32), cell_of(x, y, self._region))
            keys = hash_combine(pixels.key(), number)
            points = nets[integrand.rest_dimensions]
            sums = sum_samples(integrand, pixels, keys, points, 0, n, 1, settings.batch_size)
            return np.clip(sums.values[:3] / n, -LARGEST, LARGEST).T

        # Summed in one order, whoever is first.
        for (_, block, which, n), values in zip(work, map_(sample, range(len(work))), strict=True):
            at = block.y[which] - y0, block.x[which] - x0
            layer.radiance[at] += values
            layer.sample_count[at] += n
