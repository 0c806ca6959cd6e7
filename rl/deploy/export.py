"""Trained policies, taken out of Stable-Baselines3 and written for NumPy, C and ONNX."""

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
from rl.observer import PAPER, View
from rl.task import observation_bounds, observation_names
from sim2real.errors import InputError
from sim2real.output import check_writable, provenance, write_whole

_EXPECTED = "a policy saved by Stable-Baselines3's SAC"


def read_zip(
    path: str | os.PathLike[str], *, seed: int | None = None, price: float | None = None
) -> Policy:
    """Read the policy of an SAC agent, without its memory and critics.

    Where the agent says what angles its actions of -1 and 1 mean (as ``rl.sac.sac`` makes them), so
    does the policy; otherwise its action space is in rad.

    Such a zip holds pickled Python: read only those from people you trust.

    Args:
        path: Saved by ``SAC.save``.
        seed: For the provenance.
        price: What energy costs it, over the training's own; that of the file where None.

    Raises:
        InputError: If it is none, or a policy that is not a plain network with ReLU, or did not
            learn for this price.
    """
    file = Path(path)
    agent = read_agent(file)
    if price is not None:
        set_price(agent, price, where=str(file))
    return policy_of(agent, where=str(file), made={**provenance([file], seed)})


def read_agent(path: str | os.PathLike[str]) -> SAC:
    """Read an SAC agent without room for a memory; see ``read_zip``.

    Raises:
        InputError: If there is none.
    """
    file = Path(path)
    if not file.is_file():
        raise InputError(file, "", "no file", _EXPECTED)
    try:
        return SAC.load(file, device="cpu", custom_objects={"buffer_size": 1})
    except Exception as error:  # whatever unpickling a file that is none may raise
        found = f"none that can be loaded ({type(error).__name__}: {error})"
        raise InputError(file, "", found, _EXPECTED) from None


def set_price(agent: SAC, price: float, *, where: str = "agent") -> None:
    """Let an agent swim at another price of energy that it learned for.

    The price is a constant input of its actor, and goes into the first layer's bias.

    Args:
        agent: As ``rl.sac`` saves them.
        price: Over the training's own.
        where: Its file, for errors.

    Raises:
        InputError: If the agent did not learn for this price.
    """
    known: dict[str, Any] = getattr(agent, "by_price", {})
    prices = known.get("prices", 1.0)
    if not 1 / prices <= price <= prices:
        expected = f"{1 / prices:g} to {prices:g}" if prices > 1 else "1, as it learned"
        raise InputError(where, "price", f"{price:g}", expected)
    if prices > 1:
        share, actor = math.log(price) / math.log(prices), cast(Any, agent.actor)
        bias = actor.latent_pi[0].bias.data
        bias += bias.new_tensor(known["column"]) * (share - known["share"])
        known["share"] = share


def policy_of(agent: SAC, *, where: str = "agent", made: Mapping[str, Any] | None = None) -> Policy:
    """The deterministic policy of an SAC agent.

    Raises:
        InputError: As ``read_zip``.
    """
    layers = _layers(agent, where)
    low, high, joints = _actions(agent)
    view = view_of(agent)
    F, J = layers[0].in_features, len(low)
    if view.size(J) != F:
        found = f"{F} columns for {J} joints"
        raise InputError(where, "observation", found, f"{view.size(J)}, as its view has them")
    return Policy(
        weights=tuple(_array(layer.weight) for layer in layers),
        biases=tuple(_array(layer.bias) for layer in layers),
        low=low,
        high=high,
        joints=joints,
        observation=tuple(observation_names(joints)),
        observation_limit=np.array(observation_bounds(J), dtype=np.float32),
        view=view,
        provenance=dict(made or {}),
    )


def view_of(agent: SAC) -> View:
    """How an agent looks at the task; as the paper's where it doesn't say."""
    view = getattr(agent, "view", PAPER)
    return view if isinstance(view, View) else PAPER


def _layers(agent: SAC, where: str) -> list[nn.Linear]:
    actor: Any = agent.actor
    if not isinstance(actor.features_extractor, FlattenExtractor):
        found = type(actor.features_extractor).__name__
        raise InputError(where, "policy", f"a {found}", "an MlpPolicy")
    if not isinstance(actor.mu, nn.Linear):
        raise InputError(where, "policy", "state-dependent exploration", "a policy without")
    modules: list[Any] = list(actor.latent_pi) if isinstance(actor.latent_pi, nn.Sequential) else []
    for k, module in enumerate(modules):
        if not isinstance(module, (nn.Linear, nn.ReLU)[k % 2]):
            expected = "fully connected layers with ReLU between them"
            raise InputError(where, "policy", f"a layer {type(module).__name__}", expected)
    return [*modules[::2], actor.mu]


def _actions(agent: SAC) -> tuple[Any, Any, tuple[str, ...]]:
    """Angles in rad at the ends of tanh's range, and the joints' names."""
    box: Any = agent.action_space
    low, high = box.low.astype(np.float32), box.high.astype(np.float32)
    joints = getattr(agent, "joints", None)
    if joints is None:
        return low, high, tuple(f"j{k + 1}" for k in range(len(low)))
    told: Any = agent
    first, span = told.joint_low, told.joint_high - told.joint_low
    ends = (np.asarray(first + (end + 1) / 2 * span, dtype=np.float32) for end in (low, high))
    return next(ends), next(ends), tuple(map(str, joints))


def _array(parameter: Any) -> Any:  # noqa: ANN401 - a tensor, an array
    return np.array(parameter.detach().cpu().numpy(), dtype=np.float32)


FORMATS: Mapping[str, tuple[str, Callable[[Policy], str | bytes]]] = {
    "npz": (".npz", npz),
    "c": (".h", c_header),
    "onnx": (".onnx", onnx_model),
}
"""Each format's file name ending and writer."""


def write_policy(policy: Policy, path: Path, formats: tuple[str, ...]) -> list[Path]:
    """Write a policy, ``path`` with the ending of each format; all are made before one is written.

    Raises:
        InputError: If a format's package is missing or a file can't be written.
    """
    files = [check_writable(path.with_suffix(FORMATS[one][0])) for one in formats]
    contents = [FORMATS[one][1](policy) for one in formats]
    return [write_whole(file, content) for file, content in zip(files, contents, strict=True)]
