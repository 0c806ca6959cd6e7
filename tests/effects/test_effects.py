"""The catalogue: every effect is well formed, absent at 0, and does what its equation says."""

import inspect
import itertools
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sim2real.effects import CATALOGUE, named
from sim2real.errors import InputError
from sim2real.model import FittedEffect, JointModel
from sim2real.servo.parameters import CELLS, joint_row
from sim2real.servo.rollout import STEPS_PER_RADIAN, active_effects, rollout
from sim2real.units import readable, unit_of

KP, KD, LATENCY, INERTIA = 2.2, 0.06, 0.05, 0.002
T = 0.01 * np.arange(600)
STEP = np.where(T > 0.2, 0.4, 0.0)
SQUARE = np.where(T > 0.3, 0.5 * np.sign(np.sin(np.pi * T)), 0.0)

SPECIFIED = {  # the joint, supply and link rows of the file format
    "coulomb_friction", "stribeck_friction", "asymmetric_friction", "load_friction",
    "quadratic_drag", "backlash", "compliance", "deadband", "torque_saturation",
    "torque_asymmetry", "rate_limit", "integral_action", "command_filter", "acceleration_limit",
    "presliding_friction", "gravity_load", "unmodelled_inertia", "cogging", "thermal_derating",
    "encoder_quantization", "sensor_offset", "sensor_gain", "sensor_filter", "voltage_sag",
    "supply_droop", "latency_jitter", "packet_loss", "clock_drift",
}  # fmt: skip


def row(kp=KP, kd=KD, latency=LATENCY, inertia=INERTIA, **effects):
    fitted = tuple(FittedEffect(name, parameters) for name, parameters in effects.items())
    return joint_row(JointModel(kp, kd, latency, inertia, effects=fitted), None)[None]


def simulate(command=STEP, t=T, accuracy=STEPS_PER_RADIAN, **values):
    return rollout(row(**values), t, command, steps_per_radian=accuracy)[0]


def typical(effect):
    values = {parameter.name: parameter.typical for parameter in effect.parameters}
    if effect.name == "compliance":  # at the stability limit with a controller of the load
        values["control_on_output"] = 0.0
    return values


def each(*names):
    effects = [named(name) for name in names] if names else CATALOGUE
    return pytest.mark.parametrize("effect", effects, ids=lambda effect: effect.name)


@pytest.fixture(scope="module")
def plain():
    return simulate(SQUARE)


def test_the_catalogue_is_complete_and_each_name_stands_once():
    names = [effect.name for effect in CATALOGUE]
    assert len(set(names)) == len(names)
    assert set(names) >= SPECIFIED
    with pytest.raises(InputError, match="magic"):
        named("magic")


@each()
def test_effect_is_documented_and_bounded(effect):
    module = sys.modules[f"sim2real.effects.servo.{effect.name}"]
    text = " ".join(module.__doc__.split())
    assert "Confused with" in text or "Nothing else" in text
    assert effect.parameters
    for parameter in effect.parameters:
        assert parameter.low <= parameter.typical <= parameter.high
        assert parameter.low < parameter.high
    said = effect.statement(typical(effect))
    assert effect.plain and not set("{}_") & set(said + effect.plain)
    assert not effect.plain.endswith(".") and not said.endswith("."), "they are clauses"
    assert effect.statement({p.name: p.high for p in effect.parameters}) != said
    sites = [effect.site, *(site for site, _ in effect.also)]
    assert len(set(sites)) == len(sites), "further terms act elsewhere"
    readme = (Path(inspect.getfile(named)).parent / "README.md").read_text()
    assert any(f"| `{effect.name}` | {site} | {effect.component} |" in readme for site in sites)


@pytest.mark.parametrize(
    ("name", "value", "said", "unit"),
    [
        ("gap_rad", np.radians(1.7), "1.7°", "rad"),
        ("time_constant_s", 0.03, "30 ms", "s"),
        ("loss_at_full_load", 0.12, "12 %", ""),
        ("torque_Nm", 0.05, "0.05 N m", "N m"),
        ("limit_rad_s", 1234.5, "1230 rad/s", "rad/s"),
        ("limit_rad_s2", 999.9, "1000 rad/s²", "rad/s²"),
        ("compliance_rad_per_Nm", np.radians(2.0), "2° per N m", "rad/(N m)"),
        ("ki_Nm_per_rad_s", 5236.0, "5240 N m/(rad s)", "N m/(rad s)"),
        ("coefficient_Nms2", 0.0123456, "0.0123 N m s²", "N m s²"),
        ("s_per_s", 1e-4, "100 ppm", "s/s"),
    ],
)
def test_values_are_said_in_units_that_people_read(name, value, said, unit):
    assert readable(name, value) == said
    assert unit_of(name) == unit


