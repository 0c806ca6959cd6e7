"""Play and springs against two bodies that are integrated one by one, in small steps."""

import numpy as np
import pytest

from sim2real.model import FittedEffect, JointModel
from sim2real.recording import Load
from sim2real.servo.parameters import joint_row
from sim2real.servo.rollout import rollout

KP, KD, J, ROTOR = 2.0, 0.06, 0.0015, 5e-4
LOAD, WHOLE = (Load(inertia, 0.1, 0.1) for inertia in (J, J + ROTOR))
T = 0.01 * np.arange(100)
COMMAND = 0.4 * np.sign(np.sin(2 * np.pi * T / 0.5 + 0.1))
GAP, STIFF, DAMPING = 0.03, 5000.0, 2.0
GIVES = 0.02


def contact(twist, speed):
    """Torque through a contact with play, stiff and damped."""
    beyond = np.sign(twist) * max(abs(twist) - GAP / 2, 0.0)
    return STIFF * beyond + DAMPING * speed * (beyond != 0)


def spring(twist, speed):
    """Torque through a spring that hardly rings."""
    return twist / GIVES + 0.05 * speed


def two_bodies(between, twist):
    """Angles of motor and load at ``T``, the motor ahead by ``twist`` at first."""
    h, per = 2e-5, 500
    q = COMMAND[0]
    for _ in range(30):
        q = COMMAND[0] - LOAD.gravity_Nm * np.sin(q) / KP
    ql = q - twist(LOAD.gravity_Nm * np.sin(q))
    v = vl = 0.0
    out = []
    for u in COMMAND:
        out.append((q, ql))
        for _ in range(per):
            through = between(q - ql, v - vl)
            v += h * (KP * (u - q) - KD * v - through) / ROTOR
            vl += h * (through - LOAD.gravity_Nm * np.sin(ql)) / J
            q, ql = q + h * v, ql + h * vl
    return np.array(out).T


def apart(effect, parameters, load, expected):
    """Root mean square of what the effect's law gets wrong, in rad."""
    joint = JointModel(KP, KD, 0.0, J, effects=(FittedEffect(effect, parameters),))
    row = joint_row(joint, load)[None]
    found = rollout(row, T, COMMAND, steps_per_radian=64.0)[0]
    return np.sqrt(np.mean((found - expected) ** 2))


@pytest.mark.parametrize(
    ("effect", "parameters", "between", "twist", "side"),
    [
        ("backlash", {"gap_rad": GAP}, contact, lambda torque: GAP / 2 + torque / STIFF, 1),
        ("compliance", {"compliance_rad_per_Nm": GIVES}, spring, lambda torque: torque * GIVES, 0),
    ],
)
def test_the_rotor_moves_by_itself(effect, parameters, between, twist, side):
    expected = two_bodies(between, twist)[side]
    with_rotor = apart(effect, parameters | {"rotor_inertia_kgm2": ROTOR}, LOAD, expected)
    without = apart(effect, parameters, WHOLE, expected)
    assert 2 * with_rotor < min(without, 4e-3)
