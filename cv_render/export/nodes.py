# SPDX-License-Identifier: GPL-3.0-or-later
"""Shader nodes: what feeds a socket, through groups, reroutes and muted nodes, and its constant value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..versions import node_tree
from .messages import Messages


@dataclass(frozen=True)
class Socket:
    """A node's socket, and the group nodes that were entered on the way to it."""

    socket: Any
    groups: tuple[Any, ...] = ()

    @property
    def node(self) -> Any:
        return self.socket.node

    def input(self, *names: str) -> Socket | None:
        """This node's first enabled input that has one of ``names``."""
        for name in names:
            for socket in self.node.inputs:
                if socket.enabled and socket.name == name:
                    return Socket(socket, self.groups)
        return None

    def inputs(self) -> list[Socket]:
        return [Socket(socket, self.groups) for socket in self.node.inputs if socket.enabled]

    def source(self) -> Socket:
        """The output that feeds this input, or the input whose own value does."""
        socket, groups = self.socket, self.groups
        while socket is not None and not socket.is_output:
            link = next((link for link in socket.links if link.is_valid and not link.is_muted), None)
            if link is None:
                break
            socket, groups = _enter(link.from_socket, groups, fallback=socket)
        return Socket(socket, groups)


def _enter(output: Any, groups: tuple[Any, ...], fallback: Any) -> tuple[Any, tuple[Any, ...]]:
    """``output`` itself if its node computes something, else the socket that it passes on."""
    node = output.node
    if node.type == "REROUTE":
        return node.inputs[0], groups
    if node.mute:
        passed = next((link.from_socket for link in node.internal_links if link.to_socket == output), None)
        return (passed, groups) if passed is not None else (output, groups)
    if node.type == "GROUP" and node.node_tree is not None:
        ends = (n for n in node.node_tree.nodes if n.type == "GROUP_OUTPUT" and n.is_active_output)
        end = next(ends, None)
        if end is not None:
            return _same(end.inputs, output), (*groups, node)
    if node.type == "GROUP_INPUT" and groups:
        return _same(groups[-1].inputs, output), groups[:-1]
    return output, groups


def _same(sockets: Any, socket: Any) -> Any:
    return next(other for other in sockets if other.identifier == socket.identifier)


def surface(datablock: Any) -> Socket | None:
    """The closure that feeds the Surface of the output that Cycles would use; None if nothing does."""
    output = output_node(datablock)
    if output is None:
        return None
    source = Socket(output.inputs["Surface"]).source()
    return source if source.socket.is_output else None


def output_node(datablock: Any) -> Any | None:
    tree = node_tree(datablock)
    return tree.get_output_node("CYCLES") if tree else None


def constant(socket: Socket, owner: str, messages: Messages) -> np.ndarray:
    """The value of an input, (3,) or a number; its default, with a message, if something unknown feeds it."""
    source = socket.source()
    if not source.socket.is_output:
        return _value(source.socket)
    if source.node.type in ("RGB", "VALUE"):
        return _as_kind_of(socket.socket, _value(source.socket))
    messages.add(
        owner,
        f"{described(source)} is not supported yet, "
        f'"{socket.socket.name}" of "{socket.node.name}" keeps its plain value',
    )
    return _value(socket.socket)


def described(socket: Socket) -> str:
    """How messages call a socket's node."""
    return f'node "{socket.node.name}" ({socket.node.bl_label})'


def _value(socket: Any) -> np.ndarray:
    value = np.array(socket.default_value, np.float64)
    return value[:3] if value.ndim else value


def _as_kind_of(socket: Any, value: np.ndarray) -> np.ndarray:
    """Blender's own conversion between colours and numbers: grey, or the luminance."""
    if np.ndim(socket.default_value) and not value.ndim:
        return np.full(3, value)
    if not np.ndim(socket.default_value) and value.ndim:
        return np.dot(value, (0.2126, 0.7152, 0.0722))
    return value
