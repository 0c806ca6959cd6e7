from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from good_input import message

from sim2real.clock import recording_clock_findings
from sim2real.errors import InputError
from sim2real.importers.rosbag import read_bag

pytest.importorskip("rosbags", reason="ROS bags are read with the package rosbags")

from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

EPOCH_NS = 1_700_000_000 * 10**9
MS = 10**6
STATE, COMMAND = "/joint_states", "/commands"
FORMATS = ("ros1.bag", "ros2.db3", "ros2.mcap")


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

    def trajectory(self, names, *points, stamp_ns=0):
        def point(after_ns, positions):
            none = np.array([], dtype=np.float64)
            after = self.make("builtin_interfaces/msg/Duration", *divmod(after_ns, 10**9))
            positions = np.array(positions, dtype=np.float64)
            kind = "trajectory_msgs/msg/JointTrajectoryPoint"
            return self.make(kind, positions, none, none, none, after)

        kind = "trajectory_msgs/msg/JointTrajectory"
        points = [point(*p) for p in points]
        return self.make(kind, self.header(stamp_ns), list(names), points)

    def write(self, *messages):
        """Write (topic, receive time in ms, message) and return the bag's path."""
        if self.is1:
            writer, serialize = rosbag1.Writer(self.file), self.store.serialize_ros1
        else:
            plugin = {".db3": "SQLITE3", ".mcap": "MCAP"}[self.file.suffix]
            plugin = rosbag2.StoragePlugin[plugin]
            writer = rosbag2.Writer(self.file.with_suffix(""), version=9, storage_plugin=plugin)
            serialize = self.store.serialize_cdr
        connections = {}
        with writer:
            for topic, ms, message in sorted(messages, key=lambda m: m[1]):
                kind = message.__msgtype__
                if topic not in connections:
                    added = writer.add_connection(topic, kind, typestore=self.store)
                    connections[topic] = added
                ns = EPOCH_NS + round(ms * MS)
                writer.write(connections[topic], ns, serialize(message, kind))
        return writer.path


@pytest.fixture(params=FORMATS)
def ros(request, tmp_path):
    return Ros(tmp_path / request.param)


@pytest.fixture
def ros2(tmp_path):
    return Ros(tmp_path / "ros2.db3")


def stamp(ms):
    return EPOCH_NS + round(ms * MS)


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
    recording = read_bag(bag, state_topic=STATE, command_topic=COMMAND)
    assert recording.joints == ("j1", "j2")
    # Commands at 23, 33, 43 ms, states at 30, 40, 50 ms.
    np.testing.assert_allclose(recording.t, [0, 0.007, 0.010, 0.017, 0.020, 0.027], atol=1e-12)
    np.testing.assert_array_equal(recording.command[:, 0], [2, 2, 3, 3, 4, 4])
    np.testing.assert_array_equal(recording.command[:, 1], [-2, -2, -3, -3, -4, -4])
    nan = math.nan
    np.testing.assert_array_equal(recording.position[:, 0], [nan, 3.1, nan, 4.1, nan, 5.1])
    np.testing.assert_array_equal(recording.position[:, 1], [nan, 3.2, nan, 4.2, nan, 5.2])
    speed = recording.columns["j2.velocity_rad_s"]
    np.testing.assert_array_equal(speed, [nan, -3, nan, -4, nan, -5])
    np.testing.assert_array_equal(recording.columns["j1.load"], [nan, 4, nan, 4, nan, 4])
    assert recording.loads == {}
    assert recording.metadata["clock"] == {STATE: "header stamp", COMMAND: "header stamp"}
    assert recording.metadata["states_before_first_command"] == 3
    assert recording.metadata["clock_at_start_s"] == pytest.approx(1_700_000_000.023, abs=1e-6)
    assert recording.metadata["original_file"] == bag.name


