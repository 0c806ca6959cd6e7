"""The gear train against two masses advanced in small steps; the context that a servo runs in."""

from dataclasses import replace

import numpy as np
import pytest
from good_input import message
from simulated import INERTIA, LATENCY, recording, row, traced

from sim2real.identification.priors import gains
from sim2real.identification.problem import ServoProblem
from sim2real.identification.search import fit
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.recording import Load
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.gear_train import SPRING_DAMPING
from sim2real.servo.parameters import COLUMNS, LINE, joint_row, stated
from sim2real.servo.prediction import predict_recordings
from sim2real.servo.rollout import rollout, rollout_on
from sim2real.servo.trace import reported_drive, trace

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


SEEN = {"control_on_output": 1.0, "damping_ratio": 0.5}


@pytest.mark.parametrize("dry", [0.0, 0.05])
@pytest.mark.parametrize(
    ("give", "more", "alike"), [(0.05, {}, {}), (0.02, SEEN, {"on_output": 1.0, "ratio": 0.5})]
)
def test_springs_agree_with_small_steps_whichever_end_the_controller_sees(dry, give, more, alike):
    spring = {"compliance_rad_per_Nm": give, "sensor_on_output": 1.0} | more
    angle = simulated(dry, "compliance", spring)
    assert rms(angle - reference(dry, 0.0, compliance=give, **alike)) < 1e-4


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


def column(values, name):
    return values[COLUMNS.index(name)]


def test_every_simulation_heeds_the_context():
    plain = traced()
    soft = replace(plain, gain_ratio=0.25, sample_delay_s=0.003)
    weak = row()
    weak[0] *= 0.25
    weak[COLUMNS.index("latency_s")] -= 0.003
    expected = rollout(weak[None], plain.t, plain.command)[0]
    np.testing.assert_allclose(rollout_on(soft, row()[None])[0], expected, atol=1e-9)
    still = replace(soft, position=np.zeros_like(plain.t))
    batch = Batch([[still, replace(still, gain_ratio=1.0)]])
    problems = Problems(np.zeros(1, dtype=np.int32), row()[None, None], np.zeros((1, 1)))
    angle = batch.evaluate(problems, keep=True).residual[0]
    np.testing.assert_allclose(angle[0], expected, atol=2e-4)
    assert np.abs(angle[1] - expected).max() > 0.01


def test_a_recording_that_samples_late_shows_the_whole_latency():
    delay, sent = 0.0026, recording(seconds=6.0, noise=0.0)
    times = np.sort(np.concatenate([sent.t, sent.t + delay]))
    angle = rollout(row()[None], times, np.repeat(sent.command[:, 0], 2))[0][1::2]
    angle += np.random.default_rng(1).normal(0, 0.0005, angle.size)
    late = replace(sent, position=angle[:, None], metadata={"context": {"sample_delay_s": delay}})
    start = row()
    found = fit(ServoProblem([trace(late, "j1")], start, gains(INERTIA)), start[None])
    assert column(found.row, "latency_s") == pytest.approx(LATENCY, abs=2e-4)
    model = Model({"j1": stated(row(), Load(INERTIA))})
    (rmse,) = predict_recordings([late], model).rmse.values()
    assert rmse < 0.0006


@pytest.mark.parametrize(
    ("context", "gain", "volts"),
    [({"supply_ratio": 0.5}, 0.5, 0.5), ({"gain_ratio": 0.5}, 0.5, 1.0),
     ({"supply_ratio": 0.5, "gain_ratio": 3.0}, 1.5, 0.5)],
)  # fmt: skip
def test_supply_scales_what_the_voltage_gives_and_gain_the_gain(context, gain, volts):
    motor = {"stall_torque_Nm": 0.4, "no_load_speed_rad_s": 5.0}
    model = Model({"j1": replace(stated(row(), Load(INERTIA)), law="motor", motor=motor)})
    there = replace(recording(seconds=4.0), metadata={"context": context})
    (angles,) = predict_recordings([there], model).angles
    scaled = joint_row(model.joints["j1"], None)
    scaled[COLUMNS.index("kp_Nm_per_rad")] *= gain
    scaled[[COLUMNS.index(name) for name in LINE]] *= volts
    expected = rollout(scaled[None], there.t, there.command[:, 0])[0]
    np.testing.assert_allclose(angles[:, 0], expected, atol=1e-9)
    (usual,) = predict_recordings([replace(there, metadata={})], model).angles
    assert np.abs(usual[:, 0] - expected).max() > 0.01


def test_the_reported_drive_of_late_samples_has_the_same_latency():
    t, delay, latency = 0.01 * np.arange(2000), 0.006, 0.008

    def sent(at):
        return 0.3 * np.sin(2 * np.pi * 0.5 * at) + 0.2 * np.sin(2 * np.pi * 1.3 * at)

    angle = sent(t + delay - 0.05)
    drive = sent(t + delay - latency) - angle
    found = reported_drive(t, sent(t), angle, drive, delay)
    assert found.latency_s == pytest.approx(latency, abs=5e-4)


def test_a_context_that_is_none_is_refused_in_one_line():
    bad = replace(recording(), metadata={"context": {"supply_ratio": -1}})
    message(lambda: trace(bad, "j1"), "context.supply_ratio", "-1", "above 0")


def test_an_unknown_parameter_of_the_motor_is_refused():
    joint = replace(stated(row(), Load(INERTIA)), law="motor", motor={"stall_torque": 1.0})
    message(lambda: predict_recordings([recording()], Model({"j1": joint})), "'stall_torque'")


def test_a_controller_that_sees_the_output_s_angle_alone_is_damped_by_the_motor():
    """As with a back-EMF that is all of the damping, which acts on the motor's speed."""
    row = joint_row(JointModel(2.2, 0.06, 0.02, 0.002), None)
    gap = [COLUMNS.index(f"backlash.{x}") for x in ("gap_rad", "rotor_inertia_kgm2")]
    row[gap] = 0.03, 4e-4
    half, back_emf = row.copy(), row.copy()
    half[COLUMNS.index("backlash.control_on_output")] = 0.5
    back_emf[COLUMNS.index("backlash.control_on_output")] = 1.0
    back_emf[[COLUMNS.index(x) for x in LINE]] = 60.0, 1000.0
    t = 0.01 * np.arange(100)
    angles = rollout(np.stack([half, back_emf]), t, 0.5 * (t > 0.1))
    np.testing.assert_allclose(angles[0], angles[1], atol=1e-9)
