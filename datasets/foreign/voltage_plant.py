"""A hobby servo by its circuit: firmware that clips its duty, back-EMF, friction by load.

After Duclusaud, Passault, Padois, Ly, "Extended Friction Models for the Physics Simulation of Servo
Actuators" (ICRA 2025): friction is solved for in each step, as large as would stop the shaft and no
larger than its level allows. Semi-implicit steps of 0.1 ms. Needs ``pip install numba``.
"""

from __future__ import annotations

import numpy as np
from bench import Load
from foreign_servos import ForeignServo
from foreign_world import Acting, fields_of, marched
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S = 1e-4
FIELDS = {  # with the value at which each does nothing
    "kp": 1.0, "stall": 1e9, "emf": 0.0, "inertia": 1.0, "pendulum": 0.0,
    "ripple": 0.0, "waves": 1.0, "phase": 0.0,
    "dry": 0.0, "breakaway": 0.0, "slow": 1.0, "asymmetric": 0.0, "of_load": 0.0,
    "drag": 0.0, "dead": 0.0, "limit": 1e9, "lopsided": 0.0, "integral": 0.0, "weight": 0.0,
    "cog": 0.0, "cog_period": 1.0, "cog_phase": 0.0, "heat_loss": 0.0, "heat_ref": 1.0,
    "droop": 0.0, "push": 0.0, "jam": 0.0, "off": 0.0, "shake": 0.0, "shake_Hz": 1.0,
    "shake_phase": 0.0, "stop": 1e9, "stop_side": 1.0, "stop_k": 0.0,
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
    """The shaft's angle, rad, at the times ``grid`` (T,), from rest."""
    values = dict(FIELDS)
    values |= {
        "kp": servo.kp, "stall": servo.stall_Nm, "emf": servo.kd, "inertia": load.inertia_kgm2,
        "pendulum": load.gravity_Nm, "ripple": servo.nuisances["ripple_Nm"],
        "waves": servo.nuisances["ripple_per_rad"], "phase": servo.nuisances["ripple_phase"],
    }  # fmt: skip
    values |= fields_of(acting)
    if "unmodelled_inertia" in acting:
        values["inertia"] += acting["unmodelled_inertia"]["inertia_kgm2"]
    if "stribeck_friction" in acting:
        values["breakaway"] -= values["dry"]
    if "brown_out" in acting:
        values["off"] = 1.0
    row = np.array([values[name] for name in FIELDS])
    return marched(_march, row, STEP_S, servo.loop_Hz, grid, arrivals, setpoints, windows)


(KP, STALL, EMF, INERTIA, PENDULUM, RIPPLE, WAVES, PHASE, DRY, BREAKAWAY, SLOW, ASYMMETRIC, OF_LOAD,
 DRAG, DEAD, LIMIT, LOPSIDED, INTEGRAL, WEIGHT, COG, COG_PERIOD, COG_PHASE, HEAT_LOSS, HEAT_REF,
 DROOP, PUSH, JAM, OFF, SHAKE, SHAKE_HZ, SHAKE_PHASE, STOP, STOP_SIDE, STOP_K, SCHEDULE,
 SCHEDULE_BY) = range(len(FIELDS))  # fmt: skip


@njit(cache=True)
def _march(p, target, inside, turn, at_once):
    q, v, seen, integral, heat, drive = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    out = np.empty(target.size)
    level = 0.0
    for k in range(target.size):
        time = k * STEP_S
        out[k] = q
        if k % turn == 0:
            seen = q
        if k % turn == 0 or at_once:
            error = target[k] - seen
            size = max(abs(error) - p[DEAD], 0.0)
            if size > p[SCHEDULE]:
                size = p[SCHEDULE] + p[SCHEDULE_BY] * (size - p[SCHEDULE])
            drive = p[KP] * size * np.sign(error)
        if p[INTEGRAL] > 0.0:
            most = 0.5 * p[STALL]
            integral = min(max(integral + p[INTEGRAL] * (target[k] - seen) * STEP_S, -most), most)
        full = p[STALL] * (1.0 - p[DROOP] * time / 60.0)
        # Duty: share of the supply. Torque falls with the supply and with speed.
        duty = min(max((drive + integral) / p[STALL], -1.0), 1.0)
        if p[OFF] > 0.0 and inside[k] > 0.0:
            duty = 0.0
        motor = duty * full - p[EMF] * v
        motor = min(max(motor, -p[LIMIT]), p[LIMIT])
        if p[HEAT_LOSS] > 0.0:
            heat += (motor * motor / p[HEAT_REF] - heat) * STEP_S / 30.0
            motor *= 1.0 - p[HEAT_LOSS] * (1.0 - np.exp(-heat))
        motor *= 1.0 + 0.5 * p[LOPSIDED] * np.sign(motor)
        level += (inside[k] - level) * STEP_S / 0.04
        outer = -(p[PENDULUM] + p[WEIGHT]) * np.sin(q) - p[DRAG] * v * abs(v)
        outer += p[RIPPLE] * np.sin(p[WAVES] * q + p[PHASE])
        if p[COG] > 0.0:
            outer += p[COG] * np.sin(2.0 * np.pi * q / p[COG_PERIOD] + p[COG_PHASE])
        outer += p[PUSH] * level
        if p[SHAKE] > 0.0:
            outer += p[SHAKE] * np.sin(2.0 * np.pi * p[SHAKE_HZ] * time + p[SHAKE_PHASE])
        beyond = p[STOP_SIDE] * q - p[STOP]
        if beyond > 0.0:
            outer -= p[STOP_SIDE] * p[STOP_K] * beyond
        rub = p[DRY] + p[OF_LOAD] * abs(motor)
        if p[BREAKAWAY] > 0.0:
            rub += p[BREAKAWAY] * np.exp(-((v / p[SLOW]) ** 2))
        if p[JAM] > 0.0 and inside[k] > 0.0:
            rub += p[JAM]
        stopping = -(motor + outer) - p[INERTIA] * v / STEP_S
        if p[ASYMMETRIC] != 0.0:
            rub *= 1.0 - p[ASYMMETRIC] * np.sign(stopping)
        friction = min(max(stopping, -rub), rub)
        v += STEP_S * (motor + outer + friction) / p[INERTIA]
        q += STEP_S * v
    return out
