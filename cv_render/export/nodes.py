# SPDX-License-Identifier: GPL-3.0-or-later
"""Shader nodes as expressions: what feeds a socket, through groups, reroutes and muted nodes.

What a node computes is an entry in a table of `input_nodes`, `texture_nodes` or `converter_nodes`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ...engine_core.shading.arithmetic import average, replicated, unit
from ...engine_core.shading.colour import luminance
from ...engine_core.shading.coordinates import NORMAL
from ...engine_core.shading.textures import ImagePixels
from ...engine_core.shading.values import Value, compute
from ..versions import node_tree
from . import converter_nodes, input_nodes, texture_nodes
from .images import stored_image
from .messages import Messages

NODES = input_nodes.NODES | texture_nodes.NODES | converter_nodes.NODES
"""By Blender's node type, a function of `Node` that gives the expression of its output."""


@dataclass(frozen=True)
class Socket:
    """A node's socket, and the group nodes that were entered on the way to it."""

    socket: Any
    groups: tuple[Any, ...] = ()

    @property
    def node(self) -> Any:
        return self.socket.node

    def input(self, *names: str) -> Socket | None:
        """This node's first enabled input that has one of ``names``, which may be identifiers."""
        for name in names:
            for socket in self.node.inputs:
                if socket.enabled and name in (socket.name, socket.identifier):
                    return Socket(socket, self.groups)
        return None

    def inputs(self) -> list[Socket]:
        return [Socket(socket, self.groups) for socket in self.node.inputs if socket.enabled]

    def source(self) -> Socket:
        """The output that feeds this input, or the input whose own value does."""
        return self.route()[0]

    def route(self) -> tuple[Socket, list[str]]:
        """The `source`, and the types of the sockets on the way from there to this one, its own included."""
        socket, groups = self.socket, self.groups
        types: list[str] = []
        while socket is not None and not socket.is_output:
            types.insert(0, socket.type)
            link = next((link for link in socket.links if link.is_valid and not link.is_muted), None)
            if link is None:
                break
            socket, groups = _enter(link.from_socket, groups, fallback=socket)
        return Socket(socket, groups), types

    def key(self) -> tuple[int, ...]:
        """The same for the same socket in the same instance of a group."""
        return (self.socket.as_pointer(), *(group.as_pointer() for group in self.groups))


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


class Graph:
    """The nodes of one data-block, on their way to expressions.

    owner : how messages call the data-block.
    images : those read so far, by their pointers; shared by the graphs of an export.
    """

    def __init__(self, owner: str, messages: Messages, images: dict[int, ImagePixels] | None = None) -> None:
        self.owner = owner
        self._messages = messages
        self._images = {} if images is None else images
        self._known: dict[Any, Value | np.ndarray] = {}

    def tell(self, problem: str) -> None:
        self._messages.add(self.owner, problem)

    def value(self, socket: Socket) -> Value | np.ndarray:
        """An input, in its own type: () or (N,) of a number, (3, 1) or (3, N) of a colour or vector."""
        source, types = socket.route()
        if not source.socket.is_output:
            found = plain_value(source.socket)
        elif source.node.type in NODES and not source.node.mute:
            found = self._output(source)
        else:
            return self.unsupported(socket, source)
        for before, after in pairwise([source.socket.type, *types]):
            found = _converted(found, before, after)
        return found

    def unsupported(self, socket: Socket, source: Socket) -> Value | np.ndarray:
        """What an input is taken for if nobody knows what its ``source`` computes."""
        instead = f'"{socket.socket.name}" of "{socket.node.name}" keeps its plain value'
        if socket.socket.type == "SHADER":
            instead = "it is rendered black"
        self.tell(f"{described(source)} is not supported yet, {instead}")
        return plain_value(socket.socket)

    def _output(self, source: Socket) -> Value | np.ndarray:
        return self.shared(source.key(), lambda: NODES[source.node.type](Node(self, source)))

    def image(self, image: Any | None) -> ImagePixels:
        pointer = image.as_pointer() if image is not None else 0
        if pointer not in self._images:
            self._images[pointer] = stored_image(image, self._messages, self.owner)
        return self._images[pointer]

    def shared(self, key: Any, make: Callable[[], Value | np.ndarray]) -> Value | np.ndarray:
        """What ``make`` gives, only once for each ``key``."""
        if key not in self._known:
            self._known[key] = make()
        return self._known[key]


