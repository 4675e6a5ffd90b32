# SPDX-License-Identifier: GPL-3.0-or-later
"""The sentence: integrate this function over those bins, in that way."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from .control_variates import ControlVariates
from .integrand import FunctionOnGrid, Staged
from .monte_carlo import MonteCarlo, Sobol
from .problem import Method, Pool, Problem
from .quadrature import Quadrature
from .result import Result
from .thesis_2020 import Thesis2020

METHODS: dict[str, type] = {
    "monte_carlo": MonteCarlo,
    "sobol": Sobol,
    "quadrature": Quadrature,
    "control_variates": ControlVariates,
}
PRESETS: dict[str, type] = {"default": ControlVariates, "thesis_2020": Thesis2020}


def integrate(
    f: Callable[[np.ndarray], np.ndarray] | Staged,
    ndim: int,
    bins: int | Sequence[int] = 1,
    samples: float = 64,
    method: str | Method = "control_variates",
    seed: int = 0,
    preset: str = "default",
    threads: int = 1,
    dtype: type = np.float64,
    **options: object,
) -> Result:
    """The mean of a function over every bin of a regular grid.

    f : u (D, N) in the unit cube -> (N,), or (C, N) for C channels; or the same in two stages, `Staged`.
        What it returns that is not finite counts as 0, and is counted. Points may lie on the cube's faces.
    ndim : D. bins : how many along each of the first dimensions; dimension i of u runs along axis i.
    samples : evaluations for each bin, on average, everything included; need not be whole.
    method : "control_variates", "sobol", "monte_carlo", "quadrature", or an object of such a class.
    preset : of the control variates: "default", or "thesis_2020" for the method as first published.
    seed : the same one gives the same result, bit for bit, for any number of threads.
    threads : workers, 0 for one a processor.
    dtype : of the points handed to f, float32 or float64.
    options : of the method named, such as ``cv_dims=3`` or ``residual=False``.

    >>> integrate(lambda u: u[0] * u[1], ndim=2, bins=(2, 2)).value[0]  # doctest: +SKIP
    array([[0.0625, 0.1875], [0.1875, 0.5625]])
    """
    bins = (bins,) if np.ndim(bins) == 0 else tuple(bins)
    if not bins or any(int(n) != n or n < 1 for n in bins):
        raise ValueError(f"bins is {bins!r}, wanted positive whole numbers")
    if int(ndim) != ndim or ndim < len(bins):
        raise ValueError(f"ndim is {ndim!r}, wanted at least {len(bins)}, one for each dimension of bins")
    if not (np.isfinite(samples) and samples > 0):
        raise ValueError(f"samples is {samples!r}, wanted a number above 0")
    if isinstance(method, str):
        if method not in METHODS:
            raise ValueError(f"method is {method!r}, wanted one of {sorted(METHODS)}")
        if preset not in PRESETS:
            raise ValueError(f"preset is {preset!r}, wanted one of {sorted(PRESETS)}")
        kind = METHODS[method]
        try:
            method = (PRESETS[preset] if kind is ControlVariates else kind)(**options)
        except TypeError as error:
            raise ValueError(f"method {method!r} has no such option: {error}") from error
    elif options:
        raise ValueError(f"{sorted(options)} belong to the method, which is given as an object")
    bins = tuple(int(n) for n in bins)
    pool = Pool(threads)
    try:
        integrand = FunctionOnGrid(f, int(ndim), len(bins), np.dtype(dtype))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return method.estimate(Problem(integrand, int(ndim), bins, samples, seed, pool))
    finally:
        pool.close()
