"""Export of a policy with its observer as an ONNX graph."""

from __future__ import annotations

from typing import Any

import numpy as np

from rl import observer
from rl.deploy.forward import Policy
from sim2real.errors import library

_DOC = """One decision. observation (N, O): {columns}. begin (N, 1): 1 where a swim starts, else 0.
memory (N, M): result of the last call; arbitrary where a swim starts. set_points (N, {period}, J):
desired angles in rad of {joints} for the next {period} periods of 20 ms; if frames were lost and
the decision is k periods late, send from number k on and decide again {period} - k later."""


class _Graph:
    """Nodes and constants of a graph; each method returns the name of its result."""

    def __init__(self, onnx: Any) -> None:  # noqa: ANN401 - a module without types
        self._onnx = onnx
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, values: Any, kind: type = np.float32) -> str:  # noqa: ANN401
        """Add a constant array."""
        name = f"c{len(self.constants)}"
        array: Any = np.asarray(values, dtype=kind)
        self.constants.append(self._onnx.numpy_helper.from_array(array, name))
        return name

    def add(self, kind: str, *inputs: Any, **attributes: Any) -> str:  # noqa: ANN401
        """Add a node; numbers and arrays among the inputs become constants."""
        names = [x if isinstance(x, str) else self.constant(x) for x in inputs]
        name = f"n{len(self.nodes)}"
        self.nodes.append(self._onnx.helper.make_node(kind, names, [name], **attributes))
        return name

    def columns(self, matrix: str, start: int, stop: int) -> str:
        """Columns ``start`` to ``stop`` of a matrix."""
        ends = [self.constant([x], np.int64) for x in (start, stop, 1)]
        return self.add("Slice", matrix, *ends)

    def cut(self, x: str, low: Any, high: Any) -> str:  # noqa: ANN401
        """Clip to two bounds."""
        return self.add("Min", self.add("Max", x, low), high)


def onnx_model(policy: Policy) -> bytes:
    """The policy as ONNX, float32: inputs observation, memory, begin; outputs set-points, memory.

    Raises:
        InputError: If the package ``onnx`` is not installed.
    """
    onnx = library("onnx", "--format")
    g, J, O = _Graph(onnx), len(policy.joints), len(policy.observation)  # noqa: E741
    M = max(policy.view.memory, 2) * J + 2
    _decision(g, policy, J, O)
    helper, single = onnx.helper, onnx.TensorProto.FLOAT
    shapes = {"observation": ["N", O], "memory": ["N", M], "begin": ["N", 1]}
    inputs = [helper.make_tensor_value_info(k, single, v) for k, v in shapes.items()]
    shapes = {"set_points": ["N", policy.view.period, J], "next_memory": ["N", M]}
    outputs = [helper.make_tensor_value_info(k, single, v) for k, v in shapes.items()]
    text = _DOC.format(
        columns=", ".join(policy.observation), joints=", ".join(policy.joints),
        period=policy.view.period,
    )  # fmt: skip
    graph = helper.make_graph(g.nodes, "policy", inputs, outputs, g.constants, doc_string=text)
    model = helper.make_model(
        graph, producer_name="sim2real", ir_version=8, opset_imports=[helper.make_opsetid("", 17)]
    )
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())


def _decision(g: _Graph, policy: Policy, J: int, O: int) -> None:  # noqa: E741
    """``rl.observer.Observer``: begin, observe, decide, and set-points until the next decision."""
    view, K = policy.view, max(policy.view.memory, 2)
    clipped = g.cut("observation", -policy.observation_limit, policy.observation_limit)
    ahead, leftward = g.columns(clipped, O - 2, O - 1), g.columns(clipped, O - 1, O)
    raw = _angle_of(g, leftward, ahead)
    angle = g.add("Sub", g.columns(clipped, 3, 3 + J), policy.low)
    share = g.add("Div", g.add("Mul", angle, 2.0), policy.high - policy.low)
    share = g.add("Sub", share, 1.0)
    start = g.add("Concat", *[g.cut(share, -1.0, 1.0)] * K, axis=1)
    begins = g.add("Greater", "begin", 0.5)
    decisions = g.add("Where", begins, start, g.columns("memory", 0, K * J))
    last_bearing = g.add("Where", begins, raw, g.columns("memory", K * J, K * J + 1))
    initial_side = g.add("Where", g.add("Less", raw, 0.0), -1.0, 1.0)
    side = g.add("Where", begins, initial_side, g.columns("memory", K * J + 1, K * J + 2))
    turn, pi = np.float32(2 * np.pi), np.float32(np.pi)
    offset = g.add("Where", g.add("Greater", raw, 0.0), -turn, turn)
    wrapped = g.add("Add", raw, offset)
    allowed = g.add("LessOrEqual", g.add("Abs", wrapped), np.float32(observer.KEPT_RAD))
    crossed = g.add("And", g.add("Less", g.add("Mul", raw, last_bearing), 0.0), allowed)
    bearing = g.add("Where", crossed, wrapped, raw)
    parts = [clipped]
    if view.scaled:
        squares = g.add("Add", g.add("Mul", ahead, ahead), g.add("Mul", leftward, leftward))
        distance = g.add("Add", g.add("Sqrt", squares), observer.NEAR_M)
        distance = g.add("Div", distance, observer.HALF_M)
        scale = np.array([observer.SURGE_M_S, observer.SWAY_M_S, observer.YAW_RAD_S])
        rate = g.add("Div", g.columns(clipped, 3 + J, 3 + 2 * J), observer.RATE_RAD_S)
        body = [g.add("Div", g.columns(clipped, 0, 3), scale), share, rate]
        body += [g.add("Sin", bearing), g.add("Cos", bearing), g.add("Log", distance)]
        parts = [g.cut(g.add("Concat", *body, axis=1), -observer.LARGEST, observer.LARGEST)]
    parts += [g.add("Div", bearing, pi), side] if view.sides else []
    parts += [g.columns(decisions, 0, view.memory * J)] if view.memory else []
    decision = _network(g, policy, g.add("Concat", *parts, axis=1))
    mean = g.add("ReduceMean", decision, axes=[1], keepdims=1)
    strokes = g.add("Greater", g.add("Abs", mean), observer.STROKE)
    side = g.add("Where", strokes, g.add("Sign", mean), side)
    before = g.columns(decisions, 0, J)
    kept_decisions = g.columns(decisions, 0, (K - 1) * J)
    memory = g.add("Concat", decision, kept_decisions, bearing, side, axis=1)
    g.nodes.append(g._onnx.helper.make_node("Identity", [memory], ["next_memory"]))  # noqa: SLF001
    shares = (np.arange(view.period) + 1) / view.period if view.ramp else np.ones(view.period)
    axis = g.constant([1], np.int64)
    step = g.add("Unsqueeze", g.add("Sub", decision, before), axis)
    line = g.add("Mul", step, shares[None, :, None])
    line = g.add("Add", g.add("Unsqueeze", before, axis), line)
    half_span = (policy.high - policy.low) / np.float32(2)
    angles = g.add("Add", g.add("Mul", g.add("Add", line, 1.0), half_span), policy.low)
    g.nodes.append(g._onnx.helper.make_node("Identity", [angles], ["set_points"]))  # noqa: SLF001


def _network(g: _Graph, policy: Policy, x: str) -> str:
    output = len(policy.weights) - 1
    for k, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        x = g.add("Gemm", x, weight, bias, transB=1)
        x = g.add("Relu" if k < output else "Tanh", x)
    return x


def _angle_of(g: _Graph, y: str, x: str) -> str:
    """atan2, which ONNX lacks: by the half plane of the point."""
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
