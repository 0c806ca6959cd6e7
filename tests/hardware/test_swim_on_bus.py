"""A policy that drives servos on a bus of this computer, with poses from a tracker."""

import socket
import threading
import time

import numpy as np
import pytest
from virtual_bench import LIMITS, limit, limits, refused, robot_file, served

from rl.deploy.link import Telemetry, telemetry_bytes
from rl.deploy.policy import npz
from sim2real.cli import main
from sim2real.recording import read_recording
from tests.rl.test_swim import random_policy

JOINTS = ("j1", "j2", "j3")


@pytest.fixture
def policy(tmp_path):
    (tmp_path / "policy.npz").write_bytes(npz(random_policy()))
    return tmp_path / "policy.npz"


@pytest.fixture
def tracker():
    """URL at which poses arrive, from a tracker that sees the fish stand still."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        address = probe.getsockname()
    done = threading.Event()

    def watch():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not done.wait(0.02):
                seen = Telemetry(time.monotonic(), np.zeros(3), np.empty(0))
                sender.sendto(telemetry_bytes(seen), address)

    thread = threading.Thread(target=watch)
    thread.start()
    yield "udp://{}:{}".format(*address)
    done.set()
    thread.join()


def swim(policy, folder, port, tracker, *more, bus="dynamixel"):
    robot = str(robot_file(folder, 3))
    return main(
        ["swim", str(policy), "--target", "1.5,0.4", "--bus", bus, "--port", port, "--ids", "1,2,3",
         "--robot", robot, "--pose", tracker, "--seconds", "1", "--out", str(folder / "swim.csv"),
         *more]
    )  # fmt: skip


def test_servos_follow_the_policy_and_are_released(policy, tmp_path, tracker):
    with served(3, bus="dynamixel") as bench:
        for servo in bench.servos:
            limit(servo)
        assert swim(policy, tmp_path, bench.port, tracker) == 0
        for servo in bench.servos:
            assert not servo.powered
            assert limits(servo) == LIMITS
    recording = read_recording(tmp_path / "swim.csv")
    assert recording.joints == JOINTS
    assert np.nanmax(np.abs(recording.position)) > 0.1
    late = recording.command[:-4] - recording.position[4:]  # its latency
    assert np.nanmedian(np.abs(late)) < 0.2


def test_a_hot_servo_ends_the_swim(policy, tmp_path, tracker, capsys):
    with served(3, bus="feetech", temperature_C=60, heating_C_per_s=6) as bench:
        assert swim(policy, tmp_path, bench.port, tracker, "--seconds", "5", bus="feetech") == 1
        assert not any(servo.powered for servo in bench.servos)
    assert "j1's servo is at 66 C, above 65 C" in capsys.readouterr().err


def test_what_is_wrong_is_one_line(policy, tmp_path, tracker, capsys):
    for more, part in (
        (["--ids", "1,2"], "--ids: found 2 numbers, expected 3"),
        (["--pose", "nonsense"], "--pose"),
        (["--bus", "lynx"], "--bus: found 'lynx'"),
        (["--ids", "4,5,6"], "no reply from servo 4"),
    ):
        with served(3, bus="dynamixel") as bench:
            refused(capsys, swim(policy, tmp_path, bench.port, tracker, *more), 2, part)
