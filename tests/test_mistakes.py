"""Common mistakes of unit, column and spelling are refused in one line that names them."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from good_input import message
from simulated import INERTIA, LATENCY, NOISE, one_joint, recording, robot, row, steps

import sim2real as s2r
from sim2real.errors import InputError
from sim2real.exporters.simulators import TARGETS
from sim2real.model import JointModel, Model
from sim2real.output import write_json
from sim2real.plausible import validate_recording
from sim2real.readings import lead_s
from sim2real.recording import Load, Recording, read_commands, read_recording
from sim2real.robot import Servo, read_robot
from sim2real.servo.rollout import rollout

GOOD = recording(1, "bench", seconds=8.0)
BENCH = robot("j1")
SERVO = Model(joints={"j1": JointModel(2.2, 0.06, 0.05, INERTIA)})


@pytest.mark.parametrize(
    ("wrong", "parts"),
    [
        (replace(GOOD, t=1e3 * GOOD.t), ("t_s", "20 s apart", "in milliseconds?")),
        (replace(GOOD, t=1e6 * GOOD.t), ("t_s", "in microseconds?")),
        (replace(GOOD, t=1e9 * GOOD.t), ("t_s", "in nanoseconds?")),
        (replace(GOOD, t=GOOD.t / 3600), ("t_s", "20 us", "hours")),
        (
            replace(GOOD, command=GOOD.position, position=GOOD.command),
            ("j1.position_rad", "moves 0.", "before its command", "swapped"),
        ),
        (replace(GOOD, position=GOOD.command), ("j1.command_rad and j1.position_rad", "twice")),
        (
            replace(GOOD, loads={"j1": Load(1e3 * INERTIA)}),
            ("loads.j1.inertia_kgm2", "N m", "1.67"),
        ),
        (
            replace(
                GOOD, command=np.degrees(GOOD.command) / 5, position=np.degrees(GOOD.position) / 5
            ),
            ("j1.command_rad at", "limits_rad of -1 to 1", "degrees"),
        ),
        (
            replace(GOOD, position=np.degrees(GOOD.position) / 5),
            ("j1.position_rad", "rad/s", "no_load_speed_rad_s", "degrees"),
        ),
    ],
)
def test_recordings(wrong: Recording, parts: tuple[str, ...]) -> None:
    for verb in (s2r.check, s2r.identify, s2r.diagnose):
        message(lambda verb=verb: verb(wrong, BENCH), "bench.csv", *parts)


@pytest.mark.parametrize("unit", [1e3, 1e6])
def test_commands_whose_times_are_not_in_seconds(tmp_path: Path, unit: float) -> None:
    path = tmp_path / "next.csv"
    path.write_text("t_s,j1.command_rad\n" + "".join(f"{unit * k / 50},0.1\n" for k in range(9)))
    message(lambda: read_commands(path), str(path), "t_s", "seconds?")
    path.write_text("t_s,j1.command_rad\n0,0.1\n5,0.2\n10,0.1\n")  # way points
    assert read_commands(path).t.size == 3


def test_shipped_and_real_recordings_are_plausible(realdata: Path) -> None:
    root = Path(__file__).parents[1] / "datasets"
    for folder in (root / "servo_steps", root / "pool", *realdata.iterdir()):
        for path in folder.glob("*.csv") if folder.is_dir() else ():
            if path.stem == "emps":  # a linear drive, in another form
                continue
            known = read_recording(path)
            validate_recording(
                known, read_robot(folder / known.metadata.get("robot", "robot.toml"))
            )


@pytest.mark.parametrize(
    ("call", "parts"),
    [
        (lambda: s2r.identify(GOOD, BENCH, law="pid"), ("law", "'pid'", "pd, motor")),
        (lambda: s2r.identify(GOOD, BENCH, seed=-1), ("seed", "-1", "at least 0")),
        (lambda: s2r.identify(GOOD, BENCH, effects="backlsh"), ("effects", "'backlsh'")),
        (lambda: s2r.identify(GOOD, BENCH, effects=[3]), ("effects", "3", "a name")),
        (lambda: s2r.identify(3, BENCH), ("recordings", "3")),
        (lambda: s2r.identify([None], BENCH), ("recordings", "None")),
        (lambda: s2r.identify([], BENCH), ("recordings", "none", "at least one")),
        (lambda: s2r.identify(GOOD, None), ("robot", "None")),
        (lambda: s2r.predict(GOOD, BENCH, 3), ("model", "3")),
        (lambda: s2r.posterior(GOOD, BENCH, SERVO, steps=0), ("steps", "0", "at least 1")),
        (
            lambda: s2r.simulate(GOOD, BENCH, SERVO, fidelity="real"),
            ("fidelity", "'real'", "fluid, twin"),
        ),
        (
            lambda: TARGETS["json"].write(SERVO, robot("a", "b")),
            ("joints", "a, b", "the model's joint j1"),
        ),
    ],
)
def test_arguments(call: Callable[[], object], parts: tuple[str, ...]) -> None:
    message(call, *parts)


def test_no_data_sheet_means_the_linear_law() -> None:
    for stated in ({}, {"max_torque_Nm": 1.67}):
        bare = robot("j1", servo=Servo("lx824", **stated))
        found = s2r.identify(GOOD, bare).joints["j1"]
        assert found.law == "pd"
        assert any("states no" in n and "no_load_speed_rad_s" in n for n in found.notes)
        s2r.check(GOOD, bare)
        with pytest.raises(InputError, match="lx824|servos"):
            s2r.identify(GOOD, bare, law="motor")
    linear = s2r.identify(GOOD, BENCH, law="pd").joints["j1"]
    assert found.kp_Nm_per_rad == pytest.approx(linear.kp_Nm_per_rad)
    assert not any("states no" in note for note in linear.notes)


def test_a_polled_set_point_shortens_the_latency_by_half_a_period() -> None:
    period, found = 0.016, []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        sent_at = 0.001 * np.arange(20_000)
        sent = steps(sent_at, rng)
        angle = rollout(row()[None], sent_at, sent)[0]
        seen = np.arange(0, sent_at.size, 16)
        position = angle[seen] + rng.normal(0, NOISE, seen.size)
        polled = one_joint(sent_at[seen], sent[seen], position)
        found.append(s2r.identify(polled, BENCH, law="pd").joints["j1"].latency_s)
    assert np.mean(found) == pytest.approx(LATENCY - period / 2, abs=0.002)


def test_infinite_numbers_in_json(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    write_json(path, {"a": [np.inf, -np.inf, float("nan")], "b": {"c": (np.float64(np.inf), 1.5)}})
    found = json.loads(path.read_text(), parse_constant=pytest.fail)
    assert found == {"a": ["inf", "-inf", None], "b": {"c": ["inf", 1.5]}}


@pytest.mark.parametrize("frequency_hz", [0.2, 0.7, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("latency_s", [0.02, 0.08, 0.15])
def test_smooth_commands_are_followed(frequency_hz: float, latency_s: float) -> None:
    t = 0.02 * np.arange(600)
    rng = np.random.default_rng(0)
    phase = 2 * np.pi * frequency_hz * np.maximum(t - 0.5, 0.0)
    late = 2 * np.pi * frequency_hz * np.maximum(t - 0.5 - latency_s, 0.0)
    command, position = 0.5 * np.sin(phase), 0.5 * np.sin(late) + rng.normal(0, 0.002, t.size)
    assert lead_s(t, command, position) is None