def test_one_mechanism_is_one_family_which_excludes_one_another_on_the_shaft():
    families = {}
    for effect in CATALOGUE:
        assert effect.excludes(effect)
        families.setdefault(effect.family, set()).add(effect.name)
    assert all(len(names) > 1 for family, names in families.items() if family)
    filters = {"command_filter", "sensor_filter"}
    assert filters <= families["filter"]
    frictions = ("coulomb", "stribeck", "asymmetric", "presliding")
    frictions = [named(f"{kind}_friction") for kind in frictions]
    assert {effect.name for effect in frictions} <= families["dry friction"]
    assert all(one.excludes(other) for one, other in itertools.permutations(frictions, 2))
    pairs = itertools.permutations(map(named, ("coulomb_friction", *filters)), 2)
    assert not any(one.excludes(other) for one, other in pairs)


@each()
def test_effect_matters_is_off_at_zero_and_does_not_depend_on_the_step(effect, plain):
    values = {effect.name: typical(effect)}
    coarse = simulate(SQUARE, **values)
    assert np.abs(coarse - plain).max() > 1e-3
    zero = {effect.name: dict.fromkeys(typical(effect), 0.0)}
    assert active_effects(row(**zero))[0] == 0
    np.testing.assert_array_equal(simulate(SQUARE, **zero), plain)
    fine = simulate(SQUARE, accuracy=2 * STEPS_PER_RADIAN, **values)
    # the torque that sags is that of the sub-step before
    assert np.abs(coarse - fine).max() < (4e-4 if effect.name == "voltage_sag" else 3e-4)
    assert np.isfinite(coarse).all()


def test_all_effects_run_together():
    everything = {effect.name: typical(effect) for effect in CATALOGUE}
    assert np.isfinite(simulate(SQUARE, **everything)).all()
    assert sum(effect.memory for effect in CATALOGUE) + 2 == CELLS  # the drive that is held, a load


def test_an_effect_the_catalogue_lacks_is_refused():
    with pytest.raises(InputError, match=r"magic.*expected one of .*coulomb_friction"):
        row(magic={"x": 1.0})
    with pytest.raises(InputError, match="torque_Nm"):
        row(coulomb_friction={"limit": 1.0})


def test_each_effect_has_its_own_memory():
    """Two servos with memory in one batch do not share it, nor does a second run remember."""
    rows = np.vstack(
        [row(backlash={"gap_rad": g}, command_filter={"time_constant_s": 0.03}) for g in (0.1, 0.2)]
    )
    together = rollout(rows, T, SQUARE)
    alone = [rollout(rows[[k]], T, SQUARE)[0] for k in range(2)]
    np.testing.assert_array_equal(together, np.stack(alone))


# Friction


@each("coulomb_friction", "presliding_friction")
def test_friction_holds_what_is_below_it(effect):
    values = {"torque_Nm": 0.05} | ({"stiffness_Nm_per_rad": 100.0} if effect.memory else {})
    crawl = np.where(T > 0.2, 0.02, 0.0)
    assert np.ptp(simulate(crawl, **{effect.name: values})) < 4e-3
    assert simulate(np.where(T > 0.2, 0.1, 0.0), **{effect.name: values})[-1] > 0.06


