"""Scenes as MCAP files, which Foxglove and Lichtblick show."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import library
from sim2real.output import write_whole
from sim2real.version import __version__
from sim2real.viewers.signal_group import (
    TRACK_COLOURS,
    MovingLine,
    Scene,
    SignalGroup,
)

FRAME = "world"
_NS = 1_000_000_000
_PRIMITIVES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")

Message = tuple[float, dict[str, Any]]


def mcap_library() -> Any:  # noqa: ANN401 - a module
    """The library that writes the file.

    Raises:
        InputError: If it is not installed.
    """
    return library("mcap.writer", "--mcap")


def write_mcap(scene: Scene, path: str | os.PathLike[str]) -> Path:
    """Write a scene as JSON messages, each topic with its JSON schema.

    A group of signals is a topic ``/RECORDING/JOINT/QUANTITY`` with one message per sample, whose
    fields are the signals; a missing sample has no field. A line is a topic of
    ``foxglove.SceneUpdate`` (https://docs.foxglove.dev/docs/sdk/schemas/scene-update), in the frame
    ``world``. Times start at 0 where a recording's are negative.

    Raises:
        InputError: If the file cannot be written, or the library is not installed.
    """
    library = mcap_library()
    stream = io.BytesIO()
    writer = library.Writer(stream)
    writer.start(profile="", library=f"sim2real {__version__}")
    for group in scene.groups:
        _write_topic(writer, group.path, _signals_schema(group), _samples(group))
    schema = _object("foxglove.SceneUpdate", {"deletions": _ARRAY, "entities": _ARRAY})
    for track, colour in zip(scene.tracks, cycle(TRACK_COLOURS), strict=False):
        _write_topic(writer, track.path, schema, _scene_updates(track, colour))
    writer.finish()
    return write_whole(path, stream.getvalue())


_ARRAY = {"type": "array", "items": {"type": "object"}}


def _write_topic(
    writer: Any,  # noqa: ANN401 - of the library
    path: tuple[str, ...],
    schema: dict[str, Any],
    messages: Iterator[Message],
) -> None:
    topic = "".join("/" + part.replace("/", "_") for part in path)
    schema_id = writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
    channel_id = writer.register_channel(topic, "json", schema_id)
    start: float | None = None
    for number, (time_s, message) in enumerate(messages):
        start = min(time_s, 0.0) if start is None else start
        time_ns = round((time_s - start) * _NS)
        data = json.dumps(message, allow_nan=False).encode()
        writer.add_message(channel_id, time_ns, data, time_ns, sequence=number)


def _signals_schema(group: SignalGroup) -> dict[str, Any]:
    number = {"type": "number", "description": f"unit: {group.unit or '1'}"}
    quantity = "sim2real." + group.path[-1].replace(" ", "_")
    return _object(quantity, dict.fromkeys(group.signals, number))


def _object(title: str, properties: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


def _samples(group: SignalGroup) -> Iterator[Message]:
    for k, time_s in enumerate(group.t.tolist()):
        values = {name: float(x[k]) for name, x in group.signals.items() if np.isfinite(x[k])}
        if values:
            yield time_s, values


def _scene_updates(track: MovingLine, colour: tuple[int, int, int]) -> Iterator[Message]:
    """The moving line and, from the start, the path of its first point."""
    name = "/".join(track.path)
    entities = [_entity(f"{name}/path", float(track.t[0]), track.points[:, 0], colour)]
    for time_s, points in zip(track.t.tolist(), track.points, strict=True):
        entities.append(_entity(name, time_s, points, colour))
        yield time_s, {"deletions": [], "entities": entities}
        entities = []


def _entity(
    name: str, time_s: float, points: Array, colour: tuple[int, int, int]
) -> dict[str, Any]:
    """A ``foxglove.SceneEntity``: a line strip, which replaces the earlier one of this name."""
    seconds, nanoseconds = divmod(round(max(time_s, 0.0) * _NS), _NS)
    line = {
        "type": 0,  # a line strip
        "pose": {"position": _vector(0, 0, 0), "orientation": {**_vector(0, 0, 0), "w": 1.0}},
        "thickness": 4.0,
        "scale_invariant": True,
        "points": [_vector(*point) for point in points.tolist()],
        "color": {**dict(zip("rgb", (x / 255 for x in colour), strict=True)), "a": 1.0},
        "colors": [],
        "indices": [],
    }
    return {
        "timestamp": {"sec": seconds, "nsec": nanoseconds},
        "frame_id": FRAME,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": False,
        "metadata": [],
        **{name: [line] if name == "lines" else [] for name in _PRIMITIVES},
    }


def _vector(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}
