import math
import sys

import numpy as np
import pytest
from good_input import message

from sim2real.clock import recording_clock_findings
from sim2real.importers.rosbag import read_bag

pytest.importorskip("rosbags", reason="ROS bags are read with the package rosbags")

from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

EPOCH_NS = 1_700_000_000 * 10**9
MS = 10**6
STATE, COMMAND = "/joint_states", "/commands"
STORAGE = {".db3": rosbag2.StoragePlugin.SQLITE3, ".mcap": rosbag2.StoragePlugin.MCAP}
nan = math.nan


class Ros:
    """Makes messages of one ROS version and writes them into a bag."""

    def __init__(self, file):
        self.file, self.is1 = file, file.suffix == ".bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.is1 else Stores.ROS2_HUMBLE)

    def make(self, kind, *values):
        return self.store.types[kind](*values)

    def header(self, ns):
        stamp = self.make("builtin_interfaces/msg/Time", *divmod(ns, 10**9))
        return self.make("std_msgs/msg/Header", *([0] if self.is1 else []), stamp, "")

    def state(self, names, position, velocity=(), effort=(), stamp_ns=0):
        arrays = [np.array(x, dtype=np.float64) for x in (position, velocity, effort)]
        header = self.header(stamp_ns)
        return self.make("sensor_msgs/msg/JointState", header, list(names), *arrays)

    def array(self, *values):
        layout = self.make("std_msgs/msg/MultiArrayLayout", [], 0)
        return self.make("std_msgs/msg/Float64MultiArray", layout, np.array(values, dtype=float))

    def number(self, value):
        return self.make("std_msgs/msg/Float64", value)

    def point(self, after_ns, positions):
        none, positions = np.array([]), np.array(positions, dtype=float)
        after = self.make("builtin_interfaces/msg/Duration", *divmod(after_ns, 10**9))
        kind = "trajectory_msgs/msg/JointTrajectoryPoint"
        return self.make(kind, positions, none, none, none, after)

    def trajectory(self, names, *points):
        points = [self.point(*p) for p in points]
        kind = "trajectory_msgs/msg/JointTrajectory"
        return self.make(kind, self.header(0), list(names), points)

    def write(self, *messages):
        """Write (topic, receive time in ms, message) and return the bag's path."""
        if self.is1:
            writer, serialize = rosbag1.Writer(self.file), self.store.serialize_ros1
        else:
            plugin = STORAGE[self.file.suffix]
            writer = rosbag2.Writer(self.file.with_suffix(""), version=9, storage_plugin=plugin)
            serialize = self.store.serialize_cdr
        connections = {}
        with writer:
            for topic, ms, message in sorted(messages, key=lambda m: m[1]):
                kind = message.__msgtype__
                if topic not in connections:
                    added = writer.add_connection(topic, kind, typestore=self.store)
                    connections[topic] = added
                writer.write(connections[topic], stamp(ms), serialize(message, kind))
        return writer.path


@pytest.fixture(params=["ros1.bag", "ros2.db3", "ros2.mcap"])
def ros(request, tmp_path):
    return Ros(tmp_path / request.param)


@pytest.fixture
def ros2(tmp_path):
    return Ros(tmp_path / "ros2.db3")


def stamp(ms):
    return EPOCH_NS + round(ms * MS)


def read(bag, **more):
    return read_bag(bag, **({"state_topic": STATE, "command_topic": [COMMAND]} | more))


