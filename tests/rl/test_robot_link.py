"""The robot's end of the air, and that of poses, with strangers on it: real sockets on loopback."""

import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest

from rl.deploy import link as protocol
from rl.deploy.link import Link, SetPoints, Telemetry, set_point_bytes, telemetry_bytes
from rl.deploy.robots import Poses, Received, served
from sim2real.errors import InputError
from sim2real.hardware.radio import opened, sealed, shared_key, unsealed

KEY = b"a key of the swimming pool"
LIMITS = np.array([[-0.5, 0.4], [-0.5, 0.4]])
PATIENCE_S = 30.0
HELLO = SetPoints(0, np.empty(0), "0123456789abcdef")


class Still(Received):
    """A robot that only notes what it is to do."""

    def __init__(self, key: bytes | None = None) -> None:
        super().__init__(np.zeros(2), LIMITS, key)
        self.t = 0

    def advance(self) -> None:
        self.t += 1
        self.desired = self.next_set_points()

    def measured(self) -> tuple[float, np.ndarray, np.ndarray]:
        return 0.02 * self.t, np.zeros(3), self._desired


class Stranger:
    """Another sender, at another port of this computer."""

    def __init__(self, url: str) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(0.3)
        host, port = url.removeprefix("udp://").split(":")
        self.socket.connect((host, int(port)))

    def send(self, *datagrams: bytes) -> None:
        for datagram in datagrams:
            self.socket.send(datagram)

    def hears_nothing(self) -> bool:
        try:
            self.socket.recv(2048)
        except TimeoutError:
            return True
        return False


@contextmanager
def air(key: bytes | None = None) -> Iterator[tuple[Still, str, Stranger, Callable[..., Link]]]:
    """A robot, its URL, a stranger and a maker of pilots."""
    robot = Still(key)
    with served(robot) as url, ExitStack() as stack:
        stranger = Stranger(url)
        stack.callback(stranger.socket.close)
        yield robot, url, stranger, lambda k=key: stack.enter_context(Link(url, 2, k))


def until(condition: Callable[[], bool]) -> bool:
    """Whether a condition becomes true within a few seconds."""
    deadline = time.monotonic() + 5
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005)
    return True


def begin(pilot: Link) -> None:
    def answered() -> bool:
        pilot.begin()
        return bool(pilot.receive(0.05))

    assert until(answered)


def drive(pilot: Link, robot: Still, joint: list[float], reached: object = None) -> None:
    """Send set-points until the robot has them."""
    aim = joint if reached is None else reached

    def there() -> bool:
        pilot.send(np.array(joint))
        pilot.receive(0.02)
        return np.allclose(robot._desired, aim)

    assert until(there)


@pytest.fixture
def patient(monkeypatch) -> None:
    """Ends that wait long before they take the other for silent, on a busy computer."""
    monkeypatch.setattr("rl.deploy.robots.SILENCE_S", PATIENCE_S)


@pytest.fixture
def sent(monkeypatch) -> list[bytes]:
    """All datagrams that pilots send."""
    datagrams: list[bytes] = []

    def noted(*given: object) -> bytes:
        datagrams.append(set_point_bytes(*given))  # type: ignore[arg-type]
        return datagrams[-1]

    monkeypatch.setattr(protocol, "set_point_bytes", noted)
    return datagrams


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("key", [None, KEY])
def test_the_first_pilot_is_kept(key, sent):
    with air(key) as (robot, _, stranger, pilot_of):
        pilot = pilot_of()
        begin(pilot)
        drive(pilot, robot, [0.1, 0.2])
        for number in (1, 2, 40, 10**9):
            stranger.send(set_point_bytes(SetPoints(number, np.ones(2), robot.session), key))
        stranger.send(set_point_bytes(HELLO, key), *sent)
        drive(pilot, robot, [0.2, 0.1])
        assert stranger.hears_nothing()
        assert pilot.strange == 0


@pytest.mark.usefixtures("patient")
def test_old_and_huge_numbers_of_the_pilots_own_address_are_ignored(sent):
    with air() as (robot, _, _, pilot_of):
        pilot = pilot_of()
        begin(pilot)
        drive(pilot, robot, [0.1, 0.2])
        drive(pilot, robot, [0.3, 0.2])
        session = robot.session
        for datagram in sent:
            pilot._socket.send(datagram)
        for number in (10**3, 10**9, 2**70):
            pilot._socket.send(set_point_bytes(SetPoints(number, np.zeros(2) - 0.3, session)))
        drive(pilot, robot, [0.2, 0.1])
        assert robot.session == session
        assert until(lambda: robot._number == pilot._number)


def test_another_pilot_waits_until_the_first_is_silent(sent):
    with air() as (robot, _, stranger, pilot_of):
        first, second = pilot_of(), pilot_of()
        begin(first)
        drive(first, robot, [0.1, 0.2])
        for _ in range(5):
            second.begin()
            first.send(np.array([0.1, 0.2]))
            assert not second.receive(0.05)
        old = list(sent)
        begin(second)
        assert np.array_equal(robot._desired, np.zeros(2)), "in silence it went to rest"
        for datagram in old:
            first._socket.send(datagram)
        stranger.send(*old)
        drive(second, robot, [0.3, 0.3])


