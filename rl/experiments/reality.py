"""A reality of your own: a Python file that says how robots are moved and seen.

``sim2real ablate --reality FILE.py`` swims trained policies in it: a rig, or a surrogate of one's
own. Only then is the file run, as a script would be: at its top it may import what stands beside
it. It offers::

    def make(robot, n, seed, device, **options):
        ...               # n robots; ``device`` is cpu or cuda:0, as training's
        return reality    # with the two methods below

    AT_ONCE = 1           # if there are only so many robots at a time, or:
    def at_once(**options): return 1       # the same by the options of make

and what ``make`` returns has::

    reality.reset(pose, joint)    # poses (n, 3), joint angles (n, J): put them there, at rest
    reality.step(desired)         # desired joint angles (n, J), held for 0.02 s

Both return what is then seen: poses (n, 3), x and y of the head's centre of mass in m and its
heading in rad, in the pool's frame, and joint angles (n, J) as the servos report them; NaN where
unseen. A robot whose episode is over is sent straight joints. Velocities, observations, arrival and
reward are computed from what is seen, as on the real robot. A surrogate knows more::

    reality.rate()                # true joint rates (n, J) in rad/s now

Where there is this third method the energy is counted from it, as a simulator counts its own: rates
estimated through five samples of what servos report miss half of it. Without it energies of
simulation and reality must not be compared. An example is ``datasets/pool/reality.py``.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sim2real.errors import InputError
from sim2real.robot import Robot

Array = NDArray[np.float64]
_NAME = "reality_of_your_own"


class Reality(Protocol):
    """Some robots, moved and seen."""

    def reset(self, pose: Array, joint: Array) -> tuple[Array, Array]:
        """Put them there at rest; poses and joint angles as seen."""

    def step(self, desired: Array) -> tuple[Array, Array]:
        """Hold these angles for a control period; poses and joint angles as seen after it."""


@dataclass(frozen=True)
class RealityFile:
    """A file that makes realities.

    Attributes:
        files: The file itself, and what it imports from its own folder.
        sha256: Of these.
        options: Of its ``make``: given ones, and the defaults of the others.
        at_once: Most robots at a time; any number where None.
        make: Called as ``make(robot, n, seed, device, **options)``.
    """

    files: tuple[Path, ...]
    sha256: str
    options: Mapping[str, Any]
    at_once: int | None
    make: Callable[..., Reality]

    @property
    def path(self) -> Path:
        """Where it is."""
        return self.files[0]

    def __call__(self, robot: Robot, n: int, seed: int, device: str) -> Reality:
        """A reality of n robots.

        Raises:
            InputError: If what the file makes has no ``reset`` or no ``step``.
        """
        made = self.make(robot, n, seed, device, **self.options)
        for name in ("reset", "step"):
            if not callable(getattr(made, name, None)):
                found = f"{type(made).__name__} without {name}"
                raise InputError(self.path, "make", found, "a reality with reset and step")
        return made


def read_reality(path: Path, **options: Any) -> RealityFile:  # noqa: ANN401 - the file's own
    """Run a file that offers ``make``.

    Args:
        path: The file.
        options: For its ``make``.

    Raises:
        InputError: If it can't be run, or does not offer what it should.
    """
    module, files = _run(path)
    make = getattr(module, "make", None)
    if not callable(make):
        raise InputError(path, "make", "nothing to call", "make(robot, n, seed, device, **options)")
    try:
        signature = inspect.signature(make)
        signature.bind(None, 1, 0, "cpu", **options)
    except (TypeError, ValueError) as error:
        expected = f"make(robot, n, seed, device{''.join(f', {o}=...' for o in options)})"
        raise InputError(path, "make", str(error), expected) from None
    own = list(signature.parameters.values())[4:]
    defaults = {p.name: p.default for p in own if p.default is not p.empty}
    most = getattr(module, "AT_ONCE", None)
    if callable(by_options := getattr(module, "at_once", None)):
        most = by_options(**{**defaults, **options})
    if most is not None and (type(most) is not int or most < 1):
        raise InputError(path, "AT_ONCE", repr(most), "a number of robots, at least 1")
    whole = hashlib.sha256()
    for file in files:
        whole.update(hashlib.sha256(file.read_bytes()).digest())
    return RealityFile(tuple(files), whole.hexdigest(), {**defaults, **options}, most, make)


def _run(path: Path) -> tuple[ModuleType, list[Path]]:
    """The file as a module, and the files it is made of: itself, then those beside it."""
    if not path.is_file():
        raise InputError(path, "", "no such file", "a Python file that offers make")
    spec = importlib.util.spec_from_file_location(_NAME, path)
    if spec is None or spec.loader is None:
        raise InputError(path, "", "no Python file", "one that ends in .py")
    module = importlib.util.module_from_spec(spec)
    with _beside(path) as beside:
        sys.modules[_NAME] = module  # dataclasses look their module up by its name
        try:
            spec.loader.exec_module(module)
        except Exception as error:
            found = f"{type(error).__name__}: {error}"
            raise InputError(path, "", found, "a Python file that can be run") from None
    return module, [path, *beside]


@contextmanager
def _beside(path: Path) -> Iterator[list[Path]]:
    """Let a file import its neighbours, as a script does; forget them after, and say which."""
    folder = path.resolve().parent
    names = {file.stem for file in folder.glob("*.py")} | {_NAME}
    known = {name: sys.modules.pop(name) for name in names & set(sys.modules)}
    sys.path.insert(0, str(folder))
    found: list[Path] = []
    try:
        yield found
    finally:
        sys.path.remove(str(folder))
        for name in sorted(names & set(sys.modules)):
            file = getattr(sys.modules.pop(name), "__file__", None)
            if file is not None and Path(file).parent == folder and Path(file) != path.resolve():
                found.append(path.parent / Path(file).name)
        sys.modules.update(known)
