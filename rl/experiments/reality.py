"""A user-defined reality: a Python file that moves and measures robots.

``sim2real ablate --reality FILE.py`` tests trained policies in it. The file may import modules of
its own folder, and defines::

    def make(robot, n, seed, device, **options):
        ...               # n robots; ``device`` is cpu or cuda:0, as training's
        return reality

    AT_ONCE = 1           # if the number of robots at a time is limited, or:
    def at_once(**options): return 1       # the same, as a function of the options of make

``reality.reset(pose, joint)`` places the robots at rest at poses (n, 3) with joint angles (n, J);
``reality.step(desired)`` commands joint angles (n, J), held for 0.02 s. Both return measurements:
poses (n, 3), x and y of the head's centre of mass in m and its heading in rad, in the pool's frame,
and joint angles (n, J) as the servos report them; NaN where there is none. A robot whose episode is
over is commanded to straight joints. A surrogate can add ``reality.rate()``, true joint rates
(n, J) in rad/s; from reported angles half of the energy is missed.
"""

from __future__ import annotations

import hashlib
import inspect
import runpy
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from rl.deploy.link import SILENCE_S, Telemetry
from rl.deploy.pilot import Measurements
from rl.observer import observation_bounds
from rl.task import CONTROL_S, Task, bonus, effort, reward
from rl.world import Step
from sim2real.arrays import Array, Index
from sim2real.errors import InputError
from sim2real.robot import Robot


class Starts(NamedTuple):
    """Where n episodes begin: poses (n, 3), joint angles (n, J), waypoints (n, W, 2)."""

    pose: Array
    joint: Array
    targets: Array

    def of(self, rows: Index) -> Starts:
        """The starts of some of the episodes."""
        return Starts(*(x[rows] for x in self))


@dataclass(frozen=True)
class RealityFile:
    """A file that makes realities."""

    files: tuple[Path, ...]  # the file itself, and the modules that it imports from its folder
    sha256: str  # hash of these files
    options: Mapping[str, Any]  # options of its ``make``, including defaults
    at_once: int | None  # maximum number of robots at a time; None if unlimited
    make: Callable[..., Any]  # the function of the file

    def __call__(self, robot: Robot, n: int, seed: int, device: str) -> Any:  # noqa: ANN401
        """Make a reality of n robots, which has ``reset`` and ``step``."""
        reality = self.make(robot, n, seed, device, **self.options)
        for name in ("reset", "step"):
            if not callable(getattr(reality, name, None)):
                problem = f"{type(reality).__name__} without {name}"
                raise InputError(self.files[0], "make", problem, "a reality with reset and step")
        return reality


def read_reality(path: Path, **options: Any) -> RealityFile:  # noqa: ANN401 - the file's own
    """Run a file that defines ``make``; ``options`` are those of its ``make``."""
    content, files = _run(path)
    make = content.get("make")
    if not callable(make):
        raise InputError(path, "make", "nothing to call", "make(robot, n, seed, device, **options)")
    try:
        signature = inspect.signature(make)
        signature.bind(None, 1, 0, "cpu", **options)
    except (TypeError, ValueError) as error:
        expected = f"make(robot, n, seed, device{''.join(f', {o}=...' for o in options)})"
        raise InputError(path, "make", str(error), expected) from None
    own_parameters = list(signature.parameters.values())[4:]
    defaults = {p.name: p.default for p in own_parameters if p.default is not p.empty}
    at_once = content.get("AT_ONCE")
    if callable(by_options := content.get("at_once")):
        at_once = by_options(**{**defaults, **options})
    if at_once is not None and (type(at_once) is not int or at_once < 1):
        raise InputError(path, "AT_ONCE", repr(at_once), "a number of robots, at least 1")
    digests = [hashlib.sha256(file.read_bytes()).digest() for file in files]
    sha256 = hashlib.sha256(b"".join(digests)).hexdigest()
    return RealityFile(tuple(files), sha256, {**defaults, **options}, at_once, make)


def _run(path: Path) -> tuple[dict[str, Any], list[Path]]:
    """Names in the file, and its files, those imported from its folder included, then unloaded."""
    if not path.is_file():
        raise InputError(path, "", "no such file", "a Python file that defines make")
    folder, before = str(path.resolve().parent), set(sys.modules)
    sys.path.insert(0, folder)
    try:
        content = runpy.run_path(str(path), run_name="reality_of_your_own")
    except Exception as error:
        problem = f"{type(error).__name__}: {error}"
        raise InputError(path, "", problem, "a Python file that can be run") from None
    finally:
        sys.path.remove(folder)
        new = {*sys.modules} - before
        files = {name: Path(getattr(sys.modules[name], "__file__", None) or "") for name in new}
        own = sorted(name for name, file in files.items() if str(file.parent) == folder)
        for name in own:
            del sys.modules[name]
    return content, [path, *(path.parent / files[name].name for name in own)]


