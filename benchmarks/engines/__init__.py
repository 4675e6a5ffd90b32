# SPDX-License-Identifier: GPL-3.0-or-later
"""The renderers that are measured, one module a kind."""
