"""A recording from beginning to end on virtual servos, and from a port to gains and a page."""

import json
import subprocess
import sys

import numpy as np
import pytest
from virtual_bench import LAW, record, refused, robot_file, served

from sim2real.cli import main
from sim2real.identification.identify import identify
from sim2real.model import read_model
from sim2real.recording import read_recording
from sim2real.robot import read_robot


def test_three_joints_keep_apart_on_a_wire_that_echoes(tmp_path, capsys):
    with served(3, echo=True) as bench:
        more = ["--seconds", "1.5", "--trim=10,0,-10", "--reverse", "j2", "--medium", "water"]
        assert record(tmp_path, bench.port, *more, joints=3) == 0
        assert not any(servo.powered for servo in bench.servos)
    recording = read_recording(tmp_path / "run.csv")
    assert recording.joints == ("j1", "j2", "j3")
    assert recording.medium == "water"
    assert np.isnan(recording.position).mean() < 0.2
    rest, moved = recording.t < 0.5, recording.t > 0.9
    assert np.nanmax(np.abs(recording.position[rest])) < 0.005, "trimmed"
    apart = recording.position[moved] - recording.position[moved][:, :1]
    assert np.nanmax(np.abs(apart)) < 0.1, "all three do the same"
    assert np.nanmax(np.abs(recording.position)) > 0.4
    told = [np.isfinite(recording.columns[f"j{k}.temperature_C"]).sum() for k in (1, 2, 3)]
    assert min(told) >= 10


def test_commands_of_a_file_are_played(tmp_path):
    rows = ["t_s,j1.command_rad", "0,0.1", "0.5,0.2", "0.8,2.0"]
    (tmp_path / "plan.csv").write_text("\n".join(rows) + "\n")
    with served(1) as bench:
        assert record(tmp_path, bench.port, signal=str(tmp_path / "plan.csv")) == 0
    recording = read_recording(tmp_path / "run.csv")
    sent = recording.command[:, 0]
    assert sent[0] == pytest.approx(0.1, abs=0.003)
    assert sent[-1] == pytest.approx(0.3, abs=0.01), "on its way to the limit at the servo's speed"
    assert np.abs(np.diff(sent)).max() <= 5.24 / 50 + 0.0042
    assert recording.metadata["signal"]["notes"]


def test_a_dry_run_shows_the_signal_and_needs_no_port(tmp_path, capsys):
    robot, picture = robot_file(tmp_path, 2), tmp_path / "signal.png"
    options = ["--robot", str(robot), "--dry-run", "--plot", str(picture), "--amplitude", "0.9"]
    assert main(["record", "square", *options]) == 0
    text = capsys.readouterr().out
    assert "1500 set-points" in text
    assert "-0.800 to +0.800 rad" in text
    assert "0.9 rad cut to 0.8 rad by its limits" in text
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_identify_finds_the_servo_through_a_radio_that_loses_packets(tmp_path, capsys):
    """What is lost is missing; the rest is what the servo did."""
    with served(1, udp=True, loss=0.02, noise=0.001) as bench:
        more = ["--inertia=0.002", "--seconds", "14"]
        assert record(tmp_path, bench.port, *more, signal="steps") == 0
    recording, said = read_recording(tmp_path / "run.csv"), capsys.readouterr().out
    rows, missing = recording.t.size, int(np.isnan(recording.position).sum())
    assert f"{rows} rows" in said and f"j1 {missing}" in said
    assert 5 < missing < 0.4 * rows, "two per cent of packets each way, and noise"
    assert recording.t[-1] == pytest.approx(14, abs=0.1), "its schedule does not drift"
    assert recording.loads["j1"].inertia_kgm2 == 0.002
    supply, temperature = (recording.columns[c] for c in ("supply_V", "j1.temperature_C"))
    assert np.nanmin(supply) == np.nanmax(supply) == 7.4
    assert np.nanmin(temperature) == np.nanmax(temperature) == 30
    clock = recording.columns["device_t_s"]
    told = np.isfinite(clock)
    assert told.sum() > 0.6 * rows
    apart = np.diff(clock[told]) - np.diff(recording.t[told])
    assert np.abs(np.median(apart)) < 1e-3
    robot = read_robot(tmp_path / "robot.toml")
    model = identify([recording], robot, law="pd").joints["j1"]  # what the virtual servo obeys
    assert model.kp_Nm_per_rad == pytest.approx(LAW.kp_Nm_per_rad, rel=0.03)
    assert model.kd_Nms_per_rad == pytest.approx(LAW.kd_Nms_per_rad, rel=0.03)
    assert model.latency_s == pytest.approx(LAW.latency_s, abs=0.003)


