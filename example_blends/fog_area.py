# SPDX-License-Identifier: GPL-3.0-or-later
"""`fog_ball` under a square light of 1.4 m instead of a point: its shadow in the fog is soft."""

from .fog_ball import lit
from .model import Model


def model() -> Model:
    return lit("AREA", 450, {"shape": "SQUARE", "size": 1.4})
