# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions from which glowing fog may light a surface.

What glows along a direction is integrated exactly, so a direction is all that a sample needs. The lobe gives
it or, half of the time, it leads to a ball around a body that glows; the balance heuristic weighs both. A
ball is not looked for where it looks larger than the lobe is wide, least of all from inside: what the lobe
gives meets it. Its part of the chances is the lobe's then, like that of fog all around.
"""

from __future__ import annotations

import numpy as np

from ..bsdf.lobe import Lobe
from ..geometry.vectors import dot, take
from ..geometry.warps import cosine_hemisphere
from .glowing_bodies import Cap, brightest, chosen
from .media import Media

_WIDEST = 0.5
"""Height of the cap that is as large as a diffuse lobe is wide: a uniform density in it is 1 / pi."""

_WIDTH = 16.0
"""The same of a glossy lobe, over its alpha^2: more than the 2 at which a cap has the lobe's
highest density, 1 / (4 pi alpha^2), as such lobes have long tails."""

_BRIGHTEST = 1e100
"""What no estimate of radiance exceeds, so that their sums and quotients are finite."""

_AT_ONCE = 1 << 18
"""Samples of these times balls, about."""


class GlowDirections:
    """Directions sampled for what glows of media."""

    def __init__(self, media: Media) -> None:
        balls = brightest(media)
        self._balls = [(centre, radius) for centre, radius, _ in balls]
        radiance = np.array([bright / radius**2 for _, radius, bright in balls])[:, None]
        self._radiance = np.clip(radiance, 1 / _BRIGHTEST, _BRIGHTEST)
        around = media.emission[:, 0].mean() / max(media.extinction[:, 0].mean(), 1 / _BRIGHTEST)
        self._around = 2 * min(around, _BRIGHTEST)

    def sample(
        self, lobe: Lobe, row: np.ndarray, position: np.ndarray, u: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Unit directions (3, N), and what the lobe reflects (3, N) of radiance from there over the density.

        row : (N,) lanes of the lobe. position : (3, N). u : (2, N).
        """
        step = _AT_ONCE // (1 + len(self._balls))
        if self._balls and len(row) > step:
            parts = [slice(low, low + step) for low in range(0, len(row), step)]
            found = [self.sample(lobe, row[part], position[:, part], u[:, part]) for part in parts]
            directions, values = zip(*found, strict=True)
            return np.concatenate(directions, axis=1), np.concatenate(values, axis=1)
        caps = [Cap(centre, radius, position) for centre, radius in self._balls]
        chances = self._chances(lobe, row, caps)
        if chances is None:
            direction = _sampled(lobe, row, u)
            value, pdf = _evaluated(lobe, row, direction)
            return direction, value / np.maximum(pdf, np.float32(1e-37))
        technique, u = chosen(chances, u)
        direction = np.empty((3, len(row)))
        for number, cap in enumerate([None, *caps]):
            rows = np.flatnonzero(technique == number)
            of = take(u, rows)
            if cap is None:
                direction[:, rows] = _sampled(lobe, row.take(rows), of.astype(np.float32))
            else:
                direction[:, rows] = cap.sample(rows, of)
        density = sum(chance * cap.pdf(direction) for chance, cap in zip(chances[1:], caps, strict=True))
        direction = direction.astype(np.float32)
        value, pdf = _evaluated(lobe, row, direction)
        density += chances[0] * pdf
        return direction, (value / np.maximum(density, 1e-37)).astype(np.float32)

    def _chances(self, lobe: Lobe, row: np.ndarray, caps: list[Cap]) -> np.ndarray | None:
        """(1 + B, N) of the lobe and of each ball, by how much light may come; None if no ball has any."""
        if not caps:
            return None
        height = np.stack([cap.height for cap in caps])
        light = self._radiance * height
        widest = _WIDEST
        if not lobe.smooth:
            widest = np.minimum(_WIDTH * (lobe.alpha[0] * lobe.alpha[1]).take(row), _WIDEST)
        looked_for = height < widest
        if not looked_for.any():
            return None
        chances = np.empty((1 + len(caps), len(row)))
        chances[1:] = 0.5 * looked_for * (light / (light.sum(axis=0) + self._around))
        chances[0] = 1 - chances[1:].sum(axis=0)
        return chances


def _sampled(lobe: Lobe, row: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Directions (3, N) by a lobe, by the cosine for one that is smooth."""
    return cosine_hemisphere(take(lobe.normal, row), u)[0] if lobe.smooth else lobe.sample(row, u)


def _evaluated(lobe: Lobe, row: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the lobe reflects (3, N), and the density (N,) of `_sampled`."""
    value, pdf = lobe.evaluate(row, direction)
    if pdf is None:
        pdf = np.maximum(dot(take(lobe.normal, row), direction), 0) * np.float32(1 / np.pi)
    return value, pdf
