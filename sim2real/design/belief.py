"""Prior of a servo before the next recording: draws of its parameters, and its noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array
from sim2real.design.limits import CommandLimits
from sim2real.identification.priors import motor_prior
from sim2real.identification.problem import plain_row
from sim2real.inference.normal import Z90
from sim2real.inference.parameters import column, kronecker
from sim2real.model import JointModel, Model
from sim2real.recording import PER_INERTIA, Load
from sim2real.robot import Robot, Servo
from sim2real.servo.parameters import BASE, COLUMNS, LINE, ROTOR, ROTOR_INERTIA, joint_row
from sim2real.servo.trace import Trace, shows_inertia

GAINS = BASE[:3]
"""Gains and latency, the parameters of every servo."""


@dataclass(frozen=True)
class AngleError:
    """Errors of the measured angle about the model.

    Attributes:
        white_rad: Standard deviation of independent errors, quantisation included.
        angle_rad: Standard deviation of errors that repeat with the angle: an eccentric sensor, or
            cogging of motor and gears.
        angle_scale_rad: Angle over which these change.
        lost: Probability that a set-point does not arrive in its period. One that is late by a
            share of the period counts as the square of that share: 1 ms of 20 ms, by default.
    """

    white_rad: float
    angle_rad: float
    angle_scale_rad: float = 0.1
    lost: float = 0.0025


@dataclass(frozen=True)
class Belief:
    """Draws of a servo's parameters, those that the next recording is to determine, and the noise.

    Attributes:
        names: Columns of the F parameters (``servo.parameters``).
        rows: Parameters of D servos, shape (D, P).
        prior_sd: Standard deviations of the logarithm of each parameter in the prior of the fit,
            infinite where there is none, shape (F,).
        load: The load on the shaft.
        noise: Errors of the measured angle.
    """

    names: tuple[str, ...]
    rows: Array
    prior_sd: Array
    load: Load
    noise: AngleError

    @property
    def columns(self) -> list[int]:
        """Indices of the F parameters in a row."""
        return [COLUMNS.index(name) for name in self.names]


def belief_of(
    robot: Robot,
    model: Model | None,
    limits: CommandLimits,
    *,
    load: Load | None = None,
    draws: int = 8,
    seed: int = 0,
) -> Belief:
    """The prior of one joint: its fitted model, or its data sheet where there is none.

    Args:
        robot: The robot.
        model: Its fitted servos.
        limits: Limits of the commands, which name the joint.
        load: The load on the shaft; by default that of the model, or an unknown one.
        draws: Number D of servos.
        seed: Seed of the draws.
    """
    joint = robot.joint(limits.joint)
    assert joint is not None
    rng = np.random.default_rng(seed)
    fitted = None if model is None else model.joints.get(limits.joint)
    if model is None or fitted is None:
        return _from_sheet(joint.servo, limits, load or PER_INERTIA, draws, rng)
    figures = model.fit.get(f"{limits.joint}.position_rad", {})
    white = float(figures.get("noise") or _white(limits))
    train = float(figures.get("train") or white)
    noise = AngleError(white, float(np.sqrt(max(train**2 - white**2, (0.3 * white) ** 2))))
    for effect in (*fitted.effects, *model.effects):
        if effect.effect == "packet_loss":
            noise = replace(noise, lost=max(noise.lost, effect.parameters["probability"]))
    return _from_model(fitted, joint.servo, load, noise, draws, rng)


def _from_model(
    joint: JointModel,
    servo: Servo,
    load: Load | None,
    noise: AngleError,
    draws: int,
    rng: np.random.Generator,
    *,
    widest_sd: float = 0.5,
) -> Belief:
    """Draws from the intervals of a fitted joint and their correlations, as logarithms."""
    row = joint_row(joint, load)
    known = [n for n in joint.interval if n in COLUMNS and row[COLUMNS.index(n)] > 0]
    names = tuple(dict.fromkeys([*GAINS, *known]))
    values = row[[COLUMNS.index(name) for name in names]]
    ends = np.array([joint.interval.get(name, (0.0, np.inf)) for name in names])
    half = (ends[:, 1] - ends[:, 0]) / (2 * Z90 * np.maximum(values, 1e-12))
    sd = np.where(np.isfinite(half), np.minimum(half, widest_sd), widest_sd)
    correlation = np.eye(len(names))
    for i, first in enumerate(names):
        for j, second in enumerate(names):
            correlation[i, j] = joint.correlation.get(
                f"{first}, {second}", joint.correlation.get(f"{second}, {first}", float(i == j))
            )
    level, directions = np.linalg.eigh(correlation)
    root = directions * np.sqrt(np.maximum(level, 0.0))
    offset = sd * (rng.standard_normal((draws, len(names))) @ root.T)
    offset[0] = 0.0
    rows = np.tile(row, (draws, 1))
    rows[:, [COLUMNS.index(name) for name in names]] = values * np.exp(offset)
    stated = load or joint.load or (PER_INERTIA if joint.per_inertia else Load(joint.inertia_kgm2))
    return Belief(names, rows, _prior_sd(names, servo, stated), stated, noise)


def _from_sheet(
    servo: Servo,
    limits: CommandLimits,
    load: Load,
    draws: int,
    rng: np.random.Generator,
    *,
    frequency_rad_s: tuple[float, float] = (12.0, 50.0),
    damping_ratio: tuple[float, float] = (0.4, 1.3),
    latency_s: tuple[float, float] = (0.01, 0.08),
) -> Belief:
    """Servos that the data sheet allows: usual natural frequencies, damping ratios and latencies.

    Torque and speed vary about the data sheet as in the prior of the fit.
    """
    points = kronecker(draws, 6, rng)
    low, high = np.log([frequency_rad_s, damping_ratio, latency_s]).T
    frequency, damping, latency = np.exp(low + points[:, :3] * (high - low)).T
    names: tuple[str, ...] = GAINS
    motor = np.zeros((draws, 0))
    if servo.states("max_torque_Nm", "no_load_speed_rad_s"):
        still = _still(load)
        line = (*LINE, ROTOR) if shows_inertia([still]) else LINE
        prior = motor_prior(servo, [still])
        parameters = [prior[name] for name in line]
        # of the prior's rotors the lighter ones: stated loads mostly include the rotor
        middle = np.array([0.5, 0.5, 1.0])[: len(line)]
        share = np.sqrt(12) * (points[:, 3 : 3 + len(line)] - middle)
        motor = np.exp(column(parameters, "nominal") + share * column(parameters, "prior_sd"))
        names = (*GAINS, *line)
    rows = np.tile(plain_row(0.0, 0.0, 0.0), (draws, 1))
    rows[:, [COLUMNS.index(name) for name in names[3:]]] = motor
    inertia = load.inertia_kgm2 + rows[:, ROTOR_INERTIA]
    rows[:, 0] = frequency**2 * inertia
    rows[:, 1] = 2 * damping * frequency * inertia
    rows[:, 2] = latency
    rows[:, 3:5] = load.inertia_kgm2, load.gravity_Nm
    white = _white(limits)
    return Belief(names, rows, _prior_sd(names, servo, load), load, AngleError(white, white))


def _prior_sd(names: tuple[str, ...], servo: Servo, load: Load) -> Array:
    """Standard deviations of the logarithms in the prior of the fit, shape (F,)."""
    sd = np.full(len(names), np.inf)
    if servo.states("max_torque_Nm", "no_load_speed_rad_s"):
        prior = motor_prior(servo, [_still(load)])
        stated = {p.name: p.prior_sd for p in prior.parameters if p.log}
        sd[:] = [stated.get(name, np.inf) for name in names]
    return sd


def _white(limits: CommandLimits, *, sensor_rad: float = 1e-3) -> float:
    """Usual noise of a sensor and the quantisation that the data sheet states, rad."""
    return float(np.hypot(sensor_rad, limits.resolution_rad / np.sqrt(12)))


def _still(load: Load) -> Trace:
    """A trace that states a load, for the prior of a motor."""
    none = np.zeros(2)
    return Trace("next", "next", np.array([0.0, 1.0]), none, none, load, np.ones(2, dtype=bool))
