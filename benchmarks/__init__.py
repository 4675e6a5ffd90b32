# SPDX-License-Identifier: GPL-3.0-or-later
"""Benchmarks and comparisons: ``python dev.py bench NAME``, or ``python -m benchmarks.NAME`` where bpy is."""
