"""Export of policies trained with Stable-Baselines3 to NumPy, C and ONNX."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from stable_baselines3 import SAC
from stable_baselines3.common.torch_layers import FlattenExtractor
from torch import nn

from rl.deploy.forward import Policy, npz
from rl.deploy.header import c_header
from rl.deploy.onnx_graph import onnx_model
from rl.sac.sac import read_agent, view_of
from rl.task import observation_bounds, observation_names
from sim2real.errors import InputError
from sim2real.output import check_writable, provenance, write_whole


def read_zip(
    path: str | os.PathLike[str], *, seed: int | None = None, price: float | None = None
) -> Policy:
    """Read the policy of an SAC agent, without its memory and critics.

    If the agent states the angles of its actions -1 and 1 (as those of ``rl.sac.sac`` do), the
    policy has them; otherwise its action space is in rad.

    Nothing in the file is executed, see ``rl.sac.policy_zip``.

    Args:
        path: Saved by an agent of this library, or by Stable-Baselines3's ``SAC.save``.
        seed: For the provenance.
        price: Price of energy relative to that of the training; default: that of the file.

    Raises:
        InputError: If it is no policy, not a fully connected network with ReLU, or was not trained
            for this price.
    """
    file = Path(path)
    agent = read_agent(file)
    if price is not None:
        set_price(agent, price, where=str(file))
    return policy_of(agent, where=str(file), note={**provenance([file], seed)})


def set_price(agent: SAC, price: float, *, where: str = "agent") -> None:
    """Set another price of energy that an agent was trained for.

    The price is a constant input of its actor, and goes into the first layer's bias.

    Args:
        agent: An agent saved by ``rl.sac``.
        price: Price relative to that of the training.
        where: Its file, for errors.

    Raises:
        InputError: If the agent was not trained for this price.
    """
    by_price: dict[str, Any] = getattr(agent, "by_price", {})
    prices = by_price.get("prices", 1.0)
    if not 1 / prices <= price <= prices:
        expected = f"{1 / prices:g} to {prices:g}" if prices > 1 else "1, as in training"
        raise InputError(where, "price", f"{price:g}", expected)
    if prices > 1:
        share, actor = math.log(price) / math.log(prices), cast(Any, agent.actor)
        bias = actor.latent_pi[0].bias.data
        bias += bias.new_tensor(by_price["column"]) * (share - by_price["share"])
        by_price["share"] = share


def policy_of(agent: SAC, *, where: str = "agent", note: Mapping[str, Any] | None = None) -> Policy:
    """The deterministic policy of an SAC agent.

    Raises:
        InputError: As ``read_zip``.
    """
    layers = _layers(agent, where)
    low, high, joints = _actions(agent)
    view, spread = view_of(agent), getattr(agent, "trained_over", None)
    F, J = layers[0].in_features, len(low)
    if view.size(J) != F:
        problem = f"{F} columns for {J} joints"
        raise InputError(where, "observation", problem, f"{view.size(J)}, as in its view")
    return Policy(
        weights=tuple(_array(layer.weight) for layer in layers),
        biases=tuple(_array(layer.bias) for layer in layers),
        low=low,
        high=high,
        joints=joints,
        observation=tuple(observation_names(joints)),
        observation_limit=np.array(observation_bounds(J), dtype=np.float32),
        view=view,
        provenance={**(note or {}), **({"trained_over": spread} if spread else {})},
    )


def _layers(agent: SAC, where: str) -> list[nn.Linear]:
    actor: Any = agent.actor
    if not isinstance(actor.features_extractor, FlattenExtractor):
        extractor = type(actor.features_extractor).__name__
        raise InputError(where, "policy", f"a {extractor}", "an MlpPolicy")
    if not isinstance(actor.mu, nn.Linear):
        raise InputError(where, "policy", "state-dependent exploration", "a policy without")
    modules: list[Any] = list(actor.latent_pi) if isinstance(actor.latent_pi, nn.Sequential) else []
    for k, module in enumerate(modules):
        if not isinstance(module, (nn.Linear, nn.ReLU)[k % 2]):
            expected = "fully connected layers with ReLU between them"
            raise InputError(where, "policy", f"a layer {type(module).__name__}", expected)
    return [*modules[::2], actor.mu]


def _actions(agent: SAC) -> tuple[Any, Any, tuple[str, ...]]:
    """Angles in rad of the actions -1 and 1, and names of the joints."""
    box: Any = agent.action_space
    low, high = box.low.astype(np.float32), box.high.astype(np.float32)
    joints = getattr(agent, "joints", None)
    if joints is None:
        return low, high, tuple(f"j{k + 1}" for k in range(len(low)))
    attributes: Any = agent
    lowest, span = attributes.joint_low, attributes.joint_high - attributes.joint_low
    ends = (np.asarray(lowest + (end + 1) / 2 * span, dtype=np.float32) for end in (low, high))
    return next(ends), next(ends), tuple(map(str, joints))


def _array(parameter: Any) -> Any:  # noqa: ANN401 - a tensor, an array
    return np.array(parameter.detach().cpu().numpy(), dtype=np.float32)


FORMATS: Mapping[str, tuple[str, Callable[[Policy], str | bytes]]] = {
    "npz": (".npz", npz),
    "c": (".h", c_header),
    "onnx": (".onnx", onnx_model),
}
"""File name extension and writer of each format."""


def write_policy(policy: Policy, path: Path, formats: tuple[str, ...]) -> list[Path]:
    """Write a policy in several formats, to ``path`` with the extension of each.

    Raises:
        InputError: If the package of a format is missing or a file cannot be written.
    """
    files = [check_writable(path.with_suffix(FORMATS[name][0])) for name in formats]
    contents = [FORMATS[name][1](policy) for name in formats]
    return [write_whole(file, content) for file, content in zip(files, contents, strict=True)]
