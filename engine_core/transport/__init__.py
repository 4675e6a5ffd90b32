# SPDX-License-Identifier: GPL-3.0-or-later
"""What is integrated: light transport as functions of a point in primary space."""
