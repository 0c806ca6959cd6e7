"""Faults of measured angles: each is found where it is, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from sim2real import readings
from sim2real.errors import InputError
from sim2real.findings import all_findings
from sim2real.plausible import admitted, validate_recording
from sim2real.recording import Load

PENDULUM = Load(0.004, 0.3, 0.1)
PLAIN = simulated.recording(3)
T, ANGLE = PLAIN.t, PLAIN.position[:, 0]
SENT = PLAIN.command[:, 0]
STEP = 0.00153


def changed(angle, command=None, **other):
    sent = PLAIN.command if command is None else command[:, None]
    return replace(PLAIN, position=angle[:, None], command=sent, **other)


def said(recording, robot=None):
    texts = {"note": "", "warning": "", "error": ""}
    for finding in all_findings(recording, robot):
        texts[finding.severity] += finding.text
    return texts


def chirp(t):
    return 0.5 * np.sin(2 * np.pi * (0.3 + 0.15 * t) * t)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("command", [None, chirp])
@pytest.mark.parametrize("load", [None, PENDULUM])
@pytest.mark.parametrize("effects", [{}, simulated.FRICTION])
def test_servos_without_a_fault_have_no_warning(seed, command, load, effects):
    recording = simulated.recording(seed, command=command, load=load, **effects)
    assert admitted([recording], simulated.robot("j1"))[1] == ()
    coarse = STEP * np.round(recording.position / STEP)
    assert admitted([replace(recording, position=coarse)])[1] == ()


def test_a_pendulum_that_hangs_far_below_its_command_follows_it():
    """A servo that is weak for its load is deflected in proportion to the sine of its angle."""
    heavy = Load(0.02, 1.5, 0.14)
    recording = simulated.recording(0, load=heavy, command=lambda t: 1.2 * np.sin(0.8 * t))
    off = np.abs(recording.position - recording.command).max()
    assert off > 0.35
    assert readings.departure(T, *recording.command.T, *recording.position.T, gravity=True) is None


def test_a_wrong_reading_is_found_and_nothing_else():
    wrong = np.array([40, 41, 200, 431])
    angle = ANGLE.copy()
    angle[wrong] += [1.0, 1.0, -2.4, 0.4]
    np.testing.assert_array_equal(np.flatnonzero(readings.wrong_readings(angle)), wrong)
    assert "j1 has 4 readings far from those before and after" in said(changed(angle))["warning"]
    gap = angle.copy()
    gap[::9] = np.nan
    found = np.flatnonzero(readings.wrong_readings(gap))
    np.testing.assert_array_equal(found, np.setdiff1d(wrong, np.arange(0, T.size, 9)))


def test_a_fast_motion_has_no_wrong_reading():
    t = np.arange(0, 4, 0.033)
    assert not readings.wrong_readings(1.5 * np.sin(2 * np.pi * 4 * t)).any()
    assert not readings.wrong_readings(np.where(t % 1 < 0.5, 0.0, 2.0)).any()


def test_one_wrong_reading_is_no_angle_that_precedes_its_command():
    """The correlation with the command depends on that one alone."""
    slow = simulated.recording(1, seconds=6.0, command=lambda t: 0.08 * np.sin(t))
    angle = slow.position.copy()
    angle[150] += 4.5
    wrong = replace(slow, position=angle)
    validate_recording(wrong)
    assert ["one reading far" in text for text in admitted([wrong])[1]] == [True]


@pytest.mark.parametrize("turn", [2 * np.pi, 5.24])
def test_an_angle_that_wraps_is_refused(turn):
    wrapped = changed(np.mod(ANGLE + 0.2, turn))
    after, jumps = readings.wraps(wrapped.position[:, 0])
    crossings = np.flatnonzero(np.abs(np.diff(wrapped.position[:, 0])) > 3) + 1
    np.testing.assert_array_equal(after, crossings)
    np.testing.assert_allclose(np.abs(jumps), turn, atol=0.3)
    with pytest.raises(InputError, match=r"j1\.position_rad: found an angle that jumps by .* rad"):
        admitted([wrapped])[1]
    assert "(one turn)" in said(wrapped)["error"] or turn < 6


@pytest.mark.parametrize("every", [2, 3, 5, 40])
def test_a_constant_between_measurements_is_refused(every):
    angle = ANGLE + 1.0
    angle[::every] = 0.0
    value, count = readings.interleaved_constant(angle)
    assert (value, count) == (0.0, pytest.approx(angle.size / every, abs=2))
    with pytest.raises(InputError, match="reads exactly 0 rad between other angles"):
        admitted([changed(angle)])[1]


def test_turning_points_are_no_constant():
    t = np.arange(0, 6, 0.05)
    angle = STEP * np.round(0.6 * np.sin(2 * np.pi * 5 * t) / STEP)
    assert readings.interleaved_constant(angle) is None


@pytest.mark.parametrize("share", [0.05, 0.1, 0.5])
def test_stale_readings_are_named(share):
    recording = simulated.recording(2, seconds=20.0, command=chirp, noise=1e-4)
    angle = STEP * np.round(recording.position[:, 0] / STEP)
    before = said(replace(recording, position=angle[:, None]))
    assert before["warning"] == ""
    stale = np.random.default_rng(0).random(angle.size) < share
    for k in np.flatnonzero(stale[1:]) + 1:
        angle[k] = angle[k - 1]
    found = readings.stale_share(angle, STEP, 5e-4)
    assert share > 0.2 or found == pytest.approx(share, rel=0.3)  # else few turn steadily
    text = said(replace(recording, position=angle[:, None]))["warning"]
    assert "j1 has stale readings: " in text


def test_a_stop_is_found_with_its_times_and_place():
    stopped = np.minimum(ANGLE, 0.1)
    stopped += 1e-4 * np.random.default_rng(0).standard_normal(T.size)
    found = readings.departure(T, SENT, stopped, gravity=False)
    start, end = found.windows_s[0]
    beyond = (start + 0.3 < T) & (end - 0.3 > T)
    assert found.held_rad == pytest.approx(0.1, abs=0.01)
    assert found.largest_rad == pytest.approx(np.max(SENT) - 0.1, rel=0.2)
    assert np.all(SENT[beyond] > 0.1)
    text = said(changed(stopped))["warning"]
    assert "j1 does not follow its command: for" in text
    assert "stays near 0.1 rad" in text


def released(angle):
    off = angle.copy()
    off[(T > 4) & (T < 7)] = 0.6
    return off + 1e-4 * np.random.default_rng(0).standard_normal(T.size)


@pytest.mark.parametrize(
    "fault",
    [
        lambda: changed(ANGLE, np.diff(SENT, prepend=0.0)),
        lambda: changed(released(ANGLE)),
        lambda: changed(simulated.recording(8).position[:, 0]),
    ],
    ids=["increments", "released", "other command"],
)
def test_an_angle_that_does_not_follow_its_command_is_found(fault):
    found = said(fault())
    assert "j1 does not follow its command" in found["warning"] + found["error"]


def test_a_reversed_sign_is_refused_but_half_a_period_is_not():
    with pytest.raises(InputError, match="found an angle that moves against its command"):
        admitted([changed(-ANGLE)])[1]
    late = simulated.recording(0, command=lambda t: 0.5 * np.sin(2 * np.pi * t))
    (text,) = admitted([replace(late, position=-late.position)])[1]
    assert "or its latency exceeds 0.15 s" in text


def test_readings_outside_the_limits_are_named():
    robot = simulated.robot("j1")
    angle = ANGLE.copy()
    angle[300:] += 1.4
    text = said(changed(angle), robot)["warning"]
    assert "outside its limits of -1 to 1 rad" in text
