# SPDX-License-Identifier: GPL-3.0-or-later
"""Flat figures as seen from a point: maps to directions within them, of which none peaks however near."""

from __future__ import annotations

import numpy as np

from ...geometry.vectors import dot, length
from ...geometry.warps import TWO_PI, Bilinear, basis, concentric_disk

# What the corners of a rectangle weigh at least: few samples for those below the horizon.
LEAST_COSINE = np.float32(0.01)


class SphericalRectangle:
    """Rectangles as seen from the origin, and directions within them.

    Uniform ones by C. Urena, M. Fajardo, A. King, "An Area-Preserving Parametrization for Spherical
    Rectangles", 2013; for surfaces the unit square is warped before, bilinearly between the cosines at the
    corners.

    usable : (M,) bool; false where the solid angle is too small for this, or the rectangle turns its back.
    solid_angle : (M,).
    """

    def __init__(
        self,
        centre: np.ndarray,
        edge_x: np.ndarray,
        edge_y: np.ndarray,
        facing: np.ndarray,
        normal: np.ndarray | None,
    ) -> None:
        """Vectors (3, M) or (3, 1): to the centre, along the whole edges, the front's normal, and the normal
        of the surface at the origin, None for a point in space."""
        length_x, length_y = length(edge_x), length(edge_y)
        self._x, self._y, self._facing = edge_x / length_x, edge_y / length_y, facing
        z0 = dot(facing, centre)
        # Its square is a number of its own, too.
        self._height = np.maximum(-z0, np.float32(1e-18))
        xc, yc = dot(self._x, centre), dot(self._y, centre)
        self._x0, self._x1 = xc - 0.5 * length_x, xc + 0.5 * length_x
        self._y0, self._y1 = yc - 0.5 * length_y, yc + 0.5 * length_y
        squared = self._height * self._height
        # z components of the normals of the four planes through the edges.
        n0, n1, n2, n3 = (a / np.sqrt(a * a + squared) for a in (-self._y0, self._x1, self._y1, -self._x0))
        # Inner angles less pi / 2, whose sum is the solid angle without cancellation.
        g0, g1, g2, g3 = (np.arcsin(a * b) for a, b in ((n0, n1), (n1, n2), (n2, n3), (n3, n0)))
        self._n0, self._n2, self._g23 = n0, n2, g2 + g3
        self.solid_angle = np.maximum(g0 + g1 + g2 + g3, np.float32(1e-30))
        self.usable = (z0 < 0) & (self.solid_angle > np.float32(1e-3))
        self._warp = None if normal is None else Bilinear(*self._cosines(normal, squared))

    def _cosines(self, normal: np.ndarray, squared: np.ndarray) -> list[np.ndarray]:
        """(M,) at the four corners."""
        x, y = dot(self._x, normal), dot(self._y, normal)
        z = -self._height * dot(self._facing, normal)
        return [
            np.maximum((x * a + y * b + z) / np.sqrt(a * a + b * b + squared), LEAST_COSINE)
            for b in (self._y0, self._y1)
            for a in (self._x0, self._x1)
        ]

    def sample(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vectors (3, M) to points of the rectangles, for u (2, M), and densities per solid angle (M,)."""
        (u0, u1), density = (u, np.float32(1)) if self._warp is None else self._warp.sample(u)
        height, n0 = self._height, self._n0
        squared = height * height
        phi = u0 * self.solid_angle - self._g23
        sin = np.sin(phi)
        sin = np.where(np.abs(sin) < 1e-12, np.float32(1e-12), sin)
        f = (np.cos(phi) * n0 + self._n2) / sin
        c = np.copysign(1 / np.sqrt(f * f + n0 * n0), f)
        c = np.clip(c, -1, 1)
        xu = np.clip(c * height / np.sqrt(np.maximum(1 - c * c, np.float32(1e-14))), self._x0, self._x1)
        d = np.sqrt(xu * xu + squared)
        y0, y1 = self._y0, self._y1
        h0, h1 = y0 / np.sqrt(d * d + y0 * y0), y1 / np.sqrt(d * d + y1 * y1)
        h = h0 + u1 * (h1 - h0)
        yu = np.clip(h * d / np.sqrt(np.maximum(1 - h * h, np.float32(1e-14))), y0, y1)
        return xu * self._x + yu * self._y - height * self._facing, density / self.solid_angle

    def pdf(self, vector: np.ndarray) -> np.ndarray:
        """(M,) density of the direction of ``vector`` (3, M), to a point of the rectangle."""
        if self._warp is None:
            return 1 / self.solid_angle
        height = self._height
        scale = height / np.maximum(-dot(self._facing, vector), np.float32(1e-30))
        xu = np.clip(dot(self._x, vector) * scale, self._x0, self._x1)
        yu = np.clip(dot(self._y, vector) * scale, self._y0, self._y1)
        # What lies on this side of x is a spherical rectangle, too.
        square = xu * xu + height * height
        n1 = xu / np.sqrt(square)
        angle = np.arcsin(self._n0 * n1) + np.arcsin(n1 * self._n2) + self._g23
        h0, h1, h = (y / np.sqrt(square + y * y) for y in (self._y0, self._y1, yu))
        place = angle / self.solid_angle, (h - h0) / np.maximum(h1 - h0, np.float32(1e-30))
        return self._warp.density(np.clip(np.stack(place), 0, 1)) / self.solid_angle


class SphericalEllipse:
    """Ellipses as seen from the origin, and directions within them of nearly constant density.

    The cone through an ellipse has an elliptical cross-section perpendicular to its own axis, with half
    axes a and b at distance 1. Along a radius of the unit disk of which that is a stretched image, at the
    azimuth phi, solid angle integrates in closed form, to a b g(k) with k = a^2 cos^2 + b^2 sin^2. How this
    varies with phi is followed by tan psi = c tan phi with a uniform psi: exact for a narrow cone and for
    one that fills the hemisphere, equal at the four vertices of all between them (within 5 % everywhere).

    usable : (M,) bool; false where the ellipse turns its back or is too thin for this.
    """

    def __init__(
        self,
        centre: np.ndarray,
        edge_x: np.ndarray,
        edge_y: np.ndarray,
        facing: np.ndarray,
        normal: np.ndarray | None,
    ) -> None:
        """As for `SphericalRectangle`, in which the ellipses are inscribed; ``normal`` is not used."""
        half_x, half_y = 0.5 * length(edge_x), 0.5 * length(edge_y)
        self._x, self._y, self._facing = 0.5 * edge_x / half_x, 0.5 * edge_y / half_y, facing
        self._height = -dot(facing, centre)
        scale = 1 / np.maximum(half_x, half_y)
        p, q = 1 / (half_x * scale), 1 / (half_y * scale)
        h = np.maximum(self._height * scale, np.float32(1e-15))
        xc, yc = dot(self._x, centre) * (scale * p), dot(self._y, centre) * (scale * q)
        # In the ellipse's own axes, z towards its plane: (h p x - xc z)^2 + (h q y - yc z)^2 - z^2.
        hp, hq = h * p, h * q
        xx, yy, xz, yz = hp * hp, hq * hq, -hp * xc, -hq * yc
        zz = xc * xc + yc * yc - 1
        least = -_negative_eigenvalue(xx, yy, xc * xc, yc * yc)
        # Edge-on all of this vanishes.
        from_xx, from_yy = (np.maximum(v - least, np.float32(1e-28)) for v in (xx, yy))
        x, y = -xz / from_xx, -yz / from_yy
        z = 1 / np.sqrt(1 + x * x + y * y)
        axis = np.stack([x * z, y * z, z])
        # The form across the axis, between two vectors perpendicular to it.
        s, t = basis(axis)
        su, sv, sw = xx * s[0] + xz * s[2], yy * s[1] + yz * s[2], xz * s[0] + yz * s[1] + zz * s[2]
        tu, tv, tw = xx * t[0] + xz * t[2], yy * t[1] + yz * t[2], xz * t[0] + yz * t[1] + zz * t[2]
        ss, st = su * s[0] + sv * s[1] + sw * s[2], su * t[0] + sv * t[1] + sw * t[2]
        tt = tu * t[0] + tv * t[1] + tw * t[2]
        half = 0.5 * (ss - tt)
        spread = np.sqrt(half * half + st * st)
        turn = 0.5 * np.arctan2(st, half)
        cos, sin = np.cos(turn), np.sin(turn)
        large = 0.5 * (ss + tt) + spread
        # The product of all eigenvalues is known better than the least of the three in size.
        small = xx * yy / np.maximum(-large * least, np.float32(1e-37))
        # A few ellipses, long and seen from beyond their ends, have no good eigenvalue yet.
        residual = 1 + least * (1 + xc * xc / from_xx + yc * yc / from_yy)
        usable = (self._height > 0) & (np.abs(residual) < 1e-5)
        a, b = (
            np.sqrt(np.where(usable, -least / np.maximum(v, np.float32(1e-37)), 1)) for v in (large, small)
        )
        self.usable = usable & (a > 1e-3) & (b < 1e6)
        self._a, self._b = a, np.minimum(b, np.float32(1e6))
        self._c = np.sqrt(_radial(self._a * self._a) / _radial(self._b * self._b))
        self._axis, self._s, self._t = axis, cos * s + sin * t, cos * t - sin * s

    def _density(self, cos: np.ndarray, sin: np.ndarray, k: np.ndarray) -> np.ndarray:
        a, b, c = self._a, self._b, self._c
        return c / ((cos * cos + c * c * sin * sin) * (TWO_PI * a * b) * _radial(k))

    def sample(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vectors (3, M) to points of the ellipses, and their densities per solid angle (M,)."""
        x, y = concentric_disk(u[0], u[1])
        square = x * x + y * y
        cos, sin = self._c * x, np.where(square > 0, y, 1)
        inverse = 1 / np.sqrt(cos * cos + sin * sin)
        cos, sin = cos * inverse, sin * inverse
        ax, ay = self._a * cos, self._b * sin
        k = ax * ax + ay * ay
        # 1 - cosine of the angle to the axis is uniform along the radius.
        below = square * k * _radial(k)
        stretch = np.sqrt(below * (2 - below) / k) / np.maximum(1 - below, np.float32(1e-30))
        ax *= stretch
        ay *= stretch
        lx, ly, lz = (ax * self._s[i] + ay * self._t[i] + self._axis[i] for i in range(3))
        scale = self._height / np.maximum(lz, np.float32(1e-30))
        vector = (lx * scale) * self._x + (ly * scale) * self._y - self._height * self._facing
        return vector, self._density(cos, sin, k)

    def pdf(self, vector: np.ndarray) -> np.ndarray:
        """(M,) density of the direction of ``vector`` (3, M), to a point of the ellipse."""
        local = np.stack([dot(self._x, vector), dot(self._y, vector), -dot(self._facing, vector)])
        cos, sin = dot(local, self._s) * self._b, dot(local, self._t) * self._a
        inverse = 1 / np.maximum(np.hypot(cos, sin), np.float32(1e-30))
        cos, sin = cos * inverse, sin * inverse
        ax, ay = self._a * cos, self._b * sin
        return self._density(cos, sin, ax * ax + ay * ay)


def _radial(k: np.ndarray) -> np.ndarray:
    """(1 - 1 / sqrt(1 + k)) / k."""
    root = np.sqrt(1 + k)
    return 1 / (root * (1 + root))


def _negative_eigenvalue(
    xx: np.ndarray, yy: np.ndarray, xc_sqr: np.ndarray, yc_sqr: np.ndarray
) -> np.ndarray:
    """(M,) size m of the negative eigenvalue of a cone's form: m (1 + xc^2 / (xx + m) + yc^2 / (yy + m)) = 1.

    Nothing is subtracted in that, so float32 will do. For a circle it is quadratic. Otherwise the slower term
    is held and the quadratic solved again and again, and Newton's method ends what converges from below.
    """
    m = _quadratic(np.float32(1), np.minimum(xx, yy), xc_sqr + yc_sqr)
    if (np.abs(xx - yy) <= np.float32(1e-6) * xx).all():
        return m
    swap = xx > yy
    fast, slow = np.where(swap, yy, xx), np.where(swap, xx, yy)
    fast_sqr, slow_sqr = np.where(swap, yc_sqr, xc_sqr), np.where(swap, xc_sqr, yc_sqr)
    for _ in range(2):
        m = _quadratic(1 + slow_sqr / (slow + m), fast, fast_sqr)
    for _ in range(2):
        a, b = 1 / (xx + m), 1 / (yy + m)
        slope = 1 + xc_sqr * xx * a * a + yc_sqr * yy * b * b
        m = m + (1 - m * (1 + xc_sqr * a + yc_sqr * b)) / slope
    return m


def _quadratic(c: np.ndarray, d: np.ndarray, e: np.ndarray) -> np.ndarray:
    """The positive m with m (c + e / (d + m)) = 1."""
    half = 0.5 * (c * d + e - 1)
    root = np.sqrt(half * half + c * d)
    return np.where(half > 0, d / np.maximum(half + root, np.float32(1e-37)), (root - half) / c)


class SphericalTriangle:
    """Triangles as seen from the origin, and uniform directions within them.

    J. Arvo, "Stratified Sampling of Spherical Triangles", 1995, with the arithmetic of M. Pharr et al.,
    "Physically Based Rendering", 4th edition, section 6.5.4.

    usable : (M,) bool; false where it is too small or too thin for this, or nearly fills the half space,
        which it may do if the corners are float64.
    solid_angle : (M,).
    """

    def __init__(self, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
        """Vectors (3, M) to the corners."""
        self._across = _cross(b - a, c - a)
        self._height = dot(self._across, a)
        a, b, c = (x / np.maximum(length(x), np.float32(1e-30)) for x in (a, b, c))
        volume = np.abs(dot(a, _cross(b, c)))
        angle = 2 * np.arctan2(volume, 1 + dot(a, b) + dot(b, c) + dot(c, a))
        ab, ca = _cross(a, b), _cross(c, a)
        norm = length(ab) * length(ca)
        scale = 1 / np.maximum(norm, np.float32(1e-30))
        # At corner a, between the planes through its edges.
        self._cos, self._sin = -dot(ab, ca) * scale, np.minimum(volume * scale, 1)
        self._a, self._b, self._c, self._angle = a, b, c, angle
        most, least_norm, least_sin = (6, 1e-4, 0.03) if a.dtype == np.float32 else (6.28318, 1e-8, 1e-6)
        self.usable = (angle > 0.03) & (angle < most) & (norm > least_norm) & (self._sin > least_sin)
        self.solid_angle = angle

    def sample(self, u: np.ndarray) -> np.ndarray:
        """Vectors (3, M) to points of the triangles, for u (2, M)."""
        a, b, c, cos, sin = self._a, self._b, self._c, self._cos, self._sin
        # The angle at a, less that of the part of the area that is chosen.
        area = u[0] * self._angle
        cos_area, sin_area = np.cos(area), np.sin(area)
        # phi = pi + area - alpha.
        sin_phi = cos_area * sin - sin_area * cos
        cos_phi = -(cos_area * cos + sin_area * sin)
        k1, k2 = cos_phi + cos, sin_phi - sin * dot(a, b)
        below = (k2 * sin_phi + k1 * cos_phi) * sin
        above = k2 + (k2 * cos_phi - k1 * sin_phi) * cos
        cos_b = np.clip(above / np.where(np.abs(below) > np.float32(1e-30), below, np.float32(1e-30)), -1, 1)
        sin_b = np.sqrt(1 - cos_b * cos_b)
        edge = c - dot(c, a) * a
        corner = cos_b * a + sin_b * edge / np.maximum(length(edge), np.float32(1e-30))
        beyond = corner - dot(corner, b) * b
        one_minus = u[1] * (1 - dot(corner, b))
        cos_t = 1 - one_minus
        sin_t = np.sqrt(np.maximum(one_minus * (2 - one_minus), 0))
        direction = cos_t * b + sin_t * beyond / np.maximum(length(beyond), np.float32(1e-30))
        slope = dot(self._across, direction)
        distance = self._height / np.where(slope == 0, 1, slope)
        return direction * distance


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
