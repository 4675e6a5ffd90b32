# SPDX-License-Identifier: GPL-3.0-or-later
"""Bidirectional scattering distribution functions, as lobes: arrays of parameters, one lane a hit."""