class Node:
    """A node's output that is wanted, and its inputs as expressions."""

    def __init__(self, graph: Graph, socket: Socket) -> None:
        self.graph = graph
        self.socket = socket
        self.options = socket.node

    @property
    def output(self) -> str:
        """The wanted output's identifier, which no translation changes."""
        return self.socket.socket.identifier

    @property
    def output_index(self) -> int:
        return list(self.options.outputs).index(self.socket.socket)

    def __getitem__(self, key: str | tuple[str, ...]) -> Value | np.ndarray:
        """The input of a name or identifier, or of several that Blender's versions know it by."""
        return self.graph.value(self.socket.input(*((key,) if isinstance(key, str) else key)))

    def values(self, *identifiers: str) -> list[Value | np.ndarray]:
        """Inputs by their identifiers, also such as the node has switched off."""
        sockets = {socket.identifier: socket for socket in self.options.inputs}
        return [self.graph.value(Socket(sockets[name], self.socket.groups)) for name in identifiers]

    def linked(self, key: str) -> bool:
        """Whether anything gives the input a value."""
        socket = self.socket.input(key)
        return socket is not None and socket.source().socket != socket.socket

    def get(self, key: str, otherwise: Any) -> Any:
        """An input whose own value means ``otherwise``, unless something is linked to it."""
        return self[key] if self.linked(key) else otherwise

    def normal(self, key: str = "Normal") -> Value | None:
        """(3, N) unit, None for the surface's own."""
        value = self.get(key, None)
        if value is None or value is NORMAL:
            return None
        return compute(_normal_or_surface, value, NORMAL)

    def share(self, make: Callable[[], Value | np.ndarray]) -> Value | np.ndarray:
        """What all outputs of the node have in common, made once."""
        key = (self.options.as_pointer(), *(group.as_pointer() for group in self.socket.groups))
        return self.graph.shared(("node", *key), make)

    def tell(self, problem: str) -> None:
        self.graph.tell(f"{described(self.socket)}: {problem}")


def _normal_or_surface(normal: np.ndarray, surface: np.ndarray) -> np.ndarray:
    return np.where((normal != 0).any(axis=0), unit(normal), surface)


def constant(socket: Socket, owner: str, messages: Messages) -> np.ndarray:
    """The value of an input, (3,) or a number; its default, with a message, if it varies."""
    value = Graph(owner, messages).value(socket)
    if isinstance(value, Value):
        messages.add(
            owner,
            f"{described(socket.source())} varies, which is not supported here yet, "
            f'"{socket.socket.name}" of "{socket.node.name}" keeps its plain value',
        )
        value = plain_value(socket.socket)
    return value.astype(np.float64).reshape(value.shape[:1])


def described(socket: Socket) -> str:
    """How messages call a socket's node."""
    return f'node "{socket.node.name}" ({socket.node.bl_label})'


def plain_value(socket: Any) -> np.ndarray:
    """() or (3, 1) float32, what an unlinked socket says; a shader's says nothing, which is black."""
    value = np.array(getattr(socket, "default_value", (0, 0, 0)), np.float32)
    return value[:3, None] if value.ndim else value


_NUMBERS = ("VALUE", "INT", "BOOLEAN")


def _converted(value: Value | np.ndarray, source: str, target: str) -> Value | np.ndarray:
    """From a socket's type to another's, as Cycles does: luminance of colours, the mean of vectors."""
    if source in _NUMBERS and target not in _NUMBERS:
        return compute(replicated, value)
    if source not in _NUMBERS and target in _NUMBERS:
        value = compute(luminance if source == "RGBA" else average, value)
    return compute(np.trunc, value) if target == "INT" and source != "INT" else value