@pytest.mark.parametrize("ratio", [0.0, 0.05])
def test_a_bristle_that_holds_rings_down_as_its_damping_says(ratio):
    """A push far too weak to make it slip: the logarithmic decrement is that of a damped spring."""
    stiffness, t = 20.0, 0.0001 * np.arange(5000)
    bristle = {"torque_Nm": 50.0, "stiffness_Nm_per_rad": stiffness, "damping_ratio": ratio}
    weak, command = 0.02 * stiffness, np.where(t > 0.01, 0.05, 0.0)
    swing = rollout(row(kp=weak, kd=0.0, latency=0.0, presliding_friction=bristle), t, command)[0]
    swing = swing - 0.05 * weak / (weak + stiffness)
    peaks = swing[1:-1][(swing[1:-1] > swing[:-2]) & (swing[1:-1] >= swing[2:]) & (t[1:-1] > 0.02)]
    lost = np.diff(np.log(peaks)).mean()
    own = ratio * np.sqrt(stiffness / (weak + stiffness))
    assert lost == pytest.approx(-2 * np.pi * own / np.sqrt(1 - own**2), rel=0.03, abs=2e-3)


def coast(**effects):
    """Accelerations while the shaft coasts with its torque off, per second squared."""
    t = 0.001 * np.arange(400)
    command = np.where(t < 0.05, 0.5, np.nan)
    command[0] = 0.0
    angle = simulate(command, t, latency=0.0, **effects)
    return np.gradient(angle, 0.001)[60:115], np.diff(angle[59:116], 2) / 1e-6


@pytest.mark.parametrize(
    ("effects", "torque"),
    [
        ({"coulomb_friction": {"torque_Nm": 0.02}}, lambda speed: 0.02),
        ({"quadratic_drag": {"coefficient_Nms2": 0.0005}}, lambda speed: 0.0005 * speed**2),
        ({"asymmetric_friction": {"torque_Nm": 0.02, "asymmetry": 0.5}}, lambda speed: 0.03),
    ],
    ids=lambda given: "+".join(given) if isinstance(given, dict) else "",
)
def test_friction_and_drag_decelerate_by_their_torque(effects, torque):
    speed, acceleration = coast(**effects)
    expected = np.broadcast_to(-torque(speed) / INERTIA, acceleration.shape)
    np.testing.assert_allclose(acceleration, expected, rtol=1e-3)


def test_stribeck_friction_breaks_away_at_its_larger_torque():
    values = {"torque_Nm": 0.02, "breakaway_Nm": 0.06, "velocity_rad_s": 0.2}
    slow = np.clip(0.05 * (T - 0.2), 0.0, None)  # kp times the angle reached is the torque
    angle = simulate(slow, stribeck_friction=values)
    stuck = slow[np.flatnonzero(np.abs(angle) > 1e-6)[0] - 6]  # latency and one sample
    assert KP * stuck == pytest.approx(0.06, rel=0.1)


def test_load_friction_is_a_share_of_the_torque():
    """Climbing a weight takes (1 + r) times what holding it back from falling does."""
    weight = {"gravity_load": {"torque_Nm": 0.5}}
    up = np.clip(0.5 * (T - 0.2), 0, 1.2)
    angle = simulate(up, load_friction={"ratio": 0.2}, **weight)
    k = np.searchsorted(T, 2.0)
    torque = KP * (up[k - 5] - angle[k]) - KD * 0.5  # latency is five samples
    assert 0.8 * torque == pytest.approx(0.5 * np.sin(angle[k]), rel=0.05)


# Motor and controller


def test_a_limit_of_the_drive_leaves_the_damping():
    """At the limit L - kd v = I dv/dt, so that v = L / kd (1 - exp(-kd t / I))."""
    t = 0.001 * np.arange(200)
    command = np.where(t > 0.01, 2.0, 0.0)
    drive = {"limit_Nm": 0.2, "free_damping": 1.0}
    angle = simulate(command, t, kd=0.1, latency=0.0, torque_saturation=drive)
    speed = 2.0 * (1 - np.exp(-0.1 / INERTIA * np.clip(t - 0.011, 0.0, None)))
    assert np.abs(np.gradient(angle, t) - speed)[20:150].max() < 5e-3


def test_directional_friction_holds_a_shaft_at_rest_by_where_it_would_go():
    friction = {"torque_Nm": 0.1, "asymmetry": 0.5}
    step = np.where(T > 0.2, 0.1 / KP, 0.0)
    there, back = (simulate(sign * step, asymmetric_friction=friction)[-1] for sign in (1, -1))
    assert there == 0.0
    assert back == pytest.approx(-0.05 / KP, rel=0.6)