def test_a_session_that_was_recorded_cannot_be_replayed(sent):
    with air(KEY) as (robot, _, stranger, pilot_of):
        pilot = pilot_of()
        begin(pilot)
        drive(pilot, robot, [0.1, 0.2])
        assert until(lambda: not robot.held)
        before = robot.session
        stranger.send(*sent)
        assert until(lambda: robot.session != before), "it may begin"
        stranger.send(*sent)
        assert until(lambda: not robot.held), "but not keep the robot"
        assert np.array_equal(robot._desired, np.zeros(2))
        assert robot._number == 0, "or move it"


@pytest.mark.parametrize(("robots", "pilots"), [(KEY, None), (None, KEY), (KEY, KEY[::-1])])
def test_another_key_is_no_key(robots, pilots):
    with air(robots) as (robot, _, _, pilot_of):
        pilot = pilot_of(pilots)
        for _ in range(4):
            pilot.begin()
            assert not pilot.receive(0.05)
        assert robot.session == ""


def test_a_robot_limits_its_angles():
    with air() as (robot, _, _, pilot_of):
        pilot = pilot_of()
        begin(pilot)
        drive(pilot, robot, [9.0, -1e9], [0.4, -0.5])


def test_a_pilot_hears_its_own_session_only():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        with Link("udp://{}:{}".format(*end.getsockname()), 2) as pilot:
            pilot.begin()
            datagram, pilots = end.recvfrom(2048)
            own = json.loads(datagram)["session"]
            assert len(own) == 16
            for session in ("", "other", own + "robot", own + "stranger"):
                seen = Telemetry(1.0, np.zeros(3), np.zeros(2), session)
                end.sendto(telemetry_bytes(seen), pilots)
            heard = [telemetry.session for telemetry in pilot.receive(1.0)]
            assert heard == [own + "robot"]
            assert pilot.strange == 3


@pytest.fixture
def seen_at():
    """Poses at a free port of this computer, and a function from a key to them."""
    with ExitStack() as stack:

        def poses(key: bytes | None = None) -> tuple[Poses, Callable[[], Stranger]]:
            listener = stack.enter_context(opened("udp://:0", "--pose", "", bind=True))
            host, port = listener.getsockname()
            assert host == "127.0.0.1"

            def sender() -> Stranger:
                one = Stranger(f"udp://{host}:{port}")
                stack.callback(one.socket.close)
                return one

            return Poses(listener, key), sender

        yield poses


def pose(t: float, x: float, key: bytes | None = None, session: str = "") -> bytes:
    return telemetry_bytes(Telemetry(t, np.array([x, 0, 0]), np.empty(0), session), key)


@pytest.mark.usefixtures("patient")
def test_the_first_tracker_is_kept(seen_at):
    poses, sender = seen_at()
    tracker, stranger = sender(), sender()
    tracker.send(pose(5.0, 1.0))
    assert poses.newest()[0] == 1.0
    stranger.send(pose(5.1, 9.0), pose(6.0, 9.0))
    assert np.isnan(poses.newest()).all(), "another address"
    tracker.send(pose(5.02, 2.0), pose(5.01, 9.0), pose(5.02, 9.0), pose(4.0, 9.0))
    assert poses.newest()[0] == 2.0, "older times"
    tracker.send(pose(1e6, 9.0), pose(5.04, 9.0, session="other"), pose(5.04, 3.0))
    assert poses.newest()[0] == 3.0, "a huge time, another session"
    poses._heard -= PATIENCE_S
    stranger.send(pose(0.1, 4.0))
    assert poses.newest()[0] == 4.0, "the first was silent"
    tracker.send(pose(5.06, 9.0))
    assert np.isnan(poses.newest()).all()


def test_poses_have_the_key(seen_at):
    poses, sender = seen_at(KEY)
    stranger = sender()
    stranger.send(pose(1.0, 9.0), pose(1.0, 9.0, KEY[::-1]), b"", KEY)
    assert np.isnan(poses.newest()).all()
    stranger.send(pose(2.0, 1.0, KEY))
    assert poses.newest()[0] == 1.0


def test_keys(tmp_path, monkeypatch):
    assert unsealed(sealed(b"fish", KEY), KEY) == b"fish"
    assert unsealed(sealed(b"fish", KEY)[:-1], KEY) is None
    assert unsealed(b"", KEY) is None
    monkeypatch.delenv("SIM2REAL_KEY", raising=False)
    assert shared_key() is None
    monkeypatch.setenv("SIM2REAL_KEY", KEY.decode())
    assert shared_key() == KEY
    (tmp_path / "key").write_bytes(b" another key of a pool \n")
    assert shared_key(tmp_path / "key") == b"another key of a pool"
    for content in (b"", b"short\n", b"\xff" * 20):
        (tmp_path / "key").write_bytes(content)
        with pytest.raises(InputError, match="key"):
            shared_key(tmp_path / "key")
    monkeypatch.setenv("SIM2REAL_KEY", "")
    with pytest.raises(InputError, match="at least 16"):
        shared_key()
