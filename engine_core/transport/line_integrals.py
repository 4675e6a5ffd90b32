# SPDX-License-Identifier: GPL-3.0-or-later
"""Integrals along a line of what is smooth times what is seen, each found apart.

Shadow rays to a few *nodes* tell where along a line something is seen, or what part of each colour; between
two that differ, bisection finds the shadow's edge. All other factors are one smooth function of the place, a
polynomial through Gauss-Legendre points; its antiderivative needs no ray.

The unbiased estimate adds rays: one in the last bracket of each edge, and a few anywhere, where the
integrand is compared with the polynomial times the visibility that was found. (Own; measured in
docs/sampling.md.)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from ..integration.rules import gauss

BISECTIONS = 6
"""Of the step in which a shadow has its edge."""

_INSET = 1e-3
"""Part of a line, at both ends, in which what is seen is what is next to it: no surface shadows itself."""

_LAST = np.float32(1 - 2.0**-24)
"""The last place but the end, where something may be infinitely far."""

Looks = tuple[int, int]
"""Nodes and checks of a line."""

SHARP = 0.02
"""How much what is seen differs between nodes, of all of it, so that an edge is looked for between them. What
differs less, as through panes seen at other angles, is a step in the middle; samples find the rest."""

OUTLINE = 0.25
"""The same, so that it is told of as the edge of a shadow."""

Visibility = Callable[[Any, np.ndarray], np.ndarray]
"""Of n lines and places s (..., n), or (Q, 1), on them: (1, ..., n) bool what is seen from there, or
(3, ..., n) float32 what part of each colour."""


class Lines(Protocol):
    """n lines, each in a variable s of [0, 1]; values of G groups and C channels there.

    breaks : (B, n) ascending places s between which the integrand is smooth.
    lit : (2, n), two of them outside of which it is next to nothing; None if that is not known.
    shift : (n,) float32 in [0, 1), as if by chance, another one for each camera ray.
    turn : (n,) the same, how lines that belong together are staggered; None if there is but one.
    """

    breaks: np.ndarray
    lit: np.ndarray | None
    shift: np.ndarray
    turn: np.ndarray | None

    def __len__(self) -> int: ...

    def take(self, rows: np.ndarray) -> Lines:
        """Lines ``rows``."""
        ...

    def smooth(self, s: np.ndarray) -> np.ndarray:
        """(G, C, n) the integrand at s (n,), or (G, C, Q, n) at s (Q, n) or (Q, 1)."""
        ...


STEPS, EVERYWHERE = 24, 0.2
"""Of the table by which points follow a peak, and the part of their density that is the same everywhere."""


class LineIntegrals:
    """The rules for lines of one kind."""

    def __init__(self, points: int, peaks: bool = False) -> None:
        """points : of the quadrature in each piece of a line. peaks : whether few points are where the
        integrand is large, which takes some more of its values than theirs.
        """
        self._quadrature, self._peaks = _Quadrature(points), peaks

    def integral(
        self, lines: Lines, seen: Visibility, looks: Looks, u: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """(G, C, n) integrals of `Lines.smooth` times visibility over s, for u (2, n); None for none. Three
        channels where visibility has.

        Without a u, also what deviation the last brackets of shadows leave, and how many edges these have
        (n,); None for 0.
        """
        nodes, checks = looks
        pieces = _Pieces(lines, self._quadrature)
        # Samples of a pixel divide the work: their checks are evenly spread in steps that are the same.
        shift = lines.shift if u is None else np.full(len(lines), 0.5, np.float32)
        if lines.turn is not None:
            shift = wrapped(shift + lines.turn)
            u = None if u is None else wrapped(u[:2] + lines.turn)
        s = _places(nodes, shift)
        told = seen(lines, s)
        result = pieces.whole * told[:, -1]
        jump = _differing(told[:, 1:], told[:, :-1])
        step, line = np.nonzero(jump)
        error = edges = None
        low = high = np.zeros(0)
        if line.size:
            part, first, last = lines.take(line), told[:, step, line], told[:, step + 1, line]
            low, high, size = s[step, line], s[step + 1, line], jump[step, line]
            sharp = np.flatnonzero(size > SHARP)
            bracket = self._bisected(seen, part, sharp, low, high, first, last)
            if u is None:
                edge = 0.5 * (bracket[0] + bracket[1])
            else:
                # Brackets are believed dark, or to be what is on their later side, and sampled.
                dark = first[0] < last[0] if len(told) == 1 else np.zeros(len(line), bool)
                edge = np.where(dark, bracket[1], bracket[0])
                if len(sharp) < len(line):
                    faint = size <= SHARP
                    edge[faint] = low[faint] = high[faint] = (0.5 * (low + high))[faint]
                low[sharp], high[sharp] = (x[sharp] for x in bracket)
            change = pieces.integral(line, edge) * _less(first, last)
            if u is None:
                rough = pieces.value(line, edge)
                rough *= (0.5 * size * (bracket[1] - bracket[0])).astype(np.float32)
                error = _sums(line, rough * rough, len(lines))
                # What is one node long here may lie between nodes nearby, where the checks alone find it.
                lone = np.square(np.minimum(jump[1:], jump[:-1]), dtype=np.float64).sum(axis=0)
                error += pieces.whole**2 * (lone / (nodes * checks))
                error = np.sqrt(error)
                edges = np.bincount(line[size > OUTLINE], minlength=len(lines))
            elif sharp.size:
                believed = np.where(dark, first, last)
                if len(sharp) == len(line):
                    change += self._sampled(seen, part, low, high, believed, u[0].take(line))
                else:
                    where = low[sharp], high[sharp], believed[:, sharp], u[0].take(line[sharp])
                    change[:, :, sharp] += self._sampled(seen, part.take(sharp), *where)
            result += _sums(line, change, len(lines))
        if u is not None:
            result += self._checked(lines, seen, pieces, shift, told, (step, line, low, high), checks, u[1])
        return result, error, edges

    @staticmethod
    def _sampled(
        seen: Visibility,
        lines: Lines,
        low: np.ndarray,
        high: np.ndarray,
        believed: np.ndarray,
        u: np.ndarray,
    ) -> np.ndarray:
        """(G, C, X) what lines bring more than is ``believed`` to be seen (c, X), between ``low`` and
        ``high`` (X,): at a place, by u (X,).
        """
        at = low + (high - low) * u
        sample = _less(seen(lines, at), believed)
        sample *= (high - low).astype(np.float32)
        return lines.smooth(at) * sample

    @staticmethod
    def _bisected(
        seen: Visibility,
        lines: Lines,
        rows: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        first: np.ndarray,
        last: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Brackets (X,), from between ``low`` and ``high``, in which what is seen of lines ``rows`` goes from
        ``first`` to ``last`` (c, X); of others as they are.
        """
        whole = low.copy(), high.copy()
        if len(rows) < len(low):
            lines, low, high = lines.take(rows), low[rows], high[rows]
            first, last = first[:, rows], last[:, rows]
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            there = seen(lines, middle)
            same = _differing(there, first) < _differing(there, last)
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        for all_of_it, some in zip(whole, (low, high), strict=True):
            all_of_it[rows] = some
        return whole

    def by_points(self, lines: Lines, seen: Visibility, count: int, u: np.ndarray) -> np.ndarray:
        """(G, C, n) float64, the same by a point in each of ``count`` parts of a line, at u (n,); of
        parts that are equally bright, about, if there are peaks.
        """
        s = (np.arange(count, dtype=np.float32)[:, None] + u) / count
        s, weight = _followed(lines, s) if self._peaks else (s, None)
        np.minimum(s, _LAST, out=s)
        value, part = lines.smooth(s), seen(lines, s)
        if weight is not None:
            part = part * weight
        value = np.multiply(value, part, out=value if len(part) == 1 else None)
        return value.mean(axis=2, dtype=np.float64)

    @staticmethod
    def _checked(
        lines: Lines,
        seen: Visibility,
        pieces: _Pieces,
        shift: np.ndarray,
        told: np.ndarray,
        edges: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
        checks: int,
        u: np.ndarray,
    ) -> np.ndarray:
        """(G, C, n) what is missing where nodes say ``told`` (c, K, n), by a few rays placed by u (n,).

        edges : steps, lines, and brackets (X,) of shadows' edges, in which visibility is sampled for itself.
        """
        # Rays ask what is seen at places in each part of a line; how right the polynomial is needs but one,
        # the likelier the nearer to an end, where a polynomial through Gauss-Legendre points is wrong most.
        part = np.arange(checks, dtype=np.float32)[:, None]
        angle = np.float32(np.pi) * u
        at = np.concatenate([np.square(np.sin(0.5 * angle))[None], (u + part) / checks])
        np.minimum(at, _LAST, out=at)
        steps, here = told.shape[1] - 1, np.arange(len(lines))
        cell = np.clip(at * np.float32(steps) + (np.float32(0.5) - shift), 0, steps - 1).astype(np.intp)
        believed, known = told[:, cell, here], np.ones(at.shape, bool)
        step, line, low, high = edges
        if line.size:
            row = np.full((steps, len(lines)), -1)
            row[step, line] = np.arange(len(line))
            row = row[cell, here]
            near = np.nonzero(row >= 0)
            place, row = at[near], row[near]
            below = place < low.take(row)
            later = told[(slice(None), cell[near] + 1, here[near[1]])]
            believed[(slice(None), *near)] = np.where(below, believed[(slice(None), *near)], later)
            known[near] = below | (place > high.take(row))
        # Brackets that are believed dark leave nothing to the polynomial.
        lit = np.flatnonzero(believed[:, 0].any(axis=0) & (known[0] | (len(told) > 1)))
        groups, channels, n = pieces.whole.shape
        missing = np.zeros((groups, max(channels, len(told)), n))
        if lit.size:
            place = at[0].take(lit)
            off = lines.take(lit).smooth(place) - pieces.value(lit, place)
            off *= np.float32(np.pi / 2) * np.sin(angle.take(lit))
            missing[:, :, lit] = off * believed[:, 0, lit]
        there = seen(lines, at[1:])
        wrong, line = np.nonzero((there != believed[:, 1:]).any(axis=0) & known[1:])
        if line.size:
            less = _less(there[:, wrong, line], believed[:, 1 + wrong, line])
            less *= np.float32(1 / checks)
            missing += _sums(line, lines.take(line).smooth(at[1 + wrong, line]) * less, n)
        return missing


