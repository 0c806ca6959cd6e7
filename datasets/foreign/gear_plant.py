"""A gear train of two masses: rotor and output, a spring with a damper across a gap between them.

Nordin and Gutman, "Controlling mechanical systems with backlash - a survey", Automatica 38 (2002)
1633-1649, Sec. 2.2: the flanks push, they never pull. Dry friction acts on the rotor or on the
output. The drive's torque is clipped, and damping acts in addition: with the data sheet's no-load
speed that is a motor limited in voltage, with a lower one a motor limited in current.
Semi-implicit steps of 0.02 ms. Needs ``pip install numba``.
"""

from __future__ import annotations

import numpy as np
from bench import Load
from foreign_servos import ForeignServo
from foreign_world import Acting, fields_of, marched
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S = 2e-5
SPRING_DAMPING = 0.05
"""Damping ratio of a train that is a spring."""
FIELDS = {  # with the value at which each does nothing
    "kp": 1.0, "kd": 0.0, "firmware_kd": 0.0, "stall": 1e9, "rotor": 1.0, "output": 1.0,
    "pendulum": 0.0, "ripple": 0.0, "waves": 1.0, "phase": 0.0,
    "gap": 0.0, "spring": 1e3, "damper": 0.0,
    "dry_rotor": 0.0, "dry_output": 0.0, "on_output": 0.0, "control_on_output": 0.0,
    "drag": 0.0, "dead": 0.0, "limit": 1e9, "integral": 0.0, "weight": 0.0,
    "cog": 0.0, "cog_period": 1.0, "cog_phase": 0.0, "push": 0.0, "jam": 0.0,
    "shake": 0.0, "shake_Hz": 1.0, "shake_phase": 0.0, "stop": 1e9, "stop_side": 1.0, "stop_k": 0.0,
    "schedule": 1e9, "schedule_by": 1.0,
}  # fmt: skip


def simulate(
    servo: ForeignServo,
    load: Load,
    acting: Acting,
    grid: Array,
    arrivals: Array,
    setpoints: Array,
    windows: list[tuple[float, float]],
) -> Array:
    """The angle that the recorded sensor sees, rad, at the times ``grid`` (T,), from rest."""
    rotor = servo.rotor_inertia
    output = load.inertia_kgm2 - rotor
    values = dict(FIELDS)
    values |= {
        "kp": servo.kp, "kd": servo.kd * (1 - servo.firmware_damping),
        "firmware_kd": servo.kd * servo.firmware_damping, "stall": servo.stall_Nm,
        "pendulum": load.gravity_Nm, "ripple": servo.nuisances["ripple_Nm"],
        "waves": servo.nuisances["ripple_per_rad"], "phase": servo.nuisances["ripple_phase"],
        "on_output": float(servo.sensor_on_output or "backlash" in acting),
        "control_on_output": float(servo.control_on_output),
    }  # fmt: skip
    values |= fields_of(acting)
    if "unmodelled_inertia" in acting:
        output += acting["unmodelled_inertia"]["inertia_kgm2"]
    side = "dry_output" if servo.friction_on_output else "dry_rotor"
    values[side] = servo.dry_friction_Nm
    values[side] += acting.get("coulomb_friction", {}).get("torque_Nm", 0.0)
    together = rotor * output / (rotor + output)
    spring, ratio = together * (2 * np.pi * servo.flank[0]) ** 2, servo.flank[1]
    if "compliance" in acting:
        spring, ratio = 1 / acting["compliance"]["compliance_rad_per_Nm"], SPRING_DAMPING
    values |= {"rotor": rotor, "output": output, "spring": spring}
    values["damper"] = 2 * ratio * np.sqrt(spring * together)
    row = np.array([values[name] for name in FIELDS])
    return marched(_march, row, STEP_S, servo.loop_Hz, grid, arrivals, setpoints, windows)


