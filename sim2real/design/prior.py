"""Prior of a servo before the next recording: draws of its parameters, and its noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array
from sim2real.design.limits import CommandLimits
from sim2real.identification.fit import plain_row
from sim2real.identification.motor_prior import motor_prior
from sim2real.inference.low_discrepancy import kronecker
from sim2real.inference.normal import Z90
from sim2real.inference.parameters import column
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

    A set-point that is late by a share of the period counts as lost with the square of that share:
    1 ms of 20 ms, by default.
    """

    white_rad: float  # standard deviation of independent errors, quantisation included
    angle_rad: float  # of errors that repeat with the angle: an eccentric sensor, cogging
    angle_scale_rad: float = 0.1  # angle over which these change
    lost: float = 0.0025  # probability that a set-point does not arrive in its period


@dataclass(frozen=True)
class ServoPrior:
    """Draws of a servo, its parameters that the next recording is to determine, and the noise."""

    names: tuple[str, ...]  # columns of the F parameters (``servo.parameters``)
    rows: Array  # parameters of D servos, shape (D, P)
    # standard deviations of the logarithm of each parameter in the prior of the fit, infinite where
    # there is none, shape (F,)
    sd: Array
    load: Load  # the load on the shaft
    noise: AngleError  # errors of the measured angle

    @property
    def columns(self) -> list[int]:
        """Indices of the F parameters in a row."""
        return [COLUMNS.index(name) for name in self.names]


def prior_of(
    robot: Robot,
    model: Model | None,
    limits: CommandLimits,
    *,
    load: Load | None = None,
    draws: int = 8,
    seed: int = 0,
) -> ServoPrior:
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
    # usual noise of a sensor and the quantisation that the data sheet states
    white = float(np.hypot(1e-3, limits.resolution_rad / np.sqrt(12)))
    if model is None or fitted is None:
        noise = AngleError(white, white)
        return _from_sheet(joint.servo, noise, load or PER_INERTIA, draws, rng)
    figures = model.fit.get(f"{limits.joint}.position_rad", {})
    white = float(figures.get("noise") or white)
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
) -> ServoPrior:
    """Draws from the intervals of a fitted joint and their correlations, as logarithms."""
    row = joint_row(joint, load)
    known = [n for n in joint.interval if n in COLUMNS and row[COLUMNS.index(n)] > 0]
    names = tuple(dict.fromkeys([*GAINS, *known]))
    columns = [COLUMNS.index(name) for name in names]
    ends = np.array([joint.interval.get(name, (0.0, np.inf)) for name in names])
    half = (ends[:, 1] - ends[:, 0]) / (2 * Z90 * np.maximum(row[columns], 1e-12))
    sd = np.where(np.isfinite(half), np.minimum(half, widest_sd), widest_sd)
    correlation = np.eye(len(names))
    for pair, value in joint.correlation.items():
        places = [names.index(name) for name in pair.split(", ") if name in names]
        if len(places) == 2:
            correlation[places, places[::-1]] = value
    level, directions = np.linalg.eigh(correlation)
    root = directions * np.sqrt(np.maximum(level, 0.0))
    offset = sd * (rng.standard_normal((draws, len(names))) @ root.T)
    offset[0] = 0.0
    rows = np.tile(row, (draws, 1))
    rows[:, columns] = row[columns] * np.exp(offset)
    stated = load or joint.load or (PER_INERTIA if joint.per_inertia else Load(joint.inertia_kgm2))
    return ServoPrior(names, rows, _prior_sd(names, servo, stated), stated, noise)


def _from_sheet(
    servo: Servo,
    noise: AngleError,
    load: Load,
    draws: int,
    rng: np.random.Generator,
    *,
    frequency_rad_s: tuple[float, float] = (12.0, 50.0),
    damping_ratio: tuple[float, float] = (0.4, 1.3),
    latency_s: tuple[float, float] = (0.01, 0.08),
) -> ServoPrior:
    """Servos that the data sheet allows, of usual frequencies, damping ratios and latencies."""
    points = kronecker(draws, 6, rng)
    low, high = np.log([frequency_rad_s, damping_ratio, latency_s]).T
    frequency, damping, latency = np.exp(low + points[:, :3] * (high - low)).T
    names: tuple[str, ...] = GAINS
    rows = np.tile(plain_row(0.0, 0.0, 0.0), (draws, 1))
    if servo.states("max_torque_Nm", "no_load_speed_rad_s"):
        still = _still(load)
        line = (*LINE, ROTOR) if shows_inertia([still]) else LINE
        prior = motor_prior(servo, [still])
        parameters = [prior.parameters[prior.index(name)] for name in line]
        # of the prior's rotors the lighter ones: stated loads mostly include the rotor
        middle = np.array([0.5, 0.5, 1.0])[: len(line)]
        share = np.sqrt(12) * (points[:, 3 : 3 + len(line)] - middle)
        motor = np.exp(column(parameters, "nominal") + share * column(parameters, "prior_sd"))
        rows[:, [COLUMNS.index(name) for name in line]] = motor
        names = (*GAINS, *line)
    inertia = load.inertia_kgm2 + rows[:, ROTOR_INERTIA]
    rows[:, 0] = frequency**2 * inertia
    rows[:, 1] = 2 * damping * frequency * inertia
    rows[:, 2] = latency
    rows[:, 3:5] = load.inertia_kgm2, load.gravity_Nm
    return ServoPrior(names, rows, _prior_sd(names, servo, load), load, noise)


def _prior_sd(names: tuple[str, ...], servo: Servo, load: Load) -> Array:
    """Standard deviations of the logarithms in the prior of the fit, shape (F,)."""
    sd = np.full(len(names), np.inf)
    if servo.states("max_torque_Nm", "no_load_speed_rad_s"):
        known = {p.name: p.prior_sd for p in motor_prior(servo, [_still(load)]).parameters if p.log}
        sd = np.array([known.get(name, np.inf) for name in names])
    return sd


def _still(load: Load) -> Trace:
    """A trace that states a load, for the prior of a motor."""
    none = np.zeros(2)
    return Trace("next", "next", np.array([0.0, 1.0]), none, none, load, np.ones(2, dtype=bool))
