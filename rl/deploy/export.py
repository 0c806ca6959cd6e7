"""Policies of agents trained with Stable-Baselines3, exported to NumPy, C and ONNX."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import SAC
from torch import nn

from rl.deploy.header import c_header
from rl.deploy.onnx_graph import onnx_model
from rl.deploy.policy import Policy, PolicyController, npz
from rl.observer import observation_bounds, observation_names
from rl.sac.plan import Settings
from rl.sac.sac import read_agent, view_of
from sim2real.arrays import Array32, Mask
from sim2real.errors import InputError
from sim2real.output import check_writable, provenance, write_whole


def read_zip(
    path: str | os.PathLike[str], *, seed: int | None = None, price: float | None = None
) -> Policy:
    """Read the policy of an SAC agent of this library or of Stable-Baselines3.

    Nothing in the file is executed, see ``rl.sac.policy_zip``.

    Args:
        path: The file.
        seed: For the provenance.
        price: Price of energy relative to that of the training; default: that of the file.

    Raises:
        InputError: If it is no policy, not a fully connected network with ReLU, or was not trained
            for this price.
    """
    agent = _at_price(path, price)
    return policy_of(agent, where=str(path), note=provenance([Path(path)], seed))


def _at_price(path: str | os.PathLike[str], price: float | None) -> SAC:
    agent = read_agent(path)
    if price is not None:
        set_price(agent, price, where=str(path))
    return agent


def set_price(agent: SAC, price: float, *, where: str = "agent") -> None:
    """Set another price of energy, relative to that of the training, that an agent learned for.

    The price is a constant input of its actor, and goes into the first layer's bias.

    Raises:
        InputError: If the agent was not trained for this price.
    """
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
    """The deterministic policy of an SAC agent.

    If the agent states the angles of its actions -1 and 1 (as those of ``rl.sac.sac`` do), the
    policy has them; otherwise its action space is in rad.

    Raises:
        InputError: As ``read_zip``.
    """
    actor: Any = agent.actor
    layers: list[nn.Linear] = [*actor.latent_pi[::2], actor.mu]
    attributes, box = vars(agent), agent.action_space
    low, high, joints = box.low, box.high, attributes.get("joints")  # type: ignore[attr-defined]
    if joints is None:
        joints = [f"j{k + 1}" for k in range(len(low))]
    else:
        lowest, span = agent.joint_low, agent.joint_high - agent.joint_low  # type: ignore[attr-defined]
        low, high = (lowest + (end + 1) / 2 * span for end in (low, high))
    view, spread = view_of(agent), attributes.get("trained_over")
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


def _array(parameter: torch.Tensor) -> Array32:
    return np.array(parameter.detach().cpu().numpy(), dtype=np.float32)


class SampledController(PolicyController):
    """Samples the distribution of the actor, with noise correlated in time as in training."""

    def __init__(
        self,
        path: Path | str,
        seed: int = 0,
        noise_s: float = Settings.noise_s,
        price: float | None = None,
    ) -> None:
        """Read an agent; ``noise_s`` is the correlation time, other arguments as ``read_zip``.

        Raises:
            InputError: As ``read_zip``.
        """
        agent = _at_price(path, price)
        super().__init__(policy_of(agent, where=str(path)))
        self._actor: Any = agent.actor
        self._rng = np.random.default_rng(seed)
        self._decay = math.exp(-self.policy.view.decision_s / noise_s) if noise_s > 0 else 0.0
        self._noise = np.empty((0, len(self.policy.low)))

    def reset(self, mask: Mask) -> None:
        """Draw new noise for the robots that are reset."""
        super().reset(mask)
        fresh = self._rng.standard_normal((len(mask), len(self.policy.low)))
        same_size = len(self._noise) == len(mask)
        self._noise = np.where(mask[:, None], fresh, self._noise) if same_size else fresh

    def decided(self, inputs: Array32) -> Array32:
        """Sample actions."""
        if len(self._noise) != len(inputs):
            self._noise = self._rng.standard_normal((len(inputs), len(self.policy.low)))
        with torch.no_grad():
            mean, log_std, _ = self._actor.get_action_dist_params(torch.as_tensor(inputs))
        drawn = np.tanh(mean.numpy() + np.exp(log_std.numpy()) * self._noise)
        fresh = self._rng.standard_normal(self._noise.shape)
        self._noise = self._decay * self._noise + math.sqrt(1 - self._decay**2) * fresh
        return np.asarray(drawn, dtype=np.float32)


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
