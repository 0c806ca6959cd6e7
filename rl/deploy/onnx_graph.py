"""A policy as an ONNX graph, observer and all, for whatever runs those."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from rl.deploy.forward import Policy
from rl.observer import (
    HALF_M,
    KEPT_RAD,
    LARGEST,
    NEAR_M,
    RATE_RAD_S,
    STROKE,
    SURGE_M_S,
    SWAY_M_S,
    YAW_RAD_S,
)
from sim2real.errors import InputError

_DOC = """One decision. observation (N, O): {columns}. begin (N, 1): 1 where a swim begins, else 0.
memory (N, M): what the last call gave; anything where a swim begins. set_points (N, {period}, J):
desired angles in rad of {joints} for the next {period} periods of 20 ms; where frames were lost and
the decision comes k periods late, send from number k on and decide again {period} - k later."""


class _Graph:
    """Nodes and constants, added one by one; each method gives the name of its result."""

    def __init__(self, onnx: Any) -> None:  # noqa: ANN401 - a module without types
        self._onnx = onnx
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, values: Any, kind: type = np.float32) -> str:  # noqa: ANN401
        """An array."""
        name = f"c{len(self.constants)}"
        array: Any = np.asarray(values, dtype=kind)
        self.constants.append(self._onnx.numpy_helper.from_array(array, name))
        return name

    def add(self, kind: str, *given: Any, **attributes: Any) -> str:  # noqa: ANN401
        """A node; numbers and arrays among what is given become constants."""
        names = [one if isinstance(one, str) else self.constant(one) for one in given]
        name = f"n{len(self.nodes)}"
        self.nodes.append(self._onnx.helper.make_node(kind, names, [name], **attributes))
        return name

    def columns(self, of: str, first: int, last: int) -> str:
        """Some columns of a matrix."""
        ends = [self.constant([x], np.int64) for x in (first, last, 1)]
        return self.add("Slice", of, *ends)

    def cut(self, x: str, low: Any, high: Any) -> str:  # noqa: ANN401
        """Between two bounds."""
        return self.add("Min", self.add("Max", x, low), high)


def onnx_model(policy: Policy) -> bytes:
    """The policy as ONNX: observation, memory and begin in, set-points and memory out, float32.

    Raises:
        InputError: If the package ``onnx`` is not installed.
    """
    try:
        onnx: Any = importlib.import_module("onnx")
    except ModuleNotFoundError:
        expected = "it installed: pip install 'sim2real[onnx]'"
        raise InputError("--format", "onnx", "no package onnx", expected) from None
    g, J, O = _Graph(onnx), len(policy.joints), len(policy.observation)  # noqa: E741
    M = max(policy.view.memory, 2) * J + 2
    _decision(g, policy, J, O)
    helper, single = onnx.helper, onnx.TensorProto.FLOAT
    shapes = {"observation": ["N", O], "memory": ["N", M], "begin": ["N", 1]}
    given = [helper.make_tensor_value_info(k, single, v) for k, v in shapes.items()]
    shapes = {"set_points": ["N", policy.view.period, J], "next_memory": ["N", M]}
    gives = [helper.make_tensor_value_info(k, single, v) for k, v in shapes.items()]
    told = _DOC.format(
        columns=", ".join(policy.observation), joints=", ".join(policy.joints),
        period=policy.view.period,
    )  # fmt: skip
    graph = helper.make_graph(g.nodes, "policy", given, gives, g.constants, doc_string=told)
    model = helper.make_model(
        graph, producer_name="sim2real", ir_version=8, opset_imports=[helper.make_opsetid("", 17)]
    )
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def _decision(g: _Graph, policy: Policy, J: int, O: int) -> None:  # noqa: E741
    """``rl.observer.Observer``: begin, see, decide and the set-points until the next decision."""
    view, K = policy.view, max(policy.view.memory, 2)
    seen = g.cut("observation", -policy.observation_limit, policy.observation_limit)
    ahead, left = g.columns(seen, O - 2, O - 1), g.columns(seen, O - 1, O)
    raw = _angle_of(g, left, ahead)
    angle = g.add("Sub", g.columns(seen, 3, 3 + J), policy.low)
    share = g.add("Div", g.add("Mul", angle, 2.0), policy.high - policy.low)
    share = g.add("Sub", share, 1.0)
    start = g.add("Concat", *[g.cut(share, -1.0, 1.0)] * K, axis=1)
    begins = g.add("Greater", "begin", 0.5)
    given = g.add("Where", begins, start, g.columns("memory", 0, K * J))
    last = g.add("Where", begins, raw, g.columns("memory", K * J, K * J + 1))
    first = g.add("Where", g.add("Less", raw, 0.0), -1.0, 1.0)
    side = g.add("Where", begins, first, g.columns("memory", K * J + 1, K * J + 2))
    turn, pi = np.float32(2 * np.pi), np.float32(np.pi)
    back = g.add("Where", g.add("Greater", raw, 0.0), -turn, turn)
    other = g.add("Add", raw, back)
    near = g.add("LessOrEqual", g.add("Abs", other), np.float32(KEPT_RAD))
    crossed = g.add("And", g.add("Less", g.add("Mul", raw, last), 0.0), near)
    bearing = g.add("Where", crossed, other, raw)
    parts = [seen]
    if view.scaled:
        squares = g.add("Add", g.add("Mul", ahead, ahead), g.add("Mul", left, left))
        far = g.add("Div", g.add("Add", g.add("Sqrt", squares), NEAR_M), HALF_M)
        scale = np.array([SURGE_M_S, SWAY_M_S, YAW_RAD_S])
        rate = g.add("Div", g.columns(seen, 3 + J, 3 + 2 * J), RATE_RAD_S)
        body = [g.add("Div", g.columns(seen, 0, 3), scale), share, rate]
        body += [g.add("Sin", bearing), g.add("Cos", bearing), g.add("Log", far)]
        parts = [g.cut(g.add("Concat", *body, axis=1), -LARGEST, LARGEST)]
    parts += [g.add("Div", bearing, pi), side] if view.sides else []
    parts += [g.columns(given, 0, view.memory * J)] if view.memory else []
    now = _network(g, policy, g.add("Concat", *parts, axis=1))
    mean = g.add("ReduceMean", now, axes=[1], keepdims=1)
    strokes = g.add("Greater", g.add("Abs", mean), STROKE)
    side = g.add("Where", strokes, g.add("Sign", mean), side)
    before = g.columns(given, 0, J)
    rest = g.columns(given, 0, (K - 1) * J)
    memory = g.add("Concat", now, rest, bearing, side, axis=1)
    g.nodes.append(g._onnx.helper.make_node("Identity", [memory], ["next_memory"]))  # noqa: SLF001
    shares = (np.arange(view.period) + 1) / view.period if view.ramp else np.ones(view.period)
    axis = g.constant([1], np.int64)
    step = g.add("Unsqueeze", g.add("Sub", now, before), axis)
    line = g.add("Mul", step, shares[None, :, None])
    line = g.add("Add", g.add("Unsqueeze", before, axis), line)
    half = (policy.high - policy.low) / np.float32(2)
    angles = g.add("Add", g.add("Mul", g.add("Add", line, 1.0), half), policy.low)
    g.nodes.append(g._onnx.helper.make_node("Identity", [angles], ["set_points"]))  # noqa: SLF001


def _network(g: _Graph, policy: Policy, x: str) -> str:
    last = len(policy.weights) - 1
    for k, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        x = g.add("Gemm", x, weight, bias, transB=1)
        x = g.add("Relu" if k < last else "Tanh", x)
    return x


def _angle_of(g: _Graph, y: str, x: str) -> str:
    """atan2, which ONNX has not: by the half plane in which the point is."""
    pi = np.float32(np.pi)
    steep = g.add("Greater", g.add("Abs", y), g.add("Abs", x))
    safe_x = g.add("Where", g.add("Equal", x, 0.0), 1.0, x)
    safe_y = g.add("Where", g.add("Equal", y, 0.0), 1.0, y)
    flat = g.add("Atan", g.add("Div", y, safe_x))
    sign = g.add("Where", g.add("Less", y, 0.0), -1.0, 1.0)
    behind = g.add("Where", g.add("Less", x, 0.0), g.add("Mul", sign, pi), 0.0)
    flat = g.add("Add", flat, behind)
    upright = g.add("Sub", g.add("Mul", sign, pi / 2), g.add("Atan", g.add("Div", x, safe_y)))
    return g.add("Where", steep, upright, flat)
