"""Export of a policy with its observer as an ONNX graph."""

from __future__ import annotations

import warnings
from io import BytesIO
from typing import Any

import torch
from torch import Tensor, nn

from rl.deploy.policy import Policy
from rl.observer import Observer
from sim2real.errors import library

_DOC = """One decision. observation (N, O): {columns}. begin (N, 1): 1 where a swim starts, else 0.
memory (N, M): result of the last call; arbitrary where a swim starts. set_points (N, {period}, J):
desired angles in rad of {joints} for the next {period} periods of 20 ms; if frames were lost and
the decision is k periods late, send from number k on and decide again {period} - k later."""


class _Decision(nn.Module):
    """``rl.observer.Observer``: begin, observe, decide, and set-points until the next decision."""

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self.policy = policy
        layers: list[nn.Module] = []
        for weight, bias in zip(policy.weights, policy.biases, strict=True):
            linear = nn.Linear(*weight.shape[::-1])
            linear.weight.data, linear.bias.data = torch.tensor(weight), torch.tensor(bias)
            layers += [linear, nn.ReLU()]
        self.network = nn.Sequential(*layers[:-1], nn.Tanh())

    def forward(self, observation: Tensor, memory: Tensor, begin: Tensor) -> tuple[Tensor, Tensor]:
        policy, limit = self.policy, torch.tensor(self.policy.observation_limit)
        raw = torch.minimum(torch.maximum(observation, -limit), limit)
        # the exporter's atan2 takes 0 to the left for a little to the right
        left = torch.where(raw[:, -1:] == 0, torch.finfo(raw.dtype).tiny, raw[:, -1:])
        raw = torch.cat([raw[:, :-1], left], 1)
        low, high = torch.tensor(policy.low), torch.tensor(policy.high)
        observer = Observer(policy.view, low, high, len(observation))
        observer.remember(memory)
        observer.begin(raw, begin[:, 0] > 0.5)
        observer.decide(self.network(observer.observe(raw)))
        ticks = range(policy.view.period)
        return torch.stack([observer.set_points(k) for k in ticks], 1), observer.memory()


def onnx_model(policy: Policy) -> bytes:
    """The policy as ONNX, float32: inputs observation, memory, begin; outputs set-points, memory.

    Raises:
        InputError: If the package ``onnx`` is not installed.
    """
    onnx = library("onnx", "--format")
    O, J, M = len(policy.observation), len(policy.joints), max(policy.view.memory, 2)  # noqa: E741
    names = ["observation", "memory", "begin"], ["set_points", "next_memory"]
    examples = tuple(torch.zeros(2, width) for width in (O, M * J + 2, 1))
    stream: Any = BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter that needs no further package is the old one
        torch.onnx.export(
            _Decision(policy), examples, stream, dynamo=False, opset_version=17,
            input_names=names[0], output_names=names[1],
            dynamic_axes={name: {0: "N"} for name in (*names[0], *names[1])},
        )  # fmt: skip
    model = onnx.load_from_string(stream.getvalue())
    model.graph.name, model.producer_name = "policy", "sim2real"
    columns, joints = ", ".join(policy.observation), ", ".join(policy.joints)
    model.graph.doc_string = _DOC.format(columns=columns, joints=joints, period=policy.view.period)
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString())