def _places(nodes: int, shift: np.ndarray) -> np.ndarray:
    """(K, n) where in lines visibility is asked for: at both ends, and by even steps, shifted (n,), between.

    What is thinner than a step is seen by some of the rays nearby, instead of by none or by all of them.
    """
    s = (np.arange(nodes, dtype=np.float32)[:, None] + (shift - np.float32(0.5))) / np.float32(nodes - 1)
    s[0], s[-1] = _INSET, 1 - _INSET
    return s


def _differing(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(...) how much what is seen, (c, ...), differs in any colour; of light and dark, whether it does."""
    return (a != b)[0] if a.dtype == bool else np.abs(a - b).max(axis=0)


def _less(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(c, ...) float32 a - b of what is seen."""
    return a - b if a.dtype != bool else a.astype(np.float32) - b


def wrapped(u: np.ndarray) -> np.ndarray:
    """Modulo 1."""
    return u - np.floor(u)


def _sums(line: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """(G, C, count) sums of values (G, C, X) of the same line (X,)."""
    flat = values.reshape(-1, len(line))
    return np.stack([np.bincount(line, row, count) for row in flat]).reshape(*values.shape[:2], count)


class _Quadrature:
    """Gauss-Legendre on [0, 1], and the polynomial through its points.

    at : (Q,) points. weights : (Q,) float32.
    """

    def __init__(self, points: int) -> None:
        self.at, weights = gauss(points)
        self.weights = weights.astype(np.float32)
        order = np.arange(points)
        # From values to coefficients of Legendre polynomials, and on to those of their antiderivatives.
        series = (2 * order + 1)[:, None] * _legendre(self.at, points) * weights
        higher = np.zeros((points, points + 1))
        higher[order, order + 1] = 0.5 / (2 * order + 1)
        higher[order[1:], order[1:] - 1] = -0.5 / (2 * order[1:] + 1)
        higher[0, 0] = 0.5
        self._values = series.T.astype(np.float32)
        self._integrals = (series.T @ higher).astype(np.float32)

    def value(self, values: np.ndarray, s: np.ndarray) -> np.ndarray:
        """(..., X) of the polynomials through ``values`` (..., Q, X) at s (X,), or (J, X)."""
        legendre = _legendre(s.astype(np.float32), len(self.at))
        factor = np.einsum("qk,k...->q...", self._values, legendre)
        return np.einsum("gcqx,qx->gcx" if s.ndim == 1 else "gcqx,qjx->gcjx", values, factor)

    def integral(self, values: np.ndarray, s: np.ndarray) -> np.ndarray:
        """(..., X) their integrals from 0 to s (X,)."""
        legendre = _legendre(s.astype(np.float32), len(self.at) + 1)
        factor = np.einsum("qk,kx->qx", self._integrals, legendre)
        return (values * factor).sum(axis=-2)


def _legendre(s: np.ndarray, count: int) -> np.ndarray:
    """(count, X) Legendre polynomials of order 0, 1, ... on [0, 1] at s (X,)."""
    t = 2 * s - 1
    p = np.empty((count, *s.shape), s.dtype)
    p[0] = 1
    p[1] = t
    for k in range(1, count - 1):
        np.multiply(p[k], t, out=p[k + 1])
        p[k + 1] *= (2 * k + 1) / (k + 1)
        p[k + 1] -= (k / (k + 1)) * p[k - 1]
    return p


class _Pieces:
    """The smooth factor of n lines: a polynomial of each, or one in each piece of a line.

    whole : (G, C, n) integrals over the lines.
    """

    def __init__(self, lines: Lines, quadrature: _Quadrature) -> None:
        self._quadrature = quadrature
        self._number = None
        if len(lines.breaks) == 0:
            self._values = lines.smooth(quadrature.at[:, None])  # (G, C, Q, n)
            self.whole = self._means()
            return
        n = len(lines)
        edge = np.concatenate([np.zeros((1, n)), lines.breaks, np.ones((1, n))])
        length = np.diff(edge, axis=0)
        some = length > 0
        if lines.lit is not None:
            lit = some & (edge[1:] > lines.lit[0]) & (edge[:-1] < lines.lit[1])
            # Every line has one at least.
            some = np.where(lit.any(axis=0), lit, some)
        piece, line = np.nonzero(some)
        self._number = np.full(length.shape, -1)
        self._number[piece, line] = np.arange(len(line))
        self._low, self._length = edge[piece, line], length[piece, line]
        self._values = lines.take(line).smooth(self._low + self._length * quadrature.at[:, None])
        self._values *= self._length.astype(np.float32)
        self.whole = _sums(line, self._means(), n)

    def _means(self) -> np.ndarray:
        # Not by ``@``, as `integration.rules.weighted`.
        return np.einsum("q,gcqn->gcn", self._quadrature.weights, self._values)

    def integral(self, line: np.ndarray, s: np.ndarray) -> np.ndarray:
        """(G, C, X) integrals over lines (X,) from 0 to s (X,)."""
        if self._number is None:
            return self._quadrature.integral(self._values.take(line, axis=-1), s)
        result = 0
        for number in self._number:
            row = number.take(line)
            place = np.clip((s - self._low.take(row)) / self._length.take(row), 0, 1)
            part = self._quadrature.integral(self._values.take(row, axis=-1), place)
            result = result + part * (row >= 0)
        return result

    def value(self, line: np.ndarray | None, s: np.ndarray) -> np.ndarray:
        """(G, C, X) the factor at s (X,) of lines (X,), None for all in order; (G, C, J, X) at s (J, X)."""
        if self._number is None:
            values = self._values if line is None else self._values.take(line, axis=-1)
            return self._quadrature.value(values, s)
        if s.ndim == 2:
            return np.stack([self.value(line, one) for one in s], axis=2)
        row = np.full(len(s), -1)
        for number in self._number:
            of = number if line is None else number.take(line)
            row = np.where((of >= 0) & (s >= self._low.take(of)), of, row)
        length = self._length.take(row)
        place = (s - self._low.take(row)) / length
        value = self._quadrature.value(self._values.take(row, axis=-1), np.clip(place, 0, 1))
        # Between pieces there is nothing.
        value /= np.where((row >= 0) & (place <= 1 + 1e-9), length, np.inf).astype(np.float32)
        return value


def _followed(lines: Lines, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places s (P, n), and 1 / density there, for u (P, n): by the integrand in the middle of equal steps."""
    steps = (np.arange(STEPS, dtype=np.float32)[:, None] + np.float32(0.5)) / STEPS
    found = np.abs(lines.smooth(steps)).sum(axis=(0, 1), dtype=np.float64)  # (STEPS, n)
    total = found.mean(axis=0)
    density = np.divide(found, total, out=np.ones_like(found), where=(total > 0) & np.isfinite(total))
    density = EVERYWHERE + (1 - EVERYWHERE) * density
    end = np.cumsum(density, axis=0) / STEPS
    cell = np.zeros(u.shape, np.intp)
    for row in end[:-1]:
        cell += u >= row
    own = np.take_along_axis(density, cell, axis=0)
    begin = np.take_along_axis(end, cell, axis=0) - own / STEPS
    s = (cell + np.clip((u - begin) * STEPS / own, 0, 1)) / STEPS
    return s.astype(np.float32), (1 / own).astype(np.float32)
