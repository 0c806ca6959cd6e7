import numpy as np
import simulated

from sim2real.model import FittedEffect, JointModel
from sim2real.posterior.servo import servo_priors
from sim2real.servo.parameters import COLUMNS


def test_priors_of_a_servo_and_its_effects():
    effects = (FittedEffect("backlash", {"gap_rad": 0.03}),
               FittedEffect("latency_jitter", {"halfwidth_s": 0.01}))  # fmt: skip
    joint = JointModel(simulated.KP, simulated.KD, simulated.LATENCY, simulated.INERTIA,
                       effects=effects)  # fmt: skip
    priors = servo_priors(joint)
    assert priors.names[3:] == ("backlash.gap_rad",)  # what is random is held
    assert set(priors.names) <= set(COLUMNS)
    truth = np.array([simulated.KP, simulated.KD, simulated.LATENCY, 0.03])
    low, high = np.array([[p.low, p.high] for p in priors.each]).T
    assert ((low < truth) & (truth < high)).all()
    assert priors.each[3].unit == "rad" and "log-uniform" in str(priors.each[0])