def test_states_and_set_points_stand_at_their_own_times(ros):
    names = ["j2", "other", "j1"]
    measured = [
        ros.state(names, [k + 0.2, 9, k + 0.1], [-k, 0, k], [5, 0, 4], stamp(10 * k))
        for k in range(6)
    ]
    sent = [ros.state(["j1", "j2"], [k, -k], stamp_ns=stamp(10 * k + 3)) for k in range(2, 5)]
    # Messages arrive 4 ms after they were stamped.
    bag = ros.write(
        *[(STATE, 10 * k + 4, m) for k, m in enumerate(measured)],
        *[(COMMAND, 10 * k + 7, m) for k, m in enumerate(sent, start=2)],
        ("/noise", 1, ros.number(3.0)),
    )
    recording = read(bag)
    assert recording.joints == ("j1", "j2")
    # Commands at 23, 33, 43 ms, states at 30, 40, 50 ms.
    np.testing.assert_allclose(recording.t, [0, 0.007, 0.010, 0.017, 0.020, 0.027], atol=1e-12)
    for found, expected in (
        (recording.command[:, 0], [2, 2, 3, 3, 4, 4]),
        (recording.command[:, 1], [-2, -2, -3, -3, -4, -4]),
        (recording.position[:, 0], [nan, 3.1, nan, 4.1, nan, 5.1]),
        (recording.position[:, 1], [nan, 3.2, nan, 4.2, nan, 5.2]),
        (recording.columns["j2.velocity_rad_s"], [nan, -3, nan, -4, nan, -5]),
        (recording.columns["j1.load"], [nan, 4, nan, 4, nan, 4]),
    ):
        np.testing.assert_array_equal(found, expected)
    assert recording.loads == {}
    assert recording.metadata["clock"] == {STATE: "header stamp", COMMAND: "header stamp"}
    assert recording.metadata["states_before_first_command"] == 3
    assert recording.metadata["clock_at_start_s"] == pytest.approx(1_700_000_000.023, abs=1e-6)
    assert recording.metadata["original_file"] == bag.name


def test_a_clean_bag_has_a_clean_clock_and_two_publishers_are_refused(ros2):
    t = np.arange(0, 6, 0.008)
    angle = 0.5 * np.sin(3 * t)
    states = [
        (STATE, 1000 * at + 0.2, ros2.state(["j1"], [x], stamp_ns=stamp(1000 * at)))
        for at, x in zip(t, angle, strict=True)
    ]
    sent = [(COMMAND, 1000 * at, ros2.number(np.sin(3 * at))) for at in np.arange(0.003, 6, 1 / 45)]
    recording = read(ros2.write(*states, *sent))
    assert recording_clock_findings(recording.joints, recording.t, recording.position) == []
    assert recording.rate_hz == pytest.approx(125)
    assert recording.missing(0) == 0
    assert "import_warnings" not in recording.metadata
    more = [
        (STATE, s + 1.1, ros2.state(["j1"], [0.0], stamp_ns=stamp(s))) for _, s, _ in states[::5]
    ]
    bag = Ros(ros2.file.with_stem("again")).write(*states, *more, *sent)
    message(lambda: read(bag), STATE, "two publishers", "angles of j1")


A, B = "/a/command", "/b/command"
POINTS = (["a"], (0, [0.3])), (["a"], (0, [0.3]), (20 * MS, [0.6]))


@pytest.mark.parametrize(
    ("kind", "sent", "options", "t", "command"),
    [
        (  # in the order of the joints; NaN sends nothing
            "array",
            [(COMMAND, 5, nan, 1), (COMMAND, 10, 2, nan), (COMMAND, 20, 3, 4)],
            {"joints": ["b", "a"]},
            # a has its first set-point at 5 ms, b at 10 ms; states and commands share rows.
            [0, 0.01, 0.02, 0.03],
            [[2, 1], [3, 4], [3, 4], [3, 4]],
        ),
        (
            "number",
            [(A, 1, 1), (B, 2, 2), (A, 25, 3)],
            {"joints": ["a", "b"], "command_topic": [A, B]},
            [0, 0.008, 0.018, 0.023, 0.028, 0.038],
            [[1, 2], [1, 2], [1, 2], [3, 2], [3, 2], [3, 2]],
        ),
        (  # the point that lies ahead
            "trajectory",
            [(COMMAND, 5, *POINTS[0]), (COMMAND, 25, *POINTS[1])],
            {},
            [0, 0.005, 0.015, 0.02, 0.025, 0.035],
            [[0.3], [0.3], [0.3], [0.6], [0.6], [0.6]],
        ),
    ],
)
def test_kinds_of_set_points(ros, kind, sent, options, t, command):
    states = [(STATE, 10 * k, ros.state(["a", "b"], [k, -k])) for k in range(5)]
    sent = [(topic, ms, getattr(ros, kind)(*values)) for topic, ms, *values in sent]
    recording = read(ros.write(*states, *sent), **options)
    assert list(recording.joints) == options.get("joints", ["a"])
    np.testing.assert_allclose(recording.t, t, atol=1e-12)
    np.testing.assert_array_equal(recording.command, command)
    for joint, angle in zip(recording.joints, recording.position.T, strict=True):
        sign = {"a": 1, "b": -1}[joint]
        assert angle[np.isfinite(angle)].tolist() == [sign * k for k in (1, 2, 3, 4)]
    assert recording.metadata["clock"][STATE] == "receive time"
    assert not recording.columns


