"""LeRobot datasets, formats 2.0, 2.1 and 3.0: what was measured and commanded in one episode.

Layout: https://huggingface.co/docs/lerobot, "LeRobotDataset v3.0". Tables are Parquet, read with
pyarrow: a file for each episode (2.x), or files of many episodes that ``meta/episodes`` indexes.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError, optional
from sim2real.importers.options import Conversion, check_increasing, import_warnings
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
    """Read one episode of a dataset as a ``servo`` recording with unknown loads, from time 0.

    The path is that of the folder with ``meta/info.json``; the episode may be None if there is only
    one. If the dataset does not name its joints, ``joints`` are names for all of them, in order;
    else they select. A suffix ``.pos`` of a name is removed. ``InputError`` if the dataset, the
    episode or a joint is invalid.
    """
    root = Path(path)
    info, total = _info(root)
    if episode is None and total > 1:
        raise InputError("--episode", "", "nothing", f"one of the {total} episodes, from 0")
    index = episode or 0
    if not 0 <= index < total:
        raise InputError("--episode", "", str(index), f"0 to {total - 1}")
    file = _data_file(root, info, index)
    frames = _read(file, ["timestamp", STATE, ACTION], index)
    if (rows := len(frames["timestamp"])) < 2:
        raise InputError(file, "episode_index", f"{rows} frames of episode {index}", "at least two")
    names = {feature: _names(info, feature, joints) for feature in QUANTITY}
    chosen = tuple(joints) if joints else tuple(n for n in names[STATE] if n in names[ACTION])
    if len(set(chosen)) != len(chosen):
        raise InputError("--joints", "", ", ".join(chosen), "each joint once")
    t = frames["timestamp"] - frames["timestamp"][0]
    check_increasing(file, t, "timestamp, frame {}", 0)
    angles, warnings = {}, []
    for feature, available in names.items():
        for joint in chosen or ("joint of both",):
            if joint not in available:
                expected = f"one of {', '.join(available)}"
                raise InputError(info.file, feature, f"no {joint}", expected)
        values = frames[feature]
        if values.ndim != 2 or values.shape[1] < len(available):
            found = f"values of shape {' x '.join(map(str, values.shape))}"
            raise InputError(file, feature, found, f"{len(available)} in each frame")
        values = values[:, [available.index(joint) for joint in chosen]]
        angles[feature] = conversion.radians(chosen, QUANTITY[feature], values, file)
        if left := [joint for joint in available if joint not in chosen]:
            warnings.append(f"{feature} of {', '.join(left)} is not read.")
    if not np.isfinite(angles[ACTION]).all():
        raise InputError(file, ACTION, "a missing value", "a set-point at every frame")
    features = info.table("features")
    kinds = {str(name): features.table(name).content.get("dtype") for name in features.content}
    others = (name for name, kind in kinds.items() if str(kind).startswith("float"))
    if unread := ", ".join(name for name in others if name not in (*QUANTITY, *INDICES)):
        warnings.append(f"{unread}: not read.")
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
            **import_warnings(warnings),
        },
    )


def with_episodes(recordings: Any, most: int) -> Any:  # noqa: ANN401 - whatever was given
    """Recordings or their files with the first episodes of each dataset, in degrees, in its place.

    For what does not depend on the unit of angles.
    """
    given = [recordings] if isinstance(recordings, str | os.PathLike) else recordings
    if not isinstance(given, Sequence):
        return given
    listed: list[Any] = []
    for one in given:
        if isinstance(one, str | os.PathLike) and is_lerobot(one):
            total, degrees = _info(Path(one))[1], Conversion({"": "deg"})
            episodes = range(min(total, most))
            listed += [read_lerobot(one, degrees, episode=k) for k in episodes]
        else:
            listed.append(one)
    return listed


def _info(root: Path) -> tuple[Fields, int]:
    """What a dataset says of itself, and its number of episodes."""
    file = root / "meta" / "info.json"
    info = Fields(file, "", read_json(file))
    return info, int(info.number("total_episodes", low=1))


def _data_file(root: Path, info: Fields, episode: int) -> Path:
    """The file that contains the episode."""
    version = info.text("codebase_version")
    if version in ("v2.0", "v2.1"):
        chunk = episode // int(info.number("chunks_size", 1000, low=1))
        fields = {"episode_chunk": chunk, "episode_index": episode}
    elif version.startswith("v3."):
        columns = {"chunk_index": "data/chunk_index", "file_index": "data/file_index"}
        folder = root / "meta" / "episodes"
        tables = (
            _read(x, [*columns.values()], episode) for x in sorted(folder.glob("*/*.parquet"))
        )
        table = next((one for one in tables if one["data/chunk_index"].size), None)
        if table is None:
            raise InputError(folder, "episode_index", f"no episode {episode}", "a row for it")
        fields = {name: int(table[column][0]) for name, column in columns.items()}
    else:
        raise info.error("codebase_version", "v2.0, v2.1 or v3.0")
    try:
        return root / info.text("data_path").format(**fields)
    except (LookupError, ValueError, AttributeError):
        raise info.error("data_path", f"a path with {' and '.join(fields)} in it") from None


def _read(file: Path, columns: list[str], episode: int) -> dict[str, Array]:
    """Columns of the rows of an episode in a Parquet file, (rows,) or (rows, length) of lists."""
    with optional(str(file)):
        import pyarrow
        from pyarrow import parquet
    if not file.is_file():
        raise InputError(file, "", "no such file", "a Parquet file")
    try:
        names = parquet.read_schema(file).names
        for name in ("episode_index", *columns):
            if name not in names:
                raise InputError(file, "columns", f"no {name}", f"one of {', '.join(names)}")
        filters = [("episode_index", "==", episode)]
        table = parquet.read_table(file, columns=columns, filters=filters)
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
    names, shape = fields.content.get("names"), fields.content.get("shape")
    if isinstance(names, dict) and len(names) == 1:
        names = next(iter(names.values()))
    length = shape[0] if isinstance(shape, list) and len(shape) == 1 else None
    if not isinstance(length, int) or length < 1:
        raise fields.error("shape", "the number of joints, in a list")
    if isinstance(names, list) and len(names) == length:
        return [str(name).removesuffix(".pos") for name in names]
    if joint_names is None or len(joint_names) != length:
        found = "none" if joint_names is None else str(len(joint_names))
        expected = f"{length} names, as {info.file} has none for {feature}"
        raise InputError("--joints", "", found, expected)
    return list(joint_names)
