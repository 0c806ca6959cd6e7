"""What is wrong with recordings is stated wherever a number depends on them."""

import importlib
from dataclasses import replace

import numpy as np
import pytest
import simulated

import sim2real as s2r
from sim2real.cli import main
from sim2real.errors import InputError
from sim2real.identification.identify import identify
from sim2real.identification.problem import plain_row
from sim2real.recording import Load
from sim2real.servo.rollout import rollout

GATHER = importlib.import_module("sim2real.ranges.gather")
ROBOT = simulated.robot("j1")
GOOD = simulated.recording(1, "good", seconds=8.0)


MOVED = simulated.recording(2, "stopped", seconds=8.0)
STOPS = 1e-4 * np.random.default_rng(0).normal(size=MOVED.position.shape)
STOPPED = replace(MOVED, position=np.minimum(MOVED.position, 0.2) + STOPS)
WORDS = "stopped: j1 does not follow its command"


@pytest.fixture(scope="module")
def model():
    return identify([STOPPED, GOOD], ROBOT)


def test_identified_model(model):
    assert any(note.startswith(WORDS) for note in model.notes)
    assert WORDS in " ".join(str(model).split())
    assert "physics is missing" not in str(model)  # the stop comes first
    assert "see the warnings about the recordings" in " ".join(str(model).split())


def test_diagnosis():
    once = GOOD.position.copy()
    once[300] += 2.0
    found = s2r.diagnose([replace(GOOD, position=once), simulated.recording(3, "next")], ROBOT)
    words = "good: j1 has one reading far from those before and after"
    assert [text.startswith(words) for text in found.warnings] == [True]
    assert f"warning: {words}" in str(found)
    assert words in " ".join(found.gate)


def test_posterior_and_ranges(model, monkeypatch):
    monkeypatch.setattr(GATHER, "sample_joints", lambda *_: ({}, {}))
    with pytest.warns(UserWarning, match=WORDS):
        s2r.posterior([STOPPED, GOOD], ROBOT, model)
    notes = s2r.ranges([STOPPED, GOOD], ROBOT, model).ranges.notes
    assert notes[0].startswith(WORDS)


def test_design_repeats_the_notes_of_its_model(model):
    with pytest.warns(UserWarning, match=WORDS):
        s2r.design(ROBOT, model, seconds=4.0)


@pytest.mark.parametrize("verb", ["identify", "diagnose"])
def test_errors_are_refused(verb):
    backwards = replace(GOOD, position=-GOOD.position)
    backwards = replace(backwards, name="backwards")
    message = r"backwards\.csv: j1\.position_rad: found an angle that moves against its command"
    with pytest.raises(InputError, match=message):
        getattr(s2r, verb)([GOOD, backwards], ROBOT)
    with pytest.raises(InputError, match=message):
        s2r.diagnose([GOOD], ROBOT, references=[backwards])


def at_gain(gain, seed):
    """A recording of the servo whose kp is that of a firmware gain of 30, at another gain."""
    recording = simulated.recording(seed, f"gain_{gain}")
    row = simulated.row()
    row[0] *= gain / 30
    sent = recording.command[:, 0]
    noise = np.random.default_rng(seed).normal(0, simulated.NOISE, sent.size)
    angle = rollout(row[None], recording.t, sent)[0] + noise
    return replace(recording, position=angle[:, None], metadata={"firmware_p_gain": gain})


def test_kp_is_in_proportion_to_the_firmware_gain(tmp_path):
    recordings = [at_gain(30, 1), at_gain(60, 2), at_gain(15, 3)]
    model = identify(recordings, ROBOT)
    assert model.joints["j1"].kp_Nm_per_rad == pytest.approx(simulated.KP, rel=0.02)
    assert model.fit["j1.position_rad"]["heldout"] < 2 * simulated.NOISE
    assert model.firmware_p_gain == 30
    assert "kp is that of the firmware gain 30; recordings with a gain of 60, 15" in str(model)
    s2r.write_model(model, tmp_path / "model.json")
    again = s2r.read_model(tmp_path / "model.json")
    for recording in recordings:  # whose contexts state no ratio
        (error,) = s2r.predict(recording, ROBOT, again).rmse.values()
        assert error < 2 * simulated.NOISE


def test_an_alias_above_half_the_sampling_rate_is_searched_again(monkeypatch):
    """Smooth motions at 30 Hz: a servo that rings at 26 Hz is an optimum, too."""
    t = np.arange(0, 20, 1 / 30)
    rng = np.random.default_rng(0)
    row = simulated.row()
    row[:3] = 1.5, 0.07, 0.045
    knots = np.append(0.0, rng.uniform(-0.6, 0.6, 25))
    share = np.minimum((t % 0.8) / 0.5, 1.0)
    share = share**3 * (10 - 15 * share + 6 * share**2)
    place = (t / 0.8).astype(int)
    sent = knots[place] + share * (knots[place + 1] - knots[place])
    seen = rollout(row[None], t, sent)[0] + rng.normal(0, 1e-3, t.size)
    recording = simulated.one_joint(t, sent, seen)
    module = importlib.import_module("sim2real.identification.joint_fit")
    guess = module.first_guess

    def trapped(traces, rng, **options):
        """The first search ends near the alias, as it may; one below half the rate cannot."""
        if "fastest_rad_s" in options:
            return guess(traces, rng, **options)
        return plain_row(60.0, 0.076, 0.06)[None]

    monkeypatch.setattr(module, "first_guess", trapped)
    joint = identify([recording], ROBOT, law="pd").joints["j1"]
    low, high = joint.interval["kp_Nm_per_rad"]
    assert low <= 1.5 <= high < 2.0