def test_torque_asymmetry_scales_the_torque():
    t = 0.001 * np.arange(60)
    command = np.where(t > 0.0, 0.5, 0.0)

    def first_push(direction, **effects):
        return simulate(direction * command, t, latency=0.01, **effects)[14]

    plain = first_push(1)
    uneven = {"torque_asymmetry": {"asymmetry": 0.2}}
    assert first_push(1, **uneven) / plain == pytest.approx(1.1, rel=0.01)
    assert first_push(-1, **uneven) / plain == pytest.approx(-0.9, rel=0.01)


def test_voltage_sag_is_in_balance_with_a_weight():
    """torque = kp error (1 - loss |torque asked| / full), full load being half a radian's."""
    angle = simulate(gravity_load={"torque_Nm": 0.6}, voltage_sag={"loss_at_full_load": 0.5})[-1]
    asked = KP * (0.4 - angle)
    assert asked * (1 - 0.5 * asked / (0.5 * KP)) == pytest.approx(0.6 * np.sin(angle), rel=1e-3)


def test_supply_droop_leaves_the_damping_and_an_empty_battery_moves_nothing():
    """Pulled by little and braked by much, the shaft approaches at kp left / kd."""
    t = 0.02 * np.arange(7500)
    command = np.where(t > 90.0, 0.1, 0.0)
    angle = simulate(command, t, kp=0.05, kd=0.06, supply_droop={"loss_per_min": 0.5})
    # since the set-point arrived, the exponent is kp / kd times the integral of what is left
    since = 90.02 + LATENCY
    lasted = np.clip(t - since, 0.0, None)
    exponent = 0.05 / 0.06 * (lasted - 0.5 / 60 * lasted * (t + since) / 2)
    expected = 0.1 * (1 - np.exp(-exponent))
    assert np.abs(angle - expected)[:6000].max() < 2.5e-3
    assert np.ptp(angle[6100:]) < 1e-5  # nothing is left after two minutes


def test_thermal_derating_comes_with_work():
    t = 0.02 * np.arange(2500)
    command = 0.5 * np.sin(20 * t)
    warm = simulate(command, t, thermal_derating={"loss": 0.5})
    plain = simulate(command, t)
    early, late = slice(0, 200), slice(-200, None)
    assert np.abs(warm - plain)[late].max() > 3 * np.abs(warm - plain)[early].max()


def test_punch_helps_small_errors_against_friction():
    """At rest kp error + punch is the friction's, so the shaft stops nearer by punch / kp."""
    creep = np.clip(0.2 * (T - 0.2), 0.0, 0.3)
    friction, punch = {"torque_Nm": 0.1}, {"torque_Nm": 0.06, "width_rad": 1e-3}
    alone = 0.3 - simulate(creep, kd=0.3, coulomb_friction=friction)[-1]
    helped = 0.3 - simulate(creep, kd=0.3, coulomb_friction=friction, punch=punch)[-1]
    assert alone - helped == pytest.approx(0.06 / KP, rel=0.05)


@pytest.mark.parametrize("step_share", [0.0, 1.0])
def test_a_dead_band_subtracts_or_switches(step_share):
    """At rest the controller acts on the error that holds the weight, or on what is beyond."""
    band = {"halfwidth_rad": 0.05, "step_share": step_share}
    weight = {"gravity_load": {"torque_Nm": 0.3}}
    held = simulate(np.full(T.size, 1.5), kp=1.5, kd=0.3, deadband=band, **weight)[-1]
    acting = 1.5 - held - (1 - step_share) * 0.05
    assert 1.5 * acting == pytest.approx(0.3 * np.sin(held), rel=1e-4)


def test_integral_action_removes_the_static_error():
    weight = {"gravity_load": {"torque_Nm": 0.3}}
    t = 0.02 * np.arange(2000)
    command = np.where(t > 0.2, 0.4, 0.0)
    assert simulate(command, t, **weight)[-1] < 0.37
    settled = simulate(command, t, integral_action={"ki_Nm_per_rad_s": 2.0}, **weight)[-1]
    assert settled == pytest.approx(0.4, abs=1e-4)


# Set-point


def quick(**effects):
    """What a servo that is fast as lightning makes of the step: the set-point inside it."""
    return simulate(kp=500.0, kd=2.0, latency=0.0, **effects)


