"""Stable-Baselines3's SAC with the paper's hyper-parameters, learning by ``rl.sac.agents``."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import SAC
from stable_baselines3.common.vec_env import VecEnv

from rl.env import action_space, observation_space
from rl.sac.agents import Agents, Settings
from rl.world import World


class SwimSAC(SAC):
    """SAC whose transitions stay on its device and whose update there is one captured graph.

    ``learn``, ``predict`` and ``save`` are Stable-Baselines3's; what is saved is an ordinary model
    that ``SAC.load`` takes. It carries ``joints``, ``joint_low`` and ``joint_high``: what actions
    of -1 and 1 mean, in rad.

    Attributes:
        agents: What learns, where this model learns by itself.
    """

    agents: Agents | None = None

    def learns(self, settings: Settings) -> None:
        """Prepare for ``learn``: put the parameters and an empty memory on the model's device."""
        self.agents = Agents([self], settings, self.device)

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Update from the memory; the batch size is that of the settings."""
        if self.agents is None:
            super().train(gradient_steps, batch_size)
            return
        self.agents.learn(gradient_steps)
        self._n_updates += gradient_steps
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")

    def _store_transition(
        self,
        replay_buffer: Any,  # noqa: ANN401 - Stable-Baselines3's own
        buffer_action: NDArray[Any],
        new_obs: Any,  # noqa: ANN401
        reward: NDArray[Any],
        dones: NDArray[Any],
        infos: list[dict[str, Any]],
    ) -> None:
        if self.agents is None:
            super()._store_transition(replay_buffer, buffer_action, new_obs, reward, dones, infos)
            return
        following, ended = np.array(new_obs), np.array(dones)
        for e in np.flatnonzero(dones):
            following[e] = infos[e]["terminal_observation"]
            ended[e] = not infos[e]["TimeLimit.truncated"]
        parts = (self._last_obs, buffer_action, reward, following, ended)
        self.agents.remember(*(torch.as_tensor(x, device=self.device)[None] for x in parts))
        self._last_obs = new_obs

    def get_parameters(self) -> dict[str, Any]:
        """As ever, but each parameter by itself: here they are views of shared tensors."""
        parameters: dict[str, Any] = super().get_parameters()
        own = parameters["policy"]
        parameters["policy"] = {name: value.detach().cpu().clone() for name, value in own.items()}
        return parameters

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "agents"]


class _Spaces(gymnasium.Env[Any, Any]):
    """Says what a model's observations and actions are; cannot be run."""

    def __init__(self, observation: spaces.Box, action: spaces.Box) -> None:
        self.observation_space: Any = observation
        self.action_space: Any = action


def make_sac(
    world: World, settings: Settings, seed: int, env: VecEnv | None = None, device: str = "cpu"
) -> SwimSAC:
    """An untrained model for a world's robots.

    Args:
        world: The robots.
        settings: Hyper-parameters.
        seed: Of the first parameters.
        env: What ``learn`` is to run in; none where ``Agents`` does the learning.
        device: Where the model is to be.
    """
    model = SwimSAC(
        "MlpPolicy",
        env or _Spaces(observation_space(world), action_space(world)),
        learning_rate=settings.rate,
        buffer_size=1,  # the memory is that of ``Agents``
        learning_starts=settings.warm_up,
        batch_size=settings.batch,
        tau=settings.tau,
        gamma=settings.gamma,
        ent_coef=f"auto_{settings.entropy_start}",
        train_freq=1,
        gradient_steps=-1,
        policy_kwargs={"net_arch": list(settings.hidden)},
        seed=seed,
        device=device,
    )
    told: Any = model
    told.joints = [joint.name for joint in world.simulator.robot.joints]
    told.joint_low = world.low.cpu().numpy()
    told.joint_high = world.high.cpu().numpy()
    return model