def test_a_clean_bag_has_a_clean_clock_and_two_publishers_are_refused(ros):
    t = np.arange(0, 6, 0.008)
    angle = 0.5 * np.sin(3 * t)
    states = [
        (STATE, 1000 * at + 0.2, ros.state(["j1"], [x], stamp_ns=stamp(1000 * at)))
        for at, x in zip(t, angle, strict=True)
    ]
    sent = [(COMMAND, 1000 * at, ros.number(np.sin(3 * at))) for at in np.arange(0.003, 6, 1 / 45)]
    arguments = {"state_topic": STATE, "command_topic": COMMAND}
    recording = read_bag(ros.write(*states, *sent), **arguments)
    assert recording_clock_findings(recording.joints, recording.t, recording.position) == []
    assert recording.rate_hz == pytest.approx(125)
    assert recording.missing(0) == 0
    assert "import_warnings" not in recording.metadata
    more = [(s[0], s[1] + 1.1, ros.state(["j1"], [0.0], stamp_ns=stamp(s[1]))) for s in states[::5]]
    again = Ros(ros.file.with_stem("again"))
    bag = again.write(*states, *more, *sent)
    message(lambda: read_bag(bag, **arguments), STATE, "two publishers", "angles of j1")


def test_array_is_in_the_order_of_the_joints_and_nan_sends_nothing(ros):
    bag = ros.write(
        *[(STATE, 10 * k, ros.state(["a", "b"], [k, -k])) for k in range(5)],
        (COMMAND, 5, ros.array(math.nan, 1.0)),
        (COMMAND, 10, ros.array(2.0, math.nan)),
        (COMMAND, 20, ros.array(3.0, 4.0)),
    )
    recording = read_bag(bag, state_topic=STATE, command_topic=COMMAND, joints=["b", "a"])
    # a has its first set-point at 5 ms, b at 10 ms; states and commands share rows.
    np.testing.assert_allclose(recording.t, [0, 0.01, 0.02, 0.03], atol=1e-12)
    np.testing.assert_array_equal(recording.command, [[2, 1], [3, 4], [3, 4], [3, 4]])
    np.testing.assert_array_equal(recording.position[:, 0], [-1, -2, -3, -4])
    assert recording.metadata["clock"][STATE] == "receive time"
    assert not recording.columns


def test_one_topic_for_each_joint(ros):
    bag = ros.write(
        *[(STATE, 10 * k, ros.state(["a", "b"], [k, -k])) for k in range(5)],
        ("/a/command", 1, ros.number(1.0)),
        ("/b/command", 2, ros.number(2.0)),
        ("/a/command", 25, ros.number(3.0)),
    )
    topics = ["/a/command", "/b/command"]
    recording = read_bag(bag, state_topic=STATE, command_topic=topics, joints=["a", "b"])
    assert recording.joints == ("a", "b")
    np.testing.assert_array_equal(recording.command[:, 0], [1, 1, 1, 3, 3, 3])
    np.testing.assert_array_equal(recording.command[:, 1], [2] * 6)


def test_trajectory_gives_the_point_that_lies_ahead(ros):
    bag = ros.write(
        *[(STATE, 10 * k, ros.state(["a"], [k])) for k in range(5)],
        (COMMAND, 5, ros.trajectory(["a"], (0, [0.3]))),
        (COMMAND, 25, ros.trajectory(["a"], (0, [0.3]), (20 * MS, [0.6]))),
    )
    recording = read_bag(bag, state_topic=STATE, command_topic=COMMAND)
    np.testing.assert_allclose(recording.t, [0, 0.005, 0.015, 0.02, 0.025, 0.035], atol=1e-12)
    np.testing.assert_array_equal(recording.command[:, 0], [0.3, 0.3, 0.3, 0.6, 0.6, 0.6])


