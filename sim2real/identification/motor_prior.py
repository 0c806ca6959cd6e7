"""Prior of a motor's parameters, from its data sheet with a wide margin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE, LINE, LOOP
from sim2real.servo.reported_drive import ReportedDrive
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spreads:
    """Standard deviations of the prior that were chosen (see ``benchmarks/prior_choice.py``).

    Attributes:
        losses: Factor on the standard deviations of losses and friction below.
        reported: Standard deviation of the logarithm of the gain that the reported drive shows, and
            of that of the damping; infinite to ignore it.
    """

    losses: float = 1.0
    reported: float = 0.01


SPREADS = Spreads()
_FREE = np.inf


@dataclass(frozen=True)
class PriorSettings:
    """Prior knowledge of any motor in addition to its data sheet.

    Attributes:
        sheet_sd: Standard deviations of the logarithms of stall torque and no-load speed about the
            data sheet's.
        unknown_sd: Standard deviation of the logarithm of stall torque per unknown inertia.
        motor_time_s: Time constant of small geared motors, rotor inertia times no-load speed over
            stall torque.
        motor_time_sd: Standard deviation of its logarithm.
        back_emf_sd: Scale of the logarithm of damping about that by the back-EMF, with long tails,
            as the controller may add damping.
        tick_s: Natural unit of a loop's period, which accumulates over thousands of samples.
    """

    sheet_sd: tuple[float, float] = (0.35, 0.25)
    unknown_sd: float = 1.5
    motor_time_s: float = 0.03
    motor_time_sd: float = 0.8
    back_emf_sd: float = 0.3
    tick_s: float = 2e-7


PRIOR_SETTINGS = PriorSettings()
"""The defaults."""


@dataclass(frozen=True)
class ParameterPrior:
    """Bounds and normal prior of one parameter.

    Attributes:
        name: Column of the law, see ``servo.parameters``.
        log: Whether it is searched as a logarithm, to which ``middle`` and ``sd`` then refer.
        middle: Most likely value.
        sd: Standard deviation, infinite for a flat prior.
        low: Smallest value, in SI units.
        high: Largest value.
        unit: Natural unit, as searched.
    """

    name: str
    log: bool
    middle: float
    sd: float
    low: float
    high: float
    unit: float


@dataclass(frozen=True)
class MotorPrior:
    """Prior of all parameters of a motor, with relations between them.

    Attributes:
        parameters: Prior of each, gains and latency first.
        drive: Controller that the reported drive shows, if the servo reports it.
        back_emf_sd: Scale of the logarithm of damping about that by the back-EMF.
    """

    parameters: tuple[ParameterPrior, ...]
    drive: ReportedDrive | None
    back_emf_sd: float = PRIOR_SETTINGS.back_emf_sd

    @property
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

    def terms(self, x: Array) -> Array:
        """Residuals whose squares are twice the negative logarithm of the prior, shape (B, F + 2).

        Args:
            x: Parameters as searched, shape (B, F).
        """
        middle = np.array([b.middle if np.isfinite(b.sd) else 0.0 for b in self.parameters])
        sd = np.array([parameter.sd for parameter in self.parameters])
        normal_terms = (x - middle) / sd
        kp, kd, stall, no_load_speed = (x[:, self.index(n)] for n in (*BASE[:2], *LINE))
        if self.drive is not None and np.isfinite(SPREADS.reported):
            back_emf = np.exp(stall - no_load_speed)
            damping = kd - np.log(back_emf + self.drive.lead_s * np.exp(kp))
            drive = kp - stall - np.log(self.drive.per_rad)
            ties = np.stack([damping, drive], axis=1) / SPREADS.reported
        else:
            damping = (kd - stall + no_load_speed) / self.back_emf_sd
            # tails of a Cauchy distribution
            damping = np.sign(damping) * np.sqrt(np.log1p(damping**2))
            ties = np.stack([damping, np.zeros_like(kp)], axis=1)
        return np.hstack([normal_terms, ties])


def motor_prior(
    servo: Servo, traces: Sequence[Trace], *, settings: PriorSettings = PRIOR_SETTINGS
) -> MotorPrior:
    """The prior of a servo's law from its data sheet and, if it is reported, its drive.

    A servo that reports its drive shows its controller: kp is that gain times the stall torque, the
    damping that of the back-EMF and of the controller's derivative term, and the latency is known
    to a sampling period. Torque and speed of the data sheet are those of the motor's line without
    friction, within the prior's width. The rotor inertia follows from a motor's time constant; the
    ratios of friction are those of spur gears with ratios of hundreds (Duclusaud and others, ICRA
    2025: 0.05 to 0.4).
    """
    stall, speed = servo.max_torque_Nm, servo.no_load_speed_rad_s
    load_known = traces[0].load is not PER_INERTIA
    torque_sd = settings.sheet_sd[0]
    if not load_known:
        stall, torque_sd = speed / settings.motor_time_s, settings.unknown_sd
    damping = stall / speed
    drive = _common_drive(traces)
    latency = ParameterPrior("latency_s", False, 0.0, _FREE, 0.0, 0.5, 0.02)
    if drive is not None and np.isfinite(SPREADS.reported):
        latency = replace(latency, middle=drive.latency_s, sd=drive.period_s)
    inertia = traces[0].load.inertia_kgm2

    def log(
        name: str, middle: float, sd: float, room: float = 4.0, unit: float = 0.3
    ) -> ParameterPrior:
        low, high = float(middle * np.exp(-room)), float(middle * np.exp(room))
        return ParameterPrior(name, True, float(np.log(middle)), sd, low, high, unit)

    def share(name: str, sd: float, high: float, unit: float) -> ParameterPrior:
        return ParameterPrior(name, False, 0.0, SPREADS.losses * sd, 0.0, high, unit)

    return MotorPrior(
        (
            ParameterPrior("kp_Nm_per_rad", True, 0.0, _FREE, 1e-9 * inertia, 1.6e5 * inertia, 0.3),
            ParameterPrior(
                "kd_Nms_per_rad", True, 0.0, _FREE, 1e-3 * inertia, 1.6e3 * inertia, 0.3
            ),
            latency,
            log(LINE[0], stall, torque_sd),
            log(LINE[1], speed, settings.sheet_sd[1]),
            share("motor.resistance_rise", 1.5, 8.0, 1.0),
            log(
                "motor.rotor_inertia_kgm2",
                settings.motor_time_s * damping,
                settings.motor_time_sd,
                8.0,
            ),
            share("motor.coulomb_Nm", 0.03 * stall, 0.5 * stall, 0.03 * stall),
            share("motor.motor_friction", 0.4, 0.95, 0.2),
            share("motor.load_friction", 0.4, 2.0, 0.2),
            share("motor.stribeck_motor_friction", 0.3, 0.9, 0.2),
            share("motor.stribeck_load_friction", 0.3, 2.0, 0.2),
            log("motor.stribeck_speed_rad_s", 0.05 * speed, 0.8),
            share("motor.stick_time_s", 0.01, 0.1, 0.01),
            share("motor.creep_time_s", 0.002, 0.05, 0.002),
            *(ParameterPrior(name, False, 0.0, _FREE, 0.0, 0.05, settings.tick_s) for name in LOOP),
        ),
        drive,
        settings.back_emf_sd,
    )


def _common_drive(traces: Sequence[Trace]) -> ReportedDrive | None:
    """Median of the controllers that the recordings show; None if none reports its drive."""
    drives = [astuple(trace.drive) for trace in traces if trace.drive is not None]
    return ReportedDrive(*(float(x) for x in np.median(drives, axis=0))) if drives else None