class RealWorld:
    """The robots of a reality at a task, as ``rl.world.World`` has those of a simulator.

    Observations, rewards and ends are computed from measurements; an episode also ends if a robot
    or joint is not measured for ``SILENCE_S``.
    """

    device = torch.device("cpu")

    def __init__(
        self,
        reality: Any,  # noqa: ANN401 - with the methods above
        robot: Robot,
        task: Task,
        starts: Starts,
        name: str = "reality",
    ) -> None:
        """Take over the robots of a reality; ``name`` is its name in errors."""
        self.n_envs, J = starts.joint.shape
        self.task, self.targets = task, torch.as_tensor(starts.targets)
        self._reality, self._starts, self._name = reality, starts, name
        self._limits = np.array([joint.limits_rad for joint in robot.joints]).T
        self._bound = np.array(observation_bounds(J), dtype=np.float32)

    def reset(self) -> Tensor:
        """Start all episodes, with all robots measured; the first observations, shape (n, O)."""
        n = self.n_envs
        self._observers = [Measurements(self._bound) for _ in range(n)]
        self._going, self._periods = np.ones(n, dtype=bool), 0
        self._reached = np.zeros(n, dtype=np.int64)
        self._observation = np.zeros((n, len(self._bound)), dtype=np.float32)
        self._look(self._reality.reset(self._starts.pose, self._starts.joint))
        return torch.from_numpy(self._observation)

    def step(self, action: Tensor, *, begin: bool = False) -> Step:
        """Command angles (n, J) for a control period; no episode is started where one ended."""
        assert not begin, "a reality has one episode of each robot"
        before = self._distance()
        desired = np.clip(action.numpy(), *self._limits)
        desired[~self._going] = np.clip(0.0, *self._limits)
        self._look(self._reality.step(desired))
        distance = self._distance()
        reached = distance < self.task.arrive_m
        outside = (
            self.pose[:, :2].abs() > torch.tensor(self.task.domain_m, dtype=torch.float64) / 2
        ).any(dim=1)
        used, ending = effort(self.rate), bonus(self.task, reached, outside)
        value = reward(self.task, before, distance, self.rate, reached, outside)
        self._reached += reached.numpy() & self._going
        arrived = self._reached >= self.targets.shape[1]
        for e in np.flatnonzero(reached.numpy() & self._going & ~arrived).tolist():
            self._observe(e)
        blind = np.array([observer.blind_s > SILENCE_S for observer in self._observers])
        ended = torch.as_tensor(arrived) | outside
        self._going = self._going & ~(ended.numpy() | blind)
        seen, count = torch.from_numpy(self._observation), torch.from_numpy(self._reached.copy())
        return Step(seen, value, used, ending, ended, torch.as_tensor(blind), count, seen)

    def _look(self, measured: tuple[Array, Array]) -> None:
        """Process what the reality measured of the robots whose episodes go on."""
        pose, joint = self._checked(measured)
        t = CONTROL_S * self._periods
        self._periods += 1
        for e in np.flatnonzero(self._going).tolist():
            self._observers[e].take(Telemetry(t, pose[e], joint[e]))
            if not np.isfinite(self._observers[e].blind_s):
                problem = f"robot {e} not measured at its start"
                raise InputError(self._name, "reset", problem, "a pose and all angles")
            self._observe(e)
        self.pose, self.rate = torch.as_tensor(pose), torch.as_tensor(self._rates(joint.shape))

    def _observe(self, e: int) -> None:
        target = self._starts.targets[e, min(self._reached[e], self.targets.shape[1] - 1)]
        self._observation[e] = self._observers[e].observation(target)

    def _distance(self) -> Tensor:
        """From each head to its target in m, shape (n,)."""
        return torch.as_tensor(np.hypot(*self._observation[:, -2:].T.astype(np.float64)))

    def _rates(self, shape: tuple[int, ...]) -> Array:
        """Joint rates in rad/s: true values if the reality has them, else estimates."""
        true_rate = getattr(self._reality, "rate", None)
        if not callable(true_rate):
            return self._observation[:, 3 + shape[1] : -2].astype(np.float64)
        return np.nan_to_num(np.asarray(true_rate(), dtype=np.float64)).reshape(shape)

    def _checked(self, measured: tuple[Array, Array]) -> tuple[Array, Array]:
        """Measured poses and joint angles as arrays of their own."""
        try:
            pose, joint = (np.array(x, dtype=np.float64) for x in measured)
        except (TypeError, ValueError) as error:
            raise InputError(self._name, "seen", str(error), "poses and joint angles") from None
        expected = ((self.n_envs, 3), (self.n_envs, (len(self._bound) - 5) // 2))
        if (pose.shape, joint.shape) != expected:
            problem = f"arrays of shapes {pose.shape} and {joint.shape}"
            raise InputError(self._name, "seen", problem, f"{expected[0]} and {expected[1]}")
        return pose, joint
