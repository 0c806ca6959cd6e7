"""The gear train against two masses that are advanced one by one in small steps."""

import numpy as np
import pytest

from sim2real.model import FittedEffect, JointModel
from sim2real.recording import Load
from sim2real.servo.parameters import joint_row
from sim2real.servo.rollout import rollout

KP, KD, INERTIA, ROTOR, GAP = 2.6, 0.11, 0.004, 0.0014, 0.02
T = 0.02 * np.arange(150)
COMMAND = 0.4 * np.sign(np.sin(2 * np.pi * 0.7 * T)) * (T > 0.1)


def reference(dry, held, step=2e-5):
    """Angle of the output: rigid flanks, inelastic impacts, friction on motor and output."""
    q = o = v = w = 0.0
    out, mass = [], INERTIA - ROTOR
    for u in COMMAND:
        out.append(o)
        for _ in range(round(0.02 / step)):
            v += step * (KP * (u - q) - KD * v) / ROTOR
            v -= min(max(v, -step * dry / ROTOR), step * dry / ROTOR)
            w -= min(max(w, -step * held / mass), step * held / mass)
            lead = q - o + step * (v - w)
            if abs(lead) >= GAP / 2 and lead * (v - w) > 0:
                v = w = (ROTOR * v + mass * w) / INERTIA
            q, o = q + step * v, o + step * w
    return np.array(out)


@pytest.mark.parametrize(("dry", "held"), [(0.06, 0.02), (0.0, 0.06), (0.03, 0.0)])
def test_friction_acts_on_the_side_that_has_it(dry, held):
    play = {"gap_rad": GAP, "rotor_inertia_kgm2": ROTOR, "output_friction_Nm": held}
    effects = [FittedEffect("backlash", play)]
    if dry:
        effects.append(FittedEffect("coulomb_friction", {"torque_Nm": dry}))
    joint = JointModel(KP, KD, 0.0, INERTIA, effects=tuple(effects))
    angle = rollout(joint_row(joint, Load(INERTIA))[None], T, COMMAND)[0]
    assert np.sqrt(np.mean((angle - reference(dry, held)) ** 2)) < 3e-4


def test_the_motor_is_measured_or_the_load():
    def angle(side):
        spring = {"compliance_rad_per_Nm": 0.05, "rotor_inertia_kgm2": ROTOR}
        effect = FittedEffect("compliance", spring | {"sensor_on_output": side})
        joint = JointModel(KP, KD, 0.0, INERTIA, effects=(effect,))
        return rollout(joint_row(joint, Load(INERTIA))[None], T, COMMAND)[0]

    between = 0.5 * (angle(0.0) + angle(1.0))
    np.testing.assert_allclose(angle(0.5), between, atol=1e-12)
    assert np.abs(angle(0.0) - angle(1.0)).max() > 0.01
