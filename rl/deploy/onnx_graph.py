"""A policy as an ONNX graph, for whatever runs those."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from rl.deploy.forward import Policy
from sim2real.errors import InputError


def onnx_model(policy: Policy) -> bytes:
    """The policy as ONNX: ``observation`` (N, O) in, ``action`` (N, J) in rad out, float32.

    Raises:
        InputError: If the package ``onnx`` is not installed.
    """
    try:
        onnx: Any = importlib.import_module("onnx")
    except ModuleNotFoundError:
        expected = "it installed: pip install 'sim2real[onnx]'"
        raise InputError("--format", "onnx", "no package onnx", expected) from None
    helper, numpy_helper = onnx.helper, onnx.numpy_helper
    half = (policy.high - policy.low) / np.float32(2)
    constants = {"half_range": half, "middle": policy.low + half}
    nodes, value = [], "observation"
    last = len(policy.weights) - 1
    for k, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        constants |= {f"weight_{k}": weight, f"bias_{k}": bias}
        given = [value, f"weight_{k}", f"bias_{k}"]
        nodes.append(helper.make_node("Gemm", given, [f"sum_{k}"], transB=1))
        value = f"layer_{k}"
        nodes.append(helper.make_node("Relu" if k < last else "Tanh", [f"sum_{k}"], [value]))
    nodes.append(helper.make_node("Mul", [value, "half_range"], ["offset"]))
    nodes.append(helper.make_node("Add", ["offset", "middle"], ["action"]))
    single = onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("observation", single, ["N", len(policy.observation)])],
        [helper.make_tensor_value_info("action", single, ["N", len(policy.joints)])],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
        doc_string=f"observation: {', '.join(policy.observation)}; action: desired angles in rad "
        f"of {', '.join(policy.joints)}",
    )
    model = helper.make_model(
        graph, producer_name="sim2real", ir_version=8, opset_imports=[helper.make_opsetid("", 17)]
    )
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())
