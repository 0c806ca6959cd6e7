"""Stable-Baselines3's SAC, trained by ``rl.sac.agents``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
from gymnasium import spaces
from stable_baselines3 import SAC
from stable_baselines3.sac.policies import SACPolicy
from torch import nn

from rl.env import action_space, observation_space
from rl.observer import View
from rl.sac.settings import Settings
from rl.world import World
from sim2real.arrays import Array32
from sim2real.errors import InputError


class NormedPolicy(SACPolicy):
    """SAC policy with layer normalization in the critics, as in ``batched.Layers``."""

    def make_critic(self, *args: Any, **kwargs: Any) -> Any:  # noqa: ANN401 - its own
        """A critic whose hidden layers are normalised before the ReLU."""
        critic: Any = super().make_critic(*args, **kwargs)
        for i, original in enumerate(critic.q_networks):
            modules: list[nn.Module] = []
            for module in original:
                if isinstance(module, nn.ReLU):
                    previous: Any = modules[-1]
                    modules.append(nn.LayerNorm(previous.out_features, elementwise_affine=False))
                modules.append(module)
            network = nn.Sequential(*modules).to(self.device)
            critic.q_networks[i] = network
            setattr(critic, f"qf{i}", network)
        return critic


class SwimSAC(SAC):
    """SAC whose networks are views of those of ``Agents``, which trains them.

    ``predict`` and ``save`` are those of Stable-Baselines3; ``SAC.load`` reads the saved models,
    with the attributes below.

    Attributes:
        view: Definition of the observations.
        joints: Names of the joints.
        joint_low: Angles of actions -1 in rad, shape (J,).
        joint_high: Angles of actions 1 in rad, shape (J,).
        trained_over: 5 % and 95 % quantile of each parameter of the robots of the training.
        by_price: Effect of the price of energy on the actor, see ``rl.deploy.export.set_price``.
    """

    view: View
    joints: list[str]
    joint_low: Array32
    joint_high: Array32
    trained_over: Mapping[str, Sequence[float]]
    by_price: dict[str, Any]

    def get_parameters(self) -> dict[str, Any]:
        """Copies of the parameters, which are views of shared tensors."""
        parameters: dict[str, Any] = super().get_parameters()
        policy = parameters["policy"]
        parameters["policy"] = {
            name: value.detach().cpu().clone() for name, value in policy.items()
        }
        return parameters


class _Spaces(gymnasium.Env[Any, Any]):
    """Observation and action spaces of a model; cannot be stepped."""

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
    """An untrained model for the robots of a world.

    Args:
        world: The robots.
        settings: Hyper-parameters.
        seed: Seed of the initial parameters.
        view: Definition of the observations.
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
    model.view = view
    model.joints = [joint.name for joint in world.simulator.robot.joints]
    model.joint_low, model.joint_high = world.low.cpu().numpy(), world.high.cpu().numpy()
    return model


def start_from(model: SwimSAC, path: Path) -> None:
    """Copy the networks and the entropy coefficient of a saved model.

    Raises:
        InputError: If there is no saved model, or its shape or view differs.
    """
    from rl.deploy.export import read_agent, view_of

    saved: Any = read_agent(path)
    if view_of(saved) != model.view:
        raise InputError(path, "view", f"{view_of(saved)}", f"{model.view}, as this training has")
    try:
        model.policy.load_state_dict(saved.policy.state_dict())
    except RuntimeError as error:
        problem = str(error).splitlines()[-1].strip()
        raise InputError(path, "networks", problem, "those of this training's recipe") from None
    entropy: Any = model.log_ent_coef
    entropy.data.copy_(saved.log_ent_coef.data)
