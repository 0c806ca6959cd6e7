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
from sim.inference.swims import PoseNoise, by_followed_twin, pose_noise, with_values
from sim2real.body import observed


@pytest.mark.parametrize(
    ("signal", "part", "words"),
    [
        (0, lambda swim: swim.t < 2.0, "first 2 s"),
        (4, lambda swim: np.gradient(swim.signals[:, 4]) > 0.01, "joint 2 turns to positive"),
        (0, lambda swim: swim.t > 0.75 * swim.t[-1], "at times above"),
        (2, lambda swim: np.ones(swim.t.size, dtype=bool), "throughout"),
    ],
)
def test_the_part_with_the_residual_is_told(signal, part, words):
    swim = swum({})
    large = part(swim)
    square = np.random.default_rng(0).standard_normal(swim.t.size) ** 2 * np.where(large, 25, 1)
    where, advice = located([swim], square, signal)
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
    truth = {"j2.coulomb_friction.torque_Nm": 0.05, "j3.kd_Nms_per_rad": 0.08}
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


PERIOD = 0.02
SD = np.array([0.002, 0.003, 0.01])


def filmed(lag, seed=0, samples=1000):
    """A robot that swims and turns, filmed with noise, and smoothed by the catalogue's filter."""
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(samples)
    beat = 2 * np.pi * 1.2 * t
    swims = np.stack([0.2 * t, 0.02 * np.sin(beat), 0.3 * np.sin(beat + 0.4)], axis=1)
    shaken = swims + SD * rng.standard_normal(swims.shape)
    return observed(t, shaken, {"pose_filter.time_constant_s": lag})


@pytest.mark.parametrize("seed", range(3))
def test_white_noise_is_as_large_as_it_is_and_no_filter(seed):
    found = pose_noise(filmed(0.0, seed), PERIOD)
    assert found.lag_s == 0.0
    np.testing.assert_allclose(found.sd, SD, rtol=0.12)
    assert found.log_ratio(0.03) < -10


@pytest.mark.parametrize("lag", [0.03, 0.06, 0.12])
def test_a_filter_shows_in_the_noise(lag):
    found = pose_noise(filmed(lag), PERIOD)
    assert found.log_ratio(lag) > 15
    assert found.lag_s > 0.01
    assert found.log_ratio(0.0) == 0.0


def test_noise_is_drawn_as_it_was_found():
    drawn = PoseNoise(SD, 0.03).drawn(np.random.default_rng(0), (4000,), PERIOD)
    kept = np.exp(-PERIOD / 0.03)
    np.testing.assert_allclose(drawn.std(axis=0), SD * ((1 - kept) / (1 + kept)) ** 0.5, rtol=0.06)
    assert pose_noise(drawn, PERIOD).lag_s == pytest.approx(0.03, rel=0.4)


def test_short_films_say_nothing():
    assert pose_noise(filmed(0.0, samples=60), PERIOD) is None
