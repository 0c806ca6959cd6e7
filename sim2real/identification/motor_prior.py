"""What is believed of a servo's motor before it is recorded: its data sheet, with a wide margin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE, LINE, LOOP
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spreads:
    """What of the prior is judgement, and is checked by ``benchmarks/prior_choice.py``.

    Attributes:
        losses: Spreads of losses and friction, over those stated below.
        reported: Spread of the drive that the servo itself reports; infinite where it is not used.
    """

    losses: float = 1.0
    reported: float = 0.05


SPREADS = Spreads()
_FREE = np.inf


@dataclass(frozen=True)
class MotorBeliefs:
    """What is believed of any motor besides its data sheet.

    Attributes:
        sheet_sd: Standard deviation of stall torque and no-load speed about the data sheet's, as
            logarithms.
        unknown_sd: Standard deviation of the stall torque per unit of an inertia that is not known.
        motor_time_s: Time constant of small geared motors, rotor inertia times no-load speed over
            stall torque.
        motor_time_sd: Standard deviation of its logarithm.
        back_emf_sd: Scale of the damping about the back-EMF's; long tails, as a controller may damp
            as well.
        tick_s: A change of a loop's period that thousands of its looks add up to one that matters.
    """

    sheet_sd: tuple[float, float] = (0.35, 0.25)
    unknown_sd: float = 1.5
    motor_time_s: float = 0.03
    motor_time_sd: float = 0.8
    back_emf_sd: float = 0.3
    tick_s: float = 2e-7


MOTOR_BELIEFS = MotorBeliefs()
"""The defaults."""


@dataclass(frozen=True)
class Belief:
    """One parameter: where it is searched and what is believed of it.

    Attributes:
        name: Its column.
        log: Whether it is searched as a logarithm; ``middle`` and ``sd`` are then the logarithm's.
        middle: Most likely value.
        sd: Spread about it, infinite where nothing is believed.
        low: Smallest value, in the parameter's own unit.
        high: Largest value.
        unit: A step that matters, as searched.
    """

    name: str
    log: bool
    middle: float
    sd: float
    low: float
    high: float
    unit: float


@dataclass(frozen=True)
class Prior:
    """Beliefs about all parameters and about what ties them together.

    Attributes:
        beliefs: The parameters, gains and latency first.
        per_rad: Drive that the servo reports per radian of error, where it does.
        back_emf_sd: Scale of the damping about the back-EMF's.
    """

    beliefs: tuple[Belief, ...]
    per_rad: float | None
    back_emf_sd: float = MOTOR_BELIEFS.back_emf_sd

    @property
    def names(self) -> tuple[str, ...]:
        """Columns of the parameters."""
        return tuple(belief.name for belief in self.beliefs)

    def index(self, name: str) -> int:
        """Place of a parameter."""
        return self.names.index(name)

    def loosened(self, factor: float) -> Prior:
        """The prior with spreads of losses and friction so many times as wide."""
        beliefs = tuple(
            b if b.log or not np.isfinite(b.sd) else replace(b, sd=factor * b.sd)
            for b in self.beliefs
        )
        return replace(self, beliefs=beliefs)

    def values(self, x: Array) -> Array:
        """Parameters in their own units from those searched, shape (..., F)."""
        log = np.array([belief.log for belief in self.beliefs])
        return np.where(log, np.exp(np.where(log, x, 0.0)), x)

    def terms(self, x: Array) -> Array:
        """Residuals whose squares are twice the negative logarithm of the prior, shape (B, F + 2).

        Args:
            x: Parameters as searched, shape (B, F).
        """
        middle = np.array([b.middle if np.isfinite(b.sd) else 0.0 for b in self.beliefs])
        sd = np.array([belief.sd for belief in self.beliefs])
        own = (x - middle) / sd
        kp, kd, stall, fast = (x[:, self.index(n)] for n in (*BASE[:2], *LINE))
        tie = (kd - stall + fast) / self.back_emf_sd
        tie = np.sign(tie) * np.sqrt(np.log1p(tie**2))  # Cauchy's tails
        reported = np.zeros_like(kp)
        if self.per_rad is not None:
            reported = (kp - stall - np.log(self.per_rad)) / SPREADS.reported
        return np.hstack([own, tie[:, None], reported[:, None]])


def motor_prior(
    servo: Servo, traces: Sequence[Trace], *, beliefs: MotorBeliefs = MOTOR_BELIEFS
) -> Prior:
    """The prior of a servo's law from its data sheet and, where it reports it, its drive.

    What the data sheet calls torque and speed is the motor's line without friction, up to the
    spread. A rotor's inertia follows from a motor's time constant; the ratios of friction are those
    of spur gears of ratios of hundreds (Duclusaud and others, ICRA 2025: 0.05 to 0.4).
    """
    stall, fast = servo.max_torque_Nm, servo.no_load_speed_rad_s
    known = traces[0].load is not PER_INERTIA
    torque_sd = beliefs.sheet_sd[0]
    if not known:
        stall, torque_sd = fast / beliefs.motor_time_s, beliefs.unknown_sd
    damping = stall / fast
    slopes = [t.drive_per_rad for t in traces if t.drive_per_rad is not None]
    inertia = traces[0].load.inertia_kgm2

    def log(name: str, middle: float, sd: float, room: float = 4.0, unit: float = 0.3) -> Belief:
        low, high = float(middle * np.exp(-room)), float(middle * np.exp(room))
        return Belief(name, True, float(np.log(middle)), sd, low, high, unit)

    def share(name: str, sd: float, high: float, unit: float) -> Belief:
        return Belief(name, False, 0.0, SPREADS.losses * sd, 0.0, high, unit)

    return Prior(
        (
            Belief("kp_Nm_per_rad", True, 0.0, _FREE, 1e-9 * inertia, 1.6e5 * inertia, 0.3),
            Belief("kd_Nms_per_rad", True, 0.0, _FREE, 1e-3 * inertia, 1.6e3 * inertia, 0.3),
            Belief("latency_s", False, 0.0, _FREE, 0.0, 0.5, 0.02),
            log(LINE[0], stall, torque_sd),
            log(LINE[1], fast, beliefs.sheet_sd[1]),
            share("motor.resistance_rise", 1.5, 8.0, 1.0),
            log(
                "motor.rotor_inertia_kgm2",
                beliefs.motor_time_s * damping,
                beliefs.motor_time_sd,
                8.0,
            ),
            share("motor.coulomb_Nm", 0.03 * stall, 0.5 * stall, 0.03 * stall),
            share("motor.motor_friction", 0.4, 0.95, 0.2),
            share("motor.load_friction", 0.4, 2.0, 0.2),
            share("motor.stribeck_motor_friction", 0.3, 0.9, 0.2),
            share("motor.stribeck_load_friction", 0.3, 2.0, 0.2),
            log("motor.stribeck_speed_rad_s", 0.05 * fast, 0.8),
            share("motor.stick_time_s", 0.01, 0.1, 0.01),
            share("motor.creep_time_s", 0.002, 0.05, 0.002),
            *(Belief(name, False, 0.0, _FREE, 0.0, 0.05, beliefs.tick_s) for name in LOOP),
        ),
        float(np.median(slopes)) if slopes else None,
        beliefs.back_emf_sd,
    )
