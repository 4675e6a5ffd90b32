# SPDX-License-Identifier: GPL-3.0-or-later
"""The Sobol sequence and its exact nested uniform (Owen) scrambling.

Direction numbers: S. Joe and F. Y. Kuo, "Constructing Sobol sequences with better two-dimensional
projections", SIAM J. Sci. Comput. 30, 2008. Scrambling: A. B. Owen, "Randomly permuted (t,m,s)-nets
and (t,s)-sequences", 1995. Integers of 32 bits stand for binary fractions.
"""

from __future__ import annotations

import numpy as np

BITS = 32

# (degree, coefficients, initial values) of dimensions 1 to 15; dimension 0 is van der Corput's.
_JOE_KUO = (
    (1, 0, (1,)),
    (2, 1, (1, 3)),
    (3, 1, (1, 3, 1)),
    (3, 2, (1, 1, 1)),
    (4, 1, (1, 1, 3, 3)),
    (4, 4, (1, 3, 5, 13)),
    (5, 2, (1, 1, 5, 5, 17)),
    (5, 4, (1, 1, 5, 5, 5)),
    (5, 7, (1, 1, 7, 11, 19)),
    (5, 11, (1, 1, 5, 1, 1)),
    (5, 13, (1, 1, 1, 3, 11)),
    (5, 14, (1, 3, 5, 5, 31)),
    (6, 1, (1, 3, 3, 9, 7, 49)),
    (6, 13, (1, 1, 1, 15, 21, 21)),
    (6, 16, (1, 3, 1, 13, 27, 49)),
)
MAX_DIMENSIONS = len(_JOE_KUO) + 1

AT_ONCE = 1 << 15
"""Coins of a scrambling that are tossed at once, about."""

SHIFTED = np.uint32(0xFFFFFE00)
"""Digits of 32 that `digital_shift` changes: the highest, of `unit_float`."""


def direction_numbers(dimension: int) -> np.ndarray:
    """The (32,) uint32 direction numbers of one dimension."""
    if dimension == 0:
        return np.uint32(1) << np.arange(BITS - 1, -1, -1, dtype=np.uint32)
    degree, coefficients, initial = _JOE_KUO[dimension - 1]
    m = list(initial)
    for i in range(degree, BITS):
        value = m[i - degree] ^ (m[i - degree] << degree)
        for k in range(1, degree):
            value ^= ((coefficients >> (degree - 1 - k)) & 1) * (m[i - k] << k)
        m.append(value)
    return np.array([value << (BITS - 1 - i) for i, value in enumerate(m)], np.uint64).astype(np.uint32)


def sobol(index: np.ndarray, dimension: int) -> np.ndarray:
    """Coordinate ``dimension`` of the Sobol points ``index`` (uint32, any shape), as 32-bit fractions."""
    x = np.zeros_like(index)
    numbers = direction_numbers(dimension)[: int(index.max(initial=0)).bit_length()]
    for bit, number in enumerate(numbers):
        x ^= ((index >> np.uint32(bit)) & np.uint32(1)) * number
    return x


def mix(x: np.ndarray) -> np.ndarray:
    """A 32-bit integer hash: each bit of ``x`` (uint32) changes each bit of the result half of the time."""
    x = x ^ (x >> np.uint32(16))
    x *= np.uint32(0x7FEB352D)
    x ^= x >> np.uint32(15)
    x *= np.uint32(0x846CA68B)
    x ^= x >> np.uint32(16)
    return x


def hash_combine(*values: int | np.ndarray) -> np.ndarray:
    """One uint32 hash of several integers or arrays of them (broadcast)."""
    state = np.uint32(0x9E3779B9) * np.ones(1, np.uint32)
    for value in values:
        state = mix(mix(state) ^ np.asarray(value).astype(np.uint32))
        state = mix(state + np.uint32(0x632BE5AB))
    return state


def owen_scramble(x: np.ndarray, seed: int | np.ndarray, bits: int = BITS) -> np.ndarray:
    """Nested uniform scrambling of 32-bit fractions: every bit is flipped by a coin of its higher bits.

    A (t, m, s)-net stays one, each point becomes uniform. Applied to an index it permutes a sequence
    so that aligned blocks of 2^k points stay blocks of 2^k points.
    seed : of S scramblings (S, 1) for x (N,), which gives (S, N); a plain number gives (N,).
    bits : of the highest, so many are scrambled; whoever drops the others need not have them.
    """
    seeds = np.atleast_1d(seed)
    coins = np.moveaxis(hash_combine(seeds[..., None], np.arange(bits)), -1, 0)
    flips = np.zeros(np.broadcast_shapes(x.shape, np.shape(seed)), np.uint32)
    half = x >> np.uint32(1)
    # Of a short net all bits at once; of a long one, each of its few first prefixes is tossed for once.
    step = max(1, AT_ONCE // max(flips.size, 1))
    for low in range(0, bits, step):
        of_bit = coins[low : low + step]
        after = np.arange(BITS - 1 - low, BITS - 1 - low - len(of_bit), -1, dtype=np.uint32)
        after = after.reshape(-1, *[1] * seeds.ndim)
        few = step == 1 and 1 << low < x.size
        tossed = np.arange(1 << low, dtype=np.uint32) if few else half >> after
        coin = mix(mix(tossed ^ of_bit) + of_bit)
        coin >>= np.uint32(31)
        coin <<= after
        coin = np.bitwise_or.reduce(coin, axis=0)
        flips |= coin.take(half >> after[0, 0], axis=-1) if few else coin
    return x ^ flips


def digital_shift(u: np.ndarray, number: int | np.ndarray) -> np.ndarray:
    """Points u (D, ...) in (0, 1) of a net, as another net has them: which one, ``number`` (N,) says for each
    of u (D, N), or one for all. 0 is the net itself.
    """
    if np.ndim(number) == 0:
        if number == 0:
            return u
        digits = hash_combine(np.arange(len(u)), number)
    else:
        digits = hash_combine(np.arange(len(u))[:, None], np.arange(int(number.max(initial=0)) + 1))
        digits[:, 0] = 0
        digits = digits.take(number, axis=1)
    digits &= SHIFTED
    changed = (u * u.dtype.type(2.0**32)).astype(np.uint32)
    changed ^= digits.reshape(len(u), *[1] * (u.ndim - np.ndim(number) - 1), *np.shape(number))
    return unit_float(changed, u.dtype)


def unit_float(x: np.ndarray, dtype: type = np.float32) -> np.ndarray:
    """32-bit fractions as float32 or float64 in the open interval (0, 1): cell centres, never 0 nor 1."""
    if dtype == np.float64:
        return (x + 0.5) * 2.0**-32
    return (x >> np.uint32(9)).astype(np.float32) * np.float32(2.0**-23) + np.float32(2.0**-24)
