# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's own exceptions: raised where the cause is known, caught once at the boundary to the user."""


class CVRenderError(Exception):
    """Base of all errors whose message is meant for the user."""


class SceneError(CVRenderError, ValueError):
    """A scene, or a setting, that cannot be rendered; the message names field, shape and value."""


class RenderError(CVRenderError, RuntimeError):
    """A valid scene that cannot be rendered here (no ray tracer on this platform, not enough memory)."""
