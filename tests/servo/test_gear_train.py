"""The gear train against two masses that are advanced one by one in small steps."""

import numpy as np
import pytest

from sim2real.model import FittedEffect, JointModel
from sim2real.recording import Load
from sim2real.servo.gear_train import SPRING_DAMPING
from sim2real.servo.parameters import joint_row
from sim2real.servo.rollout import rollout

KP, KD, LOAD, ROTOR, GAP = 2.6, 0.11, 0.0026, 0.0014, 0.02
T = 0.02 * np.arange(150)
COMMAND = 0.4 * np.sign(np.sin(2 * np.pi * 0.7 * T)) * (T > 0.1)


def reference(
    dry, held, compliance=0.0, step=1e-5, on_output=0.0, restitution=0.0, ratio=SPRING_DAMPING
):
    """Angle of the output, with friction on either side: rigid flanks, or a spring."""
    q = o = v = w = 0.0
    out = []
    stiffness = 1 / compliance if compliance else 0.0
    damper = 2 * ratio * np.sqrt(stiffness * ROTOR * LOAD / (ROTOR + LOAD))
    for u in COMMAND:
        out.append(o)
        for _ in range(round(0.02 / step)):
            through = stiffness * (q - o) + damper * (v - w)
            seen, speed = q + on_output * (o - q), v + on_output * (w - v)
            v += step * (KP * (u - seen) - KD * speed - through) / ROTOR
            v -= min(max(v, -step * dry / ROTOR), step * dry / ROTOR)
            w += step * through / LOAD
            w -= min(max(w, -step * held / LOAD), step * held / LOAD)
            lead = q - o + step * (v - w)
            if not compliance and abs(lead) >= GAP / 2 and lead * (v - w) > 0:
                together, rate = (ROTOR * v + LOAD * w) / (ROTOR + LOAD), restitution * (w - v)
                v, w = (
                    together + rate * LOAD / (ROTOR + LOAD),
                    together - rate * ROTOR / (ROTOR + LOAD),
                )
            q, o = q + step * v, o + step * w
    return np.array(out)


def simulated(dry, effect, parameters, command=COMMAND, **settings):
    effects = [FittedEffect(effect, {"rotor_inertia_kgm2": ROTOR} | parameters)]
    if dry:
        effects.append(FittedEffect("coulomb_friction", {"torque_Nm": dry}))
    return with_effects(effects, command=command, **settings)


def with_effects(effects, motor=None, load=LOAD, command=COMMAND, **settings):
    joint = JointModel(KP, KD, 0.0, load, motor=motor or {}, effects=tuple(effects))
    return rollout(joint_row(joint, Load(load))[None], T, command, **settings)[0]


def rms(x):
    return np.sqrt(np.mean(x**2))


@pytest.mark.parametrize(("dry", "held"), [(0.06, 0.02), (0.0, 0.06), (0.03, 0.0), (0.0, 0.0)])
def test_friction_acts_on_the_side_that_has_it(dry, held):
    angle = simulated(dry, "backlash", {"gap_rad": GAP, "output_friction_Nm": held})
    assert rms(angle - reference(dry, held)) < 1e-4


@pytest.mark.parametrize(("dry", "held"), [(0.03, 0.06), (0.0, 0.03)])
@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("on_output", [0.0, 1.0])
def test_flanks_rebound_and_the_controller_sees_either_side(dry, held, restitution, on_output):
    play = {"gap_rad": GAP, "output_friction_Nm": held}
    play |= {"control_on_output": on_output, "restitution": restitution}
    angle = simulated(dry, "backlash", play, substep_s=1e-4)
    expected = reference(dry, held, on_output=on_output, restitution=restitution)
    assert rms(angle - expected) < 3e-4


@pytest.mark.parametrize("dry", [0.0, 0.05])
def test_a_controller_that_sees_the_end_of_a_spring(dry):
    spring = {"compliance_rad_per_Nm": 0.02, "sensor_on_output": 1.0}
    spring |= {"control_on_output": 1.0, "damping_ratio": 0.5}
    angle = simulated(dry, "compliance", spring)
    expected = reference(dry, 0.0, compliance=0.02, on_output=1.0, ratio=0.5)
    assert rms(angle - expected) < 1e-4


@pytest.mark.parametrize("dry", [0.0, 0.05])
def test_a_spring_agrees_with_small_steps(dry):
    angle = simulated(dry, "compliance", {"compliance_rad_per_Nm": 0.05, "sensor_on_output": 1.0})
    assert rms(angle - reference(dry, 0.0, compliance=0.05)) < 1e-4


def play(rotor):
    return FittedEffect("backlash", {"gap_rad": GAP, "rotor_inertia_kgm2": rotor})


def left_out(inertia):
    return FittedEffect("unmodelled_inertia", {"inertia_kgm2": inertia})


@pytest.mark.parametrize(
    ("effects", "motor", "load"),
    [
        ([play(0.0), left_out(ROTOR)], 0.0, LOAD),  # what the load leaves out is the rotor
        ([play(0.0)], ROTOR, LOAD),  # the rotor of the motor's law
        ([play(0.4 * ROTOR)], 0.6 * ROTOR, LOAD),  # the effect's rotor adds to it
        ([play(ROTOR), left_out(0.3 * LOAD)], 0.0, 0.7 * LOAD),  # a load that is stated too small
        ([play(ROTOR), left_out(-ROTOR)], 0.0, LOAD + ROTOR),  # one that includes the rotor
    ],
)
def test_the_rotor_adds_to_the_load_by_whatever_name(effects, motor, load):
    seen = with_effects(effects, {"rotor_inertia_kgm2": motor}, load, substep_s=0.001)
    stated = simulated(0.0, "backlash", {"gap_rad": GAP}, substep_s=0.001)
    np.testing.assert_allclose(seen, stated, atol=1e-9)


@pytest.mark.parametrize("effect", ["backlash", "compliance"])
def test_a_rigid_train_turns_rotor_and_load_together(effect):
    """Neither gap nor spring: a servo whose load has the inertia of both."""
    rotor = FittedEffect(effect, {"rotor_inertia_kgm2": ROTOR})
    seen = with_effects([rotor], substep_s=0.001)
    rigid = with_effects([], load=LOAD + ROTOR, substep_s=0.001)
    np.testing.assert_allclose(seen, rigid, atol=1e-4)


def test_contacts_are_of_second_order():
    play = {"gap_rad": GAP, "output_friction_Nm": 0.06}
    exact, *angles = (
        simulated(0.0, "backlash", play, substep_s=step) for step in (2e-5, 1e-3, 4e-3)
    )
    fine, coarse = (rms(angle - exact) for angle in angles)
    assert coarse < 3e-4
    assert fine < coarse / 8  # a quarter of the sub-step: 16 times


def test_a_spring_held_by_friction_stays_at_rest():
    command = np.where(T > 0.1, 0.5 * 0.1 / KP, 0.0)
    spring = {"compliance_rad_per_Nm": 0.05, "sensor_on_output": 0.0}
    assert np.abs(simulated(0.1, "compliance", spring, command)).max() == 0.0


def test_the_motor_is_measured_or_the_load():
    def angle(side):
        spring = {"compliance_rad_per_Nm": 0.05, "rotor_inertia_kgm2": ROTOR}
        effect = FittedEffect("compliance", spring | {"sensor_on_output": side})
        return with_effects([effect])

    between = 0.5 * (angle(0.0) + angle(1.0))
    np.testing.assert_allclose(angle(0.5), between, atol=1e-12)
    assert np.abs(angle(0.0) - angle(1.0)).max() > 0.01
