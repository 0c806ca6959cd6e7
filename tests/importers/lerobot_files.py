"""Writes small LeRobot datasets in the exact layout of formats 2.1 and 3.0.

Folders, columns and types that are read are those of the public documentation
(huggingface.co/docs/lerobot) and of published datasets' ``meta/info.json``.
"""

import json

import numpy as np
import pyarrow as pa
from pyarrow import parquet

MOTORS = ["shoulder_pan", "elbow_flex", "gripper"]
FPS = 30
INDICES = ("frame_index", "episode_index", "index", "task_index")


def dataset(root, version, episodes, names="default"):
    """A dataset of episodes, each a state and an action of shape (T, J)."""
    length = episodes[0][0].shape[1]
    if names == "default":
        names = [f"{motor}.pos" for motor in MOTORS] if version == "v3.0" else {"motors": MOTORS}
    vector = {"dtype": "float32", "shape": [length], "names": names}
    scalars = {"timestamp": "float32"} | dict.fromkeys(INDICES, "int64")
    features = {"action": vector, "observation.state": vector} | {
        name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in scalars.items()
    }
    info = {
        "codebase_version": version,
        "robot_type": "so101_follower",
        "total_episodes": len(episodes),
        "chunks_size": 1000,
        "features": features,
    }
    tables = _tables(episodes)
    if version == "v3.0":
        info["data_path"] = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
        _write(pa.concat_tables(tables), root / "data" / "chunk-000" / "file-000.parquet")
        index = {
            "episode_index": list(range(len(episodes))),
            "data/chunk_index": [0] * len(episodes),
            "data/file_index": [0] * len(episodes),
            "tasks": [["wave"]] * len(episodes),
        }
        _write(pa.table(index), root / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    else:
        path = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
        info["data_path"] = path
        for k, table in enumerate(tables):
            _write(table, root / path.format(episode_chunk=0, episode_index=k))
        (root / "meta").mkdir(parents=True, exist_ok=True)
    (root / "meta" / "info.json").write_text(json.dumps(info, indent=4))
    return root


def calibration(path):
    """A calibration file of these motors, as ``lerobot-calibrate`` writes it."""
    ranges = {"shoulder_pan": (754, 3230), "elbow_flex": (862, 3054), "gripper": (1903, 3135)}
    content = {
        name: {"id": k + 1, "drive_mode": 0, "homing_offset": -12, "range_min": a, "range_max": b}
        for k, (name, (a, b)) in enumerate(ranges.items())
    }
    path.write_text(json.dumps(content, indent=4))
    return path


def _tables(episodes):
    tables, first = [], 0
    for number, (state, action) in enumerate(episodes):
        length, joints = state.shape
        frames, vector = np.arange(length), pa.list_(pa.float32(), joints)
        indices = (frames, np.full(length, number), first + frames, np.zeros(length, np.int64))
        columns = {
            "action": pa.array(action.tolist(), vector),
            "observation.state": pa.array(state.tolist(), vector),
            "timestamp": pa.array((frames / FPS).astype(np.float32)),
        }
        tables.append(pa.table(columns | dict(zip(INDICES, map(pa.array, indices), strict=True))))
        first += length
    return tables


def _write(table, path):
    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(table, path)
