"""Prior of a motor's parameters, from its data sheet with a wide margin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array
from sim2real.inference.parameters import Parameter, column
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE, LINE, LOOP, ROTOR
from sim2real.servo.trace import Trace

_SHEET_SD = (0.35, 0.25)
"""Standard deviations of the logarithms of stall torque and no-load speed about the data sheet."""
_UNKNOWN_SD = 1.5
"""Standard deviation of the logarithm of stall torque per unknown inertia."""
_MOTOR_TIME_S, _MOTOR_TIME_SD = 0.03, 0.8
"""Time constant of small geared motors, rotor inertia times no-load speed over stall torque, and
the standard deviation of its logarithm."""
_BACK_EMF_SD = 0.3
"""Scale of the logarithm of damping about that by the back-EMF, with long tails, as the controller
may add damping."""
_TICK_S = 2e-7
"""Natural unit of a loop's period, which accumulates over thousands of samples."""
_LOG_UNIT = 0.3
"""Natural unit of a logarithm."""


@dataclass(frozen=True)
class Spreads:
    """Standard deviations of the prior that were chosen (see ``benchmarks/prior_choice.py``).

    Attributes:
        losses: Factor on the standard deviations of losses and friction below.
        reported: Standard deviation of the logarithm of the drive that the servo reports; infinite
            to ignore it.
    """

    losses: float = 1.0
    reported: float = 0.05


SPREADS = Spreads()


@dataclass(frozen=True)
class MotorPrior:
    """Prior of all parameters of a motor, with relations between them.

    Attributes:
        parameters: Prior of each column of the law (``servo.parameters``), gains and latency first.
        per_rad: Drive per radian of error that the servo reports, if it does.
    """

    parameters: tuple[Parameter, ...]
    per_rad: float | None

    @property
    def names(self) -> tuple[str, ...]:
        """Columns of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    def index(self, name: str) -> int:
        """Index of a parameter."""
        return self.names.index(name)

    def loosened(self, factor: float) -> MotorPrior:
        """The prior with the standard deviations of losses and friction multiplied by a factor."""
        wider = [p if p.log else replace(p, prior_sd=factor * p.prior_sd) for p in self.parameters]
        return replace(self, parameters=tuple(wider))

    def values(self, x: Array) -> Array:
        """Parameters in SI units from those searched, shape (..., F)."""
        log = np.array([parameter.log for parameter in self.parameters])
        return np.where(log, np.exp(np.where(log, x, 0.0)), x)

    def terms(self, x: Array) -> Array:
        """Residuals whose squares are twice the negative logarithm of the prior, shape (B, F + 2).

        Args:
            x: Parameters as searched, shape (B, F).
        """
        parts = (x - column(self.parameters, "nominal")) / column(self.parameters, "prior_sd")
        kp, kd, stall, no_load_speed = (x[:, self.index(n)] for n in (*BASE[:2], *LINE))
        damping = (kd - stall + no_load_speed) / _BACK_EMF_SD
        damping = np.sign(damping) * np.sqrt(np.log1p(damping**2))  # tails of a Cauchy distribution
        drive = np.zeros_like(kp)
        if self.per_rad is not None:
            drive = (kp - stall - np.log(self.per_rad)) / SPREADS.reported
        return np.hstack([parts, damping[:, None], drive[:, None]])


def motor_prior(servo: Servo, traces: Sequence[Trace]) -> MotorPrior:
    """The prior of a servo's law from its data sheet and, if it is reported, its drive.

    Torque and speed of the data sheet are those of the motor's line without friction, within the
    prior's width. The rotor inertia follows from a motor's time constant; the ratios of friction
    are those of spur gears with ratios of hundreds (Duclusaud and others, ICRA 2025: 0.05 to 0.4).
    """
    stall, speed = servo.max_torque_Nm, servo.no_load_speed_rad_s
    stall_sd, speed_sd = _SHEET_SD
    if traces[0].load is PER_INERTIA:
        stall, stall_sd = speed / _MOTOR_TIME_S, _UNKNOWN_SD
    inertia = traces[0].load.inertia_kgm2
    rotor_inertia = _MOTOR_TIME_S * (stall / speed)
    per_rad = [t.drive_per_rad for t in traces if t.drive_per_rad is not None]

    def log(name: str, middle: float, sd: float, room: float = 4.0) -> Parameter:
        low, high = float(middle * np.exp(-room)), float(middle * np.exp(room))
        return Parameter(name, low, high, _LOG_UNIT, float(np.log(middle)), sd, log=True)

    def share(name: str, sd: float, high: float, unit: float) -> Parameter:
        return Parameter(name, 0.0, high, unit, 0.0, SPREADS.losses * sd)

    return MotorPrior(
        (
            Parameter("kp_Nm_per_rad", 1e-9 * inertia, 1.6e5 * inertia, _LOG_UNIT, log=True),
            Parameter("kd_Nms_per_rad", 1e-3 * inertia, 1.6e3 * inertia, _LOG_UNIT, log=True),
            Parameter("latency_s", 0.0, 0.5, 0.02),
            log(LINE[0], stall, stall_sd),
            log(LINE[1], speed, speed_sd),
            share("motor.resistance_rise", 1.5, 8.0, 1.0),
            log(ROTOR, rotor_inertia, _MOTOR_TIME_SD, 8.0),
            share("motor.coulomb_Nm", 0.03 * stall, 0.5 * stall, 0.03 * stall),
            share("motor.motor_friction", 0.4, 0.95, 0.2),
            share("motor.load_friction", 0.4, 2.0, 0.2),
            share("motor.stribeck_motor_friction", 0.3, 0.9, 0.2),
            share("motor.stribeck_load_friction", 0.3, 2.0, 0.2),
            log("motor.stribeck_speed_rad_s", 0.05 * speed, 0.8),
            share("motor.stick_time_s", 0.01, 0.1, 0.01),
            share("motor.creep_time_s", 0.002, 0.05, 0.002),
            *(Parameter(name, 0.0, 0.05, _TICK_S) for name in LOOP),
        ),
        float(np.median(per_rad)) if per_rad else None,
    )