(KP, KD, FIRMWARE_KD, STALL, ROTOR, OUTPUT, PENDULUM, RIPPLE, WAVES, PHASE, GAP, SPRING, DAMPER,
 DRY_ROTOR, DRY_OUTPUT, ON_OUTPUT, CONTROL_ON_OUTPUT, DRAG, DEAD, LIMIT, INTEGRAL, WEIGHT,
 COG, COG_PERIOD, COG_PHASE, PUSH, JAM,
 SHAKE, SHAKE_HZ, SHAKE_PHASE, STOP, STOP_SIDE, STOP_K, SCHEDULE, SCHEDULE_BY,
 ) = range(len(FIELDS))  # fmt: skip


@njit(cache=True)
def _rubbed(v, force, inertia, dry):
    """Speed after a step in which dry friction stops a mass, or slows it."""
    after = v + STEP_S * force / inertia
    most = STEP_S * dry / inertia
    return after - min(max(after, -most), most)


@njit(cache=True)
def _march(p, target, inside, turn, at_once):
    a, va, b, vb = 0.0, 0.0, 0.0, 0.0
    seen, integral, level, drive = 0.0, 0.0, 0.0, 0.0
    half = 0.5 * p[GAP]
    out = np.empty(target.size)
    for k in range(target.size):
        time = k * STEP_S
        out[k] = b if p[ON_OUTPUT] > 0.0 else a
        controlled, its_speed = a, va
        if p[CONTROL_ON_OUTPUT] > 0.0:
            controlled, its_speed = b, vb
        if k % turn == 0:
            seen = controlled
        if k % turn == 0 or at_once:
            error = target[k] - seen
            size = max(abs(error) - p[DEAD], 0.0)
            if size > p[SCHEDULE]:
                size = p[SCHEDULE] + p[SCHEDULE_BY] * (size - p[SCHEDULE])
            drive = p[KP] * size * np.sign(error)
        if p[INTEGRAL] > 0.0:
            most = 0.5 * p[STALL]
            integral = min(max(integral + p[INTEGRAL] * (target[k] - seen) * STEP_S, -most), most)
        asked = drive + integral - p[FIRMWARE_KD] * its_speed
        motor = min(max(asked, -p[STALL]), p[STALL]) - p[KD] * va
        if p[LIMIT] < 1e8:
            motor = min(max(motor, -p[LIMIT]), p[LIMIT])
        level += (inside[k] - level) * STEP_S / 0.04
        apart, faster = a - b, va - vb
        through = 0.0
        if apart > half:
            through = max(p[SPRING] * (apart - half) + p[DAMPER] * faster, 0.0)
        elif apart < -half:
            through = min(p[SPRING] * (apart + half) + p[DAMPER] * faster, 0.0)
        if half == 0.0:
            through = p[SPRING] * apart + p[DAMPER] * faster
        outer = -(p[PENDULUM] + p[WEIGHT]) * np.sin(b) - p[DRAG] * vb * abs(vb)
        outer += p[PUSH] * level
        if p[SHAKE] > 0.0:
            outer += p[SHAKE] * np.sin(2.0 * np.pi * p[SHAKE_HZ] * time + p[SHAKE_PHASE])
        beyond = p[STOP_SIDE] * b - p[STOP]
        if beyond > 0.0:
            outer -= p[STOP_SIDE] * p[STOP_K] * beyond
        inner = p[RIPPLE] * np.sin(p[WAVES] * a + p[PHASE])
        if p[COG] > 0.0:
            inner += p[COG] * np.sin(2.0 * np.pi * a / p[COG_PERIOD] + p[COG_PHASE])
        rub = p[DRY_OUTPUT]
        if p[JAM] > 0.0 and inside[k] > 0.0:
            rub += p[JAM]
        va = _rubbed(va, motor + inner - through, p[ROTOR], p[DRY_ROTOR])
        vb = _rubbed(vb, through + outer, p[OUTPUT], rub)
        a += STEP_S * va
        b += STEP_S * vb
    return out
