"""Servos of all robots: gains, late set-points whose delay drifts, friction, play in the gears."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from truth import Truth, values

Array = NDArray[np.float64]

LEAST_FRICTION_NM = 0.004
"""Every servo has a little."""
SMOOTH_RAD_S = 0.1
"""Rate at which friction is three quarters of itself."""
GEAR_KGM2, TOOTH_NM_PER_RAD, TOOTH_NMS_PER_RAD = 4e-4, 150.0, 0.1
"""Where there is play: inertia of motor and gears at the shaft, the teeth's spring and damper."""
HORN_KGM2 = 2e-3
"""Inertia that is left to a servo whose link has come loose."""
PERIOD_S = 0.02
_KEPT = 12


class Servos:
    """E robots' servos, J each.

    A set-point counts when it arrives; until the first has, 0 does. The torque is
    kp (set-point - angle) - kd rate less dry friction. Where there is play, it turns motor and
    gears, a mass of their own, whose teeth touch the shaft's only at the ends of the gap; damping
    and friction are the motor's then, the angle is still measured at the shaft.
    """

    def __init__(self, truths: Sequence[Truth], J: int, h: float, rng: np.random.Generator) -> None:
        """Take what is true of them.

        Args:
            truths: One a robot.
            J: Number of joints.
            h: Time between calls of ``torque``.
            rng: Of the drift.
        """
        self._shape, self._h, self._rng = (len(truths), J), h, rng
        self._kp, self._kd, self._latency = (
            np.array([getattr(truth, key) for truth in truths]) for key in ("kp", "kd", "latency")
        )
        self.gains = self._kp, self._kd
        names = ("torque_Nm", *(f"j{j + 1}.torque_Nm" for j in range(J)))
        of_all, *own = (values(truths, "coulomb_friction", name) for name in names)
        self._friction = np.stack(own, axis=1) + of_all[:, None]
        self._gap = values(truths, "backlash", "gap_rad")[:, None]
        self._wander = values(truths, "latency_drift", "sd_s")[:, None]
        self._memory = np.maximum(values(truths, "latency_drift", "time_s")[:, None], PERIOD_S)
        self.reset(np.zeros(self._shape))

    def reset(self, turn: Array) -> None:
        """Rest at these angles of the joints, shape (E, J); nothing was sent."""
        self._gear, self._gear_rate = turn.copy(), np.zeros(self._shape)
        self._sent = np.zeros((0, *self._shape))
        self._arrival = np.zeros((0, *self._shape))
        self._drift = np.zeros(self._shape)
        if self._wander.any():
            self._drift = self._wander * self._rng.standard_normal(self._shape)

    def send(self, t: float, sent: Array) -> None:
        """Put set-points on their way, shape (E, J)."""
        if self._wander.any():  # an Ornstein-Uhlenbeck process
            kept = np.exp(-PERIOD_S / self._memory)
            fresh = np.sqrt(1 - kept**2) * self._wander * self._rng.standard_normal(self._shape)
            self._drift = kept * self._drift + fresh
        arrival = t + (self._latency + self._drift)
        self._sent = np.concatenate([self._sent, sent[None]])[-_KEPT:]
        self._arrival = np.concatenate([self._arrival, arrival[None]])[-_KEPT:]

    def wanted(self, t: float) -> Array:
        """The newest set-points that have arrived, shape (E, J)."""
        number = np.arange(1, len(self._sent) + 1)[:, None, None]
        newest = ((self._arrival <= t) * number).max(axis=0, initial=0)
        first = np.zeros((1, *self._shape))
        known = np.concatenate([first, self._sent])
        return np.asarray(np.take_along_axis(known, newest[None], axis=0)[0])

    def torque(self, t: float, turn: Array, rate: Array, trim: Array) -> Array:
        """Torques on the joints in N m, shape (E, J); play goes on by ``h``.

        Args:
            t: Time in s.
            turn: Angles of the joints, shape (E, J).
            rate: Their rates.
            trim: Angle by which each servo's horn is off, what broadcasts to (E, J).
        """
        loose = self._gap > 0
        own = np.where(loose, self._gear_rate, rate)
        torque = self._kp * (self.wanted(t) + trim - turn) - self._kd * own
        grip = np.tanh(own / SMOOTH_RAD_S)
        torque -= LEAST_FRICTION_NM * grip
        torque -= self._friction * grip
        if not loose.any():
            return np.asarray(torque)
        tooth = self._tooth(turn, rate)
        self._gear_rate = self._gear_rate + self._h / GEAR_KGM2 * (torque - tooth)
        self._gear = self._gear + self._h * self._gear_rate
        return np.where(loose, tooth, torque)

    def _tooth(self, turn: Array, rate: Array) -> Array:
        """Torque of gears on shafts: none inside the gap, and teeth only push."""
        off = self._gear - turn
        dent = off - np.clip(off, -self._gap / 2, self._gap / 2)
        pressed = TOOTH_NM_PER_RAD * dent + TOOTH_NMS_PER_RAD * (self._gear_rate - rate)
        return np.where(
            dent > 0, np.maximum(pressed, 0), np.where(dent < 0, np.minimum(pressed, 0), 0)
        )


class LooseFin:
    """A last link that comes loose from its servo, which goes on turning, and showing, its horn."""

    def __init__(self, truths: Sequence[Truth], h: float) -> None:
        """Take when it comes loose and what still holds it; ``h`` is the time between calls."""
        self._h = h
        self._from = values(truths, "loose_fin", "from_s")
        self._hold = values(truths, "loose_fin", "stiffness_Nm_per_rad")
        self._loose = self._hold > 0
        self.reset(np.zeros(len(truths)))

    def reset(self, turn: Array) -> None:
        """Rest at these angles, shape (E,)."""
        self._horn, self._rate = turn.copy(), np.zeros(turn.shape)

    def torque(self, t: float, turn: Array, rate: Array, torque: Array, servo: Array) -> Array:
        """Torque on the last joint, shape (E,): that of the servo until the fin is loose.

        Args:
            t: Time in s.
            turn: Angles of the joint, shape (E,).
            rate: Its rates.
            torque: What would act on it, likewise.
            servo: The servo's kp, kd and the angle it wants, shape (3, E).
        """
        if not self._loose.any():
            return torque
        off = self._loose & (t >= self._from)
        kp, kd, target = servo
        push = kp * (target - self._horn) - kd * self._rate
        self._rate = np.where(off, self._rate + self._h / HORN_KGM2 * push, rate)
        self._horn = np.where(off, self._horn + self._h * self._rate, turn)
        held = self._hold * (self._horn - turn) - 0.05 * self._hold * rate
        return np.where(off, held, torque)

    def shown(self, t: float, turn: Array) -> Array:
        """What the servo's sensor shows, shape (E,)."""
        return np.where(self._loose & (t >= self._from), self._horn, turn)
