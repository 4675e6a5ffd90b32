# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles and rays: what is hit first, and what can be seen from where."""
