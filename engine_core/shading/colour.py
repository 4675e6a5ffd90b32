# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour: conversions between spaces, and the blend modes of Mix, as Cycles defines them.

Colours are (3, 1) or (3, N) float32, scene linear Rec. 709.
"""

from __future__ import annotations

import numpy as np

from .arithmetic import divide, mix, number, saturate

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of scene linear red, green and blue."""


def luminance(colour: np.ndarray) -> np.ndarray:
    r, g, b = LUMINANCE
    return number(colour[0] * np.float32(r) + colour[1] * np.float32(g) + colour[2] * np.float32(b))


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    """The sRGB transfer function of any array, decoded (IEC 61966-2-1); negatives are 0."""
    low = np.maximum(encoded, 0) * np.float32(1 / 12.92)
    high = ((np.maximum(encoded, 0) + np.float32(0.055)) * np.float32(1 / 1.055)) ** np.float32(2.4)
    return np.where(encoded < np.float32(0.04045), low, high)


def linear_to_srgb(linear: np.ndarray) -> np.ndarray:
    """The inverse of `srgb_to_linear`."""
    linear = np.maximum(linear, 0)
    high = np.float32(1.055) * linear ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.where(linear < np.float32(0.0031308), linear * np.float32(12.92), high)


def rgb_to_hsv(rgb: np.ndarray) -> np.ndarray:
    top, bottom = rgb.max(axis=0), rgb.min(axis=0)
    span = top - bottom
    hue = np.where(span != 0, _hue(rgb, top, span), 0)
    return np.stack([hue, divide(span, top), top])


def _hue(rgb: np.ndarray, top: np.ndarray, span: np.ndarray) -> np.ndarray:
    """Place on the circle of colours, in [0, 1)."""
    r, g, b = rgb
    sixth = np.where(r == top, (g - b) / span, np.where(g == top, 2 + (b - r) / span, 4 + (r - g) / span))
    return np.where(sixth < 0, sixth + 6, sixth) * np.float32(1 / 6)


def hsv_to_rgb(hsv: np.ndarray) -> np.ndarray:
    h, s, v = hsv
    sector = np.where(h == 1, 0, h) * 6
    i = np.floor(sector)
    f = sector - i
    p, q, t = v * (1 - s), v * (1 - s * f), v * (1 - s * (1 - f))
    cases = [i == k for k in range(5)]
    return np.stack(
        [
            np.select(cases, [v, q, p, p, t], v),
            np.select(cases, [t, v, v, q, p], p),
            np.select(cases, [p, p, t, v, v], q),
        ]
    )


def rgb_to_hsl(rgb: np.ndarray) -> np.ndarray:
    top, bottom = rgb.max(axis=0), rgb.min(axis=0)
    span, lightness = top - bottom, np.minimum((top + bottom) / 2, 1)
    saturation = divide(span, np.where(lightness > 0.5, 2 - top - bottom, top + bottom))
    coloured = span != 0
    return np.stack(
        [np.where(coloured, _hue(rgb, top, span), 0), np.where(coloured, saturation, 0), lightness]
    )


def hsl_to_rgb(hsl: np.ndarray) -> np.ndarray:
    h, s, lightness = hsl
    pure = saturate(np.stack([np.abs(h * 6 - 3) - 1, 2 - np.abs(h * 6 - 2), 2 - np.abs(h * 6 - 4)]))
    return (pure - np.float32(0.5)) * ((1 - np.abs(2 * lightness - 1)) * s) + lightness


def unchanged(colour: np.ndarray) -> np.ndarray:
    return colour


FROM_RGB = {"RGB": unchanged, "HSV": rgb_to_hsv, "HSL": rgb_to_hsl}
TO_RGB = {"RGB": unchanged, "HSV": hsv_to_rgb, "HSL": hsl_to_rgb}


def bright_contrast(colour: np.ndarray, bright: np.ndarray, contrast: np.ndarray) -> np.ndarray:
    return np.maximum((1 + contrast) * colour + (bright - contrast * np.float32(0.5)), 0)


def gamma(colour: np.ndarray, exponent: np.ndarray) -> np.ndarray:
    return np.where(exponent == 0, 1, np.where(colour > 0, np.power(np.maximum(colour, 0), exponent), colour))


def invert(factor: np.ndarray, colour: np.ndarray) -> np.ndarray:
    return mix(factor, colour, 1 - colour)


def hue_saturation(
    hue: np.ndarray, saturation: np.ndarray, value: np.ndarray, factor: np.ndarray, colour: np.ndarray
) -> np.ndarray:
    h, s, v = rgb_to_hsv(colour)
    h = h + hue + np.float32(0.5)
    turned = np.stack(np.broadcast_arrays(h - np.floor(h), saturate(s * saturation), v * value))
    return np.maximum(mix(factor, colour, hsv_to_rgb(turned)), 0)


