"""Policies of agents trained with Stable-Baselines3, exported to NumPy, C and ONNX."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import SAC
from torch import Tensor, nn

from rl.deploy.header import c_header
from rl.deploy.policy import Policy, npz
from rl.observer import PAPER, Observer, observation_bounds, observation_names
from rl.sac.sac import read_agent
from sim2real.arrays import Array32
from sim2real.errors import InputError, library
from sim2real.output import check_writable, provenance, write_whole


def read_zip(
    path: str | os.PathLike[str], *, seed: int | None = None, price: float | None = None
) -> Policy:
    """Read the policy of an SAC agent; nothing in the file is executed, see ``rl.sac.policy_zip``.

    ``price`` is that of energy relative to the training's, by default that of the file; ``seed`` is
    for the provenance. Networks are fully connected, with ReLU; all else is an InputError.
    """
    agent = read_agent(path)
    if price is not None:
        set_price(agent, price, where=str(path))
    return policy_of(agent, where=str(path), note=provenance([Path(path)], seed))


def set_price(agent: SAC, price: float, *, where: str = "agent") -> None:
    """Set another price of energy, relative to the training's: a constant input of the actor."""
    by_price: dict[str, Any] = getattr(agent, "by_price", {})
    prices = by_price.get("prices", 1.0)
    if not 1 / prices <= price <= prices:
        expected = f"{1 / prices:g} to {prices:g}" if prices > 1 else "1, as in training"
        raise InputError(where, "price", f"{price:g}", expected)
    if prices > 1:
        actor: Any = agent.actor
        share, bias = math.log(price) / math.log(prices), actor.latent_pi[0].bias.data
        bias += bias.new_tensor(by_price["column"]) * (share - by_price["share"])
        by_price["share"] = share


def policy_of(agent: SAC, *, where: str = "agent", note: Mapping[str, Any] | None = None) -> Policy:
    """The policy of an SAC agent with its joints' angles; actions of other agents are in rad."""
    actor: Any = agent.actor
    layers: list[nn.Linear] = [*actor.latent_pi[::2], actor.mu]
    attributes, box = vars(agent), agent.action_space
    low, high, joints = box.low, box.high, attributes.get("joints")  # type: ignore[attr-defined]
    if joints is None:
        joints = [f"j{k + 1}" for k in range(len(low))]
    else:
        lowest, span = agent.joint_low, agent.joint_high - agent.joint_low  # type: ignore[attr-defined]
        low, high = (lowest + (end + 1) / 2 * span for end in (low, high))
    view, spread = attributes.get("view", PAPER), attributes.get("trained_over")
    F, J = layers[0].in_features, len(low)
    if view.size(J) != F:
        problem = f"{F} columns for {J} joints"
        raise InputError(where, "observation", problem, f"{view.size(J)}, as in its view")
    return Policy(
        weights=tuple(_array(layer.weight) for layer in layers),
        biases=tuple(_array(layer.bias) for layer in layers),
        low=np.asarray(low, dtype=np.float32),
        high=np.asarray(high, dtype=np.float32),
        joints=tuple(map(str, joints)),
        observation=tuple(observation_names(joints)),
        observation_limit=np.array(observation_bounds(J), dtype=np.float32),
        view=view,
        provenance={**(note or {}), **({"trained_over": spread} if spread else {})},
    )


def _array(parameter: Tensor) -> Array32:
    return np.array(parameter.detach().cpu().numpy(), dtype=np.float32)


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
    """The policy as ONNX, float32; InputError without the package ``onnx``."""
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


FORMATS: Mapping[str, tuple[str, Callable[[Policy], str | bytes]]] = {
    "npz": (".npz", npz),
    "c": (".h", c_header),
    "onnx": (".onnx", onnx_model),
}
"""File name extension and writer of each format."""


def write_policy(policy: Policy, path: Path, formats: tuple[str, ...]) -> list[Path]:
    """Write a policy in several formats, to ``path`` with the extension of each."""
    files = [check_writable(path.with_suffix(FORMATS[name][0])) for name in formats]
    contents = [FORMATS[name][1](policy) for name in formats]
    return [write_whole(file, content) for file, content in zip(files, contents, strict=True)]
