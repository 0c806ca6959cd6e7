"""Realities of one's own: the file, the episodes in it, and that it shares nothing by accident."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from rl.deploy.policy import PolicyController
from rl.experiments.episodes import energy, run_episodes
from rl.experiments.reality import read_reality, real_world
from rl.experiments.testbeds import Controllers, real
from rl.make import make_world
from rl.task import TASKS, Starts
from rl.world import Draws
from sim.twin.twin import Twin
from sim2real.errors import InputError
from tests.rl.test_swim import random_policy

GLIDER = """
import numpy as np
AT_ONCE = {at_once}

class Glider:
    def reset(self, pose, joint):
        self.pose, self.joint = pose.copy(), joint.copy()
        return self.pose.copy(), self.joint.copy()

    def step(self, desired):
        self.pose[:, 0] += {speed} * 0.02
        self.joint = desired
        return self.pose.copy(), self.joint.copy()

def make(robot, n, seed, device, *, cell_m=0.01):
    return Glider()
"""


class Still:
    """Asks for straight joints, and remembers what it saw."""

    def __init__(self):
        self.saw = []

    def reset(self):
        pass

    def act(self, observation):
        self.saw.append(observation.copy())
        return np.zeros((len(observation), (observation.shape[1] - 5) // 2), dtype=np.float32)


@pytest.fixture
def glider(tmp_path):
    def write(speed="0.1", at_once="None", name="glider.py"):
        (tmp_path / name).write_text(GLIDER.format(speed=speed, at_once=at_once))
        return tmp_path / name

    return write


def ahead(n, away=0.2, J=3):
    """n robots at the origin, the target ahead."""
    targets = np.tile([away, 0.0], (n, 1, 1))
    return Starts(np.zeros((n, 3)), np.zeros((n, J)), targets)


TURN = TASKS["turn"]


def run_real_episodes(reality, controller, robot, task, starts):
    return run_episodes(real_world(reality, robot, task, starts, "reality"), controller)


def test_arrival_reward_and_velocity_come_from_what_is_seen(glider, robot):
    reality = read_reality(glider())(robot, 2, 0, "cpu")
    still = Still()
    found = run_real_episodes(reality, still, robot, TURN, ahead(2))
    assert found.success.all()
    assert np.allclose(found.time_s, 1.52, atol=0.021), "0.15 m at 0.1 m/s"
    closest = 0.2 - 0.1 * found.time_s
    assert np.allclose(found.reward, 10 * (0.2 - closest) + 10, atol=1e-4)
    surge = np.array(still.saw)[:, 0, 0]
    assert surge[0] == 0
    assert np.allclose(surge[5:], 0.1, atol=1e-5)
    assert len(found.pose) == found.steps.max() + 1, "no step is swum after the last episode"


def test_it_leaves_the_pool_at_a_loss_or_reaches_one_waypoint_after_the_other(glider, robot):
    reality = read_reality(glider("-1.0"))(robot, 1, 0, "cpu")
    found = run_real_episodes(reality, Still(), robot, TURN, ahead(1))
    assert not found.success.any()
    assert np.isclose(found.steps[0], 91, atol=1)
    assert found.reward[0] < -27
    reality = read_reality(glider(name="ahead.py"))(robot, 1, 0, "cpu")
    starts = ahead(1)._replace(targets=np.array([[[0.2, 0.0], [0.4, 0.0]]]))
    found = run_real_episodes(reality, Still(), robot, TURN, starts)
    assert found.reached.tolist() == [2]
    assert np.isclose(found.time_s[0], 3.52, atol=0.021)


def test_an_unseen_robot_is_given_up_after_half_a_second(glider, robot):
    class Dark:
        def __init__(self):
            self.left = 10

        def reset(self, pose, joint):
            return pose, joint

        def step(self, desired):
            self.left -= 1
            return np.full((1, 3), np.nan if self.left < 0 else 0.0), desired

    found = run_real_episodes(Dark(), Still(), robot, TURN, ahead(1))
    assert found.steps[0] == 10 + 26
    assert np.isfinite(found.reward).all()


def test_seen_from_outside_a_twin_does_as_in_a_world(robot, model):
    """Observation, velocities and reward are those that policies are trained with."""

    class Seen:
        def __init__(self, n):
            self.twin = Twin(robot, model, n_envs=n)

        def look(self):
            state = self.twin.state()
            return state.pose, state.measured

        def rate(self):
            return self.twin.state().rate

        def reset(self, pose, joint):
            self.twin.reset(None, pose, joint)
            return self.look()

        def step(self, desired):
            self.twin.step(desired)
            return self.look()

    task = replace(TURN, steps=120)
    controller = PolicyController(random_policy())
    known = run_episodes(make_world(robot, task, Draws((model,)), n_envs=3, seed=4), controller)
    starts = Starts(known.pose[0], np.zeros((3, 3)), known.targets)
    found = run_real_episodes(Seen(3), controller, robot, task, starts)
    assert np.ptp(known.pose[:, 0, 2]) > 0.1, "it does move"
    assert np.allclose(found.pose, known.pose, atol=1e-4)
    assert np.allclose(found.reward, known.reward, atol=1e-4)
    assert np.allclose(energy(found.rate), energy(known.rate), rtol=1e-4), "true energy"


def test_robots_are_swum_in_groups(glider, robot):
    wanted = None
    for at_once in ("None", "2", "4"):
        place = real(read_reality(glider(at_once=at_once)))
        starts = Starts(
            np.zeros((6, 3)), np.zeros((6, 3)), np.linspace(0.1, 0.5, 6)[:, None, None] * [1.0, 0.0]
        )
        found = place.swim(Controllers([Still()], 6), robot, TURN, starts, 0)
        assert found.success.all()
        told = (found.reward.tolist(), found.steps.tolist())
        assert wanted in (None, told)
        wanted = told
        assert len(found.pose) == found.steps.max() + 1
        assert np.isnan(found.pose[-1, 0]).all()


def test_a_crew_steers_each_share_by_its_own_controller():
    class Says:
        def __init__(self, what):
            self.what = what

        def reset(self):
            pass

        def act(self, observation):
            return np.full((len(observation), 2), self.what, dtype=np.float32)

    several = Controllers([Says(1), Says(2), Says(3)], 2)
    assert several.act(np.zeros((6, 9), dtype=np.float32))[:, 0].tolist() == [1, 1, 2, 2, 3, 3]
    some = several.of(np.array([1, 4, 5]))
    several.owner = np.array([2, 0, 1, 0, 2, 1])
    assert several.act(np.zeros((6, 9), dtype=np.float32))[:, 0].tolist() == [3, 1, 2, 1, 3, 2]
    assert some.act(np.zeros((3, 9), dtype=np.float32))[:, 0].tolist() == [1, 3, 3]


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (None, "no such file"),
        ("def make(", "SyntaxError"),
        ("import nowhere_to_be_found", "ModuleNotFoundError"),
        ("1 / 0", "ZeroDivisionError"),
        ("x = 1", "nothing to call"),
        ("def make(robot, n): ...", "too many positional"),
        ("AT_ONCE = 0\ndef make(robot, n, seed, device): ...", "AT_ONCE"),
    ],
)
def test_a_bad_file_is_refused_in_one_line(tmp_path, source, said):
    path = tmp_path / "bad.py"
    if source is not None:
        path.write_text(source)
    with pytest.raises(InputError, match=said) as caught:
        read_reality(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_what_a_file_makes_is_looked_at(glider, robot, tmp_path):
    with pytest.raises(InputError, match="cell"):
        read_reality(glider(), cell=0.02)
    path = tmp_path / "half.py"
    path.write_text("def make(robot, n, seed, device):\n    return 1")
    with pytest.raises(InputError, match="without reset"):
        read_reality(path)(robot, 1, 0, "cpu")
    reality = read_reality(glider())(robot, 3, 0, "cpu")
    placed = reality.reset
    reality.reset = lambda pose, joint: placed(pose[:2], joint)
    with pytest.raises(InputError, match="shapes"):
        run_real_episodes(reality, Still(), robot, TURN, ahead(3))


def test_options_and_what_a_file_imports_are_known(tmp_path):
    for name in ("wall", "unused"):
        (tmp_path / f"{name}.py").write_text("HARD = 1")
    path = tmp_path / "mine.py"
    path.write_text(
        "from wall import HARD\n"
        "def at_once(*, cell_m): return int(0.1 / cell_m)\n"
        "def make(robot, n, seed, device, cell_m=0.05): ..."
    )
    assert [read_reality(path, **x).at_once for x in ({}, {"cell_m": 0.02})] == [2, 5]
    first = real(read_reality(path)).key
    assert real(read_reality(path, cell_m=0.05)).key == first
    assert real(read_reality(path, cell_m=0.02)).key != first
    (tmp_path / "unused.py").write_text("HARD = 2")
    assert real(read_reality(path)).key == first
    (tmp_path / "wall.py").write_text("HARD = 2")
    second = real(read_reality(path)).key
    path.write_text(path.read_text() + "\n")
    assert len({first, second, real(read_reality(path)).key}) == 3


def test_neighbours_are_forgotten(tmp_path):
    (tmp_path / "door.py").write_text("OPEN = 1")
    path = tmp_path / "mine.py"
    path.write_text("import door\nassert door.OPEN\ndef make(robot, n, seed, device): ...")
    before = list(sys.path)
    assert [file.name for file in read_reality(path).files] == ["mine.py", "door.py"]
    assert "door" not in sys.modules
    assert sys.path == before
