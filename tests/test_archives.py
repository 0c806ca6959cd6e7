"""Archives of any origin: only arrays, only so much, and no traceback."""

import io
import struct
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from sim2real.errors import InputError
from sim2real.structured import read_arrays

ARRAYS = {"a": np.arange(6.0).reshape(2, 3), "b": np.array(["x", "yz"]), "c": np.array(3)}


def npz(file: Path, **arrays: np.ndarray) -> Path:
    np.savez_compressed(file, **arrays)
    return file


def test_arrays_come_back(tmp_path):
    read = read_arrays(npz(tmp_path / "x.npz", **ARRAYS), "an archive")
    assert read.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert read[name].dtype == array.dtype
        np.testing.assert_array_equal(read[name], array)


def test_archives_that_are_too_large_are_not_unpacked(tmp_path):
    file = npz(tmp_path / "x.npz", a=np.zeros(2**17))
    with pytest.raises(InputError, match="1 MiB when unpacked, expected at most 0 MiB"):
        read_arrays(file, "an archive", largest=1000)


def test_an_archive_that_states_too_little_is_not_unpacked_further(tmp_path):
    """A member of 64 MiB that says that it has 128 bytes."""
    with zipfile.ZipFile(tmp_path / "x.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", bytes(2**26))
    content = bytearray((tmp_path / "x.npz").read_bytes())
    stated = struct.pack("<I", 2**26)
    while (place := content.find(stated)) >= 0:
        content[place : place + 4] = struct.pack("<I", 128)
    (tmp_path / "x.npz").write_bytes(content)
    tracemalloc.start()
    with pytest.raises(InputError, match="no arrays"):
        read_arrays(tmp_path / "x.npz", "an archive")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**22


OBJECT = np.array({"a": 1}, dtype=object)
OTHERS = [np.zeros(2, complex), np.zeros(2, "M8[s]"), np.zeros(2, "S3"), OBJECT]


@pytest.mark.parametrize("array", OTHERS)
def test_only_real_numbers_truth_values_and_text_are_read(tmp_path, array):
    with pytest.raises(InputError, match="x.npy: found no arrays"):
        read_arrays(npz(tmp_path / "x.npz", x=array), "an archive")


def test_an_array_that_states_too_much_is_refused(tmp_path):
    stream = io.BytesIO()
    np.save(stream, np.zeros(3))
    larger = stream.getvalue().replace(b"(3,), }" + 12 * b" ", b"(9999999999999,), }")
    assert larger != stream.getvalue()
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("a.npy", larger)
    with pytest.raises(InputError, match="no arrays"):
        read_arrays(tmp_path / "x.npz", "an archive")


def test_damaged_archives_are_refused_in_a_line(tmp_path):
    rng = np.random.default_rng(0)
    whole = npz(tmp_path / "x.npz", **ARRAYS, d=rng.normal(size=500)).read_bytes()
    for _ in range(300):
        damaged = bytearray(whole[: rng.integers(len(whole))] if rng.random() < 0.2 else whole)
        for k in rng.integers(max(len(damaged), 1), size=rng.integers(1, 20)):
            damaged[k : k + 1] = rng.bytes(1)
        (tmp_path / "y.npz").write_bytes(damaged)
        try:
            read_arrays(tmp_path / "y.npz", "an archive")
        except InputError as error:
            assert "\n" not in str(error)
    for none in (tmp_path, tmp_path / "none.npz", Path("/dev/zero")):
        with pytest.raises(InputError, match="no file|expected a file"):
            read_arrays(none, "an archive")
