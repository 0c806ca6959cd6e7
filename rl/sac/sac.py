"""Stable-Baselines3's SAC, trained by ``rl.sac.agents``."""

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from stable_baselines3 import SAC
from stable_baselines3.sac.policies import SACPolicy
from torch import nn

from rl.deploy.policy import is_spread
from rl.env import action_space, observation_space
from rl.observer import PAPER, View
from rl.sac.plan import Settings
from rl.sac.policy_zip import load_weights, read_policy_zip, write_policy_zip
from rl.world import World
from sim2real.arrays import Array32
from sim2real.errors import InputError
from sim2real.structured import Fields


class NormedPolicy(SACPolicy):
    """SAC policy with layer normalization in the critics, as in ``agents.Layers``."""

    def make_critic(self, *args: Any, **kwargs: Any) -> Any:  # noqa: ANN401 - its own
        """A critic whose hidden layers are normalised before the ReLU."""
        critic: Any = super().make_critic(*args, **kwargs)
        for network in critic.q_networks:
            for k in [k for k, module in enumerate(network) if isinstance(module, nn.ReLU)][::-1]:
                width = network[k - 1].out_features
                network.insert(k, nn.LayerNorm(width, elementwise_affine=False))
        return critic


class SwimSAC(SAC):
    """SAC whose networks are views of those of ``Agents``, which trains them."""

    view: View  # definition of the observations
    joints: list[str]
    joint_low: Array32  # angles of action -1 in rad, shape (J,)
    joint_high: Array32  # of action 1
    trained_over: Mapping[str, Sequence[float]]  # 5 % and 95 % quantile of each parameter
    by_price: dict[str, Any]  # effect of the price, see ``rl.deploy.export.set_price``

    def save(self, path: Any, *_: Any, **__: Any) -> None:  # noqa: ANN401 - as the base class
        """Write ``policy.zip``, without pickled objects."""
        box: Any = self.action_space
        settings: dict[str, Any] = {"algorithm": "SAC", "num_timesteps": self.num_timesteps}
        settings |= {"action_low": box.low, "action_high": box.high}
        stated = ("joint_low", "joint_high", "joints", "trained_over", "view", "by_price")
        settings |= {name: getattr(self, name) for name in stated if hasattr(self, name)}
        learned: Any = self.log_ent_coef
        variables = {} if learned is None else {"log_ent_coef": learned}
        write_policy_zip(path, self.policy, settings, variables)


class Spaces(gymnasium.Env[Any, Any]):
    """Observation and action spaces of a model; cannot be stepped."""

    def __init__(self, observation: spaces.Box, action: spaces.Space[Any]) -> None:
        self.observation_space: Any = observation
        self.action_space: Any = action


def make_sac(world: World, settings: Settings, seed: int, *, view: View) -> SwimSAC:
    """An untrained model for the robots of a world, observed through ``view``."""
    model = SwimSAC(
        NormedPolicy if settings.norm else "MlpPolicy",
        Spaces(observation_space(world, view), action_space(world)),
        learning_rate=settings.rate,
        buffer_size=1,  # the memory is that of ``Agents``
        tau=settings.tau,
        gamma=settings.gamma,
        ent_coef=f"auto_{settings.entropy_start}",
        target_entropy=settings.entropy_target[0] * len(world.low),
        policy_kwargs={"net_arch": list(settings.hidden)},
        seed=seed,
        device="cpu",
    )
    model.view = view
    model.joints = [joint.name for joint in world.simulator.robot.joints]
    model.joint_low, model.joint_high = world.low.cpu().numpy(), world.high.cpu().numpy()
    return model


def read_agent(path: str | os.PathLike[str]) -> SwimSAC:
    """Read an SAC agent without replay memory, of this library or of Stable-Baselines3."""
    saved = read_policy_zip(path, "SAC")
    inputs, *actor, J = saved.widths("actor.latent_pi", "actor.mu")
    _, *critic, _ = saved.widths("critic.qf0")
    critics = sum(bool(re.fullmatch(r"critic\.qf\d+\.0\.weight", name)) for name in saved.weights)
    low, high = (_array(saved.settings, f"action_{end}", J) for end in ("low", "high"))
    if not (low < high).all():
        raise saved.settings.error("action_low", "less than action_high")
    observations = spaces.Box(-np.inf, np.inf, (inputs,), dtype=np.float32)
    agent = SwimSAC(
        NormedPolicy if "critic.qf0.3.weight" in saved.weights else "MlpPolicy",
        Spaces(observations, spaces.Box(low, high, dtype=np.float32)),
        buffer_size=1,
        policy_kwargs={"net_arch": {"pi": actor, "qf": critic}, "n_critics": critics},
        device="cpu",
    )
    load_weights(path, agent.policy, saved.weights)
    learned = saved.variables.get("log_ent_coef")
    if learned is not None and learned.shape == (1,):
        coefficient: Any = agent.log_ent_coef
        coefficient.data.copy_(learned)
    else:
        agent.log_ent_coef = None
    _set_attributes(agent, saved.settings, J, first=(actor or [J])[0])
    return agent


def _array(settings: Fields, name: str, size: int) -> Array32:
    return np.array(settings.numbers(name, f"{size} finite numbers", size), dtype=np.float32)


def _set_attributes(agent: SwimSAC, settings: Fields, J: int, first: int) -> None:
    """Check and set the attributes of an agent with J joints and a first layer of some width."""
    content = settings.content
    agent.num_timesteps = content.get("num_timesteps", 0)
    if type(agent.num_timesteps) is not int:
        raise settings.error("num_timesteps", "a whole number")
    if "view" in settings:
        try:
            agent.view = View.from_content(content["view"])
        except ValueError:
            raise settings.error("view", "period, ramp, memory, scaled, sides") from None
    if "joints" in settings:
        agent.joints = joints = content["joints"]
        named = isinstance(joints, list) and all(isinstance(name, str) for name in joints)
        if not named or len(joints) != J:
            raise settings.error("joints", f"{J} names")
        agent.joint_low, agent.joint_high = (
            _array(settings, f"joint_{end}", J) for end in ("low", "high")
        )
    if "trained_over" in settings:
        agent.trained_over = content["trained_over"]
        if not is_spread(agent.trained_over):
            raise settings.error("trained_over", "two numbers by parameter")
    if "by_price" in settings:
        price, column = settings.table("by_price"), None
        prices, share = price.number("prices", low=1), price.number("share", low=-1.001)
        if share > 1.001:
            raise price.error("share", "a number from -1 to 1")
        if price.content.get("column") is not None:
            column = _array(price, "column", first)
        elif prices > 1:
            raise price.error("column", "numbers, for its prices")
        agent.by_price = {"prices": prices, "column": column, "share": share}


def start_from(model: SwimSAC, path: Path) -> None:
    """Copy networks and entropy coefficient of a saved model; InputError if they do not fit."""
    saved = read_agent(path)
    if (view := getattr(saved, "view", PAPER)) != model.view:
        raise InputError(path, "view", f"{view}", f"{model.view}, as this training has")
    load_weights(path, model.policy, saved.policy.state_dict(), "those of this training's recipe")
    if saved.log_ent_coef is None:
        raise InputError(path, "entropy coefficient", "a fixed one", "one that is learned")
    entropy: Any = model.log_ent_coef
    entropy.data.copy_(saved.log_ent_coef.data)
