"""Result files: written whole, never over an input of the command, with their provenance.

A result that is a link is written to the file behind the link. A result that is a device or a pipe
(``/dev/stdout``, ``/dev/null``, a FIFO) is written through to it.
"""

import contextlib
import dataclasses
import errno
import hashlib
import json
import math
import os
import platform
import re
import secrets
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from sim2real.errors import InputError

_DESCRIPTOR = re.compile(r"(?:/proc/(\d+)|/dev)/fd/(\d+)")
"""What ``/dev/stdout`` and ``/dev/fd/N`` stand for: process and number of an open file."""
_MOST_PRINTED_BYTES = 2**20


class Results:
    """The files of one call of the command line: what it reads, and results that were kept.

    Without a command line (not ``keeps``), no input is declared and no result kept.
    """

    def __init__(self, keeps: bool = False) -> None:
        self.keeps = keeps
        self.inputs: dict[tuple[int, int], str] = {}  # by device and number: not to be replaced
        self.folders: set[Path] = set()  # of results, checked before the computation
        self.kept: list[str] = []  # a sentence for each result that could not be written
        self.moved: dict[Path, Path | None] = {}  # where these are; None if printed or lost
        self.written = 0  # number of results in their places
        self._folder: Path | None = None

    def keep(self, target: Path, data: bytes, reason: str) -> None:
        """Keep a result in the temporary folder or, if that is full, print it."""
        self.moved[target] = None
        try:
            self._folder = self._folder or Path(tempfile.mkdtemp(prefix="sim2real-"))
            kept = self._folder / target.name
            kept.write_bytes(data)
        except OSError:
            shown = target.suffix != ".html" and b"\0" not in data
            if not shown or len(data) > _MOST_PRINTED_BYTES:
                self.kept.append(f"{target}: {reason}; lost, no room in {tempfile.gettempdir()}")
                return
            print(data.decode(errors="replace"))
            self.kept.append(f"{target}: {reason}; the result is printed above")
        else:
            self.moved[target] = kept
            self.kept.append(f"{target}: {reason}; the result is in {kept}")


_results = Results()


@contextlib.contextmanager
def results() -> Iterator[Results]:
    """Context of one call, which keeps a result elsewhere that can't be written in the end."""
    global _results
    before, _results = _results, Results(keeps=True)
    try:
        yield _results
    finally:
        _results = before


def place_of(path: Path) -> Path | None:
    """The file of a result that was written: ``path``, or where it was kept; None if nowhere."""
    return _results.moved.get(path, path)


def protect(path: str | os.PathLike[str]) -> None:
    """Declare a regular file as an input of this command, which no result replaces."""
    with contextlib.suppress(OSError, ValueError):
        found = os.stat(path)
        if _results.keeps and stat.S_ISREG(found.st_mode):
            _results.inputs.setdefault((found.st_dev, found.st_ino), str(path))


def check_writable(path: str | os.PathLike[str]) -> Path:
    """Raise InputError, before any computation, unless a result can be written to ``path``."""
    _place(path)
    if _results.keeps:
        _results.folders.add(Path(path).parent)
    return Path(path)


def check_not_read(place: Path, target: Path | None = None) -> None:
    """Raise InputError if ``place`` (in the message ``target``) is an input of this command."""
    with contextlib.suppress(OSError):
        found = place.stat()
        if read := _results.inputs.get((found.st_dev, found.st_ino)):
            expected = "another file"
            raise InputError(target or place, "", f"{read}, which the command reads", expected)


def is_standard_output(path: str | os.PathLike[str]) -> bool:
    """Whether ``path`` is the standard output of this process."""
    with contextlib.suppress(OSError):
        return _descriptor(_followed(Path(path))) == 1
    return False


def is_stream(path: str | os.PathLike[str]) -> bool:
    """Whether ``path`` is a device or a pipe, next to which no other file can be written."""
    with contextlib.suppress(OSError):
        return _streams(_followed(Path(path)))
    return False


def beside(out: Path, name: str) -> Path:
    """A file ``name`` next to the result ``out``, ``/`` as ``%2F``; the null device for a pipe."""
    return Path(os.devnull) if is_stream(out) else out.with_name(name.replace("/", "%2F"))


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> Path:
    """Write ``content`` to a temporary file in the same folder, sync it and rename it to ``path``.

    Permissions are those of the umask or the old file; ``results`` may keep elsewhere what fails.
    """
    target = Path(path)
    data = content.encode(errors="backslashreplace") if isinstance(content, str) else content
    try:
        place = _place(target)
        (_write_through if _streams(place) else _replace)(place, data)
        _results.written += 1
    except (OSError, InputError) as error:
        found = error.found if isinstance(error, InputError) else error.strerror or str(error)
        if target.parent in _results.folders:
            _results.keep(target, data, found)
        elif isinstance(error, InputError):
            raise
        else:
            raise InputError(target, "", found, "a folder to write in") from error
    return target


