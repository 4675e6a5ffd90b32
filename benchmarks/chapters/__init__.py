# SPDX-License-Identifier: GPL-3.0-or-later
"""The figures of the thesis, by chapter: `benchmarks.thesis` draws them."""
