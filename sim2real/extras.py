"""Optional libraries: which extra of the package brings each, and how it is installed."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from sim2real.errors import InputError

_LIBRARIES = {
    "matplotlib": ("Matplotlib", "report"),
    "jinja2": ("Jinja", "report"),
    "markupsafe": ("Jinja", "report"),
    "rosbags": ("rosbags", "ros"),
    "PIL": ("Pillow", "sim"),
    "av": ("PyAV", "sim"),
    "torch": ("PyTorch", "rl"),
    "stable_baselines3": ("Stable-Baselines3", "rl"),
    "gymnasium": ("Gymnasium", "rl"),
    "moviepy": ("MoviePy", "render"),
    "pygame": ("pygame", "render"),
    "serial": ("pyserial", "hardware"),
    "cv2": ("OpenCV", "hardware"),
    "arviz": ("ArviZ", "arviz"),
    "shtab": ("shtab", "completion"),
    "onnx": ("package onnx", "onnx"),
    "mujoco": ("MuJoCo", "mujoco"),
    "pyarrow": ("pyarrow", "lerobot"),
    "pinocchio": ("Pinocchio", "arm"),
    "rerun": ("rerun-sdk", "view"),
    "mcap": ("mcap", "view"),
    "ray": ("Ray", "cluster"),
    "tensorboard": ("TensorBoard", "tensorboard"),
}
"""Name and extra of each optional library, by module."""


class MissingLibrary(InputError, ModuleNotFoundError):
    """An optional library is not installed; the message has the command that installs it."""

    def __init__(self, place: str, module: str) -> None:
        title, extra = _LIBRARIES[module]
        super().__init__(place, "", f"no {title}", f"it installed: {install_command(extra)}")
        self.name = module

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments."""
        return type(self), (self.file, self.name)


def install_command(extra: str) -> str:
    """The command that installs an extra of this package: its wheel's, and that of a clone."""
    return f"pip install 'sim2real[{extra}]' (in a clone: pip install -e '.[{extra}]')"


def missing_library(error: ModuleNotFoundError, place: str = "") -> MissingLibrary | None:
    """The failed import of an optional library as an error of one line; None for other imports."""
    if isinstance(error, MissingLibrary):
        return error
    module = (error.name or "").partition(".")[0]
    return MissingLibrary(place or module, module) if module in _LIBRARIES else None


@contextmanager
def optional(place: str) -> Iterator[None]:
    """Context of imports of optional libraries, which the option, command or file ``place`` needs.

    Raises:
        MissingLibrary: If one is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = missing_library(error, place)
        if missing is None:
            raise
        raise missing from None


@contextmanager
def if_installed(what: str) -> Iterator[None]:
    """Context that makes ``what``, as ``"plots"``, or prints which optional library it needs."""
    try:
        yield
    except ModuleNotFoundError as error:
        missing = missing_library(error)
        if missing is None:
            raise
        title, extra = _LIBRARIES[str(missing.name)]
        print(f"no {what}: {title} is not installed; {install_command(extra)}", file=sys.stderr)


def library(module: str, place: str) -> Any:  # noqa: ANN401 - a module
    """Import an optional library.

    Raises:
        MissingLibrary: If it is not installed.
    """
    with optional(place):
        return importlib.import_module(module)