def test_joint_that_a_state_does_not_name_is_a_missing_sample(ros2):
    bag = ros2.write(
        (COMMAND, 0, ros2.state(["a", "b"], [1, 2])),
        *[(STATE, 10 * k, ros2.state(["a"], [k])) for k in range(1, 4)],
        *[(STATE, 10 * k + 5, ros2.state(["b", "wheel"], [-k, 500])) for k in range(1, 4)],
    )
    recording = read_bag(bag, state_topic=STATE, command_topic=COMMAND)
    nan = math.nan
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
    recording = read_bag(two_clocks(ros2, state_stamp), state_topic=STATE, command_topic=COMMAND)
    np.testing.assert_allclose(recording.t, t, atol=1e-12)
    assert recording.metadata["clock"] == {COMMAND: "receive time", STATE: clock}


@pytest.mark.parametrize("format", ["ros2.db3", "ros2.mcap"])
def test_storage_file_of_a_ros2_bag_can_be_named_itself(tmp_path, format):
    ros = Ros(tmp_path / format)
    folder = two_clocks(ros, lambda ms: 0)
    (file,) = [f for f in folder.iterdir() if f.suffix == ros.file.suffix]
    recordings = [read_bag(x, state_topic=STATE, command_topic=COMMAND) for x in (folder, file)]
    np.testing.assert_array_equal(recordings[0].t, recordings[1].t)
    np.testing.assert_array_equal(recordings[0].position, recordings[1].position)


def bag_with(*commands, states=None):
    """A function that writes a bag of two joints and these commands."""

    def write(ros):
        sent = [(COMMAND, 5 + 10 * k, make(ros)) for k, make in enumerate(commands)]
        measured = states or [lambda ros: ros.state(["a", "b"], [0, 0])] * 4
        return ros.write(*[(STATE, 10 * k, make(ros)) for k, make in enumerate(measured)], *sent)

    return write


BOTH = bag_with(lambda ros: ros.state(["a", "b"], [0, 0]))
ARRAY = bag_with(lambda ros: ros.array(0, 0))


@pytest.mark.parametrize(
    ("write", "arguments", "message"),
    [
        (BOTH, {"state_topic": "/nowhere"}, "/nowhere: found no such topic in the bag, expected"),
        (BOTH, {"state_topic": "/nowhere"}, "/commands (sensor_msgs/msg/JointState), /joint_st"),
        (BOTH, {"command_topic": STATE}, "found one topic for states and commands"),
        (BOTH, {"joints": ["a", "c"]}, "/joint_states: found no angle of joint c, expected one"),
        (BOTH, {"joints": ["a", "a"]}, "joints: found a, a, expected each name once"),
        (BOTH, {"command_topic": ["/x", "/y"]}, "joints: found 0 joints and 2 command topics"),
        (ARRAY, {}, "joints: found none named, expected names in the order of the set-points"),
        (ARRAY, {"joints": ["a"]}, "/commands, message 0: found 2 values in data, expected one"),
        (ARRAY, {"state_topic": COMMAND, "command_topic": STATE}, "found std_msgs/msg/Float64Mul"),
        (
            bag_with(lambda ros: ros.state(["a"], [0])),
            {"joints": ["a", "b"]},
            "/commands: found no angle of joint b, expected one of a",
        ),
        (
            bag_with(lambda ros: ros.state(["a", "b"], [0])),
            {},
            "/commands, message 0: found 1 values in position, expected one for each of a, b",
        ),
        (
            bag_with(lambda ros: ros.array(0, 0), lambda ros: ros.array(0, 90)),
            {"joints": ["a", "b"]},
            "/commands, message 1, b: found 90, expected a size of at most 12.6",
        ),
        (
            bag_with(lambda ros: ros.trajectory(["a"], (MS, [0]), (2 * MS, [1]))),
            {},
            "/commands, message 0: found 2 trajectory points ahead, expected one",
        ),
        (
            bag_with(lambda ros: ros.state(["a"], [0]), states=[lambda r: r.state(["a"], [0])]),
            {},
            "/joint_states: found no position of a after the first set-points",
        ),
        (
            bag_with(
                lambda ros: ros.number(0),
                states=[
                    lambda ros: ros.state(["a"], [0], stamp_ns=stamp(0)),
                    lambda ros: ros.state(["a"], [0], stamp_ns=stamp(-2500)),
                    *[lambda ros: ros.state(["a"], [0], stamp_ns=stamp(20))] * 3,
                ],
            ),
            {},
            "/joint_states, message 1: found a time 2.5 s before the previous one",
        ),
    ],
)
def test_errors_say_where_in_one_line(ros2, write, arguments, message):
    bag = write(ros2)
    with pytest.raises(InputError) as error:
        read_bag(bag, **({"state_topic": STATE, "command_topic": COMMAND} | arguments))
    assert message in str(error.value)
    assert str(error.value).startswith(str(bag))


