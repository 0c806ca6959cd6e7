"""LeRobot datasets, formats 2.0, 2.1 and 3.0: what was measured and commanded in one episode.

Layout: https://huggingface.co/docs/lerobot, "LeRobotDataset v3.0". Tables are Parquet, read with
pyarrow: a file for each episode (2.x), or files of many episodes that ``meta/episodes`` indexes.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.extras import optional
from sim2real.importers.missing import import_warnings
from sim2real.importers.units import Conversion
from sim2real.recording import Recording
from sim2real.structured import Fields, read_json

STATE, ACTION = "observation.state", "action"
QUANTITY = {STATE: "position", ACTION: "command"}
INDICES = ("timestamp", "frame_index", "episode_index", "index", "task_index")
SOURCE = (
    "LeRobot dataset; its licence is in its README. Set-points stand at the time of their frame, "
    "as they were sent right after its observation. Loads are unknown."
)


def is_lerobot(path: str | os.PathLike[str]) -> bool:
    """Whether a path is the folder of a LeRobot dataset."""
    return (Path(path) / "meta" / "info.json").is_file()


def read_lerobot(
    path: str | os.PathLike[str],
    conversion: Conversion,
    *,
    episode: int | None = None,
    joints: Sequence[str] | None = None,
) -> Recording:
    """Read one episode of a dataset as a recording with unknown loads.

    Args:
        path: The dataset's folder, with ``meta/info.json`` in it.
        conversion: Units of the angles, by joint.
        episode: Its index; may be None if there is only one.
        joints: The joints to read; default: all. If the dataset does not name its joints: names
            for all of them, in order. A suffix ``.pos`` of a name is removed.

    Returns:
        A ``servo`` recording of T rows at the frames' times, from 0.

    Raises:
        InputError: If the dataset, the episode or a joint is invalid.
    """
    root = Path(path)
    info = Fields(root / "meta" / "info.json", "", read_json(root / "meta" / "info.json"))
    index = _episode(info, episode)
    file = _data_file(root, info, index)
    frames = _frames(file, index)
    names = {feature: _names(info, feature, joints) for feature in (STATE, ACTION)}
    chosen = tuple(joints) if joints else tuple(n for n in names[STATE] if n in names[ACTION])
    if len(set(chosen)) != len(chosen):
        raise InputError("--joints", "", ", ".join(chosen), "each joint once")
    conversion.check_joints(chosen)
    for feature, available in names.items():
        for joint in chosen or available[:1]:
            if joint not in available or not chosen:
                raise InputError(
                    info.file, feature, f"no {joint}", f"one of {', '.join(available)}"
                )
    t = frames["timestamp"] - frames["timestamp"][0]
    decreasing = np.flatnonzero(~(np.diff(t) > 0))
    if decreasing.size:
        problem = f"{t[decreasing[0] + 1]:g} after {t[decreasing[0]]:g}"
        raise InputError(
            file, f"timestamp, frame {decreasing[0] + 1}", problem, "times that increase"
        )
    angles = {
        feature: np.stack(
            [
                conversion.radians(
                    joint, QUANTITY[feature], _column(frames[feature], k, file, feature), file
                )
                for joint in chosen
                for k in [available.index(joint)]
            ],
            axis=1,
        )
        for feature, available in names.items()
    }
    if not np.isfinite(angles[ACTION]).all():
        raise InputError(file, ACTION, "a missing value", "a set-point at every frame")
    return Recording(
        name=f"{root.resolve().name}_{index}",
        kind="servo",
        joints=chosen,
        t=t,
        command=angles[ACTION],
        position=angles[STATE],
        source=SOURCE,
        metadata={
            "original_file": f"{root.resolve().name}/{file.relative_to(root).as_posix()}",
            "episode": index,
            "robot_type": info.content.get("robot_type"),
            "units": {joint or "all": unit for joint, unit in conversion.units.items()},
            **import_warnings(_not_read(info, names, chosen)),
        },
    )


def _not_read(info: Fields, names: Mapping[str, Sequence[str]], chosen: Sequence[str]) -> list[str]:
    """Sentences on joints and numbers of the dataset that the recording lacks."""
    rest = {name: [j for j in available if j not in chosen] for name, available in names.items()}
    sentences = [f"{name} of {', '.join(left)} is not read." for name, left in rest.items() if left]
    features = info.table("features")
    known = (STATE, ACTION, *INDICES)
    numbers = [
        str(name)
        for name in features.content
        if name not in known and str(features.table(name).content.get("dtype")).startswith("float")
    ]
    return sentences + ([f"{', '.join(numbers)}: not read."] if numbers else [])


def _episode(info: Fields, episode: int | None) -> int:
    total = int(info.number("total_episodes", low=1))
    if episode is None and total > 1:
        raise InputError("--episode", "", "nothing", f"one of the {total} episodes, from 0")
    index = episode or 0
    if not 0 <= index < total:
        raise InputError("--episode", "", str(index), f"0 to {total - 1}")
    return index


def _data_file(root: Path, info: Fields, episode: int) -> Path:
    """The file that contains the episode."""
    version = info.text("codebase_version")
    if version in ("v2.0", "v2.1"):
        chunk = episode // int(info.number("chunks_size", 1000, low=1))
        fields = {"episode_chunk": chunk, "episode_index": episode}
    elif version.startswith("v3."):
        fields = _place(root, episode)
    else:
        raise info.error("codebase_version", "v2.0, v2.1 or v3.0")
    try:
        return root / info.text("data_path").format(**fields)
    except (LookupError, ValueError, AttributeError):
        raise info.error("data_path", f"a path with {' and '.join(fields)} in it") from None


def _place(root: Path, episode: int) -> dict[str, int]:
    """Chunk and file numbers of an episode in format 3."""
    columns = {"chunk_index": "data/chunk_index", "file_index": "data/file_index"}
    for file in sorted((root / "meta" / "episodes").glob("*/*.parquet")):
        table = _read(file, ["episode_index", *columns.values()])
        rows = np.flatnonzero(table["episode_index"] == episode)
        if rows.size:
            return {name: int(table[column][rows[0]]) for name, column in columns.items()}
    folder = root / "meta" / "episodes"
    raise InputError(folder, "episode_index", f"no episode {episode}", "a row for it")


def _frames(file: Path, episode: int) -> dict[str, Array]:
    table = _read(file, ["timestamp", "episode_index", STATE, ACTION])
    selected = table.pop("episode_index") == episode
    if selected.sum() < 2:
        problem = f"{selected.sum()} frames of episode {episode}"
        raise InputError(file, "episode_index", problem, "at least two")
    return {name: values[selected].astype(np.float64) for name, values in table.items()}


def _read(file: Path, columns: list[str]) -> dict[str, Any]:
    """Columns of a Parquet file, numbers of shape (rows,) and lists of shape (rows, length)."""
    with optional(str(file)):
        import pyarrow
        from pyarrow import parquet
    if not file.is_file():
        raise InputError(file, "", "no such file", "a Parquet file")
    try:
        names = parquet.read_schema(file).names
        for name in columns:
            if name not in names:
                expected = f"one of {', '.join(names)}"
                raise InputError(file, "columns", f"no {name}", expected)
        table = parquet.read_table(file, columns=columns)
    except (pyarrow.ArrowException, OSError) as error:
        reason = str(error).splitlines()[0][:80]
        raise InputError(file, "", f"no Parquet ({reason})", "a Parquet file") from None
    read = {}
    for name in columns:
        try:
            read[name] = np.array(table[name].to_pylist(), dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(file, name, "values of unlike kinds", "numbers throughout") from None
    return read


def _names(info: Fields, feature: str, joint_names: Sequence[str] | None) -> list[str]:
    """Names of the joints of a feature in the dataset, from a list or a table with one list."""
    fields = info.table("features").table(feature)
    names = fields.content.get("names")
    if isinstance(names, dict) and len(names) == 1:
        names = next(iter(names.values()))
    shape = fields.content.get("shape")
    length = shape[0] if isinstance(shape, list) and len(shape) == 1 else None
    if not isinstance(length, int) or length < 1:
        raise fields.error("shape", "the number of joints, in a list")
    if isinstance(names, list) and len(names) == length:
        return [str(name).removesuffix(".pos") for name in names]
    if joint_names is None or len(joint_names) != length:
        raise InputError(
            "--joints",
            "",
            "none" if joint_names is None else str(len(joint_names)),
            f"{length} names, as {info.file} has none for {feature}",
        )
    return list(joint_names)


def _column(values: Array, k: int, file: Path, feature: str) -> Array:
    if values.ndim != 2 or values.shape[1] <= k:
        shape = " x ".join(str(n) for n in values.shape)
        raise InputError(file, feature, f"values of shape {shape}", f"more than {k} in each frame")
    column: Array = values[:, k]
    return column
