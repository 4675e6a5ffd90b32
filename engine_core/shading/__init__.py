# SPDX-License-Identifier: GPL-3.0-or-later
"""What a surface looks like at a point: expressions over hits (`values`), and closures of them."""
