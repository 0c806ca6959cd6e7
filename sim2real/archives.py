"""Zip archives of any origin, read within a stated size and without pickled objects."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim2real.errors import InputError
from sim2real.structured import check_size

LARGEST_BYTES = 2**30
"""Largest unpacked archive of arrays that is read."""


def read_members(
    path: str | os.PathLike[str], expected: str, *, what: str, largest: int = LARGEST_BYTES
) -> Iterator[tuple[str, bytes]]:
    """Names and contents of the members of a zip archive, one after the other.

    Args:
        path: The archive.
        expected: What it should be, for errors.
        what: What it then does not contain, for errors.
        largest: Largest number of bytes of all members together, checked before any is unpacked.

    Raises:
        InputError: If it is no regular file, no archive, damaged or too large, or if two members
            have the same name.
    """
    file = Path(path)
    if file.is_dir() or not file.exists():
        raise InputError(file, "", "no file", expected)
    check_size(file, LARGEST_BYTES)
    try:
        with zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            size = sum(entry.file_size for entry in entries)
            if size > largest:
                most = f"at most {largest / 2**20:.0f} MiB"
                raise InputError(file, "", f"{size / 2**20:.0f} MiB when unpacked", most)
            if len({entry.filename for entry in entries}) < len(entries):
                raise InputError(file, "", "two members of one name", expected)
            for entry in entries:
                with archive.open(entry) as stream:
                    # a limit, as the size stated in an archive may be wrong
                    yield entry.filename, stream.read(entry.file_size)
    except InputError:
        raise
    except Exception as error:  # damaged archives raise exceptions of many kinds
        raise InputError(file, "", f"no {what} ({reason(error)})", expected) from None


def read_arrays(
    path: str | os.PathLike[str],
    expected: str,
    *,
    what: str = "arrays",
    largest: int = LARGEST_BYTES,
) -> dict[str, NDArray[Any]]:
    """The arrays of an ``.npz`` file by name: real numbers, truth values or text.

    Args:
        path: The file.
        expected: As for ``read_members``.
        what: As for ``read_members``.
        largest: As for ``read_members``.

    Raises:
        InputError: As ``read_members``, or if a member is no such array.
    """
    arrays = {}
    for name, content in read_members(path, expected, what=what, largest=largest):
        try:
            array = np.lib.format.read_array(BytesIO(content), allow_pickle=False)
            if array.dtype.kind not in "biufU":
                raise ValueError(f"an array of {array.dtype}")
        except Exception as error:  # as above
            raise InputError(path, name, f"no {what} ({reason(error)})", expected) from None
        arrays[name.removesuffix(".npy")] = array
    return arrays


def reason(error: Exception) -> str:
    """First line of an error's message, or its type if it has none."""
    return str(error).strip().partition("\n")[0] or type(error).__name__
