"""The catalogue: every effect is well formed, absent at 0, and does what its equation says."""

import sys

import numpy as np
import pytest

from sim2real.effects import CATALOGUE, effect_named
from sim2real.model import FittedEffect, JointModel
from sim2real.servo.parameters import COLUMNS, joint_row
from sim2real.servo.rollout import active_effects, rollout

T = 0.02 * np.arange(200)
STEP = np.where(T > 0.2, 0.4, 0.0)[:, None]


def row(**effects):
    fitted = tuple(FittedEffect(name, parameters) for name, parameters in effects.items())
    return joint_row(JointModel(2.2, 0.06, 0.05, 0.002, effects=fitted), None)[None]


def simulate(command=STEP, **effects):
    return rollout(row(**effects), T, command)[0, :, 0]


def test_names_are_unique_and_found():
    names = [effect.name for effect in CATALOGUE]
    assert len(set(names)) == len(names)
    assert all(effect_named(name).name == name for name in names)
    assert effect_named("magic") is None


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_effect_is_documented_bounded_and_matters(effect):
    module = sys.modules[f"sim2real.effects.{effect.name}"]
    assert module.__doc__
    assert effect.parameters
    values = {}
    for parameter in effect.parameters:
        assert parameter.low < parameter.high
        assert parameter.low <= parameter.typical <= parameter.high
        values[parameter.name] = parameter.typical
    small = {"torque_saturation": {"limit_Nm": 0.5}}.get(effect.name, values)
    assert np.abs(simulate(**{effect.name: small}) - simulate()).max() > 1e-3


def test_effects_are_off_at_zero():
    zeros = {e.name: {p.name: 0.0 for p in e.parameters} for e in CATALOGUE}
    assert active_effects(row(**zeros))[0] == 0
    np.testing.assert_array_equal(simulate(**zeros), simulate())


def test_coulomb_friction_holds_what_is_below_it():
    crawl = np.where(T > 0.2, 0.02, 0.0)[:, None]
    assert np.ptp(simulate(crawl, coulomb_friction={"torque_Nm": 0.05})) == 0.0
    assert simulate(crawl, coulomb_friction={"torque_Nm": 0.03})[-1] > 0.004


def test_coulomb_friction_decelerates_evenly():
    t = 0.001 * np.arange(400)
    parameters = {"coulomb_friction": {"torque_Nm": 0.02}}
    command = np.where(t < 0.05, 0.5, np.nan)
    command[0] = 0.0
    model = row(**parameters)
    model[0, COLUMNS.index("latency_s")] = 0.0
    angle = rollout(model, t, command[:, None])[0, :, 0]
    coasting = np.diff(angle[60:120], 2) / 1e-6
    np.testing.assert_allclose(coasting, -0.02 / 0.002, rtol=1e-3)


def test_torque_saturation_limits_the_acceleration():
    t = 0.001 * np.arange(200)
    model = row(torque_saturation={"limit_Nm": 0.3})
    model[0, COLUMNS.index("latency_s")] = 0.0
    command = np.where(t > 0.01, 0.5, 0.0)[:, None]
    acceleration = np.diff(rollout(model, t, command)[0, :, 0], 2) / 1e-6
    assert np.abs(acceleration).max() == pytest.approx(0.3 / 0.002, rel=1e-3)


def test_sensor_offset_moves_the_reading_only():
    shifted = simulate(sensor_offset={"offset_rad": 0.03})
    np.testing.assert_allclose(shifted - simulate(), 0.03, atol=3e-5)  # finer sub-steps


def test_unmodelled_inertia_is_inertia():
    heavier = joint_row(JointModel(2.2, 0.06, 0.05, 0.003), None)[None]
    added = simulate(unmodelled_inertia={"inertia_kgm2": 0.001})
    np.testing.assert_allclose(added, rollout(heavier, T, STEP)[0, :, 0], atol=3e-5)


def test_gravity_load_pulls_down():
    angle = simulate(gravity_load={"torque_Nm": 0.2})[-1]
    assert 2.2 * (0.4 - angle) == pytest.approx(0.2 * np.sin(angle), rel=1e-3)


def test_an_effect_the_catalogue_lacks_is_refused():
    from sim2real.errors import InputError

    with pytest.raises(InputError, match=r"magic.*expected one of .*coulomb_friction"):
        row(magic={"x": 1.0})
    with pytest.raises(InputError, match="torque_Nm"):
        row(coulomb_friction={"limit": 1.0})
