"""Scenes as files: for the Rerun viewer (``.rrd``), and MCAP for Foxglove and Lichtblick."""

from __future__ import annotations

import io
import json
import os
import tempfile
from collections.abc import Iterable, Iterator
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import library
from sim2real.output import write_whole
from sim2real.version import __version__
from sim2real.viewers.scenes import COMMAND, MovingLine, Scene, SignalGroup

TRACK_COLOURS = ((90, 160, 255), (255, 125, 92), (150, 150, 150))
"""Red, green and blue of successive tracks, 0 to 255."""
FRAME, TIMELINE = "world", "time"
_NS = 1_000_000_000
_PRIMITIVES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
_ARRAY = {"type": "array", "items": {"type": "object"}}
Colour = tuple[int, int, int]


def write_rerun(scene: Scene, path: str | os.PathLike[str]) -> Path:
    """Write a scene, with a layout of one plot per group and one view of the moving lines.

    Every signal is an entity ``/RECORDING/JOINT/QUANTITY/SIGNAL`` of scalars on the timeline
    ``time``; a missing sample is NaN, which the viewer shows as a gap.

    Raises:
        InputError: If the file cannot be written, or Rerun is not installed.
    """
    rr = library("rerun", "--rerun")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.rrd"
        # A stream of its own: the caller may use Rerun's global one.
        stream = rr.RecordingStream("sim2real", recording_id=Path(path).stem)
        stream.save(file, default_blueprint=_layout(rr, scene))
        for group in scene.groups:
            times = [rr.TimeColumn(TIMELINE, duration=group.t)]
            for name, values in group.signals.items():
                entity = rr.new_entity_path([*group.path, name])
                label = f"{name}, {group.unit}" if group.unit else name
                held = "StepAfter" if name == COMMAND else None
                look = rr.SeriesLines(names=label, interpolation_mode=held)
                stream.log(entity, look, static=True)
                columns = rr.Scalars.columns(scalars=values)
                stream.send_columns(entity, indexes=times, columns=columns)
        for track, colour in zip(scene.tracks, cycle(TRACK_COLOURS), strict=False):
            entity, line = (rr.new_entity_path([*track.path, *x]) for x in ((), ("path",)))
            stream.log(entity, rr.LineStrips3D.from_fields(colors=[colour]), static=True)
            stream.log(line, rr.LineStrips3D([track.points[:, 0]], colors=[colour]), static=True)
            strips = rr.LineStrips3D.columns(strips=list(track.points.astype(np.float32)))
            times = [rr.TimeColumn(TIMELINE, duration=track.t)]
            stream.send_columns(entity, indexes=times, columns=strips)
        stream.flush()
        stream.disconnect()
        return write_whole(path, file.read_bytes())


def _layout(rr: Any, scene: Scene) -> Any:  # noqa: ANN401 - Rerun
    """A tab for each component of each recording, with its quantities one below the other."""
    import rerun.blueprint as layout

    tabs: dict[tuple[str, ...], list[Any]] = {}
    for group in scene.groups:
        name = f"{group.path[-1]}, {group.unit}" if group.unit else group.path[-1]
        plot = layout.TimeSeriesView(origin=rr.new_entity_path([*group.path]), name=name)
        tabs.setdefault(group.path[:-1], []).append(plot)
    series = [layout.Vertical(*plots, name=" ".join(path)) for path, plots in tabs.items()]
    contents = [rr.new_entity_path([*track.path]) + "/**" for track in scene.tracks]
    shown: list[Any] = [layout.Tabs(*series)] if series else []
    if contents:
        shown.insert(0, layout.Spatial3DView(contents=contents, name="motion"))
    return layout.Blueprint(layout.Horizontal(*shown), collapse_panels=True)


def write_mcap(scene: Scene, path: str | os.PathLike[str]) -> Path:
    """Write a scene as JSON messages, each topic with its JSON schema.

    A group of signals is a topic ``/RECORDING/JOINT/QUANTITY`` with one message per sample, whose
    fields are the signals; a missing sample has no field. A line is a topic of
    ``foxglove.SceneUpdate`` (https://docs.foxglove.dev/docs/sdk/schemas/scene-update), in the frame
    ``world``. Times start at 0 where a recording's are negative.

    Raises:
        InputError: If the file cannot be written, or the library is not installed.
    """
    stream = io.BytesIO()
    writer = library("mcap.writer", "--mcap").Writer(stream)
    writer.start(profile="", library=f"sim2real {__version__}")
    for group in scene.groups:
        number = {"type": "number", "description": f"unit: {group.unit or '1'}"}
        title = "sim2real." + group.path[-1].replace(" ", "_")
        samples = (
            {name: float(x[k]) for name, x in group.signals.items() if np.isfinite(x[k])}
            for k in range(group.t.size)
        )
        _write_topic(writer, group, title, dict.fromkeys(group.signals, number), samples)
    fields = {"deletions": _ARRAY, "entities": _ARRAY}
    for track, colour in zip(scene.tracks, cycle(TRACK_COLOURS), strict=False):
        _write_topic(writer, track, "foxglove.SceneUpdate", fields, _updates(track, colour))
    writer.finish()
    return write_whole(path, stream.getvalue())


def _write_topic(
    writer: Any,  # noqa: ANN401 - of the library
    shown: SignalGroup | MovingLine,
    title: str,
    fields: dict[str, Any],
    messages: Iterable[dict[str, Any]],
) -> None:
    """Write a message for each sample; empty ones are left out."""
    topic = "".join("/" + part.replace("/", "_") for part in shown.path)
    schema = json.dumps({"title": title, "type": "object", "properties": fields})
    schema_id = writer.register_schema(title, "jsonschema", schema.encode())
    channel = writer.register_channel(topic, "json", schema_id)
    times = np.rint((shown.t - min(float(shown.t[0]), 0.0)) * _NS).astype(np.int64).tolist()
    for number, (time, message) in enumerate(zip(times, messages, strict=True)):
        if message:
            data = json.dumps(message, allow_nan=False).encode()
            writer.add_message(channel, time, data, time, sequence=number)


def _updates(track: MovingLine, colour: Colour) -> Iterator[dict[str, Any]]:
    """The moving line and, from the start, the path of its first point."""
    name = "/".join(track.path)
    entities = [_entity(f"{name}/path", float(track.t[0]), track.points[:, 0], colour)]
    for time_s, points in zip(track.t.tolist(), track.points, strict=True):
        yield {"deletions": [], "entities": [*entities, _entity(name, time_s, points, colour)]}
        entities = []


def _entity(name: str, time_s: float, points: Array, colour: Colour) -> dict[str, Any]:
    """A ``foxglove.SceneEntity``: a line strip, which replaces the earlier one of this name."""
    seconds, nanoseconds = divmod(round(max(time_s, 0.0) * _NS), _NS)
    origin = dict.fromkeys("xyz", 0.0)
    line = {
        "type": 0,  # a line strip
        "pose": {"position": origin, "orientation": {**origin, "w": 1.0}},
        "thickness": 4.0,
        "scale_invariant": True,
        "points": [dict(zip("xyz", point, strict=True)) for point in points.tolist()],
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
        **{kind: [line] if kind == "lines" else [] for kind in _PRIMITIVES},
    }
