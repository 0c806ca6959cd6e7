import re
import sys
from dataclasses import replace

import numpy as np
import pytest
import simulated

from sim2real.check import Check, check
from sim2real.errors import InputError, RecordingFinding
from sim2real.recording import Load, Recording, read_recording
from sim2real.robot import Robot, match_joints, read_robot

STEP = 0.00419
T = np.arange(0, 10, 0.02)
SQUARE = np.where(T % 2 < 1, 0.0, 0.5)
PENDULUM = Load(0.0049, 0.49, 0.1)
FAST = 0.4 * np.sin(2 * np.pi * T)


def robot(*names: str) -> Robot:
    return simulated.robot(*names, limits=(-0.8, 0.8))


def follow(t: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Position that follows ``command`` as a first-order lag of 50 ms, in steps of ``STEP``."""
    position = np.full(t.size, command[0])
    for k in range(1, t.size):
        share = 1 - np.exp(-(t[k] - t[k - 1]) / 0.05)
        position[k] = position[k - 1] + share * (command[k - 1] - position[k - 1])
    noise = np.random.default_rng(0).normal(0, 0.5 * STEP, t.size)
    return STEP * np.round((position + noise) / STEP)


def recording(command=SQUARE, position=None, *, t=T, load=PENDULUM, kind="servo") -> Recording:
    position = follow(t, command) if position is None else position
    loads = {} if load is None else {"j1": load}
    return Recording("bench", kind, ("j1",), t, command[:, None], position[:, None], loads)


@pytest.fixture
def without_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves out the fits that say what is identifiable: no finding depends on them."""
    module = sys.modules["sim2real.check"]  # the attribute of the package is the verb
    monkeypatch.setattr(module, "expected_precision", lambda *_, **__: ())


def said(checked: Check) -> str:
    return " ".join(finding.text for finding in checked.all_findings)


def test_a_good_recording_has_no_finding() -> None:
    checked = check(recording(), robot("j1"))
    joint = checked.joints[0]
    assert said(checked) == ""
    assert (checked.recording, checked.kind, joint.joint) == ("bench", "servo", "j1")
    assert checked.duration_s == pytest.approx(9.98)
    assert checked.timing.rate_hz == pytest.approx(50)
    assert checked.timing.jitter_s == pytest.approx(0, abs=1e-9)
    assert (checked.timing.gaps, checked.timing.missing_cells, joint.missing) == ((), 0, 0)
    assert joint.command_range_rad == 0.5
    assert joint.range_rad == pytest.approx(0.5, abs=5 * STEP)
    assert joint.step_rad == pytest.approx(STEP, rel=0.01)
    assert joint.noise_rad == pytest.approx(STEP * np.hypot(0.5, 1 / np.sqrt(12)), rel=0.25)
    assert joint.moves == 9
    assert joint.load == "0.0049 kg m2, 0.49 kg at 0.1 m"
    # kp shows against the pendulum's weight; steps of this size are too coarse for the rest
    known, unknown = joint.identifiable
    assert re.fullmatch(r"can identify: kp to [\d.]+ %", known)
    assert unknown == "cannot identify: kd, latency, inertia left out"


def test_a_joint_that_does_not_move_identifies_nothing() -> None:
    (joint,) = check(recording(np.zeros(T.size))).joints
    assert joint.identifiable == (
        "nothing can be identified: the joint does not move under command",
    )


@pytest.mark.usefixtures("without_fits")
@pytest.mark.parametrize(
    ("command", "moves"),
    [
        (np.zeros(T.size), 0),
        (SQUARE, 9),
        (np.floor(T) / 20, 9),  # a staircase: each step is a move of its own
        (np.sin(2 * np.pi * T), 21),
        (np.minimum(T, 3), 1),
    ],
)
def test_moves(command: np.ndarray, moves: int) -> None:
    assert check(recording(command)).joints[0].moves == moves


def stuck() -> np.ndarray:
    position = follow(T, FAST)
    position[100:200] = position[100]
    return position


def missing() -> np.ndarray:
    position = follow(T, SQUARE)
    position[::10] = np.nan
    return position


SLOW = 0.4 * np.sin(2 * np.pi * 0.1 * T)


@pytest.mark.usefixtures("without_fits")
@pytest.mark.parametrize(
    ("seen", "words"),
    [
        (recording(SQUARE, np.full(T.size, np.nan)), "j1 has no measured positions"),
        (recording(SQUARE, missing()), "j1 lacks 10 % of its positions"),
        (recording(np.zeros(T.size)), "j1 is never commanded to move"),
        (
            recording(SQUARE, follow(T, 0 * T)),
            "j1 does not move, although its command spans 0.5 rad",
        ),
        (recording(FAST, stuck()), "from 2 to 4 s while its command moves by 0.8 rad: friction,"),
        (recording(FAST, -follow(T, FAST)), "moves against its command"),
        (recording(SQUARE, follow(T, SQUARE) + 0.03), "starts at rest 0.03"),
        (recording(SQUARE, follow(T, SQUARE) - 0.03), "rad below its command"),
        (recording(SQUARE, follow(T, SQUARE) - 0.3), "rad away from its first command"),
        (recording(SQUARE, follow(T, SQUARE) + np.exp(-T / 0.2)), "j1 is moving at the start"),
        (recording(SLOW), "moved very slowly (about 0.1 Hz)"),
        (recording(np.where(T < 5, 0, 0.5)), "commanded to move only once"),
        (recording(1.2 * SQUARE * 2), "commanded to 1.2 rad, beyond its limits of -0.8 to 0.8"),
        (recording(3 * FAST), "at up to 7.52 rad/s, above its servo's no-load speed of 5.24"),
        (recording(SQUARE, np.round(follow(T, SQUARE), 2)), "in steps of 0.01 rad, but the data"),
        (recording(load=None), "no stated load: its gains are identified per unit"),
        (recording(load=Load(0.002)), "has no pendulum: only kp/inertia and kd/inertia are"),
        (recording(np.where(T < 7, SQUARE, np.nan), follow(T, SQUARE)), "torque is off from 7 s"),
        (recording(np.full(T.size, np.nan), FAST, kind="pool"), "No command was recorded"),
        (recording(kind="pool"), "The body was not tracked"),
    ],
)
def test_joint_findings(seen: Recording, words: str) -> None:
    assert words in said(check(seen, robot("j1")))


@pytest.mark.usefixtures("without_fits")
def test_pool_recordings_need_no_load() -> None:
    swimming = recording(load=None, kind="pool")
    checked = check(replace(swimming, columns={"body.x_m": T}), robot("j1"))
    assert said(checked) == ""
    assert checked.joints[0].load == "air"


def test_joint_that_the_robot_lacks() -> None:
    strange = replace(recording(), joints=("j9",), loads={})
    for look in (match_joints, check):
        with pytest.raises(InputError) as caught:
            look(strange, robot("j1", "j2", "j3"))
        assert caught.value.where == "joints"
        assert caught.value.found == "'j9'"
        assert caught.value.expected == "one of j1, j2, j3"
        assert caught.value.file == "bench.csv"
    match_joints(recording(), robot("j0", "j1"))


@pytest.mark.usefixtures("without_fits")
def test_text_is_narrow_and_complete() -> None:
    joint = "the joint with a very, very long name that no table would ever hold in a column"
    bad = replace(
        recording(3 * SQUARE, t=np.where(T < 4, T, T + 0.42), load=None),
        joints=(joint,),
        name="r" * 150,
    )
    checked = check(bad, robot(joint))
    row = replace(checked.joints[0], identifiable=("kp to 2 %",), load="a long load " * 9)
    text = str(replace(checked, joints=(row,)))
    lines = text.splitlines()
    assert max(map(len, lines)) <= 100
    marks = [line for line in lines if line.startswith("! ")]
    assert len(marks) == len(checked.findings) + len(row.findings) >= 3
    assert "kp to 2 %" in text
    assert "clock: 50 Hz" in text


@pytest.mark.usefixtures("without_fits")
def test_real_servos(realdata) -> None:
    folder = realdata / "bam_xl330"
    for csv in sorted(folder.glob("*.csv")):
        checked = check(read_recording(csv), read_robot(folder / "robot.toml"))
        dropped = "lift_and_drop" in csv.name
        assert ("torque is off from 2.00" in said(checked)) == dropped
        assert ("sampling rate changes" in said(checked)) == dropped
        assert ("very slowly" in said(checked)) == ("up_and_down" in csv.name)
        assert "against" not in said(checked)
        assert "limits" not in said(checked)


@pytest.mark.usefixtures("without_fits")
def test_what_joints_share_is_said_once():
    one = check(recording())
    odd, still = (RecordingFinding("a's load is odd."), RecordingFinding("a never moves."))
    first = replace(one.joints[0], joint="a", findings=(odd, still))
    second = replace(one.joints[0], joint="b", findings=(RecordingFinding("b's load is odd."),))
    both = replace(one, joints=(first, second), findings=(RecordingFinding("A gap."),))
    texts = [finding.text for finding in both.all_findings]
    assert texts == ["A gap.", "a, b: load is odd.", "a never moves."]
