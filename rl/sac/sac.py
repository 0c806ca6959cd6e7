"""Stable-Baselines3's SAC, learning by ``rl.sac.agents``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
from gymnasium import spaces
from stable_baselines3 import SAC
from stable_baselines3.sac.policies import SACPolicy
from torch import nn

from rl.env import action_space, observation_space
from rl.observer import View
from rl.sac.agents import Settings
from rl.world import World
from sim2real.errors import InputError


class NormedPolicy(SACPolicy):
    """Stable-Baselines3's, with layer normalization in the critics, as in ``batched.Layers``."""

    def make_critic(self, *args: Any, **kwargs: Any) -> Any:  # noqa: ANN401 - its own
        """A critic whose hidden layers are normalised before the ReLU."""
        critic: Any = super().make_critic(*args, **kwargs)
        for i, plain in enumerate(critic.q_networks):
            modules: list[nn.Module] = []
            for module in plain:
                if isinstance(module, nn.ReLU):
                    last: Any = modules[-1]
                    modules.append(nn.LayerNorm(last.out_features, elementwise_affine=False))
                modules.append(module)
            network = nn.Sequential(*modules).to(self.device)
            critic.q_networks[i] = network
            setattr(critic, f"qf{i}", network)
        return critic


class SwimSAC(SAC):
    """SAC whose networks are views of those of ``Agents``, which does the learning.

    ``predict`` and ``save`` are Stable-Baselines3's; what is saved is a model that ``SAC.load``
    takes. It carries ``joints``, ``joint_low`` and ``joint_high``: what actions of -1 and 1 mean,
    in rad; and ``view``: how it looks at the task.
    """

    def get_parameters(self) -> dict[str, Any]:
        """As ever, but each parameter by itself: here they are views of shared tensors."""
        parameters: dict[str, Any] = super().get_parameters()
        own = parameters["policy"]
        parameters["policy"] = {name: value.detach().cpu().clone() for name, value in own.items()}
        return parameters


class _Spaces(gymnasium.Env[Any, Any]):
    """Says what a model's observations and actions are; cannot be run."""

    def __init__(self, observation: spaces.Box, action: spaces.Box) -> None:
        self.observation_space: Any = observation
        self.action_space: Any = action


def make_sac(
    world: World,
    settings: Settings,
    seed: int,
    *,
    view: View = View(),  # noqa: B008 - frozen
) -> SwimSAC:
    """An untrained model for a world's robots.

    Args:
        world: The robots.
        settings: Hyper-parameters.
        seed: Of the first parameters.
        view: How it looks at the task.
    """
    model = SwimSAC(
        NormedPolicy if settings.norm else "MlpPolicy",
        _Spaces(observation_space(world, view), action_space(world)),
        learning_rate=settings.rate,
        buffer_size=1,  # the memory is that of ``Agents``
        learning_starts=settings.warm_up,
        batch_size=settings.batch,
        tau=settings.tau,
        gamma=settings.gamma,
        ent_coef=f"auto_{settings.entropy_start}",
        target_entropy=settings.entropy_target[0] * len(world.low),
        train_freq=1,
        gradient_steps=-1,
        policy_kwargs={"net_arch": list(settings.hidden)},
        seed=seed,
        device="cpu",
    )
    told: Any = model
    told.view = view
    told.joints = [joint.name for joint in world.simulator.robot.joints]
    told.joint_low = world.low.cpu().numpy()
    told.joint_high = world.high.cpu().numpy()
    return model


def go_on_from(model: SAC, path: Path) -> None:
    """Give a model the networks and the entropy coefficient of a saved one.

    Raises:
        InputError: If there is none, or it is of another shape or view.
    """
    from rl.deploy.export import read_agent, view_of

    saved: Any = read_agent(path)
    own: Any = model
    if view_of(saved) != own.view:
        raise InputError(path, "view", f"{view_of(saved)}", f"{own.view}, as this training has")
    try:
        own.policy.load_state_dict(saved.policy.state_dict())
    except RuntimeError as error:
        found = str(error).splitlines()[-1].strip()
        raise InputError(path, "networks", found, "those of this training's recipe") from None
    own.log_ent_coef.data.copy_(saved.log_ent_coef.data)
