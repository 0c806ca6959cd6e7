"""Swimming over the air: what is said, what a policy sees, how a swim ends, what is kept of it."""

import argparse
import os
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rl.commands.swim import run
from rl.deploy.link import (
    Link,
    SetPoints,
    Telemetry,
    read_set_points,
    read_telemetry,
    set_point_bytes,
    telemetry_bytes,
)
from rl.deploy.pilot import CONTROL_S, REST_S, Measurements, Pilot, swim
from rl.deploy.policy import Policy, PolicyController, npz
from rl.deploy.robots import VirtualRobot, serve, virtual_robot
from rl.observer import PAPER, View, observation_bounds, observation_names
from sim.inference.swims import swim_of
from sim.twin.twin import Twin
from sim2real.errors import InputError
from sim2real.recording import read_recording

POOL = Path(__file__).resolve().parents[2] / "datasets" / "pool"
JOINTS = ("j1", "j2", "j3")
LIMIT = np.array(observation_bounds(3), dtype=np.float32)
FAR = np.array([1.5, 0.4])


def random_policy(width: int = 24, seed: int = 5, view: View = PAPER) -> Policy:
    """A network that has learnt nothing and moves a lot."""
    rng = np.random.default_rng(seed)
    sizes = [(width, view.size(3)), (3, width)]
    return Policy(
        weights=tuple(rng.normal(0, 1.4 / n**0.5, (m, n)).astype(np.float32) for m, n in sizes),
        biases=tuple(rng.normal(0, 0.5, m).astype(np.float32) for m, _ in sizes),
        low=np.array([-0.8, -0.7, -0.8], np.float32),
        high=np.array([0.6, 0.8, 0.8], np.float32),
        joints=JOINTS,
        observation=tuple(observation_names(JOINTS)),
        observation_limit=LIMIT,
        view=view,
    )


@pytest.fixture
def twin(robot, model) -> Twin:
    return Twin(robot, model, threads=1)