def test_damaged_bags_are_input_errors(tmp_path):
    for name in FORMATS:
        file = tmp_path / name
        file.write_bytes(b"#ROSBAG V2.0\n\x00\x01 not a bag")
        with pytest.raises(InputError, match="no bag that can be read"):
            read_bag(file, state_topic=STATE, command_topic=COMMAND)
    with pytest.raises(InputError, match="no bag that can be read"):
        read_bag(tmp_path, state_topic=STATE, command_topic=COMMAND)
    with pytest.raises(InputError, match="no such file"):
        read_bag(tmp_path / "nowhere", state_topic=STATE, command_topic=COMMAND)


def test_without_rosbags_the_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(InputError, match=r"pip install 'sim2real\[ros\]'"):
        read_bag(tmp_path, state_topic=STATE, command_topic=COMMAND)


CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
DEFINITION = "std_msgs/Header header\nstring[] joint_names\n"
POINT = "trajectory_msgs/JointTrajectoryPoint"


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
@pytest.mark.parametrize(
    "fields", [("reference", "feedback"), ("desired", "actual")], ids=["humble", "foxy"]
)
def test_a_trajectory_controllers_own_set_points(tmp_path, suffix, fields):
    """What the controller sends between the points of a trajectory stands in its state."""
    from rosbags.typesys import get_types_from_msg

    ros = Ros(tmp_path / f"ros2{suffix}")
    wanted, seen = fields
    text = DEFINITION + f"{POINT} {wanted}\n{POINT} {seen}\n"
    ros.store.register(get_types_from_msg(text, CONTROLLER))

    def point(*positions):
        none, after = np.array([]), ros.make("builtin_interfaces/msg/Duration", 0, 0)
        kind = "trajectory_msgs/msg/JointTrajectoryPoint"
        return ros.make(kind, np.array(positions, dtype=float), none, none, none, after)

    def state(k):
        header = ros.header(stamp(10 * k))
        points = point(0.1 * k, -0.1 * k), point(0.09 * k, -0.09 * k)
        return ros.make(CONTROLLER, header, ["j1", "j2"], *points)

    states = [(10 * k, ros.state(["j1", "j2"], [k, -k], (), (), stamp(10 * k))) for k in range(5)]
    own = [(10 * k, state(k)) for k in range(5)]
    bag = ros.write(
        *[(STATE, ms, m) for ms, m in states], *[("/controller_state", ms, m) for ms, m in own]
    )
    recording = read_bag(bag, state_topic=STATE, command_topic="/controller_state")
    assert recording.joints == ("j1", "j2")
    assert recording.command[:, 0] == pytest.approx(0.1 * np.arange(5))
    assert recording.position[:, 1] == pytest.approx(-np.arange(5.0))
    sent = [(10 * k, ros.array(0.3 * k, 0.4 * k)) for k in range(5)]
    bag = Ros(tmp_path / f"other{suffix}")
    bag.store = ros.store
    path = bag.write(
        *[("/controller_state", ms, m) for ms, m in own], *[(COMMAND, ms, m) for ms, m in sent]
    )
    recording = read_bag(
        path, state_topic="/controller_state", command_topic=COMMAND, joints=["j1", "j2"]
    )
    assert recording.position[:, 0] == pytest.approx(0.09 * np.arange(5))