def blackbody(kelvin: np.ndarray) -> np.ndarray:
    """(3, 1) or (3, N) colour of a black body, of luminance 1: Planck's law seen by the CIE 1931 observer.

    Temperatures are held to 800 to 12,000 K, as in Cycles.
    """
    nanometres = np.arange(380.0, 781.0, 10.0)[:, None]
    kelvin = np.clip(np.atleast_1d(kelvin), 800.0, 12000.0).astype(np.float64)
    radiance = nanometres**-5 / np.expm1(1.438777e7 / (nanometres * kelvin))
    xyz = OBSERVER @ radiance
    return np.maximum(XYZ_TO_RGB @ (xyz / xyz[1]), 0)


# fmt: off
OBSERVER = np.array([
    [0.0014, 0.0042, 0.0143, 0.0435, 0.1344, 0.2839, 0.3483, 0.3362, 0.2908, 0.1954, 0.0956, 0.032,
     0.0049, 0.0093, 0.0633, 0.1655, 0.2904, 0.4334, 0.5945, 0.7621, 0.9163, 1.0263, 1.0622, 1.0026,
     0.8544, 0.6424, 0.4479, 0.2835, 0.1649, 0.0874, 0.0468, 0.0227, 0.0114, 0.0058, 0.0029, 0.0014,
     0.0007, 0.0003, 0.0002, 0.0001, 0],
    [0, 0.0001, 0.0004, 0.0012, 0.004, 0.0116, 0.023, 0.038, 0.06, 0.091, 0.139, 0.208,
     0.323, 0.503, 0.71, 0.862, 0.954, 0.995, 0.995, 0.952, 0.87, 0.757, 0.631, 0.503,
     0.381, 0.265, 0.175, 0.107, 0.061, 0.032, 0.017, 0.0082, 0.0041, 0.0021, 0.001, 0.0005,
     0.0002, 0.0001, 0.0001, 0, 0],
    [0.0065, 0.0201, 0.0679, 0.2074, 0.6456, 1.3856, 1.7471, 1.7721, 1.6692, 1.2876, 0.813, 0.4652,
     0.272, 0.1582, 0.0782, 0.0422, 0.0203, 0.0087, 0.0039, 0.0021, 0.0017, 0.0011, 0.0008, 0.0003,
     0.0002, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
     0, 0, 0, 0, 0],
])
# fmt: on
"""CIE 1931 colour matching functions of X, Y and Z from 380 to 780 nm, each 10 nm."""

XYZ_TO_RGB = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)
"""Scene linear Rec. 709, white D65."""


def _overlay(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(a < 0.5, a * (1 - t + 2 * t * b), 1 - (1 - t + 2 * t * (1 - b)) * (1 - a))


def _dodge(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    left = 1 - t * b
    return np.where(a == 0, a, np.where(left <= 0, 1, np.minimum(a / left, 1)))


def _burn(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    kept = 1 - t + t * b
    return np.where(kept <= 0, 0, saturate(1 - (1 - a) / kept))


def _soft_light(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    screen = 1 - (1 - b) * (1 - a)
    return (1 - t) * a + t * ((1 - a) * b * a + a * screen)


def _hsv(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return rgb_to_hsv(a), rgb_to_hsv(b)


def _mix_hue(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    (_, s, v), (hue, grey, _) = _hsv(a, b)
    turned = hsv_to_rgb(np.stack(np.broadcast_arrays(hue, s, v)))
    return np.where(grey != 0, mix(t, a, turned), a)


def _mix_saturation(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    (h, s, v), (_, s2, _) = _hsv(a, b)
    return np.where(s != 0, hsv_to_rgb(np.stack(np.broadcast_arrays(h, mix(t, s, s2), v))), a)


def _mix_value(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    (h, s, v), (_, _, v2) = _hsv(a, b)
    return hsv_to_rgb(np.stack(np.broadcast_arrays(h, s, mix(t, v, v2))))


def _mix_colour(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    (_, _, v), (h2, s2, _) = _hsv(a, b)
    return np.where(s2 != 0, mix(t, a, hsv_to_rgb(np.stack(np.broadcast_arrays(h2, s2, v)))), a)


BLEND = {
    "MIX": mix,
    "ADD": lambda t, a, b: a + t * b,
    "MULTIPLY": lambda t, a, b: a * (1 - t + t * b),
    "SUBTRACT": lambda t, a, b: a - t * b,
    "SCREEN": lambda t, a, b: 1 - (1 - t + t * (1 - b)) * (1 - a),
    "OVERLAY": _overlay,
    "DIVIDE": lambda t, a, b: np.where(b != 0, (1 - t) * a + t * a / b, a),
    "DIFFERENCE": lambda t, a, b: mix(t, a, np.abs(a - b)),
    "EXCLUSION": lambda t, a, b: np.maximum(mix(t, a, a + b - 2 * a * b), 0),
    "DARKEN": lambda t, a, b: mix(t, a, np.minimum(a, b)),
    "LIGHTEN": lambda t, a, b: mix(t, a, np.maximum(a, b)),
    "DODGE": _dodge,
    "BURN": _burn,
    "HUE": _mix_hue,
    "SATURATION": _mix_saturation,
    "VALUE": _mix_value,
    "COLOR": _mix_colour,
    "SOFT_LIGHT": _soft_light,
    "LINEAR_LIGHT": lambda t, a, b: a + t * (2 * b - 1),
}
"""Blend modes by Blender's names: functions of a factor and two colours."""
