"""Bounds, priors and natural units of a servo's parameters: the table of every fit of a servo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, field, replace

import numpy as np

from sim2real.arrays import Array
from sim2real.effects.effect import Effect, scaled
from sim2real.inference.normal import Z90
from sim2real.inference.parameters import Parameter
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import (
    BASE,
    COLUMNS,
    CURRENT_LIMIT,
    INERTIA_LEFT_OUT,
    LINE,
    LOOP,
    RATE_LIMIT,
    ROTOR,
    ROTOR_INERTIA,
    beyond_load,
)
from sim2real.servo.trace import ReportedDrive, Trace

MOTOR_TIME_S = 0.03
"""Time constant of small geared motors: rotor inertia times no-load speed over stall torque."""
MOTOR_TIME_SD = 0.8
"""Standard deviation of its logarithm."""
MOTOR_SHEET = ("max_torque_Nm", "no_load_speed_rad_s")
"""What a data sheet must state for the prior of a motor."""
LOG_UNIT = 0.3
"""Natural unit of a logarithm."""


def gains(inertia: float) -> tuple[Parameter, Parameter, Parameter]:
    """Gains and latency of a servo with this inertia in kg m2 (``scale_inertia``)."""
    return (
        Parameter(BASE[0], 1e-9 * inertia, 1.6e5 * inertia, LOG_UNIT, log=True),
        Parameter(BASE[1], 1e-3 * inertia, 1.6e3 * inertia, LOG_UNIT, log=True),
        Parameter(BASE[2], 0.0, 0.5, 0.05),
    )


def scale_inertia(traces: Sequence[Trace], row: Array) -> float:
    """Inertia in kg m2 that sets the scale of a servo's gains.

    That of the load, and on an arm that of the rotor in addition: the links beyond the last joints
    of an arm have much less inertia than the servos that move them.
    """
    inertia = traces[0].load.inertia_kgm2
    if traces[0].varying is not None:
        inertia += float(beyond_load(row))
    return inertia


def plain_parameters(traces: Sequence[Trace], row: Array) -> tuple[Parameter, ...]:
    """Parameters of a servo without effects: gains and latency, and on an arm the motor's.

    The weight of an arm is known, so that inertia, torque and gains are identifiable separately.
    """
    inertia = scale_inertia(traces, row)
    if traces[0].varying is None:
        return gains(inertia)
    if row[ROTOR_INERTIA] > 0:
        motor = [(name, float(row[COLUMNS.index(name)])) for name in (*LINE, ROTOR)]
        return (*gains(inertia), *(Parameter(n, x / 4, 4 * x, x, x) for n, x in motor))
    low = -0.9 * traces[0].load.inertia_kgm2
    rotor = Parameter(COLUMNS[INERTIA_LEFT_OUT], low, 20.0 * inertia, inertia)
    return (*gains(inertia), rotor)


def of_effects(
    effects: Sequence[Effect], row: Array, inertia: float, known: Sequence[str] = ()
) -> tuple[Parameter, ...]:
    """Every parameter of some effects, scaled to a servo like ``row`` (P,), but those ``known``."""
    pairs = [
        (effect.name, scaled(p, float(row[0]), inertia))
        for effect in effects
        for p in effect.parameters
        if p.name not in known
    ]
    return tuple(
        Parameter(f"{effect}.{p.name}", p.low, p.high, p.typical or p.high / 10, p.typical)
        for effect, p in pairs
    )


@dataclass(frozen=True)
class Ties:
    """Relations between the gains and the torque limit of a motor that its prior states."""

    # controller that the reported drive shows; None if the servo does not report it
    drive: ReportedDrive | None = None
    # median of the share of the damping that a limit of the current leaves, and the standard
    # deviation of its logarithm; None for a torque-speed line
    damping_share: tuple[float, float] | None = None

    def terms(self, rows: Array, *, reported_sd: float = 0.01, back_emf_sd: float = 0.3) -> Array:
        """Residuals whose squares are twice the negative logarithm of the prior, (B, P) to (B, 2).

        The rows are parameters of servos with a motor's line. Logarithms of gain and damping that
        the reported drive shows have the standard deviation ``reported_sd``. Without it damping is
        about that by the back-EMF, on the scale ``back_emf_sd`` with the tails of a Cauchy
        distribution, as the controller may add damping.
        """
        columns = [COLUMNS.index(name) for name in (*BASE[:2], *LINE)]
        kp, kd, stall, no_load_speed = np.log(np.maximum(rows[:, columns], 1e-300)).T
        none, damping = np.zeros_like(kp), kd - stall + no_load_speed
        if self.damping_share is not None:
            middle, sd = self.damping_share
            return np.stack([(damping + np.log(middle)) / sd, none], axis=1)
        if self.drive is None:
            ratio = damping / back_emf_sd
            return np.stack([np.sign(ratio) * np.sqrt(np.log1p(ratio**2)), none], axis=1)
        back_emf = np.exp(stall - no_load_speed)
        damping = kd - np.log(back_emf + self.drive.lead_s * np.exp(kp))
        gain = kp - stall - np.log(self.drive.per_rad)
        return np.stack([damping, gain], axis=1) / reported_sd


@dataclass(frozen=True)
class MotorPrior:
    """Prior of all parameters of a motor."""

    # prior of each column of the law (``servo.parameters``), gains and latency first
    parameters: tuple[Parameter, ...]
    ties: Ties = field(default_factory=Ties)  # relations between them

    def __getitem__(self, name: str) -> Parameter:
        """The parameter with this name."""
        return next(p for p in self.parameters if p.name == name)

    def of(self, names: Sequence[str]) -> tuple[Parameter, ...]:
        """The parameters with these names, in the order of the prior."""
        return tuple(p for p in self.parameters if p.name in names)

    def flat(self, kd: float, *, damping_share: tuple[float, float] = (0.6, 0.6)) -> MotorPrior:
        """The prior of the same motor, if its current is limited at any speed and not its voltage.

        Damping acts beyond the limit, at least a share of it, with this median and standard
        deviation of its logarithm: the stall torque over the no-load speed. The no-load speed of
        the data sheet is then no limit; its bounds lie about the damping ``kd`` of the linear servo
        in N m s/rad.
        """
        middle = float(np.exp(self[LINE[0]].nominal)) / kd / damping_share[0]
        unit, nominal = 2 * damping_share[1], np.log(middle)
        speed = Parameter(LINE[1], middle / 10, middle * 100, unit, nominal, log=True)
        changed = tuple(speed if p.name == LINE[1] else p for p in self.parameters)
        return MotorPrior(changed, Ties(damping_share=damping_share))


def motor_prior(servo: Servo, traces: Sequence[Trace]) -> MotorPrior:
    """The prior of a servo's law from its data sheet and, if its recordings report it, its drive.

    A servo that reports its drive shows its controller: kp is that gain times the stall torque, the
    damping that of the back-EMF and of the controller's derivative term, and the latency is known
    to a sampling period. Torque and speed of the data sheet are those of the motor's line without
    friction, within the prior's width; where the inertia is unknown, to which the torque is
    relative, the torque is wide. The rotor inertia follows from a motor's time constant; the
    ratios of friction are those of spur gears with ratios of hundreds (Duclusaud and others, ICRA
    2025: 0.05 to 0.4).
    """
    stall, speed, stall_sd = servo.max_torque_Nm, servo.no_load_speed_rad_s, 0.35
    if traces[0].load is PER_INERTIA:
        stall, stall_sd = speed / MOTOR_TIME_S, 1.5
    inertia = traces[0].load.inertia_kgm2
    rotor_inertia = MOTOR_TIME_S * (stall / speed)
    largest = inertia if traces[0].varying is None else inertia + rotor_inertia
    drives = [astuple(trace.drive) for trace in traces if trace.drive is not None]
    drive = ReportedDrive(*np.median(drives, axis=0).tolist()) if drives else None
    latency = (0.0, np.inf) if drive is None else (drive.latency_s, drive.period_s)
    kp, kd, delay = gains(largest)

    def log(name: str, middle: float, sd: float, room: float = 4.0) -> Parameter:
        low, high = float(middle * np.exp(-room)), float(middle * np.exp(room))
        return Parameter(name, low, high, LOG_UNIT, float(np.log(middle)), sd, log=True)

    def share(name: str, sd: float, high: float, unit: float) -> Parameter:
        return Parameter(name, 0.0, high, unit, 0.0, sd)

    return MotorPrior(
        (
            replace(kp, low=1e-9 * inertia),
            replace(kd, low=1e-3 * inertia),
            replace(delay, nominal=latency[0], prior_sd=latency[1]),
            log(LINE[0], stall, stall_sd),
            log(LINE[1], speed, 0.25),
            share("motor.resistance_rise", 1.5, 8.0, 1.0),
            log(ROTOR, rotor_inertia, MOTOR_TIME_SD, 8.0),
            share("motor.coulomb_Nm", 0.03 * stall, 0.5 * stall, 0.03 * stall),
            share("motor.motor_friction", 0.4, 0.95, 0.2),
            share("motor.load_friction", 0.4, 2.0, 0.2),
            share("motor.stribeck_motor_friction", 0.3, 0.9, 0.2),
            share("motor.stribeck_load_friction", 0.3, 2.0, 0.2),
            log("motor.stribeck_speed_rad_s", 0.05 * speed, 0.8),
            share("motor.stick_time_s", 0.01, 0.1, 0.01),
            share("motor.creep_time_s", 0.002, 0.05, 0.002),
            log(CURRENT_LIMIT, 0.6 * stall, 0.4),
            log(RATE_LIMIT, speed, 0.5),  # set about the largest speed of the motor
            # the error of a period accumulates over thousands of samples
            *(Parameter(name, 0.0, 0.05, 2e-7) for name in LOOP),
        ),
        Ties(drive),
    )


def nominal_rotor(servo: Servo) -> float:
    """Inertia of rotor and gears in kg m2 at the output that is likely for a data sheet."""
    return MOTOR_TIME_S * servo.max_torque_Nm / servo.no_load_speed_rad_s


def largest_rotor(servo: Servo) -> float:
    """Upper end of the 90 % interval of the prior of that inertia, kg m2."""
    return nominal_rotor(servo) * float(np.exp(Z90 * MOTOR_TIME_SD))