def test_command_filter_is_a_first_order_lag():
    since = np.clip(T - T[np.argmax(STEP > 0)], 0, None)
    expected = 0.4 * (1 - np.exp(-since / 0.3))
    angle = quick(command_filter={"time_constant_s": 0.3})
    assert np.abs(angle - expected).max() < 0.01


def test_rate_limit_is_a_ramp():
    speed = np.gradient(quick(rate_limit={"limit_rad_s": 0.5}), T)
    assert speed[40:90] == pytest.approx(0.5, rel=0.01)
    assert speed[120:] == pytest.approx(0.0, abs=1e-3)


def test_acceleration_limit_takes_the_time_of_two_parabolas():
    angle = quick(acceleration_limit={"limit_rad_s2": 1.0})
    arrived = T[np.argmax(angle > 0.399)] - T[np.argmax(STEP > 0)]
    assert arrived == pytest.approx(2 * np.sqrt(0.4 / 1.0), rel=0.05)
    assert angle.max() < 0.403


# Load and sensor


def test_gravity_load_and_cogging_are_in_balance_with_the_servo():
    angle = simulate(gravity_load={"torque_Nm": 0.2})[-1]
    assert KP * (0.4 - angle) == pytest.approx(0.2 * np.sin(angle), rel=1e-3)
    values = {"torque_Nm": 0.05, "period_rad": 0.5, "phase_rad": 0.3}
    angle = simulate(cogging=values)[-1]
    expected = -0.05 * np.sin(2 * np.pi * angle / 0.5 + 0.3)
    assert KP * (0.4 - angle) == pytest.approx(expected, rel=1e-2)


def test_sensor_offset_gain_and_steps_change_the_reading_only():
    plain = simulate()
    near = {"atol": 3e-5}  # finer sub-steps
    np.testing.assert_allclose(simulate(sensor_offset={"offset_rad": 0.03}), plain + 0.03, **near)
    np.testing.assert_allclose(simulate(sensor_gain={"gain": 0.1}), 1.1 * plain, **near)
    stepped = simulate(encoder_quantization={"step_rad": 0.01})
    np.testing.assert_allclose(stepped, 0.01 * np.round(stepped / 0.01), atol=1e-12)
    assert np.abs(stepped - plain).max() < 0.0051


def test_backlash_hangs_by_half_its_gap():
    """At rest the load lies against the flank that its weight pulls it to."""
    for angle in (0.4, -0.4):
        command = np.where(T > 0.2, angle, 0.0)
        load = simulate(command, gravity_load={"torque_Nm": 0.3}, backlash={"gap_rad": 0.1})[-1]
        motor = load + 0.05 * np.sign(angle)
        assert KP * (angle - motor) == pytest.approx(0.3 * np.sin(load), abs=1e-6)


def test_compliance_leads_the_load_by_what_the_spring_gives():
    """At rest kp works on the shaft's angle, and the load trails it by compliance x torque."""
    spring, weight = {"compliance_rad_per_Nm": 0.1}, {"torque_Nm": 0.3}
    seen = simulate(compliance=spring, gravity_load=weight)[-1]
    torque = KP * (0.4 - seen)
    assert torque == pytest.approx(0.3 * np.sin(seen - 0.1 * torque), rel=3e-3)


def test_sensor_filter_lags_by_its_time_constant():
    ramp = np.clip(0.2 * (T - 0.2), 0, None)
    plain, late = simulate(ramp), simulate(ramp, sensor_filter={"time_constant_s": 0.1})
    assert plain[-1] - late[-1] == pytest.approx(0.2 * 0.1, rel=1e-3)


# Link


def test_clock_drift_delays_more_and_more():
    sine = 0.3 * np.sin(4 * T)
    drifting = simulate(sine, clock_drift={"s_per_s": 0.01})
    speed = np.gradient(simulate(sine), T)
    lag = -(drifting - simulate(sine))[100:] @ speed[100:] / (speed[100:] @ (speed * T)[100:])
    assert lag == pytest.approx(0.01, rel=0.05)


def test_jitter_stays_within_its_width():
    ramp = np.clip(0.5 * (T - 0.2), 0, None)
    jittered = simulate(ramp, latency_jitter={"halfwidth_s": 0.005})
    assert 1e-5 < np.abs(jittered - simulate(ramp)).max() < 0.5 * 0.005 * 1.5


