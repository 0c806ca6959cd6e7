"""Latency by its causes: each is found where a recording shows it, and said where none does."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import simulated
from good_input import message

import sim2real as s2r
from sim2real.model import JointModel, Model
from sim2real.ranges.latency import split_latency
from sim2real.servo.prediction import predict

sys.path.append(str(Path(__file__).parents[1] / "importers"))
MODEL = Model({"j1": JointModel(simulated.KP, simulated.KD, 0.06, simulated.INERTIA)})
RNG = np.random.default_rng(2)


def made(rate_hz):
    """Twelve seconds of steps of a servo with 60 ms of latency."""
    t = np.arange(round(12 * rate_hz)) / rate_hz
    command = simulated.steps(t, RNG, 0.4)[:, None]
    angle = predict(MODEL, t, {"j1": command[:, 0]})["j1"] + RNG.normal(0, 1e-3, t.size)
    return simulated.one_joint(t, command[:, 0], angle, load=None, name="made")


@pytest.fixture(scope="module")
def recording():
    return made(50.0)


def causes(recording, **changed):
    found = split_latency([replace(recording, **changed)], [MODEL], {})
    by_name = {cause.name: cause for cause in found.causes}
    assert found.by_joint_s["j1"] == pytest.approx(by_name["command"].median_s, abs=1e-3)
    return by_name, found.ranges


def test_what_no_column_shows_is_in_the_command_or_bounded(recording):
    found, ranges = causes(recording)
    assert 0.059 < found["command"].low_s < found["command"].high_s < 0.061
    assert np.isnan([found[name].median_s for name in ("bus", "sensor", "observation")]).all()
    assert (found["inference"].low_s, found["inference"].high_s) == (0.0, pytest.approx(0.02))
    assert [x.parameter for x in ranges.entries] == ["command_latency_s", "inference_latency_s"]


def test_columns_context_and_clocks_show_the_others(recording):
    n = recording.t.size
    way = 0.004 + RNG.exponential(0.003, n)  # of telemetry; its clock is fast by 0.1 %
    columns = {
        "round_trip_s": RNG.uniform(0.002, 0.003, n),
        "inference_s": RNG.uniform(0.006, 0.008, n),
        "device_t_s": 7.0 + 1.001 * (recording.t - way),
    }
    context = {"context": {"sample_delay_s": 0.001}}
    found, ranges = causes(recording, kind="pool", columns=columns, metadata=context)
    assert found["bus"].median_s == pytest.approx(0.0025, rel=0.05)
    assert found["inference"].high_s == pytest.approx(0.0079, rel=0.02)
    assert found["observation"].high_s == pytest.approx(0.009, rel=0.2)
    assert found["sensor"].median_s == 0.001
    assert found["command"].median_s == pytest.approx(0.061, abs=5e-4)
    assert len(ranges.entries) == 5


def test_set_points_in_rows_of_their_own_and_angles_that_repeat(recording):
    t = np.ravel(np.column_stack([recording.t, recording.t + 0.007]))
    command = np.repeat(np.r_[recording.command[:1], recording.command[:-1]], 2, axis=0)
    command[1::2] = recording.command
    position = np.full(command.shape, np.nan)
    position[::2] = recording.position
    found, _ = causes(recording, t=t, command=command, position=position)
    assert found["observation"].median_s == pytest.approx(0.007)
    assert found["command"].median_s == pytest.approx(0.053, abs=5e-4)
    held = recording.position[np.arange(recording.t.size) // 2 * 2]
    found, _ = causes(recording, position=held)
    assert found["sensor"].high_s == pytest.approx(0.02)


def test_a_dataset_without_loads(tmp_path):
    lerobot_files = pytest.importorskip("lerobot_files", reason="pyarrow is not installed")
    one = made(lerobot_files.FPS)
    episode = [np.degrees(np.tile(x, 3)) for x in (one.position, one.command)]
    root = lerobot_files.dataset(tmp_path / "arm", "v3.0", [episode, episode])
    found = s2r.latency(root, episodes=1)
    first = str(found).partition("command by joint: shoulder_pan ")[2].split()[0]
    assert float(first) == pytest.approx(60.0, abs=0.5)
    assert found.plot().axes[0].has_data()
    assert found.causes[3].median_s == pytest.approx(0.06, abs=1e-3)
    message(lambda: s2r.latency(root, episodes=0), "episodes")
