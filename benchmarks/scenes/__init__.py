# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes made for measuring; those made for looking at are in example_blends."""
