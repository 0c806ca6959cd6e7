"""Hyper-parameters of soft actor-critic."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Hyper-parameters; the defaults are those of this library, ``PLAIN`` those of the paper.

    Attributes:
        gamma: Discount factor per decision.
        memory: Size of the replay memory of each agent, in transitions.
        batch: Transitions of an update.
        rate: Initial learning rate.
        rate_end: Final learning rate as a share of ``rate``; it decays linearly.
        tau: Interpolation factor of the target networks per update.
        hidden: Widths of the hidden layers.
        warm_up: Steps of random actions before learning begins.
        updates_per_step: Updates for each step of an environment.
        entropy_start: Initial entropy coefficient, of the order of the reward of a decision; it is
            learned from there.
        entropy_target: Target entropy per joint, at the start and at the end of training. A low
            final value makes the mean action, which is used after training, representative.
        noise_s: Correlation time of the exploration noise; 0 for white noise. White noise at 20 ms
            only makes a joint shake; correlated noise of the same size explores (Eberhard et al.,
            "Pink noise is all you need", ICLR 2023).
        mirror: Whether transitions are replaced by their mirror images with probability 1/2, as
            the robot is symmetric.
        norm: Layer normalization in the critics (Lyle et al., "Understanding plasticity in neural
            networks", ICML 2023, among others): fewer seeds fail.
        prices: Agents observe a price of energy and learn for all between 1 / ``prices`` and
            ``prices`` times their default (Abels et al., "Dynamic weights in multi-objective deep
            reinforcement learning", ICML 2019); 1 for the default only.
        average: The saved actor is an average, with most weight on this last share of the updates
            (polynomial-decay averaging; Shamir and Zhang, "Stochastic gradient descent for
            non-smooth optimization", ICML 2013); 0 for the last actor.
    """

    gamma: float = 0.99
    memory: int = 1_000_000
    batch: int = 256
    rate: float = 1e-3
    rate_end: float = 0.1
    tau: float = 0.005
    hidden: tuple[int, ...] = (128, 128)
    warm_up: int = 10_000
    updates_per_step: float = 0.1
    entropy_start: float = 0.1
    entropy_target: tuple[float, float] = (-1.0, -2.5)
    noise_s: float = 0.25
    mirror: bool = True
    norm: bool = True
    prices: float = 2.0
    average: float = 0.2


PLAIN = Settings(
    rate=3e-4, rate_end=1.0, hidden=(256, 256), warm_up=5_000, updates_per_step=1.0,
    entropy_target=(-1.0, -1.0), norm=False, prices=1.0, average=0.0,
)  # fmt: skip
"""SAC with the paper's hyper-parameters (Lin, Liu, Wang, Table I)."""
