# SPDX-License-Identifier: GPL-3.0-or-later
"""How integrals over primary space are estimated. Knows nothing of light.

integrate(f, ndim=4, bins=(256, 256), samples=64).value
"""

from .control_variates import ControlVariates
from .inner_rules import GaussTensor, InnerRule, MonteCarloPoints, Net, Nodes, SimpsonTensor
from .integrand import Staged
from .integrate import integrate
from .monte_carlo import MonteCarlo, Sobol
from .quadrature import Quadrature
from .result import Result
from .thesis_2020 import Thesis2020

__all__ = [
    "ControlVariates",
    "GaussTensor",
    "InnerRule",
    "MonteCarlo",
    "MonteCarloPoints",
    "Net",
    "Nodes",
    "Quadrature",
    "Result",
    "SimpsonTensor",
    "Sobol",
    "Staged",
    "Thesis2020",
    "integrate",
]