def test_joint_that_a_state_does_not_name_is_a_missing_sample(ros2):
    bag = ros2.write(
        (COMMAND, 0, ros2.state(["a", "b"], [1, 2])),
        *[(STATE, 10 * k, ros2.state(["a"], [k])) for k in range(1, 4)],
        *[(STATE, 10 * k + 5, ros2.state(["b", "wheel"], [-k, 500])) for k in range(1, 4)],
    )
    recording = read(bag)
    np.testing.assert_array_equal(recording.position[1:, 0], [1, nan, 2, nan, 3, nan])
    np.testing.assert_array_equal(recording.position[1:, 1], [nan, -1, nan, -2, nan, -3])


def two_clocks(ros, state_stamp):
    return ros.write(
        *[(STATE, 10 * k, ros.state(["a"], [k], stamp_ns=state_stamp(10 * k))) for k in range(5)],
        (COMMAND, 5, ros.number(0.5)),
    )


@pytest.mark.parametrize(
    ("state_stamp", "t", "clock"),
    [
        (lambda ms: stamp(ms - 2), [0, 0.003, 0.013, 0.023, 0.033], "header stamp"),
        # stamps of another clock are not mixed with receive times
        (lambda ms: round((ms + 1) * MS), [0, 0.005, 0.015, 0.025, 0.035], "receive time"),
    ],
)
def test_stamps_and_unstamped_commands(ros2, state_stamp, t, clock):
    recording = read(two_clocks(ros2, state_stamp))
    np.testing.assert_allclose(recording.t, t, atol=1e-12)
    assert recording.metadata["clock"] == {COMMAND: "receive time", STATE: clock}


@pytest.mark.parametrize("suffix", STORAGE)
def test_storage_file_of_a_ros2_bag_can_be_named_itself(tmp_path, suffix):
    folder = two_clocks(Ros(tmp_path / f"ros2{suffix}"), lambda ms: 0)
    (file,) = [f for f in folder.iterdir() if f.suffix == suffix]
    recordings = [read(x) for x in (folder, file)]
    np.testing.assert_array_equal(recordings[0].t, recordings[1].t)
    np.testing.assert_array_equal(recordings[0].position, recordings[1].position)


def bag_with(*commands, states=None):
    """A function that writes a bag of two joints and these commands."""

    def write(ros):
        sent = [(COMMAND, 5 + 10 * k, make(ros)) for k, make in enumerate(commands)]
        measured = states or [lambda ros: ros.state(["a", "b"], [0, 0])] * 4
        return ros.write(*[(STATE, 10 * k, make(ros)) for k, make in enumerate(measured)], *sent)

    return write


def of(*names, ms=None):
    """Makes a state of these joints at 0."""
    return lambda ros: ros.state(names, [0] * len(names), stamp_ns=0 if ms is None else stamp(ms))


BOTH = bag_with(of("a", "b"))
ARRAY = bag_with(lambda ros: ros.array(0, 0))
AB = {"joints": ["a", "b"]}
SHORT = bag_with(lambda ros: ros.state(["a", "b"], [0]))
FAR = bag_with(lambda ros: ros.array(0, 0), lambda ros: ros.array(0, 90))
AHEAD = bag_with(lambda ros: ros.trajectory(["a"], (MS, [0]), (2 * MS, [1])))
EARLY = bag_with(of("a"), states=[of("a")])
BACK = bag_with(lambda ros: ros.number(0), states=[of("a", ms=x) for x in (0, -2500, 20, 20, 20)])


