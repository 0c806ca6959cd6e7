"""One recording of the bench as it truly is: servos, supply, link and what is hidden in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from bench import JOINTS, Servo, as_records
from numpy.typing import NDArray
from plant import Record
from rollout import Motion, Supply, simulate
from sensor import seen_angle

Array = NDArray[np.float64]
Window = tuple[float, float]
MOST_WINDOWS = 3


@dataclass(frozen=True)
class Hidden:
    """A hidden effect: what the answers say of it, and how it changes a world.

    ``joint`` is the index of its joint, None where it acts on all three.
    """

    effect: str
    component: str
    parameters: dict[str, float]
    strength: float
    driver: str
    joint: int | None
    hide: Callable[[World, int, dict[str, float]], None] = field(compare=False)


@dataclass
class Link:
    """From the computer to the servos: one broadcast packet holds all three set-points."""

    jitter_s: float = 0.0
    loss: float = 0.0
    drift: float = 0.0  # seconds later per second

    def arrivals(self, t: Array, chance: Array, latency_s: float) -> tuple[Array, Array]:
        """When set-points sent at ``t`` (T,) take effect, and the index of the one then in force.

        ``chance`` (2, T), uniform in 0 to 1, decides on delays and losses. No packet overtakes.
        """
        late = self.drift * t + self.jitter_s * (2 * chance[0] - 1)
        arrival = np.maximum.accumulate(t + latency_s + late)
        index = np.arange(t.size)
        index[(chance[1] < self.loss) & (index > 0)] = 0
        return arrival, np.maximum.accumulate(index)


@dataclass
class World:
    """Everything that decides a recording but its commands and its noise.

    Attributes:
        joints: Plant parameters, shape (3,).
        supply: Losses of the common supply.
        link: Delays of the set-points.
        errors: Per joint what ``sensor.seen_angle`` adds.
        steps_rad: Per joint the step to which angles are rounded.
        windows: Per joint when intermittent physics acts.
        stuck: Joints whose sensor sticks in those windows.
    """

    joints: Record
    supply: Supply = Supply()
    link: Link = field(default_factory=Link)
    errors: list[dict[str, float]] = field(default_factory=lambda: [{} for _ in JOINTS])
    steps_rad: list[float] = field(default_factory=list)
    windows: list[list[Window]] = field(default_factory=lambda: [[] for _ in JOINTS])
    stuck: set[int] = field(default_factory=set)

    def coupled(self) -> bool:
        """Whether the joints act on each other."""
        return self.supply.sag != 0 or bool(np.any(self.joints["reaction_kgm2"] != 0))

    def motion(self, t: Array, command: Array, chance: Array, which: Sequence[int]) -> Motion:
        """The joints ``which``, moving from rest under ``command`` (T, 3); the rest is left out."""
        if self.coupled() and len(which) < len(JOINTS):
            whole = self.motion(t, command, chance, range(len(JOINTS)))
            return Motion(whole.seen[list(which)], whole.figures[list(which)])
        arrivals, setpoints = np.empty((len(which), t.size)), np.empty((len(which), t.size))
        windows = np.full((len(which), MOST_WINDOWS, 2), np.inf)
        for row, j in enumerate(which):
            latency = float(self.joints["latency_s"][j])
            arrivals[row], index = self.link.arrivals(t, chance, latency)
            setpoints[row] = command[index, j]
            for k, window in enumerate(self.windows[j]):
                windows[row, k] = window
        joints = self.joints[list(which)]
        return simulate(joints, self.supply, windows, t, arrivals, setpoints)

    def seen(self, t: Array, command: Array, chance: Array, which: Sequence[int]) -> Array:
        """Noise-free readings in rad of the joints ``which``, shape (len(which), T)."""
        angles = self.motion(t, command, chance, which).seen
        return np.array(
            [
                seen_angle(self.joints[j], self.errors[j], a)
                for j, a in zip(which, angles, strict=True)
            ]
        )


def build_world(
    servos: list[Servo],
    recording: str,
    hidden: Sequence[Hidden],
    windows: Sequence[Window] = (),
) -> World:
    """The world of ``recording`` with all of ``hidden`` in it.

    ``windows`` say when the intermittent ones among ``hidden`` act in this recording.
    """
    world = World(as_records(servos, recording))
    world.steps_rad = [servo.sensor.step_rad for servo in servos]
    for one in hidden:
        if one.joint is not None:
            world.windows[one.joint] = list(windows)
        one.hide(world, one.joint or 0, one.parameters)
    return world
