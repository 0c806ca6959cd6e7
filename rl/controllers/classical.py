"""A central pattern generator, and controllers of its bend by proportional navigation."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rl.observer import CONTROL_S
from sim2real.arrays import Array, Array32, Mask
from sim2real.structured import Fields, read_toml

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    Gains = TypeVar("Gains", bound=DataclassInstance)

SETTLE_PER_S = 12.0
"""Rate at which amplitudes and offsets approach their goals: 90 % in 0.32 s."""
COUPLING_PER_S = 5.0
"""Weight of the coupling between neighbours."""


@dataclass(frozen=True)
class Gait:
    """A travelling wave along the body; each value a number or an array (E,)."""

    frequency_hz: ArrayLike  # beats per second
    amplitude_rad: ArrayLike  # amplitude of the last joint
    front: ArrayLike = 0.5  # amplitude of the first joint relative to the last; linear in between
    lag_rad: ArrayLike = 1.2  # phase lag of a joint relative to the previous one
    # mean angle of every joint; for negative values the robot turns left
    offset_rad: ArrayLike = 0.0


class Gliding:
    """Values that approach their goals without overshoot: critically damped, second order."""

    def __init__(self, value: Array) -> None:
        self.value, self.rate = value, np.zeros_like(value)

    def step(self, goal: Array) -> Array:
        """Advance by a control period, exact for a constant goal; returns the value."""
        error = self.value - goal
        push = self.rate + SETTLE_PER_S * error
        fade = np.exp(-SETTLE_PER_S * CONTROL_S)
        self.value = goal + (error + push * CONTROL_S) * fade
        self.rate = (self.rate - SETTLE_PER_S * push * CONTROL_S) * fade
        return self.value


class CentralPatternGenerator:
    """Oscillators of E robots with J joints each, which start straight and at rest.

    The model of Ijspeert and Crespi (ICRA 2007, "Online trajectory generation in an amphibious
    snake robot using a lamprey-like central pattern generator model"): phases coupled to their
    neighbours, amplitudes and offsets of second order, both critically damped::

        phase_i'  = 2 pi f + w sum_j sin(phase_j - phase_i - lag_ij)
        angle_i   = offset_i + amplitude_i sin(phase_i)

    Their output is ``r (1 + cos phase)``; here it is symmetric about the offset.
    """

    def __init__(self, limits_rad: ArrayLike, n_envs: int) -> None:
        self.limits_rad = np.asarray(limits_rad, dtype=np.float64)  # shape (J, 2)
        self.phase = np.zeros((n_envs, len(self.limits_rad)))  # rad
        self._wave = Gliding(np.zeros((2, *self.phase.shape)))  # amplitudes, offsets
        self._fresh = np.ones(n_envs, dtype=bool)

    def reset(
        self,
        observation: NDArray[np.floating],
        phase: ArrayLike = 0.0,
        mask: Mask | Literal[True] = True,
    ) -> None:
        """Reset robots in ``mask`` (E,) to the angles of an observation, with ``phase`` in rad."""
        mask = np.broadcast_to(mask, self._fresh.shape)
        self._fresh |= mask
        self.phase[:, 0] = np.where(mask, phase, self.phase[:, 0])
        angle = np.asarray(observation[:, 3 : 3 + len(self.limits_rad)], dtype=np.float64)
        start = np.stack([np.zeros_like(angle), angle])
        self._wave.value = np.where(mask[:, None], start, self._wave.value)
        self._wave.rate = np.where(mask[:, None], 0.0, self._wave.rate)

    def step(self, gait: Gait) -> Array:
        """Advance by a period towards ``gait``; joint angles in rad (E, J), within limits."""
        n_envs, J = self.phase.shape
        values = (gait.frequency_hz, gait.amplitude_rad, gait.front, gait.lag_rad, gait.offset_rad)
        frequency, amplitude, front, lag, offset = (
            np.broadcast_to(np.asarray(x, dtype=np.float64), (n_envs,))[:, None] for x in values
        )
        locked = self.phase[:, :1] - lag * np.arange(J)
        self.phase = np.where(self._fresh[:, None], locked, self.phase)
        self._fresh[:] = False
        lead = np.sin(self.phase[:, 1:] - self.phase[:, :-1] + lag)
        pull = np.zeros_like(self.phase)
        pull[:, :-1] += lead
        pull[:, 1:] -= lead
        turn = 2 * np.pi * frequency + COUPLING_PER_S * pull
        self.phase = np.mod(self.phase + CONTROL_S * turn, 2 * np.pi)
        position = np.linspace(0.0, 1.0, J) if J > 1 else np.ones(1)
        size = amplitude * (front + (1.0 - front) * position)
        height, middle = self._wave.step(np.stack([size, np.broadcast_to(offset, size.shape)]))
        return np.asarray(np.clip(middle + height * np.sin(self.phase), *self.limits_rad.T))


TUNED = Path(__file__).with_name("tuned.toml")
"""Gains, the defaults of the controllers, written by ``benchmarks/tune_controllers.py``."""
PACES = ("fast", "middle", "frugal")
"""Trade-offs of the tuning, from little time and much energy to the opposite."""
_COMMIT_RAD = 1.25 * np.pi
"""Bearing up to which a turn keeps its direction, even if the other is shorter: hysteresis."""
_NEAR_M = 0.05
"""Distance at which the target is reached; smallest distance in the line-of-sight rate."""


def tuned(name: str, kind: type[Gains], pace: str = "middle", path: Path = TUNED) -> Gains:
    """The gains under ``[name.pace]`` in ``path``, or an InputError about a value."""
    table = Fields(path, "", read_toml(path)).table(name).table(pace)
    return kind(**{field.name: table.number(field.name) for field in fields(kind)})


@dataclass(frozen=True)
class Stroke:
    """A ``Gait`` with a bend for turning; each value a number or an array (E,)."""

    frequency_hz: ArrayLike
    amplitude_rad: ArrayLike
    front: ArrayLike
    lag_rad: ArrayLike
    bend_rad: ArrayLike
    ease: ArrayLike

    def bent(self, turn: Array) -> Gait:
        """The wave about an offset of ``turn`` in rad, shape (E,), positive to the left."""
        largest = np.asarray(self.bend_rad, dtype=np.float64)
        offset = np.clip(turn, -largest, largest)
        share = 1.0 - np.asarray(self.ease) * np.abs(offset) / largest
        amplitude = np.asarray(self.amplitude_rad) * share
        return Gait(self.frequency_hz, amplitude, self.front, self.lag_rad, -offset)


def line_of_sight_rate(observation: NDArray[np.floating]) -> Array:
    """Rate of the line to a target at rest at r, ``-(r x v) / |r|^2``, in rad/s, shape (E,)."""
    columns = np.asarray(observation, dtype=np.float64)
    surge, sway, x, y = columns[:, 0], columns[:, 1], columns[:, -2], columns[:, -1]
    return np.asarray((y * surge - x * sway) / np.maximum(x * x + y * y, _NEAR_M**2))


class LineOfSight:
    """Bearing of the target in rad, within 225 degrees to either side, and its rate, (E,) each.

    ``smooth`` and ``rate``, in rad/s, are low-pass filtered with the time constant ``filter_s``.
    """

    def __init__(self, filter_s: ArrayLike, observation: NDArray[np.floating]) -> None:
        """Begin with the observation of a control period."""
        constant = np.maximum(np.asarray(filter_s, dtype=np.float64), 1e-9)
        self._share = -np.expm1(-CONTROL_S / constant)
        columns = np.asarray(observation, dtype=np.float64)
        self.bearing = self.smooth = np.arctan2(columns[:, -1], columns[:, -2])
        self.rate = line_of_sight_rate(observation)

    def update(self, observation: NDArray[np.floating]) -> None:
        """Update with the observation of a control period."""
        columns, rate = np.asarray(observation, np.float64), line_of_sight_rate(observation)
        measured, turn = np.arctan2(columns[:, -1], columns[:, -2]), 2 * np.pi
        continued = self.bearing + (np.mod(measured - self.bearing + np.pi, turn) - np.pi)
        self.bearing = np.where(np.abs(continued) > _COMMIT_RAD, measured, continued)
        # whole turns, where the direction changes
        smooth = self.smooth + turn * np.round((self.bearing - continued) / turn)
        self.smooth = smooth + self._share * (self.bearing - smooth)
        self.rate = self.rate + self._share * (rate - self.rate)


class _Steered:
    """A pattern generator whose bend follows the line of sight; the first beat is towards it."""

    def __init__(self, limits_rad: ArrayLike, gains: Any) -> None:  # noqa: ANN401
        """Steer joints with these limits, shape (J, 2)."""
        self._limits, self.gains = limits_rad, gains
        self.reset()

    def reset(self) -> None:
        """All robots begin anew."""
        self._fresh = True

    def act(self, observation: Array32) -> Array32:
        """Desired joint angles; see ``Controller``."""
        if self._fresh:
            self._begin(observation)
        else:
            self._sight.update(observation)
        bend = self._bend(observation)
        self._fresh = False
        return self._generator.step(self.gains.bent(bend)).astype(np.float32)

    def _begin(self, observation: Array32) -> None:
        """Begin with the robots of the first observation."""
        self._sight = LineOfSight(getattr(self.gains, "filter_s", 0.0), observation)
        self._generator = CentralPatternGenerator(self._limits, len(observation))
        self._generator.reset(observation, np.where(self._sight.bearing > 0, np.pi, 0.0))

    def _bend(self, observation: Array32) -> Array:
        """The bend in rad, shape (E,), positive to the left."""
        raise NotImplementedError


@dataclass(frozen=True)
class PNLGains(Stroke):
    """Stroke, bend per rate of the line of sight in s and per bearing, and the filter's time, s."""

    navigation_s: ArrayLike
    pursuit: ArrayLike
    filter_s: ArrayLike


class ProportionalNavigation(_Steered):
    """The controller "PNL" of the paper: the bend follows the line of sight.

    Proportional navigation (Guelman, IEEE Trans. Aerosp. Electron. Syst. 7 (1971) 364), with the
    bend for the turn that it causes, and a gain on the bearing that starts the 180 degree turn::

        turn = navigation_s * line_of_sight_rate + pursuit * bearing
    """

    def _bend(self, observation: Array32) -> Array:
        turn = np.asarray(self.gains.navigation_s) * self._sight.rate
        return np.asarray(turn + np.asarray(self.gains.pursuit) * self._sight.smooth)


@dataclass(frozen=True)
class ADRCGains(Stroke):
    """Gains; each a number or an array (E,)."""

    navigation: ArrayLike  # rate of the desired heading relative to that of the line of sight
    memory_s: ArrayLike  # time constant with which the resulting lead decays, in s
    agility_rad_s2: ArrayLike  # largest angular acceleration of the transient profile
    bandwidth_rad_s: ArrayLike  # bandwidth of the closed loop of the heading
    observer_rad_s: ArrayLike  # bandwidth of the extended state observer
    effect_per_s2: ArrayLike  # angular acceleration per rad of bend


class TransientProfile:
    """Han's tracking differentiator, which approaches a goal with bounded acceleration.

    IEEE Trans. Ind. Electron. 56 (2009) 900, with its "fhan"; ``limit`` is a number or an array
    (E,). ``value`` and ``rate`` are the profile and its slope, shape (E,).
    """

    def __init__(self, n_envs: int, limit: ArrayLike) -> None:
        self.value, self.rate = np.zeros(n_envs), np.zeros(n_envs)
        self._limit = np.asarray(limit, dtype=np.float64)

    def update(self, goal: Array) -> None:
        """Advance by a period towards ``goal``, shape (E,)."""
        h, r = CONTROL_S, self._limit
        d, a0 = r * h * h, h * self.rate
        y = self.value - goal + a0
        a1 = np.sqrt(d * (d + 8 * np.abs(y)))
        a = np.where(np.abs(y) < d, a0 + y, a0 + np.sign(y) * (a1 - d) / 2)
        push = np.where(np.abs(a) < d, -r * a / d, -r * np.sign(a))
        self.value = self.value + h * self.rate
        self.rate = self.rate + h * push


class ExtendedStateObserver:
    """Linear observer of ``y'' = disturbance + effect u``, with the disturbance as third state.

    Gains 3 w, 3 w^2, w^3 put all three poles at -w (Gao, "Scaling and bandwidth-parameterization
    based controller tuning", ACC 2003); w times the control period must be below 1. ``state`` has
    y, y' and the disturbance a period after the last measurement, (E, 3).
    """

    def __init__(self, n_envs: int, bandwidth_rad_s: ArrayLike, effect: ArrayLike) -> None:
        w = np.broadcast_to(np.asarray(bandwidth_rad_s, dtype=np.float64), (n_envs,))
        self._gain = np.stack([3 * w, 3 * w**2, w**3], axis=1)
        self._effect = np.asarray(effect, dtype=np.float64)
        self.state = np.zeros((n_envs, 3))

    def update(self, y: Array, u: Array) -> None:
        """Update with a measurement and the input applied until then, each of shape (E,)."""
        z = self.state
        slope = np.stack([z[:, 1], z[:, 2] + self._effect * u, np.zeros_like(u)], axis=1)
        self.state = z + CONTROL_S * (slope + self._gain * (y - z[:, 0])[:, None])


class DisturbanceRejection(_Steered):
    """The controller "Li et al." of the paper: ADRC of the heading with proportional navigation.

    As Li et al. (Bioinspir. Biomim. 14, 2019): proportional navigation gives the desired heading, a
    tracking differentiator smooths it, an extended state observer estimates heading, yaw rate and
    disturbance, which the bend compensates, by the equations of Han and Gao. The lead of the
    desired heading decays, so that past turns are forgotten; N = 1 is pure pursuit::

        desired = line_of_sight + lead,   lead' = (N - 1) line_of_sight' - lead / memory_s
    """

    def _begin(self, observation: Array32) -> None:
        super()._begin(observation)
        n, g = len(observation), self.gains
        self._profile = TransientProfile(n, g.agility_rad_s2)
        self._observer = ExtendedStateObserver(n, g.observer_rad_s, g.effect_per_s2)
        self._heading, self._lead, self._turn = np.zeros((3, n))

    def _bend(self, observation: Array32) -> Array:
        """Linear ADRC: poles at the bandwidth, disturbance compensated."""
        gains, sight = self.gains, self._sight
        yaw_rate = np.asarray(observation[:, 2], dtype=np.float64)
        if not self._fresh:
            self._heading = self._heading + CONTROL_S * yaw_rate
        gained = (np.asarray(gains.navigation) - 1.0) * sight.rate
        self._lead = self._lead + CONTROL_S * (gained - self._lead / np.asarray(gains.memory_s))
        self._profile.update(self._heading + sight.bearing + self._lead)
        self._observer.update(self._heading, self._turn)
        w, largest, effect = (
            np.asarray(gain, dtype=np.float64)
            for gain in (gains.bandwidth_rad_s, gains.bend_rad, gains.effect_per_s2)
        )
        heading, rate, disturbance = self._observer.state.T
        push = w**2 * (self._profile.value - heading) + 2 * w * (self._profile.rate - rate)
        self._turn = np.clip((push - disturbance) / effect, -largest, largest)
        return self._turn
