"""Prior of a motor's parameters, from its data sheet with a wide margin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from functools import cached_property

import numpy as np

from sim2real.arrays import Array
from sim2real.inference.normal import Z90
from sim2real.inference.parameters import Parameter, column
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE, CURRENT_LIMIT, LINE, LOOP, ROTOR
from sim2real.servo.reported_drive import ReportedDrive
from sim2real.servo.trace import Trace

MOTOR_TIME_S = 0.03
"""Time constant of small geared motors: rotor inertia times no-load speed over stall torque."""
MOTOR_TIME_SD = 0.8
"""Standard deviation of its logarithm."""


@dataclass(frozen=True)
class MotorPrior:
    """Prior of all parameters of a motor, with relations between them.

    Attributes:
        parameters: Prior of each column of the law (``servo.parameters``), gains and latency first.
        drive: Controller that the reported drive shows; None if the servo does not report it, or
            if it is ignored.
        reported_sd: Standard deviation of the logarithm of the gain that the reported drive shows,
            and of that of the damping.
        back_emf_sd: Scale of the logarithm of the damping about that by the back-EMF, with long
            tails, as the controller may add damping.
        damping_share: Median of the share of the damping that a limit of the current leaves, and
            the standard deviation of its logarithm; None for a torque-speed line.
    """

    parameters: tuple[Parameter, ...]
    drive: ReportedDrive | None
    reported_sd: float = 0.01
    back_emf_sd: float = 0.3
    damping_share: tuple[float, float] | None = None

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    def index(self, name: str) -> int:
        """Index of a parameter."""
        return self.names.index(name)

    def values(self, x: Array) -> Array:
        """Parameters in SI units from those searched, shape (..., F)."""
        log = np.array([parameter.log for parameter in self.parameters])
        return np.where(log, np.exp(np.where(log, x, 0.0)), x)

    def widths(self, free: Sequence[int]) -> Array:
        """Standard deviations of the normal priors of some parameters, as searched."""
        sd = column([self.parameters[k] for k in free], "prior_sd")
        share = () if self.damping_share is None else self.damping_share[1:]
        return np.append(sd[np.isfinite(sd)], share)

    def flat(self, kd: float, *, damping_share: tuple[float, float] = (0.6, 0.6)) -> MotorPrior:
        """The prior of the same motor, if its current is limited at any speed and not its voltage.

        Damping acts beyond the limit, at least a share of it: the stall torque over the no-load
        speed. The no-load speed of the data sheet is then no limit.

        Args:
            kd: Damping of the linear servo in N m s/rad, about which the bounds lie.
            damping_share: Median of that share, and the standard deviation of its logarithm.
        """
        k = self.index(LINE[1])
        middle = float(np.exp(self.parameters[self.index(LINE[0])].nominal)) / kd / damping_share[0]
        free = replace(
            self.parameters[k],
            low=middle / 10,
            high=middle * 100,
            typical=2 * damping_share[1],
            nominal=np.log(middle),
            prior_sd=np.inf,
        )
        parameters = (*self.parameters[:k], free, *self.parameters[k + 1 :])
        return replace(self, parameters=parameters, damping_share=damping_share)

    def terms(self, x: Array) -> Array:
        """Residuals whose squares are twice the negative logarithm of the prior, shape (B, F + 2).

        Args:
            x: Parameters as searched, shape (B, F).
        """
        parts = (x - column(self.parameters, "nominal")) / column(self.parameters, "prior_sd")
        kp, kd, stall, no_load_speed = (x[:, self.index(n)] for n in (*BASE[:2], *LINE))
        if self.damping_share is not None:
            middle, sd = self.damping_share
            damping = (kd - stall + no_load_speed + np.log(middle)) / sd
            ties = np.stack([damping, np.zeros_like(kp)], axis=1)
        elif self.drive is None:
            damping = (kd - stall + no_load_speed) / self.back_emf_sd
            # tails of a Cauchy distribution
            damping = np.sign(damping) * np.sqrt(np.log1p(damping**2))
            ties = np.stack([damping, np.zeros_like(kp)], axis=1)
        else:
            back_emf = np.exp(stall - no_load_speed)
            damping = kd - np.log(back_emf + self.drive.lead_s * np.exp(kp))
            gain = kp - stall - np.log(self.drive.per_rad)
            ties = np.stack([damping, gain], axis=1) / self.reported_sd
        return np.hstack([parts, ties])


def motor_prior(
    servo: Servo,
    traces: Sequence[Trace],
    *,
    stall_sd: float = 0.35,
    unknown_stall_sd: float = 1.5,
    speed_sd: float = 0.25,
    motor_time_s: float = MOTOR_TIME_S,
    motor_time_sd: float = MOTOR_TIME_SD,
    loss_width: float = 1.0,
    reported_sd: float = MotorPrior.reported_sd,
    log_unit: float = 0.3,
) -> MotorPrior:
    """The prior of a servo's law from its data sheet and, if it is reported, its drive.

    A servo that reports its drive shows its controller: kp is that gain times the stall torque, the
    damping that of the back-EMF and of the controller's derivative term, and the latency is known
    to a sampling period. Torque and speed of the data sheet are those of the motor's line without
    friction, within the prior's width. The rotor inertia follows from a motor's time constant; the
    ratios of friction are those of spur gears with ratios of hundreds (Duclusaud and others, ICRA
    2025: 0.05 to 0.4).

    Args:
        servo: The data sheet.
        traces: The joint's recordings.
        stall_sd: Standard deviation of the logarithm of stall torque about the data sheet.
        unknown_stall_sd: The same where the inertia is unknown, to which the torque is relative.
        speed_sd: Standard deviation of the logarithm of no-load speed about the data sheet.
        motor_time_s: Time constant of small geared motors, s.
        motor_time_sd: Standard deviation of its logarithm.
        loss_width: Factor on the standard deviations of losses and friction.
        reported_sd: Standard deviation of the logarithm of the gain that the reported drive shows,
            and of that of the damping; infinite to ignore the reported drive.
        log_unit: Natural unit of a logarithm.
    """
    stall, speed = servo.max_torque_Nm, servo.no_load_speed_rad_s
    if traces[0].load is PER_INERTIA:
        stall, stall_sd = speed / motor_time_s, unknown_stall_sd
    inertia = traces[0].load.inertia_kgm2
    rotor_inertia = motor_time_s * (stall / speed)
    largest = inertia if traces[0].varying is None else inertia + rotor_inertia
    drive = _common_drive(traces) if np.isfinite(reported_sd) else None
    latency = (0.0, np.inf) if drive is None else (drive.latency_s, drive.period_s)

    def log(name: str, middle: float, sd: float, room: float = 4.0) -> Parameter:
        low, high = float(middle * np.exp(-room)), float(middle * np.exp(room))
        return Parameter(name, low, high, log_unit, float(np.log(middle)), sd, log=True)

    def share(name: str, sd: float, high: float, unit: float) -> Parameter:
        return Parameter(name, 0.0, high, unit, 0.0, loss_width * sd)

    return MotorPrior(
        (
            Parameter("kp_Nm_per_rad", 1e-9 * inertia, 1.6e5 * largest, log_unit, log=True),
            Parameter("kd_Nms_per_rad", 1e-3 * inertia, 1.6e3 * largest, log_unit, log=True),
            Parameter("latency_s", 0.0, 0.5, 0.02, *latency),
            log(LINE[0], stall, stall_sd),
            log(LINE[1], speed, speed_sd),
            share("motor.resistance_rise", 1.5, 8.0, 1.0),
            log(ROTOR, rotor_inertia, motor_time_sd, 8.0),
            share("motor.coulomb_Nm", 0.03 * stall, 0.5 * stall, 0.03 * stall),
            share("motor.motor_friction", 0.4, 0.95, 0.2),
            share("motor.load_friction", 0.4, 2.0, 0.2),
            share("motor.stribeck_motor_friction", 0.3, 0.9, 0.2),
            share("motor.stribeck_load_friction", 0.3, 2.0, 0.2),
            log("motor.stribeck_speed_rad_s", 0.05 * speed, 0.8),
            share("motor.stick_time_s", 0.01, 0.1, 0.01),
            share("motor.creep_time_s", 0.002, 0.05, 0.002),
            log(CURRENT_LIMIT, 0.6 * stall, 0.4),
            # the error of a period accumulates over thousands of samples
            *(Parameter(name, 0.0, 0.05, 2e-7) for name in LOOP),
        ),
        drive,
        reported_sd,
    )


def nominal_rotor(servo: Servo) -> float:
    """Inertia of rotor and gears in kg m2 at the output that is likely for a data sheet."""
    return MOTOR_TIME_S * servo.max_torque_Nm / servo.no_load_speed_rad_s


def largest_rotor(servo: Servo) -> float:
    """Upper end of the 90 % interval of the prior of that inertia, kg m2."""
    return nominal_rotor(servo) * float(np.exp(Z90 * MOTOR_TIME_SD))


def _common_drive(traces: Sequence[Trace]) -> ReportedDrive | None:
    """Median of the controllers that the recordings show; None if none reports its drive."""
    drives = [astuple(trace.drive) for trace in traces if trace.drive is not None]
    return ReportedDrive(*(float(x) for x in np.median(drives, axis=0))) if drives else None