@pytest.fixture
def radio():
    """A robot's end of the air, played by the test, and its URL."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.setblocking(False)
        end.bind(("127.0.0.1", 0))
        yield end, "udp://{}:{}".format(*end.getsockname())


def begun(robot: VirtualRobot, key: bytes | None = None, sender: object = None) -> str:
    """Begin a session with a robot; its identifier."""
    assert robot.receive(
        set_point_bytes(SetPoints(0, np.empty(0), "0123456789abcdef"), key), sender
    )
    seen = read_telemetry(robot.telemetry(), 3, key)
    assert seen is not None
    return seen.session


class TestDatagrams:
    def test_come_back_as_they_were_sent(self) -> None:
        seen = Telemetry(12.34, np.array([0.5, np.nan, -3.0]), np.array([0.1, 0.2, np.nan]))
        back = read_telemetry(telemetry_bytes(seen), 3)
        assert back is not None
        assert back.t_s == seen.t_s
        np.testing.assert_array_equal(back.pose, seen.pose)
        np.testing.assert_array_equal(back.joint, seen.joint)
        sent = read_set_points(set_point_bytes(SetPoints(7, np.array([0.25, -0.5, 0.0]))), 3)
        assert sent is not None
        assert sent.number == 7
        assert sent.joint.tolist() == [0.25, -0.5, 0.0]

    @pytest.mark.parametrize(
        "datagram",
        [
            b"",
            b"\xff\xfe",
            b"[" * 3000,
            b'{"t_s": null, "pose": [0, 0, 0], "joints_rad": [0, 0, 0]}',
            b'{"t_s": 1, "pose": [0, 0, true], "joints_rad": [0, 0, 0]}',
            b'{"t_s": 1, "pose": [0, 0, 0], "joints_rad": [0, 0]}',
            b'{"t_s": 1' + b"0" * 400 + b', "pose": [0, 0, 0], "joints_rad": [0, 0, 0]}',
            b'{"number": 1, "joints_rad": [0, 0, NaN]}',
            b'{"number": -1, "joints_rad": [0, 0, 0]}',
            b'{"number": true, "joints_rad": [0, 0, 0]}',
            b'{"number": 1, "joints_rad": []}',
        ],
    )
    def test_that_are_none_are_none(self, datagram: bytes) -> None:
        assert read_telemetry(datagram, 3) is None
        assert read_set_points(datagram, 3) is None

    @pytest.mark.parametrize("url", ["", "udp://", "tcp://127.0.0.1:9", "udp://127.0.0.1:x"])
    def test_go_to_an_address(self, url: str) -> None:
        with pytest.raises(InputError, match="--port"):
            Link(url, 3)


class TestMeasurements:
    @pytest.mark.parametrize("view", [PAPER, View()])
    def test_sees_what_it_saw_in_training(self, twin, world_of, view) -> None:
        """Steered by one policy, the robot on the air goes where the one in training goes."""
        policy, robot, world = random_policy(view=view), VirtualRobot(twin), world_of(1)
        steers, reference = PolicyController(policy), PolicyController(policy)
        target, observer = np.array([0.7, -0.6]), Measurements(LIMIT)
        place = np.array([[0.3, 0.2, 2.8]])
        world.task = replace(world.task, place=lambda *_: (place, np.zeros((1, 3)), target[None]))
        expected = world.reset()
        twin.reset(pose=place)
        moved, session = [], begun(robot)
        for k in range(150):
            seen = read_telemetry(robot.telemetry(), 3)
            assert seen is not None
            assert observer.take(seen)
            observation = observer.observation(target)
            assert observation == pytest.approx(expected[0].numpy(), abs=2e-3), k
            (sent,) = steers.act(observation[None])
            assert robot.receive(set_point_bytes(SetPoints(k + 1, sent, session)))
            robot.advance()
            action = reference.act(expected.numpy())
            expected = world.step(world._tensor(action)).observation
            moved.append(observation)
        assert (np.ptp(moved, axis=0) > 0.02).all(), "each column must have moved"
        turned = np.unwrap(np.array(observer._rows)[:, 2])
        assert np.abs(turned).max() > np.pi, "the heading must have come round"

    def test_missing_measurements_are_bridged(self) -> None:
        """On an even course, gaps, unseen cells and a faster camera change nothing."""
        rng, observer = np.random.default_rng(3), Measurements(LIMIT)
        t = np.sort(rng.uniform(0, 0.5, 60))
        heading = 2.2 + 2.0 * t  # comes round in the last moment
        for k in range(60):
            course = np.array([0.3 * t[k], 0.1 - 0.2 * t[k], np.angle(np.exp(1j * heading[k]))])
            joint = np.array([0.1, -0.2, 0.3]) + np.array([1.0, -2.0, 0.5]) * t[k]
            hidden = (rng.random(6) < 0.3) & (k not in (0, 59))
            course[hidden[:3]], joint[hidden[3:]] = np.nan, np.nan
            assert observer.take(Telemetry(t[k], course, joint))
        now = t[-1]
        c, s = np.cos(2.2 + 2 * now), np.sin(2.2 + 2 * now)
        dx, dy = 1 - 0.3 * now, 1 - (0.1 - 0.2 * now)
        expected = [c * 0.3 - s * 0.2, -c * 0.2 - s * 0.3, 2.0]
        expected += [0.1 + now, -0.2 - 2 * now, 0.3 + 0.5 * now, 1.0, -2.0, 0.5]
        expected += [c * dx + s * dy, c * dy - s * dx]
        assert observer.observation(np.ones(2)) == pytest.approx(expected, abs=1e-5)
        assert not observer.take(Telemetry(now, np.zeros(3), np.zeros(3))), "old news"


def options_of(policy, **changes: object) -> argparse.Namespace:
    options = {"target": "1.5,0.4", "port": None, "virtual": True, "seconds": 1.0, "out": None}
    options |= {"bus": None, "key_file": None}
    options |= {"robot": POOL / "robot.toml", "model": POOL / "model.json", "seed": 0}
    return argparse.Namespace(policy=policy, **{**options, **changes})


@pytest.fixture
def policy_file(tmp_path):
    (tmp_path / "policy.npz").write_bytes(npz(random_policy()))
    return tmp_path / "policy.npz"


class TestCommand:
    def test_a_virtual_swim_ends_in_a_recording(self, policy_file, robot, tmp_path, capsys) -> None:
        out = tmp_path / "swim.csv"
        assert run(options_of(policy_file, out=out)) == 0
        told = capsys.readouterr()
        assert told.err == ""
        assert str(out) in told.out
        recording = read_recording(out)
        assert (recording.kind, recording.joints, recording.medium) == ("pool", JOINTS, "water")
        device = recording.columns["device_t_s"]
        answered = recording.columns["inference_s"]
        assert (answered[:-1] > 0).all() and np.nanmax(answered) < 1
        assert np.ptp(device) == pytest.approx(REST_S + 1.0, abs=0.15)
        steps = np.round(np.diff(device) / CONTROL_S)
        assert np.median(steps) == 1, "a robot at 50 Hz is answered at 50 Hz"
        still = device - device[0] < REST_S - 0.01
        assert (recording.command[still] == 0).all()
        assert np.ptp(recording.command[~still], axis=0).min() > 0.05
        assert np.ptp(recording.position, axis=0).min() > 0.05
        low, high = random_policy().low, random_policy().high
        assert (recording.command >= low - 1e-6).all()
        assert (recording.command <= high + 1e-6).all()
        assert recording.metadata["swim"]["target_m"] == [1.5, 0.4]
        assert np.isfinite(swim_of(recording, robot).signals).all(), "fit for 'calibrate'"

    def test_a_key_is_used_and_not_written(self, policy_file, tmp_path) -> None:
        out, key = tmp_path / "swim.csv", tmp_path / "key"
        key.write_text("a key of the swimming pool\n")
        assert run(options_of(policy_file, out=out, seconds=0.2, key_file=key)) == 0
        assert "swimming" not in out.with_suffix(".json").read_text()
        key.write_text("short")
        with pytest.raises(InputError, match="5 characters"):
            run(options_of(policy_file, key_file=key))

    def test_it_stops_at_the_target(self, policy_file, tmp_path, capsys) -> None:
        twin_starts_at = 0.26 - 0.1  # half its length ahead of the middle, the head's centre behind
        near = f"{twin_starts_at + 0.03},0.0"
        out = tmp_path / "swim.csv"
        assert run(options_of(policy_file, target=near, out=out, seconds=9)) == 0
        assert "target reached in 0.00 s" in capsys.readouterr().out
        assert read_recording(out).metadata["swim"]["closest_m"] < 0.05

    def test_ctrl_c_sends_it_to_rest_and_keeps_the_rows(self, policy_file, tmp_path, capsys):
        out = tmp_path / "swim.csv"
        blow = threading.Timer(1.2, os.kill, (os.getpid(), signal.SIGINT))
        blow.start()
        status = run(options_of(policy_file, out=out, seconds=60))
        blow.join()
        assert status == 1
        assert "interrupted" in capsys.readouterr().err
        assert read_recording(out).metadata["swim"]["stopped"] == "interrupted"

    def test_without_a_robot_nothing_is_written(self, policy_file, tmp_path, radio, monkeypatch):
        monkeypatch.setattr("rl.deploy.pilot.ANSWER_S", 0.2)
        (tmp_path / "out").mkdir()
        for url in (radio[1], "udp://127.0.0.1:9"):
            with pytest.raises(InputError, match="no answer from"):
                run(
                    options_of(policy_file, virtual=False, port=url, out=tmp_path / "out" / "s.csv")
                )
        assert not list((tmp_path / "out").iterdir())

    @pytest.mark.parametrize(
        ("changes", "told"),
        [
            ({"target": "1"}, "--target"),
            ({"target": "1,inf"}, "--target"),
            ({"seconds": 0.0}, "--seconds"),
            ({"seconds": float("nan")}, "--seconds"),
            ({"virtual": False}, "--port"),
            ({"model": None}, "--model"),
            ({"out": "swim.txt"}, "--out"),
        ],
    )
    def test_what_cannot_be_is_refused(self, policy_file, tmp_path, changes, told) -> None:
        if "out" in changes:
            changes = {"out": tmp_path / changes["out"]}
        with pytest.raises(InputError, match=told):
            run(options_of(policy_file, **changes))

    def test_other_joints_are_refused(self, tmp_path) -> None:
        other = replace(random_policy(), joints=("j1", "j3", "j2"))
        (tmp_path / "policy.npz").write_bytes(npz(other))
        with pytest.raises(InputError, match="those of the policy"):
            run(options_of(tmp_path / "policy.npz"))

    def test_it_needs_no_torch(self) -> None:
        program = "import sys, rl.commands.swim, rl.deploy.robots; print('torch' in sys.modules)"
        done = subprocess.run(
            [sys.executable, "-c", program],
            capture_output=True, text=True, check=True, cwd=POOL.parents[1],
        )  # fmt: skip
        assert done.stdout.strip() == "False"


def drained(end: socket.socket) -> list[bytes]:
    found = []
    try:
        while True:
            found.append(end.recv(2048))
    except BlockingIOError:
        return found


class TestContact:
    def test_a_robot_that_falls_silent_is_sent_to_rest(self, twin, radio) -> None:
        end, url = radio
        left = iter([False] * 60)  # periods until it falls silent
        robot = VirtualRobot(twin)
        thread = threading.Thread(target=serve, args=(end, robot, lambda: next(left, True)))
        thread.start()
        with Link(url, 3) as link:
            track = swim(link, Pilot(random_policy(), FAR, 60.0))
        thread.join()
        assert track is not None
        assert track.stopped == "no answer from the robot for 0.5 s"
        assert 20 < len(track.t) <= 60
        last = [read_set_points(datagram, 3) for datagram in drained(end)[-5:]]
        assert [one.joint.tolist() for one in last if one] == [[0.0] * 3] * 5

    def test_a_pilot_that_fails_leaves_the_robot_at_rest(self, twin, monkeypatch) -> None:
        def fail(self: Pilot) -> None:
            raise OSError("disk full")

        monkeypatch.setattr(Pilot, "_command", fail)
        sent = []
        with virtual_robot(twin) as url, Link(url, 3) as link:
            send = link.send
            monkeypatch.setattr(link, "send", lambda joint: (sent.append(joint), send(joint)))
            with pytest.raises(OSError, match="disk full"):
                swim(link, Pilot(random_policy(), FAR, 60.0))
        assert (np.array(sent[-5:]) == 0).all()

    def test_a_camera_that_loses_sight_ends_the_swim(self) -> None:
        pilot = Pilot(random_policy(), FAR, 60.0)
        for k in range(100):
            pose = np.full(3, np.nan) if k > 40 else np.zeros(3)
            pilot.answer([Telemetry(CONTROL_S * k, pose, np.zeros(3))], CONTROL_S * k)
            if pilot.over:
                break
        assert pilot.stopped == "no pose or joint angles for 0.5 s"
        assert 0.02 * 65 < pilot.track().device_t[-1] < 0.02 * 69
        assert (pilot.track().command[-1] == 0).all()

    def test_telemetry_that_comes_too_often_is_not_answered_twice(self) -> None:
        pilot = Pilot(random_policy(), FAR, 60.0)
        answers = []
        for k in range(200):
            news = [Telemetry(0.005 * k, np.zeros(3), np.zeros(3))]
            answers.append(pilot.answer(news, 0.005 * k) is not None)
        assert 45 <= sum(answers) <= 70
