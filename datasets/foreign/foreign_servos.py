"""Servos of three makes, drawn with all that real ones have a little of.

A servo is one of the sealed challenge's (``datasets/concealed/bench.py``) with a controller of any
rate, a data sheet that is nearly right, and nuisances that are always on.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from bench import JOINTS, STEPS_RAD, Sensor, Servo, _draw_loads, _log_uniform

PLANTS = ("mujoco", "voltage", "own", "gears")
HOBBY = "hobby"
"""Gear trains of servos that control the angle of their output, with flanks that bounce."""
GEARED = ("gears", HOBBY)
FLANKS_HZ, FLANK_DAMPINGS = (150.0, 600.0), (0.1, 0.5)
BENCHES = (0.5, 0.35, 0.15)
"""Shares of benches of one, two and three servos."""
MOST_NOISE_LEVELS = 5.0
LARGEST_NUISANCE_RAD = 6e-3
RANGE_RAD = 0.8
"""Angles over which a sensor is calibrated."""
FLAT_PLANTS = ("mujoco", *GEARED)
FLAT_SHARE = 2 / 3
"""Share of benches of these plants whose drives are limited in current."""
SHEET_SPREAD = 0.07
"""Standard deviation of the true stall torque and speed about the stated ones, as logarithms."""
SLOW_LOOP_HZ = 400.0
"""Below it a new set-point acts at once on the angle seen last; above, at the loop's next turn."""


@dataclass
class ForeignServo(Servo):
    """A servo and what is small about it.

    Attributes:
        loop_Hz: Rate of the controller.
        eccentric: Amplitude in rad, cycles per radian and phase of the sensor's error.
        read_s: How long after the set-point is sent the angle is read.
        friction_on_output: Whether dry friction acts on the output's side of the gear train.
        sensor_on_output: Whether the recorded sensor is on the output's side.
        dry_friction_Nm: Coulomb friction of the servo, hidden effects aside.
        current_limited: Whether the drive's torque is clipped at the stall torque at any speed, and
            the stated no-load speed does not limit it.
        control_on_output: Whether the controller sees the output's angle, not the motor's.
        flank: Frequency in Hz of rotor and output on the flanks of the gears, damping ratio.
    """

    loop_Hz: float = 1000.0
    eccentric: tuple[float, float, float] = (0.0, 1.0, 0.0)
    read_s: float = 0.0
    friction_on_output: bool = False
    sensor_on_output: bool = False
    dry_friction_Nm: float = 0.0
    current_limited: bool = False
    control_on_output: bool = False
    flank: tuple[float, float] = (250.0, 0.4)
    calibration: tuple[float, float] = field(init=False, default=(0.0, 0.0))

    def __post_init__(self) -> None:
        q = np.linspace(-RANGE_RAD, RANGE_RAD, 161)
        amplitude, cycles, phase = self.eccentric
        slope, zero = np.polyfit(q, amplitude * np.sin(cycles * q + phase), 1)
        self.calibration = (float(zero), float(slope))

    def bent(self, q: np.ndarray) -> np.ndarray:
        """Error of the calibrated sensor at the angles ``q``, rad."""
        amplitude, cycles, phase = self.eccentric
        zero, slope = self.calibration
        return np.asarray(amplitude * np.sin(cycles * q + phase) - zero - slope * q)

    @property
    def noise_rad(self) -> float:
        """One noise level: white noise and rounding."""
        return float(np.hypot(self.sensor.white_rad, self.sensor.step_rad / np.sqrt(12)))


def draw_servos(plant: str, rng: np.random.Generator) -> list[ForeignServo]:
    """One to three servos of a plant, on one bus."""
    count = int(rng.choice(np.arange(len(JOINTS)) + 1, p=BENCHES))
    flat = plant in FLAT_PLANTS and bool(rng.random() < FLAT_SHARE)
    return [_draw(plant, k, rng, flat=flat) for k in range(count)]


def _draw(plant: str, place: int, rng: np.random.Generator, *, flat: bool) -> ForeignServo:
    loop = 1000.0 if plant == "own" else _log_uniform(rng, 100.0, 10000.0)
    while True:
        kp, inertia = _log_uniform(rng, 1.0, 6.0), _log_uniform(rng, 0.001, 0.008)
        if 13.0 < np.sqrt(kp / inertia) < min(50.0, 0.3 * loop):
            break
    kd = 2 * rng.uniform(0.4, 1.2) * np.sqrt(kp * inertia)
    white = _log_uniform(rng, 0.2e-3, 3e-3)
    steps = [s for s in (9.6e-5, 3.8e-4, *STEPS_RAD) if s < 8 * white]
    sensor = Sensor(
        float(rng.choice(steps)), white, white * rng.uniform(0.0, 1.0), rng.uniform(1.0, 5.0)
    )
    noise = float(np.hypot(white, sensor.step_rad / np.sqrt(12)))
    ripple, bend = np.minimum(noise * rng.uniform(0, MOST_NOISE_LEVELS, 2), LARGEST_NUISANCE_RAD)
    servo = ForeignServo(
        kp=kp,
        kd=float(kd),
        latency_s=float(rng.uniform(0.008, 0.080)),
        firmware_damping=float(rng.uniform(0.0, 0.4)) if plant == "mujoco" else 0.0,
        rotor_inertia=float(rng.uniform(0.15, 0.35) * inertia),
        volts=float(rng.uniform(7.0, 12.0)),
        loads=_draw_loads(inertia, rng),
        sensor=sensor,
        nuisances={
            "ripple_Nm": float(kp * ripple),
            "ripple_per_rad": float(2 * np.pi / _log_uniform(rng, 0.08, 0.35)),
            "ripple_phase": float(rng.uniform(0, 2 * np.pi)),
        },
        stall_Nm=float(kp * _log_uniform(rng, 0.35, 3.0)),
        loop_Hz=loop,
        eccentric=(float(bend), _log_uniform(rng, 1.0, 12.0), float(rng.uniform(0, 2 * np.pi))),
        read_s=float(place * rng.uniform(0.2e-3, 1e-3)),
    )
    off = np.exp(SHEET_SPREAD * rng.normal(size=2))
    if plant in GEARED:
        least = min(load.inertia_kgm2 for load in servo.loads.values())
        servo.rotor_inertia = float(rng.uniform(0.15, 0.6) * least)
        servo.sensor_on_output = bool(rng.random() < 0.5)
    if plant in (*GEARED, "mujoco"):
        servo.friction_on_output = bool(rng.random() < 0.5)
    if plant == HOBBY:
        servo.sensor_on_output = servo.control_on_output = True
        servo.flank = _log_uniform(rng, *FLANKS_HZ), float(rng.uniform(*FLANK_DAMPINGS))
    servo.stated = {
        "max_torque_Nm": float(servo.stall_Nm * off[0]),
        "no_load_speed_rad_s": float(servo.no_load_speed_rad_s * off[1]),
    }
    if flat:
        # No line of torque over speed limits the drive.
        servo.current_limited = True
        servo.firmware_damping = float(rng.uniform(0.0, 0.6))
        servo.stated["no_load_speed_rad_s"] = _log_uniform(rng, 3.0, 10.0)
    return servo
