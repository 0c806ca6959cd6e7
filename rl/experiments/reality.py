"""A user-defined reality: a Python file that moves and measures robots.

``docs/tutorial/your-own-test-bench.md`` describes it. The file may import modules of its own
folder; its ``make`` may have options of its own, and ``at_once(**options)`` may stand in the place
of ``AT_ONCE``. A robot whose episode is over is commanded to straight joints. A surrogate can add
``reality.rate()``, true joint rates (n, J) in rad/s; from reported angles half of the energy is
missed.
"""

import inspect
import runpy
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from rl.deploy.link import SILENCE_S
from rl.make import digest
from rl.task import CONTROL_S, Starts, Task
from rl.world import Draws, World
from sim.robot.live import Live
from sim2real.arrays import Array, Index, Mask
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.output import sha256_of
from sim2real.robot import Robot
from sim2real.velocity import NEWEST, slope_weights


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
    sha256 = digest([sha256_of(file) for file in files])
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


class MeasuredRobots:
    """The robots of a reality as a simulator of n robots; the state is what was last measured.

    One that is not measured for ``SILENCE_S`` counts as stopped.
    """

    def __init__(self, reality: Any, robot: Robot, n: int, name: str) -> None:  # noqa: ANN401
        """Take over the robots of a reality; ``name`` is its name in errors."""
        J = len(robot.joints)
        self.robot, self.n_envs, self.current = robot, n, np.zeros((n, 2))
        self._reality, self._name, self._periods = reality, name, -1  # not placed yet
        self._command, self._joint = np.zeros((2, n, J))
        self._q, self._v = np.zeros((2, n, 3 + J))
        self._clock, self._stopped = np.zeros(n), np.full(n, -1, dtype=np.int32)
        self._past = np.zeros((NEWEST, n, J))

    def live(self) -> Live:
        """As of ``sim.robot.live.Robots``, in memory of the CPU."""
        arrays = self._command, self._q, self._v, self._joint, self._clock, self._stopped
        return Live(*map(torch.from_numpy, arrays))

    def adopt(self, which: Index, models: Sequence[Model]) -> None:
        """Nothing: these robots are as they are."""

    def reset(
        self, mask: Mask | None = None, pose: Array | None = None, joint: Array | None = None
    ) -> None:
        """Place all robots at rest, unless they have been placed and not moved since."""
        if self._periods != 0:
            self._periods, self._unseen = 0, np.zeros_like(self._q)
            self._q[:], self._stopped[:] = np.nan, -1
            self._look(self._reality.reset(pose, joint))
            if blind := np.flatnonzero(~np.isfinite(self._q).all(axis=1)).tolist():
                problem = f"robot {blind[0]} not measured at its start"
                raise InputError(self._name, "reset", problem, "a pose and all angles")

    def advance(self) -> None:
        """Command the set-points for a control period, and measure."""
        self._periods += 1
        self._look(self._reality.step(self._command.copy()))

    def _look(self, measured: tuple[Array, Array]) -> None:
        """Take what was measured; what was not is as before."""
        try:
            pose, joint = (np.array(x, dtype=np.float64) for x in measured)
        except (TypeError, ValueError) as error:
            raise InputError(self._name, "seen", str(error), "poses and joint angles") from None
        expected = ((self.n_envs, 3), self._command.shape)
        if (pose.shape, joint.shape) != expected:
            problem = f"arrays of shapes {pose.shape} and {joint.shape}"
            raise InputError(self._name, "seen", problem, f"{expected[0]} and {expected[1]}")
        turns = (self._q[:, 2] - pose[:, 2]) / (2 * np.pi)
        pose[:, 2] += 2 * np.pi * np.round(np.nan_to_num(turns))
        seen = np.concatenate([pose, joint], axis=1)
        known = np.isfinite(seen)
        self._q[known], self._joint[:] = seen[known], self._q[:, 3:]
        self._unseen = np.where(known, 0, self._unseen + 1)
        self._stopped[(CONTROL_S * self._unseen > SILENCE_S).any(axis=1)] = 0
        kept = self._past[1:] if self._periods else np.broadcast_to(joint, self._past[1:].shape)
        self._past = np.concatenate([kept, self._q[None, :, 3:]])
        rate = np.tensordot(slope_weights(), self._past, 1)
        if callable(true_rate := getattr(self._reality, "rate", None)):
            rate = np.nan_to_num(np.asarray(true_rate(), dtype=np.float64)).reshape(rate.shape)
        self._v[:, 3:] = rate


def real_world(reality: Any, robot: Robot, task: Task, starts: Starts, name: str) -> World:  # noqa: ANN401
    """The robots of a reality at a task, with these starts; ``name`` is its name in errors."""
    robots = MeasuredRobots(reality, robot, len(starts.pose), name)
    placed = replace(task, place=lambda *_: starts, waypoints=starts.targets.shape[1])
    return World(robots, placed, [Draws((Model({}),))], seed=0)