def test_lost_packets_are_never_heard():
    assert np.ptp(simulate(packet_loss={"probability": 1.0})) == 0.0
    sine = 0.3 * np.sin(4 * T)
    few, many = (simulate(sine, packet_loss={"probability": p}) for p in (0.02, 0.5))
    plain = simulate(sine)
    assert 0 < np.std(few - plain) < np.std(many - plain)


def run_in_a_copy(tmp_path, files, program):
    """A program that imports a copy of the package with more files in ``effects``."""
    package, tests = Path(inspect.getfile(named)).parents[1], Path(__file__).parents[1]
    shutil.copytree(package, tmp_path / "sim2real")
    for name, source in files.items():
        (tmp_path / "sim2real" / "effects" / name).write_text(source)
    path = os.pathsep.join(map(str, (tmp_path, package.parent, tests, tests / "sim")))
    environment = os.environ | {"PYTHONPATH": path}
    call = [sys.executable, "-c", program]
    return subprocess.run(call, env=environment, cwd=tmp_path, capture_output=True, text=True)


def changed(path, *changes):
    """The source of an effect in which these texts are replaced."""
    source = (Path(inspect.getfile(named)).parent / path).read_text()
    for old, new in changes:
        assert old in source
        source = source.replace(old, new)
    return source


def test_a_new_effect_is_one_file(tmp_path):
    """Of a servo: it is simulated, fitted, named and shown.

    Of the body: it is simulated by the twin, has parameters to fit, is searched for, has words.
    """
    spring = changed(
        "servo/quadratic_drag.py",
        ("coefficient_Nms2", "stiffness_Nm_per_rad"),
        ("x - p[c] * v * wp.abs(v)", "x - p[c] * q * q * q"),
        ('plain="', 'plain="a spring that hardens, not '),
        ("high=0.5, typical=0.01", "high=20.0, typical=0.5"),
    )
    weed = changed(
        "body/linear_drag.py",
        ("robot.lengths_m / robot.lengths_m.sum()", "np.eye(robot.lengths_m.size)[-1]"),
        ("an error of the linear drag", "weed on the tail"),
    )
    program = """
from dataclasses import replace
import numpy as np
import simulated
from sim.inference.coordinates import candidates
from sim.twin.twin import Twin
from sim2real.body import listed
from sim2real.diagnose.diagnose import diagnose
from sim2real.report.diagnosis_plots import plain
from swimming_robots import FISH, servos
pendulum = simulated.Load(0.002, 0.1, 0.05)
recordings = simulated.two(load=pendulum, hard_spring={"stiffness_Nm_per_rad": 3.0})
found = diagnose(recordings, simulated.robot("j1"))
(named,) = found.effects
assert named.effect == "hard_spring", found.effects
assert abs(named.parameters["stiffness_Nm_per_rad"].mean / 3 - 1) < 0.1, named
assert plain(named.effect).startswith("a spring that hardens")
weeds = replace(servos(), body={"effects": listed({"weed.coefficient": 1.0})})
twin = Twin(FISH, [servos(), weeds], n_envs=2)
assert twin.chain.resist.numpy()[1, -1, 0] == 1.0 and not twin.chain.resist.numpy()[0, :, :1].any()
for k in range(60):
    turn = np.sin(2 * np.pi * 1.5 * 0.02 * k - 1.2 * np.arange(3))
    twin.step(np.array([0.3, 0.45, 0.6]) * turn)
gone = np.abs(twin.state().pose[:, 0])
assert abs(gone[1] - gone[0]) > 1e-4, gone
assert candidates(FISH)["weed", "body"][0].name == "weed.coefficient"
assert plain("weed") == "weed on the tail"
"""
    done = run_in_a_copy(tmp_path, {"servo/hard_spring.py": spring, "body/weed.py": weed}, program)
    assert done.returncode == 0, done.stderr


def test_more_effects_than_the_mask_has_bits_are_refused(tmp_path):
    names = [f"one_more_{k}" for k in range(40)]
    more = {f"servo/{n}.py": changed("servo/sensor_offset.py") for n in names}
    done = run_in_a_copy(tmp_path, more, "import sim2real.effects")
    assert done.returncode and "InputError" in done.stderr and "at most 62" in done.stderr
