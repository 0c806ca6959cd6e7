"""Where simulated and recorded swims differ, and the friction of servos that swims show."""

from dataclasses import replace

import numpy as np
import pytest
from swimming_robots import FISH, servos
from test_diagnose_swims import OF_THIS_LAW, only, swum

from sim.inference.diagnose_swims import diagnose_swims
from sim.inference.in_water import differs
from sim.inference.located import located, windows_of
from sim.inference.signal_error import Blocks
from sim.inference.swims import by_followed_twin, with_values


@pytest.mark.parametrize(
    ("part", "words"),
    [
        (lambda swim: swim.t < 2.0, "first 2 s"),
        (lambda swim: np.gradient(swim.signals[:, 5]) > 0.01, "turns to positive angles"),
        (lambda swim: swim.t > 0.85 * swim.t[-1], "distances from the pool's origin above"),
        (lambda swim: np.ones(swim.t.size, dtype=bool), "throughout"),
    ],
)
def test_the_part_with_the_residual_is_told(part, words):
    swim = swum({})
    large = part(swim)
    square = np.random.default_rng(0).standard_normal(swim.t.size) ** 2 * np.where(large, 25, 1)
    where, advice = located([swim], square)
    assert words in where
    assert advice.startswith("Record ")
    if not large.all():
        shared = 100 * square[large].sum() / square.sum()
        assert float(where.split()[0]) == pytest.approx(shared, abs=25)


def test_times_of_a_disturbance_are_told_and_of_none_there_is_none():
    swim = swum({})
    blocks, rng = Blocks.of(swim), np.random.default_rng(0)
    quiet = rng.standard_normal(swim.signals.shape)
    np.testing.assert_allclose(blocks.in_time(blocks.seen), np.nan_to_num(swim.signals), atol=1e-12)
    assert windows_of([swim], [quiet[:, 0]]) == {"made": ()}
    loud = quiet[:, 0] * np.where(abs(swim.t - 3.0) < 0.5, 8.0, 1.0)
    ((start, end),) = windows_of([swim], [loud])["made"]
    assert (start, end) == pytest.approx((2.5, 3.5), abs=0.15)


def test_friction_of_a_servo_is_found_in_the_angles(monkeypatch):
    """Beside a skin that couples joints, and a servo with another gain than the model's."""
    only(monkeypatch, ("coulomb_friction", "skin_coupling"))
    truth = {
        "j2.coulomb_friction.torque_Nm": 0.05,
        "j3.kd_Nms_per_rad": 0.08,
    }
    given = [swum(truth)], servos(), FISH, by_followed_twin(FISH)
    found = diagnose_swims(*given, law_error=OF_THIS_LAW)
    (named,) = (one for one in found.effects if one.probability > 0.5)
    assert (named.effect, named.component) == ("coulomb_friction", "servos")
    assert named.parameters["j2.torque_Nm"].mean == pytest.approx(0.05, rel=0.15)
    assert named.parameters["j1.torque_Nm"].mean < 0.015
    assert "Coulomb friction in the servos" in named.statement
    (fitted,) = found.model.joints["j2"].effects
    assert fitted.effect == "coulomb_friction"
    first = found.mismatch[0]
    assert first.component == "j2"
    assert f"{100 * first.share:.0f} % of the residual" in first.where


def test_the_fluid_is_asked_again_where_a_servo_differs():
    model = servos()
    assert not differs(model, with_values(model, {"j1.coulomb_friction.torque_Nm": 0.003}))
    assert differs(model, with_values(model, {"j1.coulomb_friction.torque_Nm": 0.03}))
    kp = model.joints["j2"].kp_Nm_per_rad
    assert differs(model, with_values(model, {"j2.kp_Nm_per_rad": 0.9 * kp}))
    assert differs(model, replace(model, body={"effects": [
        {"effect": "linear_drag", "parameters": {"coefficient": 0.3}}]}))  # fmt: skip
