"""From servos on a port to gains and a page, with one command."""

import json

import pytest
from virtual_bench import LAW, refused, robot_file, served

from sim2real.cli import main
from sim2real.hardware.bench import Weight
from sim2real.model import read_model

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
    assert joint.latency_s == pytest.approx(LAW.latency_s, abs=0.002)
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
    from sim2real.commands.bench import _asked

    answers = iter(["heavy", "0.1", "", "0.12"])
    monkeypatch.setattr("builtins.input", lambda question: next(answers))
    assert _asked(1) == Weight(0.1, 0.12)
    hanging = {"pendulum_mass_kg": 0.1, "pendulum_length_m": 0.12}
    inertia = {"inertia_kgm2": pytest.approx(0.1 * 0.12**2)}
    assert Weight(0.1, 0.12).load(hangs=True) == inertia | hanging
    assert Weight(0.1, 0.12).load(hangs=False) == inertia


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
