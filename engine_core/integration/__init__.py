# SPDX-License-Identifier: GPL-3.0-or-later
"""How integrals over primary space are estimated. Knows nothing of light."""