@pytest.mark.parametrize(
    ("write", "options", "part"),
    [
        (BOTH, {"state_topic": "/nowhere"}, "/nowhere: found no such topic in the bag, expected"),
        (BOTH, {"state_topic": "/nowhere"}, "/commands (sensor_msgs/msg/JointState), /joint_st"),
        (BOTH, {"command_topic": [STATE]}, "found one topic for states and commands"),
        (BOTH, {"joints": ["a", "c"]}, "/joint_states: found no angle of joint c, expected one"),
        (BOTH, {"joints": ["a", "a"]}, "joints: found a, a, expected each name once"),
        (BOTH, {"command_topic": ["/x", "/y"]}, "joints: found 0 joints and 2 command topics"),
        (ARRAY, {}, "joints: found none named, expected names in the order of the set-points"),
        (ARRAY, {"joints": ["a"]}, "/commands, message 0: found 2 values of command, expected one"),
        (ARRAY, {"state_topic": COMMAND, "command_topic": [STATE]}, "found std_msgs/msg/Float64Mu"),
        (bag_with(of("a")), AB, "/commands: found no angle of joint b, expected one of a"),
        (SHORT, {}, "message 0: found 1 values of command, expected one for each of a, b"),
        (FAR, AB, "/commands, message 1, b: found 90, expected a size of at most 12.6"),
        (AHEAD, {}, "/commands, message 0: found 2 trajectory points ahead, expected one"),
        (EARLY, {}, "/joint_states: found no position of a after the first set-points"),
        (BACK, {}, "/joint_states, message 1: found a time 2.5 s before the previous one"),
    ],
)
def test_errors_say_where_in_one_line(ros2, write, options, part):
    bag = write(ros2)
    assert message(lambda: read(bag, **options), part).startswith(str(bag))


def test_damaged_bags_are_input_errors(tmp_path):
    for name in ("a.bag", "a.db3", "a.mcap"):
        (tmp_path / name).write_bytes(b"#ROSBAG V2.0\n\x00\x01 not a bag")
    for name in ("a.bag", "a.db3", "a.mcap", "."):
        message(lambda: read(tmp_path / name), "no bag that can be read")  # noqa: B023
    message(lambda: read(tmp_path / "nowhere"), "no such file")


def test_without_rosbags_the_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    message(lambda: read(tmp_path), "pip install 'sim2real[ros]'")


CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"


@pytest.mark.parametrize(
    ("suffix", "fields"),
    [(".mcap", ("reference", "feedback")), (".db3", ("desired", "actual"))],
    ids=["humble", "foxy"],
)
def test_a_trajectory_controllers_own_set_points(tmp_path, suffix, fields):
    """What the controller sends between the points of a trajectory stands in its state."""
    ros, names = Ros(tmp_path / f"ros2{suffix}"), ["j1", "j2"]
    points = "".join(f"trajectory_msgs/JointTrajectoryPoint {field}\n" for field in fields)
    text = "std_msgs/Header header\nstring[] joint_names\n" + points
    ros.store.register(get_types_from_msg(text, CONTROLLER))

    def own(k):
        header = ros.header(stamp(10 * k))
        wanted, seen = ros.point(0, [0.1 * k, -0.1 * k]), ros.point(0, [0.09 * k, -0.09 * k])
        return "/controller_state", 10 * k, ros.make(CONTROLLER, header, names, wanted, seen)

    def state(k):
        return STATE, 10 * k, ros.state(names, [k, -k], stamp_ns=stamp(10 * k))

    bag = ros.write(*map(state, range(5)), *map(own, range(5)))
    recording = read(bag, command_topic=["/controller_state"])
    assert recording.joints == ("j1", "j2")
    assert recording.command[:, 0] == pytest.approx(0.1 * np.arange(5))
    assert recording.position[:, 1] == pytest.approx(-np.arange(5.0))
    ros.file = tmp_path / f"other{suffix}"
    sent = [(COMMAND, 10 * k, ros.array(0.3 * k, 0.4 * k)) for k in range(5)]
    bag = ros.write(*map(own, range(5)), *sent)
    recording = read(bag, state_topic="/controller_state", joints=names)
    assert recording.position[:, 0] == pytest.approx(0.09 * np.arange(5))
