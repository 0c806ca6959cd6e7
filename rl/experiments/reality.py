"""A user-defined reality: a Python file that moves and measures robots.

``sim2real ablate --reality FILE.py`` tests trained policies in it: a test bench, or a surrogate
with its own dynamics. The file is run like a script and may import modules of its own folder. It
defines::

    def make(robot, n, seed, device, **options):
        ...               # n robots; ``device`` is cpu or cuda:0, as training's
        return reality    # with the two methods below

    AT_ONCE = 1           # if the number of robots at a time is limited, or:
    def at_once(**options): return 1       # the same, as a function of the options of make

and the object that ``make`` returns has::

    reality.reset(pose, joint)    # poses (n, 3), joint angles (n, J): place robots at rest
    reality.step(desired)         # desired joint angles (n, J), held for 0.02 s

Both return measurements: poses (n, 3), x and y of the head's centre of mass in m and its
heading in rad, in the pool's frame, and joint angles (n, J) as the servos report them; NaN where
there is none. A robot whose episode is over is commanded to straight joints. Velocities,
observations, arrival and reward are computed from measurements, as on the real robot. A surrogate
can add::

    reality.rate()                # present true joint rates (n, J) in rad/s

With this method the energy is computed from true rates, as in the simulator: rates estimated from
five samples of reported angles miss half of it. Without it, energies of simulation and reality must
not be compared. An example is ``datasets/pool/reality.py``.
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

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.robot import Robot

_NAME = "reality_of_your_own"


class Reality(Protocol):
    """Robots that can be moved and measured."""

    def reset(self, pose: Array, joint: Array) -> tuple[Array, Array]:
        """Place the robots at rest; measured poses and joint angles."""

    def step(self, desired: Array) -> tuple[Array, Array]:
        """Command angles for a control period; poses and joint angles measured after it."""


@dataclass(frozen=True)
class RealityFile:
    """A file that makes realities.

    Attributes:
        files: The file itself, and the modules that it imports from its folder.
        sha256: Hash of these files.
        options: Options of its ``make``, including defaults.
        at_once: Maximum number of robots at a time; None if unlimited.
        make: Called as ``make(robot, n, seed, device, **options)``.
    """

    files: tuple[Path, ...]
    sha256: str
    options: Mapping[str, Any]
    at_once: int | None
    make: Callable[..., Reality]

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.files[0]

    def __call__(self, robot: Robot, n: int, seed: int, device: str) -> Reality:
        """Make a reality of n robots.

        Raises:
            InputError: If the result of ``make`` has no ``reset`` or no ``step``.
        """
        reality = self.make(robot, n, seed, device, **self.options)
        for name in ("reset", "step"):
            if not callable(getattr(reality, name, None)):
                problem = f"{type(reality).__name__} without {name}"
                raise InputError(self.path, "make", problem, "a reality with reset and step")
        return reality


def read_reality(path: Path, **options: Any) -> RealityFile:  # noqa: ANN401 - the file's own
    """Run a file that defines ``make``.

    Args:
        path: The file.
        options: Options of its ``make``.

    Raises:
        InputError: If it cannot be run, or has no valid ``make``.
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
    own_parameters = list(signature.parameters.values())[4:]
    defaults = {p.name: p.default for p in own_parameters if p.default is not p.empty}
    at_once = getattr(module, "AT_ONCE", None)
    if callable(by_options := getattr(module, "at_once", None)):
        at_once = by_options(**{**defaults, **options})
    if at_once is not None and (type(at_once) is not int or at_once < 1):
        raise InputError(path, "AT_ONCE", repr(at_once), "a number of robots, at least 1")
    digest = hashlib.sha256()
    for file in files:
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return RealityFile(tuple(files), digest.hexdigest(), {**defaults, **options}, at_once, make)


def _run(path: Path) -> tuple[ModuleType, list[Path]]:
    """The module, and its files: the file itself, then those imported from its folder."""
    if not path.is_file():
        raise InputError(path, "", "no such file", "a Python file that defines make")
    spec = importlib.util.spec_from_file_location(_NAME, path)
    if spec is None or spec.loader is None:
        raise InputError(path, "", "no Python file", "one that ends in .py")
    module = importlib.util.module_from_spec(spec)
    with _neighbours(path) as imported:
        sys.modules[_NAME] = module  # dataclasses look their module up by its name
        try:
            spec.loader.exec_module(module)
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
            raise InputError(path, "", problem, "a Python file that can be run") from None
    return module, [path, *imported]


@contextmanager
def _neighbours(path: Path) -> Iterator[list[Path]]:
    """Allow imports from the folder of a file, and list them; they are unloaded at the end."""
    folder = path.resolve().parent
    names = {file.stem for file in folder.glob("*.py")} | {_NAME}
    replaced = {name: sys.modules.pop(name) for name in names & set(sys.modules)}
    sys.path.insert(0, str(folder))
    imported: list[Path] = []
    try:
        yield imported
    finally:
        sys.path.remove(str(folder))
        for name in sorted(names & set(sys.modules)):
            file = getattr(sys.modules.pop(name), "__file__", None)
            if file is not None and Path(file).parent == folder and Path(file) != path.resolve():
                imported.append(path.parent / Path(file).name)
        sys.modules.update(replaced)
