"""Two rival sets of one joint: dry friction and a dead band, with what a recording left of them."""

import numpy as np
from simulated import INERTIA, KD, KP, LATENCY, PERIOD

from sim2real.diagnose.rival_sets import JointRivals, RivalSet
from sim2real.model import FittedEffect, JointModel
from sim2real.recording import Load
from sim2real.servo.parameters import COLUMNS, joint_row


def rival(probability, effect, **parameters):
    servo = JointModel(KP, KD, LATENCY, INERTIA, effects=(FittedEffect(effect, parameters),))
    names = ("kp_Nm_per_rad", "kd_Nms_per_rad", f"{effect}.{next(iter(parameters))}")
    columns = np.array([COLUMNS.index(name) for name in names], dtype=np.int32)
    sd = np.array([0.02, 0.002, 0.2 * next(iter(parameters.values()))])
    correlation = np.array([[1.0, 0.3, 0.0], [0.3, 1.0, 0.2], [0.0, 0.2, 1.0]])
    information = np.linalg.inv(correlation * np.outer(sd, sd))
    return RivalSet(
        (effect,), probability, 20.0, joint_row(servo, Load(INERTIA)), columns, information
    )


RIVALS = JointRivals(
    component="j1",
    load=Load(INERTIA),
    period_s=PERIOD,
    noise_rad=0.002,
    autoregression=np.zeros(25),
    sets=(
        rival(0.6, "coulomb_friction", torque_Nm=0.006),
        rival(0.4, "deadband", halfwidth_rad=0.003),
    ),
)


def commands():
    """Three commands of 4 s that begin at rest, shape (3, 200)."""
    t = PERIOD * np.arange(200)
    going = t > 0.5
    return np.array(
        [
            0.3 * np.sin(2 * np.pi * 0.7 * (t - 0.5)) * going,
            0.05 * np.sin(2 * np.pi * 2.0 * (t - 0.5)) * going,
            0.4 * np.sign(np.sin(2 * np.pi * 0.5 * (t - 0.5))) * going,
        ]
    )
