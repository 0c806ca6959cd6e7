"""Three servos drawn at random, each with its loads, its sensor and its small imperfections."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from firmware import TICK_S
from plant import Record, neutral_joints

JOINTS = ("j1", "j2", "j3")
RECORDINGS = ("a", "b", "c")
GRAVITY_M_S2 = 9.80665
STEPS_RAD = (0.00153, 0.00419)


@dataclass(frozen=True)
class Load:
    """What is stated of a load; units as in the interface."""

    inertia_kgm2: float
    pendulum_mass_kg: float = 0.0
    pendulum_length_m: float = 0.0

    @property
    def gravity_Nm(self) -> float:
        """Torque of the pendulum when level."""
        return self.pendulum_mass_kg * GRAVITY_M_S2 * self.pendulum_length_m


@dataclass(frozen=True)
class Sensor:
    """Noise of one joint's recorded angle, rad and s."""

    step_rad: float
    white_rad: float
    wander_rad: float
    wander_s: float


@dataclass
class Servo:
    """A servo as its firmware and motor make it.

    kp, kd and latency are those of the PD servo it behaves like; half a tick of feedback delay
    takes kp * TICK_S / 2 off the damping that the motor and the firmware give.
    """

    kp: float
    kd: float
    latency_s: float
    firmware_damping: float  # share of kd that the firmware makes; back-EMF makes the rest
    rotor_inertia: float
    volts: float
    loads: dict[str, Load]
    sensor: Sensor
    nuisances: dict[str, float]
    stall_Nm: float = 1e3  # known once the commands are
    stated: dict[str, float] = field(default_factory=dict)  # a data sheet that is not quite right

    def fields(self, recording: str) -> dict[str, float]:
        """Plant parameters of this servo with the load of ``recording`` and nothing hidden."""
        firmware = self.firmware_damping * self.kd
        back_emf = self.kd - firmware + 0.5 * TICK_S * self.kp
        wound = back_emf * self.volts / self.stall_Nm  # gear ratio times torque constant
        load = self.loads[recording]
        return {
            "volts": self.volts,
            "ohms": wound * self.volts / self.stall_Nm,
            "torque_constant": wound / 250.0,
            "gear_ratio": 250.0,
            "rotor_inertia": self.rotor_inertia,
            "inertia": load.inertia_kgm2,
            "pendulum_Nm": load.gravity_Nm,
            "gain_per_rad": self.kp / self.stall_Nm,
            "damping_s": firmware / self.stall_Nm,
            "latency_s": self.latency_s,
            **self.nuisances,
        }

    @property
    def no_load_speed_rad_s(self) -> float:
        """Speed at which back-EMF takes the whole supply."""
        return self.stall_Nm / (self.kd * (1 - self.firmware_damping) + 0.5 * TICK_S * self.kp)


def draw_servo(rng: np.random.Generator) -> Servo:
    """A servo whose natural frequency, damping and static sag are those of its class."""
    while True:
        kp, inertia = _log_uniform(rng, 1.0, 6.0), _log_uniform(rng, 0.0012, 0.006)
        if 15.0 < np.sqrt(kp / inertia) < 50.0:
            break
    kd = 2 * rng.uniform(0.4, 1.2) * np.sqrt(kp * inertia)
    step = float(rng.choice(STEPS_RAD))
    white = rng.uniform(0.5e-3, 1.5e-3)
    fine_noise = np.hypot(white, step / np.sqrt(12))
    return Servo(
        kp=float(kp),
        kd=float(kd),
        latency_s=float(rng.uniform(0.020, 0.090)),
        firmware_damping=float(rng.uniform(0.0, 0.1)),
        rotor_inertia=float(rng.uniform(0.15, 0.35) * inertia),
        volts=float(rng.uniform(7.0, 12.0)),
        loads=_draw_loads(inertia, rng),
        sensor=Sensor(step, white, rng.uniform(0.5e-3, 1.5e-3), rng.uniform(1.0, 5.0)),
        nuisances={
            "tooth_error_rad": float(np.clip(0.15 * fine_noise, 0.1e-3, 0.3e-3)),
            "teeth_per_rad": float(rng.uniform(20, 60)),
            "tooth_phase": float(rng.uniform(0, 2 * np.pi)),
            "ripple_Nm": float(kp * rng.uniform(0.03e-3, 0.1e-3)),
            "ripple_per_rad": float(rng.uniform(20, 60)),
            "ripple_phase": float(rng.uniform(0, 2 * np.pi)),
        },
    )


def as_records(servos: list[Servo], recording: str) -> Record:
    """The servos as the plant's parameters for one recording, nothing hidden."""
    joints = neutral_joints(len(servos))
    for j, servo in enumerate(servos):
        for name, value in servo.fields(recording).items():
            joints[name][j] = value
    return joints


def _draw_loads(inertia: float, rng: np.random.Generator) -> dict[str, Load]:
    heavier = rng.uniform(1.5, 2.5)
    third = rng.uniform(1.15, 1.4) if rng.random() < 0.5 else rng.uniform(2.6, 3.2)
    return {
        "a": _draw_load(inertia, rng, bare=0.0),
        "b": _draw_load(inertia * heavier, rng, bare=0.4),
        "c": _draw_load(inertia * third, rng, bare=0.3),
    }


def _draw_load(inertia: float, rng: np.random.Generator, *, bare: float) -> Load:
    """A load of about ``inertia`` kg m2, without a pendulum with probability ``bare``."""
    inertia = round(float(inertia), 6)
    gravity, share = rng.uniform(0.1, 0.4), rng.uniform(0.25, 0.6)
    if rng.random() < bare:
        return Load(inertia)
    length = round(float(share * inertia * GRAVITY_M_S2 / gravity), 4)
    return Load(inertia, round(float(gravity / (GRAVITY_M_S2 * length)), 4), length)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** rng.random())