def _place(path: str | os.PathLike[str]) -> Path:
    """The file behind the links of ``path``, to which a result may be written."""
    target = Path(path)
    try:
        place = _followed(target)
        if place.is_dir():
            raise InputError(target, "", "a folder", "the name of a file to write")
        if _streams(place):
            return place
        if place.exists() and not place.is_file():
            raise InputError(target, "", "a disk or a socket", "the name of a file to write")
        check_not_read(place, target)
        folder = place.parent
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
    except OSError as error:  # a name too long, a loop of links, a folder that can't be searched
        raise InputError(target, "", str(error.strerror), "the name of a file to write") from None
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise InputError(target, "", f"{folder}, which can't be written", "a folder to write in")
    return place


def _followed(target: Path, most_links: int = 40) -> Path:
    """The path behind links, absolute; of an open descriptor its entry in ``/dev/fd``."""
    place = target.absolute()
    for _ in range(most_links):
        place = Path(os.path.realpath(place.parent)) / place.name
        if _descriptor(place) is not None or not place.is_symlink():
            return place
        place = place.parent / place.readlink()
    raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(target))


def _descriptor(place: Path) -> int | None:
    """The number of a file that this process has open, if ``place`` stands for one."""
    parts = _DESCRIPTOR.fullmatch(str(place))
    return int(parts[2]) if parts and parts[1] in (None, str(os.getpid())) else None


def _streams(place: Path) -> bool:
    """Whether a result is written through, to a device or a pipe, instead of replacing a file."""
    if _descriptor(place) is not None:
        return True
    try:
        mode = place.stat().st_mode
    except OSError:
        return False
    return stat.S_ISCHR(mode) or stat.S_ISFIFO(mode)


def _write_through(place: Path, data: bytes) -> None:
    """Write to a device, a pipe or an open descriptor; a pipe that nobody reads is an error."""
    number = _descriptor(place)
    if number is None:
        try:
            opened = os.open(place, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
        except OSError as error:
            nobody = error.errno == errno.ENXIO
            reason = "a pipe that no program reads" if nobody else error.strerror
            raise OSError(error.errno, reason, str(place)) from None
        os.set_blocking(opened, True)
    else:
        sys.stdout.flush()
        opened = os.dup(number)
    with os.fdopen(opened, "wb") as stream:
        stream.write(data)


def _replace(place: Path, data: bytes) -> None:
    """Write a temporary file and rename it to ``place``."""
    place.parent.mkdir(parents=True, exist_ok=True)
    temporary = place.with_name(f".{place.name}.{secrets.token_hex(4)}")
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # less the umask
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            if place.exists():
                os.fchmod(handle, stat.S_IMODE(place.stat().st_mode))
            os.fsync(handle)
        os.replace(temporary, place)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
        raise


def write_json(path: str | os.PathLike[str], content: dict[str, Any]) -> Path:
    """Write ``content`` as indented JSON, with numbers converted by ``finite_json``."""
    return write_whole(path, json.dumps(finite_json(content), indent=2, allow_nan=False) + "\n")


def finite_json(value: Any) -> Any:  # noqa: ANN401 - any JSON
    """``value`` as JSON, with ``"inf"`` and ``"-inf"``, null for NaN, and text for others."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: finite_json(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): finite_json(entry) for key, entry in value.items()}
    if hasattr(value, "tolist"):
        return finite_json(value.tolist())
    if isinstance(value, list | tuple | set):
        return [finite_json(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value if isinstance(value, bool | int | float | str | None) else str(value)


def provenance(inputs: Iterable[object], seed: int | None) -> dict[str, Any]:
    """Command line, versions, seed and SHA-256 of every input, a file or object with a ``path``."""
    from importlib.metadata import PackageNotFoundError, version

    from sim2real.version import __version__

    files = (
        source if isinstance(source, str | os.PathLike) else getattr(source, "path", None)
        for source in inputs
    )
    versions = {"python": platform.python_version(), "sim2real": __version__}
    for name in ("numpy", "scipy", "warp-lang"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "command": " ".join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "seed": seed,
        "versions": versions,
        "inputs": {str(file): sha256_of(file) for file in files if file is not None},
    }


def sha256_of(path: str | os.PathLike[str]) -> str:
    """The digest; a file that is gone by the end of a computation doesn't cost the result."""
    try:
        with Path(path).open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        return f"not readable ({error.strerror})"
