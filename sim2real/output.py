"""Result files: written atomically, with their provenance."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import platform
import sys
import tempfile
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from sim2real.errors import InputError
from sim2real.version import __version__

_LIBRARIES = ("numpy", "scipy", "warp-lang")


def check_writable(path: str | os.PathLike[str]) -> Path:
    """Check, before any computation, that a result can be written to ``path``.

    Raises:
        InputError: If ``path`` is a folder, or its folder cannot be created or written.
    """
    target = Path(path)
    folder = target.absolute().parent
    try:
        if target.is_dir():
            raise InputError(target, "", "a folder", "the name of a file to write")
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
    except OSError as error:  # a name too long, a folder that may not be searched
        raise InputError(target, "", str(error.strerror), "the name of a file to write") from None
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise InputError(target, "", f"{folder}, which can't be written", "a folder to write in")
    return target


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> Path:
    """Write ``content`` to a temporary file in the same folder and rename it to ``path``.

    Raises:
        InputError: If the folder cannot be created or written.
    """
    target = check_writable(path)
    data = content.encode() if isinstance(content, str) else content
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    except OSError as error:
        raise InputError(target, "", str(error.strerror), "a folder to write in") from error
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
        os.chmod(temporary, 0o644)
        os.replace(temporary, target)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
        raise
    return target


def write_json(path: str | os.PathLike[str], content: dict[str, Any]) -> Path:
    """Write ``content`` as indented JSON, with numbers converted by ``finite_json``.

    Infinite ends of intervals must be ``None``, which is written as null.
    """
    return write_whole(path, json.dumps(finite_json(content), indent=2, allow_nan=False) + "\n")


def finite_json(value: Any) -> Any:  # noqa: ANN401 - any JSON
    """``value`` with infinities as ``"inf"`` or ``"-inf"`` and NaN as null, which JSON lacks."""
    if isinstance(value, Mapping):
        return {key: finite_json(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite_json(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(float(value))
    return value


def provenance(inputs: Iterable[object], seed: int | None) -> dict[str, Any]:
    """Provenance of a result: command line, versions, seed and SHA-256 of every input file.

    Args:
        inputs: Files, or objects read from files (with a ``path``); others are ignored.
        seed: The seed, if anything was random.
    """
    files = (
        source if isinstance(source, str | os.PathLike) else getattr(source, "path", None)
        for source in inputs
    )
    versions = {"python": platform.python_version(), "sim2real": __version__}
    versions |= {name: _version(name) for name in _LIBRARIES}
    return {
        "command": " ".join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "seed": seed,
        "versions": versions,
        "inputs": {str(file): _sha256(Path(file)) for file in files if file is not None},
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