@pytest.mark.parametrize(
    ("more", "bus"),
    [
        (["--udp", "127.0.0.1:0"], "lx"),
        (["--bus", "dynamixel", "--servo", "XM430-W350"], "dynamixel"),
    ],
)
def test_scan_finds_what_virtual_servo_serves(more, bus, capsys):
    command = [sys.executable, "-m", "sim2real", "virtual-servo", "--ids", "1,3", *more]
    program = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        port = program.stdout.readline().removeprefix("port: ").strip()
        assert main(["scan", "--port", port, "--ids", "1-4", "--bus", bus]) == 0
        rows = capsys.readouterr().out.splitlines()[1:]
        assert [row.split()[0] for row in rows] == ["1", "3"]
        assert bus == "lx" or "XM430-W350" in rows[0]
    finally:
        program.terminate()
        program.communicate(timeout=10)
    assert program.returncode == 0
    status = main(["virtual-servo", "--bus", "dynamixel", "--servo", "XM430"])
    refused(capsys, status, 2, "--servo: found 'XM430'")


UNKNOWN = "--unknown-load"


def bench(port, folder, *more):
    options = ["--bus", "feetech", "--port", port, "--ids", "1", "--out", str(folder)]
    return main(["bench", *options, *more])


def test_one_command_identifies_a_servo(tmp_path, capsys):
    inertia = ["--inertia", str(LAW.inertia_kgm2)]
    with served(1, bus="feetech", loss=0.02, noise=0.001) as servos:
        assert bench(servos.port, tmp_path, *inertia, "--seconds", "3") == 0
        assert not servos.servos[0].powered
        said = capsys.readouterr().out
        assert "STS3215" in said and "kp" in said and "index.html" in said
        refused(capsys, bench(servos.port, tmp_path, *inertia), 2, "--overwrite")
    joint = read_model(tmp_path / "model.json").joints["j1"]
    assert joint.kp_Nm_per_rad == pytest.approx(LAW.kp_Nm_per_rad, rel=0.05)
    assert joint.kd_Nms_per_rad == pytest.approx(LAW.kd_Nms_per_rad, rel=0.05)
    trip_s = np.nanmean(read_recording(tmp_path / "steps.csv").columns["round_trip_s"])
    assert joint.latency_s == pytest.approx(LAW.latency_s, abs=0.002 + trip_s)  # on a busy machine
    page = (tmp_path / "index.html").read_text()
    assert page.index("Identification") < page.index("Recordings")
    sidecar = json.loads((tmp_path / "steps.json").read_text())
    assert sidecar["loads"] == {"j1": {"inertia_kgm2": LAW.inertia_kgm2}}
    assert sidecar["bus"]["servos"][0]["model"] == "STS3215"
    assert "max_torque_Nm = 1.91" in (tmp_path / "robot.toml").read_text(), "the one for 7.4 V"


def test_the_load_is_asked_for_on_a_terminal_only(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    assert bench("udp://127.0.0.1:9", tmp_path) == 2
    assert "--mass and --arm, --inertia or --unknown-load" in capsys.readouterr().err
    from sim2real.commands.bench import _asked, load_of

    answers = iter(["heavy", "0.1", "", "0.12"])
    monkeypatch.setattr("builtins.input", lambda question: next(answers))
    hanging = {"pendulum_mass_kg": 0.1, "pendulum_length_m": 0.12}
    inertia = {"inertia_kgm2": pytest.approx(0.1 * 0.12**2)}
    assert _asked(1, hangs=True) == inertia | hanging
    assert load_of(0.1, 0.12, hangs=False) == inertia


@pytest.mark.parametrize(
    ("more", "status", "part"),
    [
        ([UNKNOWN, "--ids", "4"], 1, "no reply from servo 4 (feetech, 1000000 baud)"),
        ([UNKNOWN, "--bus", "feetec"], 2, "--bus"),
        ([UNKNOWN, "--reach", "9"], 2, "--reach"),
        ([UNKNOWN, "--seconds", "0"], 2, "--seconds"),
        ([UNKNOWN, "--ids", "a"], 2, "--ids"),
        (["--mass", "1", "--arm", "0"], 2, "--arm"),
        (["--mass", "1"], 2, "--arm: found nothing"),
        ([UNKNOWN, "--max-temperature", "300"], 2, "--max-temperature"),
    ],
)
def test_bad_input_is_one_line(tmp_path, capsys, more, status, part):
    with served(1, bus="feetech") as servos:
        refused(capsys, bench(servos.port, tmp_path, *more), status, part)
    assert not list(tmp_path.iterdir()), "nothing is written"


def test_a_servo_without_ratings_needs_a_robot_file(tmp_path, capsys):
    with served(1, bus="feetech", model="STS") as servos:
        refused(capsys, bench(servos.port, tmp_path, UNKNOWN), 2, "ratings of servo 1 (STS)")
        robot = ["--robot", str(robot_file(tmp_path, 2))]
        status = bench(servos.port, tmp_path / "out", UNKNOWN, *robot)
        refused(capsys, status, 2, "--ids: found 1 numbers, expected 2")
