"""Priors with units, and the unbounded coordinates in which a posterior is sampled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.effects import named
from sim2real.model import JointModel
from sim2real.servo.start import DAMPING_RATIO, FREQUENCY_RAD_S, LATENCY_S

Array = NDArray[np.float64]

RANDOM_EFFECTS = ("latency_jitter", "packet_loss")
"""Effects whose draws cannot be known from their parameters; they are held, not sampled."""

_UNITS = (
    ("_rad_per_Nm", "rad/(N m)"),
    ("_Nm_per_rad_s", "N m/(rad s)"),
    ("_Nms_per_rad", "N m s/rad"),
    ("_Nm_per_rad", "N m/rad"),
    ("_Nms2", "N m s²"),
    ("_Nm", "N m"),
    ("_kgm2", "kg m²"),
    ("_rad_s2", "rad/s²"),
    ("_rad_s", "rad/s"),
    ("_rad", "rad"),
    ("s_per_s", "s/s"),
    ("_per_min", "1/min"),
    ("_s", "s"),
    ("_m", "m"),
)


@dataclass(frozen=True)
class Prior:
    """What is known of one parameter before the recordings: it is between two limits.

    Attributes:
        name: The parameter, as its column in ``servo.parameters.COLUMNS``.
        unit: Its unit, SI; empty for a pure number.
        low: Smallest value.
        high: Largest value.
        log: Whether its logarithm is uniform, rather than itself; ``low`` is above 0 then.
    """

    name: str
    unit: str
    low: float
    high: float
    log: bool = False

    def __str__(self) -> str:
        kind = "log-uniform" if self.log else "uniform"
        return f"{kind} {self.low:.4g} to {self.high:.4g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Priors:
    """Independent priors of F parameters.

    A value becomes a coordinate by the logit of its place between the limits, which is any real
    number: z = log(s / (1 - s)), where s is the share of the way (of the logarithm) from ``low``.
    """

    each: Sequence[Prior]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return tuple(prior.name for prior in self.each)

    @property
    def _ends(self) -> tuple[Array, Array, NDArray[np.bool_]]:
        log = np.array([prior.log for prior in self.each])
        ends = np.array([[p.low, p.high] for p in self.each])
        scaled = np.where(log[:, None], np.log(np.where(log[:, None], ends, 1.0)), ends)
        return scaled[:, 0], scaled[:, 1], log

    def values(self, z: Array) -> Array:
        """Values of the parameters at coordinates ``z`` (..., F)."""
        low, high, log = self._ends
        scaled = low + (high - low) * _share(z)
        return np.where(log, np.exp(np.where(log, scaled, 0.0)), scaled)

    def coordinates(self, values: Array) -> Array:
        """Coordinates of ``values`` (..., F); those at or beyond a limit are taken just inside."""
        low, high, log = self._ends
        scaled = np.where(log, np.log(np.maximum(np.where(log, values, 1.0), 1e-300)), values)
        share = np.clip((scaled - low) / (high - low), _INSIDE, 1 - _INSIDE)
        return np.asarray(np.log(share) - np.log1p(-share))

    def slope(self, z: Array) -> Array:
        """Derivative of each value by its coordinate at ``z`` (..., F)."""
        low, high, log = self._ends
        share = _share(z)
        steep = (high - low) * share * (1 - share)
        return np.where(log, steep * self.values(z), steep)

    def log_density(self, z: Array) -> Array:
        """Log-density of the coordinates ``z`` (..., F), shape (...): a logistic one each."""
        return np.asarray(-(np.logaddexp(0.0, z) + np.logaddexp(0.0, -z)).sum(axis=-1))

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Values drawn from the priors, shape (count, F)."""
        share = rng.random((count, len(self.each)))
        return self.values(np.log(share) - np.log1p(-share))


_INSIDE = 1e-4


def _share(z: Array) -> Array:
    return np.asarray(0.5 * (1 + np.tanh(0.5 * z)))


def servo_priors(joint: JointModel) -> Priors:
    """Wide priors of a servo's gains, latency and the effects that its model holds.

    Gains span natural frequencies of 2 to 300 rad/s and damping ratios of 0.05 to 4, each order of
    magnitude alike; latency is anything up to 0.3 s; an effect's parameters are anywhere within the
    limits that its file gives, for a servo of this strength.
    """
    inertia = joint.inertia_kgm2
    kp = [f**2 * inertia for f in FREQUENCY_RAD_S]
    kd = [2 * d * f * inertia for d, f in zip(DAMPING_RATIO, FREQUENCY_RAD_S, strict=True)]
    units = ("1/s²", "1/s") if joint.per_inertia else ("N m/rad", "N m s/rad")
    priors = [
        Prior("kp_Nm_per_rad", units[0], kp[0], kp[1], log=True),
        Prior("kd_Nms_per_rad", units[1], kd[0], kd[1], log=True),
        Prior("latency_s", "s", *LATENCY_S),
    ]
    for fitted in joint.effects:
        if fitted.effect in RANDOM_EFFECTS:
            continue
        for parameter in named(fitted.effect).parameters:
            scaled = parameter.scaled(joint.kp_Nm_per_rad, inertia)
            name = f"{fitted.effect}.{parameter.name}"
            priors.append(Prior(name, unit_of(parameter.name), scaled.low, scaled.high))
    return Priors(tuple(priors))


def unit_of(name: str) -> str:
    """Unit of a parameter, from the ending of its name; empty for a pure number."""
    return next((unit for ending, unit in _UNITS if name.endswith(ending)), "")
