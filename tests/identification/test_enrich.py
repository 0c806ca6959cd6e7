"""Effects fitted with the gains: known ones come back, and held-out error falls to the noise."""

import numpy as np
import pytest

from sim2real.effects import named
from sim2real.effects.effect import scaled
from sim2real.identification.identify import identify
from sim2real.model import FittedEffect, JointModel
from sim2real.recording import Load, Recording
from sim2real.robot import Joint, Link, Robot, Servo
from sim2real.servo.parameters import joint_row
from sim2real.servo.rollout import rollout

NOISE_RAD = 0.001


def record(effects, name, seed):
    """Twenty seconds of steps of a servo that has ``effects``, simulated finely."""
    rng = np.random.default_rng(seed)
    t = 0.02 * np.arange(1000) + rng.normal(0, 3e-4, 1000)
    changes = np.cumsum(rng.uniform(0.4, 1.2, 100)) + 0.5
    command = np.append(0.0, rng.uniform(-0.6, 0.6, 100))[np.searchsorted(changes, t)]
    fitted = tuple(FittedEffect(e, p) for e, p in effects.items())
    row = joint_row(JointModel(2.2, 0.06, 0.0683, 0.002, effects=fitted), None)
    angle = rollout(row[None], t, command, steps_per_radian=150.0)[0]
    noisy = (angle + rng.normal(0, NOISE_RAD, t.size))[:, None]
    return Recording(name, "servo", ("j1",), t, command[:, None], noisy, {"j1": Load(0.002)})


def bench():
    link = Link("link", 0.1, 0.1, 0.1, 0.1)
    return Robot("bench", (link, link), (Joint("j1", Servo("s", 9.0, 99.0, 0.0), (-1.0, 1.0)),))


@pytest.mark.parametrize(
    "effects",
    [
        {"coulomb_friction": {"torque_Nm": 0.04}},
        {"torque_saturation": {"limit_Nm": 0.6}},
        {"backlash": {"gap_rad": 0.03, "rotor_inertia_kgm2": 5e-4}},
        {"rate_limit": {"limit_rad_s": 4.0}},
        {"load_friction": {"ratio": 0.2}, "sensor_offset": {"offset_rad": 0.02}},
    ],
    ids=lambda effects: "+".join(effects),
)
def test_a_known_effect_is_recovered_with_the_gains(effects):
    recordings = [record(effects, name, seed) for seed, name in enumerate(("a", "b"))]
    model = identify(recordings, bench(), effects=list(effects))
    joint, figures = model.joints["j1"], model.fit["j1.position_rad"]
    assert joint.kp_Nm_per_rad == pytest.approx(2.2, rel=0.03)
    assert joint.latency_s == pytest.approx(0.0683, abs=0.002)
    for fitted in joint.effects:
        for name, value in effects[fitted.effect].items():
            assert fitted.parameters[name] == pytest.approx(value, rel=0.1)
            low, high = joint.interval[f"{fitted.effect}.{name}"]
            assert low < fitted.parameters[name] < high
    assert figures["heldout"] < 1.15 * NOISE_RAD
    assert figures["heldout_without_effects"] > 1.5 * figures["heldout"]


def test_an_effect_that_is_not_there_comes_out_as_nothing():
    model = identify(
        [record({}, "a", 0), record({}, "b", 1)], bench(), effects=["coulomb_friction"]
    )
    joint = model.joints["j1"]
    assert joint.effects[0].parameters["torque_Nm"] < 0.002
    assert joint.interval["coulomb_friction.torque_Nm"][0] == 0.0
    assert joint.kp_Nm_per_rad == pytest.approx(2.2, rel=0.02)


def test_parameters_scale_with_the_servo():
    torque = named("coulomb_friction").parameters[0]
    assert scaled(torque, 4.0, 0.002).typical == 2 * torque.typical
    inertia = named("unmodelled_inertia").parameters[0]
    assert scaled(inertia, 4.0, 0.004).typical == 2 * inertia.typical
    gap = named("backlash").parameters[0]
    assert scaled(gap, 4.0, 0.004) == gap