def test_a_servo_faster_than_the_samples_has_no_certain_gains():
    fast = simulated.row()
    fast[:3] = 40.0, 0.05, 0.045  # 22 Hz
    t = np.arange(0, 12, 0.04)
    sent = simulated.steps(t, np.random.default_rng(1))
    recording = simulated.one_joint(t, sent, rollout(fast[None], t, sent)[0])
    joint = identify([recording], ROBOT, law="pd").joints["j1"]
    assert joint.interval["kp_Nm_per_rad"] == (0.0, np.inf)
    assert any("above half the sampling rate of 12.5 Hz" in note for note in joint.notes)


def test_a_white_residual_far_above_the_noise_is_reported():
    """Single rows of another series make no correlated residual."""
    rng = np.random.default_rng(0)
    noisy = simulated.recording(4, noise=1e-4)
    moving = np.abs(np.gradient(noisy.position[:, 0])) > 0.005
    position = noisy.position + 0.03 * rng.standard_normal((noisy.t.size, 1)) * moving[:, None]
    joint = identify([replace(noisy, position=position)], ROBOT, law="pd").joints["j1"]
    assert any("times the noise" in note and "correlated" not in note for note in joint.notes)


def test_the_scale_of_a_pendulum_is_stated():
    hung = simulated.recording(1, load=Load(0.004, 0.3, 0.1))
    joint = identify([hung], ROBOT).joints["j1"]
    assert "kp, kd and every torque are in proportion to the stated pendulum (0.3 kg at 0.1 m)" in (
        joint.notes
    )
    assert not any("stated pendulum" in x for x in identify([GOOD], ROBOT).joints["j1"].notes)
    level = replace(simulated.recording(1), loads={"j1": Load(simulated.INERTIA, 0.3, 0.1)})
    notes = identify([level], ROBOT, law="pd").joints["j1"].notes
    assert any("contradict the weight of the stated pendulum (0.3 kg at 0.1 m)" in x for x in notes)


def test_import_prints_what_fits_will_refuse(tmp_path, capsys):
    bench = simulated.recording(5)
    sent, counts = (4096 * x[:, 0] / (2 * np.pi) + 200 for x in (bench.command, bench.position))
    table = np.column_stack([bench.t, sent, np.round(np.mod(counts, 4096))])
    log, out = tmp_path / "log.csv", tmp_path / "recording.csv"
    np.savetxt(log, table, delimiter=",", header="time,goal,present", comments="")
    columns = ["t=time", "j1.command=goal", "j1.position=present"]
    options = ["--columns", *columns, "--units", "counts", "--counts-per-turn", "4096"]
    options += ["--zero-count", "200", "--time-unit", "s", "--out", str(out)]
    assert main(["import", str(log), *options]) == 0
    assert "! error: j1 jumps by 6." in capsys.readouterr().out
    assert main(["check", str(out)]) == 2
    assert "! error: j1 jumps by 6." in capsys.readouterr().out


def test_a_search_that_its_budget_ends_says_so():
    cut = identify([GOOD], ROBOT, law="pd", effort=0.02).joints["j1"]
    assert any("did not converge" in note and "--effort" in note for note in cut.notes)
    whole = identify([GOOD], ROBOT, law="pd").joints["j1"]
    assert not any("did not converge" in note for note in whole.notes)


@pytest.mark.parametrize("effort", [0, -1.0, np.inf, np.nan, "2"])
@pytest.mark.parametrize("verb", ["identify", "diagnose"])
def test_an_effort_is_above_0(verb, effort):
    with pytest.raises(InputError, match="effort"):
        getattr(s2r, verb)([GOOD], ROBOT, effort=effort)


def with_gripper(recording, stop_rad):
    """The recording with a second joint of the same motion, which is stopped."""
    noise = np.random.default_rng(1).normal(0, 1e-4, recording.position.shape)
    stopped = replace(recording, position=np.minimum(recording.position, stop_rad) + noise)
    return simulated.beside(recording, stopped, ("j1", "gripper"))


def test_a_joint_that_is_stopped_most_of_the_time_is_left_out():
    both = [with_gripper(recording, -0.3) for recording in (GOOD, simulated.recording(6, "next"))]
    robot = simulated.robot("j1", "gripper")
    model = identify(both, robot)
    assert set(model.joints) == {"j1"}
    assert model.joints == identify(both, robot).joints
    assert any("gripper does not follow its command" in x and "left out" in x for x in model.notes)
    with pytest.raises(InputError, match="found an angle that does not follow its command: for"):
        identify([recording.without({"j1"}) for recording in both], simulated.robot("gripper"))


def test_missing_rows_are_no_irregular_timing(monkeypatch):
    monkeypatch.setattr(simulated, "PERIOD", 0.01)
    rng = np.random.default_rng(0)
    chirp = lambda t: 0.4 * np.sin(2 * np.pi * (0.3 + 0.2 * t) * t)  # noqa: E731
    recordings = []
    for seed, command in ((1, None), (2, chirp)):
        recording = simulated.recording(seed, f"r{seed}", seconds=6, noise=5e-4, command=command)
        kept = rng.random(recording.t.size) > 0.08
        kept[:-1] |= ~kept[1:]  # rows are missing one at a time
        arrays = {name: getattr(recording, name)[kept] for name in ("t", "command", "position")}
        recordings.append(replace(recording, **arrays))
    found = s2r.diagnose(recordings, ROBOT)
    assert found.effects == ()
    assert ["samples are missing one at a time" in text for text in found.warnings] == [True] * 2


@pytest.mark.parametrize("gain", ["high", 0, -3.0, [1]])
def test_gains_that_are_none(gain):
    with pytest.raises(InputError, match="firmware_p_gain"):
        identify([replace(GOOD, metadata={"firmware_p_gain": gain})], ROBOT)
