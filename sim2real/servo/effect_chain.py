"""The chain from a command to the sensor: at each site a number passes through all active effects.

Sites are those of ``sim2real.effects.effect``; symbols those of ``law``.
"""

import warp as wp

from sim2real.effects import CATALOGUE
from sim2real.effects.effect import F, Row
from sim2real.servo.motor import read_motor
from sim2real.servo.parameters import FIRST_CELL, FIRST_COLUMN, TRAIN_ROTORS


def _at(site: str) -> tuple[list[wp.Function], list[int], list[int], list[int], int]:
    """Terms, columns, cells and bits of the effects at one site, and the sum of their bits."""
    entries = [
        (k, effect, term)
        for k, effect in enumerate(CATALOGUE)
        for place, term in ((effect.site, effect.term), *effect.also)
        if place == site
    ]
    entries.sort(key=lambda entry: entry[1].order)
    return (
        [term for _, _, term in entries],
        [FIRST_COLUMN[effect.name] for _, effect, _ in entries],
        [FIRST_CELL[effect.name] for _, effect, _ in entries],
        [1 << k for k, _, _ in entries],
        sum(1 << k for k, _, _ in entries),
    )


def _chain(site: str) -> wp.Function:
    """The function that applies all active effects of one site in order."""
    terms, columns, cells, bits, all_bits = _at(site)

    @wp.func
    def chain(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, z: Row, active: wp.int64) -> F:
        if (active & wp.static(wp.int64(all_bits))) == wp.int64(0):
            return x
        for k in range(wp.static(len(terms))):
            if (active & wp.static(wp.int64(bits[k]))) != wp.int64(0):
                x = wp.static(terms[k])(
                    x, q, v, torque, time, h, p, wp.static(columns[k]), z, wp.static(cells[k])
                )
        return x

    return chain


arrival_time = _chain("arrival")
command_in_force = _chain("command")
error_seen = _chain("error")
motor_torque = _chain("motor")
load_torque = _chain("load")
friction_bound = _chain("friction")
other_inertia = _chain("inertia")
measured_angle = _chain("sensor")

SENSOR_BITS = _at("sensor")[-1]
"""Bits of the effects on the sensor."""
FOLLOWING_BITS = SENSOR_BITS & ~sum(1 << k for k, effect in enumerate(CATALOGUE) if effect.steady)
"""Bits of those with state, which must be evaluated in every sub-step."""
MOTOR_TORQUE_BITS = _at("motor")[-1]
"""Bits of the effects on the motor's torque."""


@wp.func
def train_rotor(p: Row) -> F:
    """Inertia of the rotor in kg m2 that a gear train of two masses states; 0 where none does."""
    rotor = p[wp.static(TRAIN_ROTORS[0])]
    if rotor == wp.float64(0.0):
        rotor = p[wp.static(TRAIN_ROTORS[1])]
    return rotor


@wp.func
def shaft_inertia(inertia: F, p: Row, z: Row, active: wp.int64) -> F:
    """Inertia on the shaft in kg m2: of the load, of the rotor and of effects."""
    zero = wp.float64(0.0)
    inertia += read_motor(p).rotor + train_rotor(p)
    return other_inertia(inertia, zero, zero, zero, zero, zero, p, z, active)
