# SPDX-License-Identifier: GPL-3.0-or-later
"""A lobe: one term of a surface's BSDF at L hits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np

from ..geometry.vectors import take


@dataclass(eq=False)
class Lobe:
    """Parameters at L hits, component first, float32. Subclasses add their own, (L,) or (k, L) each.

    weight : (3, L), what the lobe's value is multiplied with.
    normal : (3, L), unit, the lobe's own (bent by a normal map).
    towards_viewer : (3, L), unit.
    surface : (3, L), unit, the surface's shading normal where the lobe's own is bent; None: they are one.
    """

    weight: np.ndarray
    normal: np.ndarray
    towards_viewer: np.ndarray
    surface: np.ndarray | None = field(default=None, kw_only=True)

    smooth = True
    """Whether sampling the lights alone serves it; else it is sampled as well, and both combined by MIS."""

    def __len__(self) -> int:
        return self.weight.shape[1]

    def evaluate(
        self, which: np.ndarray | None, to_light: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """weight * f * |cos| (3, N) towards unit ``to_light`` (3, N), and the pdf (N,) of `sample`.

        which : (N,) lanes; None for lane i at point i. The pdf is per solid angle, None of a smooth lobe,
        and 0 below the surface.
        """
        raise NotImplementedError

    def sample(self, which: np.ndarray | None, u: np.ndarray) -> np.ndarray:
        """Unit directions (3, N) for u (2, N), those below the surface of value 0. Not of smooth lobes."""
        raise NotImplementedError

    def is_mirror(self, which: np.ndarray | None) -> np.ndarray:
        """(N,) bool, whether the lobe stands for one without width."""
        raise NotImplementedError

    def take(self, rows: np.ndarray) -> Lobe:
        """The lobe at ``rows`` of its lanes."""
        return type(self)(**{f.name: at(rows, getattr(self, f.name)) for f in fields(self)})

    def filled(self, name: str) -> np.ndarray:
        """An array that means the same as None in the optional field ``name``."""
        return self.normal

    @classmethod
    def concatenate(cls, lobes: Sequence[Lobe]) -> Lobe:
        """Lobes of one class, one after the other."""
        joined = {}
        for f in fields(cls):
            parts = [getattr(lobe, f.name) for lobe in lobes]
            if all(part is None for part in parts):
                continue
            parts = [x.filled(f.name) if p is None else p for x, p in zip(lobes, parts, strict=True)]
            joined[f.name] = np.concatenate(parts, axis=-1)
        return cls(**joined)


def at(which: np.ndarray | None, a: np.ndarray | None) -> np.ndarray | None:
    """(..., N) lanes ``which`` of ``a`` (..., L); all of them for None."""
    return a if which is None or a is None else take(a, which)
