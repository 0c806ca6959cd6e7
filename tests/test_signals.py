"""Excitation signals: at rest at first, inside limits and speed, and what their names say."""

import numpy as np
import pytest
from good_input import ROBOT

from sim2real.errors import InputError
from sim2real.robot import read_robot
from sim2real.signals import REST_S, SMOOTH, UNIT, Shape, excitation, limited, played

HZ = 50


@pytest.fixture
def joints(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(ROBOT.replace("[-0.8, 0.8]", "[-0.5, 0.9]"))
    return read_robot(path).joints


def make(name, joints, seed=0, **given):
    given = {"seconds": 20.0, "rate_hz": HZ} | given
    return excitation(name, joints, rng=np.random.default_rng(seed), **given)


@pytest.mark.parametrize("name", UNIT)
@pytest.mark.parametrize("amplitude", [None, 0.2, 5.0])
def test_rest_limits_and_speed(name, amplitude, joints):
    signal = make(name, joints, amplitude_rad=amplitude)
    sent = signal.command[:, 0]
    assert sent.shape == signal.t.shape == (1000,)
    assert np.ptp(sent[signal.t < REST_S - 1e-9]) == 0
    assert np.all((sent >= -0.5) & (sent <= 0.9))
    assert signal.largest_rate[0] <= 5.24 * (1 + 1e-6)
    assert np.ptp(sent) > (0.2 if amplitude == 0.2 else 0.5)
    assert np.abs(sent - 0.2).max() <= (0.7 if amplitude is None else amplitude) + 1e-9
    assert bool(signal.notes) == (amplitude == 5.0)


@pytest.mark.parametrize("name", UNIT)
def test_the_seed_decides(name, joints):
    one, same, other = (make(name, joints, seed=seed).command for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert np.array_equal(one, other) == (name not in ("steps", "multisine"))


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("sine", 1.5, 1.5), ("square", 1.5, 1.5), ("chirp", 0.5, 3.0), ("multisine", 0.5, 3.0)],
)
def test_where_the_power_is(name, low, high, joints):
    shape = Shape(frequency_hz=1.5, band_hz=(0.5, 3.0))
    sent = make(name, joints, seconds=40.5, amplitude_rad=0.1, shape=shape).command[25:, 0]
    power = np.abs(np.fft.rfft(sent - sent.mean())) ** 2
    frequency = np.fft.rfftfreq(sent.size, 1 / HZ)
    inside = (frequency > low - 0.15) & (frequency < high + 0.15)
    assert power[inside].sum() > (0.75 if name == "square" else 0.95) * power.sum()
    if name == "multisine":
        assert np.abs(sent - 0.2).max() / np.std(sent) < 2.2, "low crest"


def test_smooth_signals_stay_smooth_where_speed_limits_them(joints):
    fast = Shape(frequency_hz=4.0, band_hz=(0.5, 4.0))
    for name in SMOOTH:
        signal = make(name, joints, amplitude_rad=0.6, shape=fast)
        assert "servo's speed" in signal.notes[0]
        slow = make(name, joints, amplitude_rad=0.1, shape=fast)
        shapes = [s.command[:, 0] - 0.2 for s in (signal, slow)]
        assert np.corrcoef(*shapes)[0, 1] > 0.9999


def test_a_step_too_fast_becomes_a_ramp(joints):
    ramp = limited(np.array([0.0, 0.0, 0.4, 0.4, 0.4, 0.4, 0.4, 2.0]), joints[0], HZ)
    np.testing.assert_allclose(np.diff(ramp)[1:4], 5.24 / HZ)
    assert ramp[6] == 0.4


def test_a_file_is_held_between_its_rows(tmp_path, joints):
    path = tmp_path / "plan.csv"
    path.write_text("t_s,j1.command_rad\n5.0,0.1\n5.1,0.15\n5.3,0.1\n")
    signal = played(path, joints, rate_hz=HZ)
    held = np.array([0.1] * 30 + [0.15] * 10 + [0.1])
    np.testing.assert_allclose(signal.command[:, 0], held)
    assert signal.notes == ()


def test_what_makes_no_signal_is_refused(tmp_path, joints):
    for name, given, part in (
        ("steps", {"seconds": 0.5}, "--seconds"),
        ("steps", {"seconds": float("nan")}, "--seconds"),
        ("sine", {"shape": Shape(frequency_hz=25.0)}, "--frequency"),
        ("chirp", {"shape": Shape(band_hz=(2.0, 1.0))}, "--band"),
        ("multisine", {"shape": Shape(band_hz=(0.0, 1.0))}, "--band"),
    ):
        with pytest.raises(InputError, match=part):
            make(name, joints, **given)
    for rows, part in (
        ("t_s,j2.command_rad\n0,0\n1,0\n", "j1.command_rad"),
        ("t_s,j1.command_rad\n0,0\n1,\n", "empty"),
    ):
        (tmp_path / "plan.csv").write_text(rows)
        with pytest.raises(InputError, match=part):
            played(tmp_path / "plan.csv", joints, rate_hz=HZ)
