"""Scenes, signals over time and lines that move in space, of recordings and results; their files.

Files are for the Rerun viewer (``.rrd``), and MCAP for Foxglove and Lichtblick.
"""

from __future__ import annotations

import io
import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.diagnose.result import Diagnosis, JointSeries
from sim2real.errors import library
from sim2real.output import write_whole
from sim2real.recording import POSE, Recording
from sim2real.robot import Robot
from sim2real.units import readable_name, unit_of
from sim2real.version import __version__

COMMAND, MEASURED, PREDICTED = "command", "measured", "predicted"
"""Names of signals; a command holds until the next one."""
_OTHER_UNITS = {"_A": "A", "_V": "V", "_C": "°C"}
"""Units of columns that no parameter has."""
TRACK_COLOURS = ((90, 160, 255), (255, 125, 92), (150, 150, 150))
"""Red, green and blue of successive tracks, 0 to 255."""
FRAME, TIMELINE = "world", "time"
_NS = 1_000_000_000
_PRIMITIVES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
_ARRAY = {"type": "array", "items": {"type": "object"}}
Colour = tuple[int, int, int]


@dataclass(frozen=True)
class SignalGroup:
    """Signals of one quantity on one time axis.

    Attributes:
        path: Where it belongs, outermost first: ``("steps", "j1", "position")``.
        unit: SI unit of all signals; empty for pure numbers.
        t: Times in s, shape (T,), increasing.
        signals: Values by name, each of shape (T,), NaN where missing. Signals without any value
            are left out.
    """

    path: tuple[str, ...]
    unit: str
    t: Array
    signals: Mapping[str, Array]

    def __post_init__(self) -> None:
        valued = {name: x for name, x in self.signals.items() if np.isfinite(x).any()}
        object.__setattr__(self, "signals", valued)


@dataclass(frozen=True)
class MovingLine:
    """A line that moves: the axis of a robot from its head to its tail.

    Attributes:
        path: Where it belongs, outermost first: ``("swim", "measured")``.
        t: Times in s, shape (T,), increasing.
        points: Ends and joints of its links in m, world frame, shape (T, L + 1, 3), finite.
    """

    path: tuple[str, ...]
    t: Array
    points: Array


@dataclass(frozen=True)
class Scene:
    """What a file for a viewer holds; ``a + b`` holds both, with the signals of equal paths merged.

    Attributes:
        groups: Signals over time.
        tracks: Lines that move in space.
    """

    groups: tuple[SignalGroup, ...] = ()
    tracks: tuple[MovingLine, ...] = ()

    def __add__(self, other: Scene) -> Scene:
        """Return the contents of both; times of equal paths must be equal."""
        groups = {group.path: group for group in self.groups}
        for group in other.groups:
            known = groups.get(group.path)
            if known is not None:
                if not np.array_equal(known.t, group.t):
                    raise ValueError(f"{'/'.join(group.path)}: two time axes")
                signals = {**known.signals, **group.signals}
                group = SignalGroup(known.path, known.unit, known.t, signals)
            groups[group.path] = group
        return Scene(tuple(groups.values()), self.tracks + other.tracks)


def recorded(recording: Recording, robot: Robot | None = None, name: str = MEASURED) -> Scene:
    """Commands, angles and all further columns of a recording.

    With its robot, a swim shows its axis in motion too. ``name`` is of signals other than commands.
    """
    groups = []
    for j, joint in enumerate(recording.joints):
        angles = {COMMAND: recording.command[:, j], name: recording.position[:, j]}
        groups.append(SignalGroup((recording.name, joint, "position"), "rad", recording.t, angles))
    groups += [_column(recording, column, name) for column in recording.columns]
    tracks = []
    if robot is not None and recording.has_poses:
        present, points = axis_points(recording, robot)
        tracks = [MovingLine((recording.name, "body", name), recording.t[present], points)]
    return Scene(tuple(groups), tuple(tracks))


def with_prediction(recording: Recording, joint: str, predicted: Array) -> Scene:
    """One joint of a recording with its predicted angles (T,) in rad and the residual."""
    return recorded(recording) + Scene(fit_groups(recording, joint, predicted))


def fit_groups(recording: Recording, joint: str, predicted: Array) -> tuple[SignalGroup, ...]:
    """Position and residual of one joint, of predicted angles (T,) in rad.

    Without a residual if nothing was measured.
    """
    j = recording.joints.index(joint)
    measured, place, t = recording.position[:, j], (recording.name, joint), recording.t
    angles = {COMMAND: recording.command[:, j], MEASURED: measured, PREDICTED: predicted}
    position = SignalGroup((*place, "position"), "rad", t, angles)
    residual = SignalGroup((*place, "residual"), "rad", t, {PREDICTED: measured - predicted})
    return (position, residual) if residual.signals else (position,)


def diagnosed(diagnosis: Diagnosis) -> Scene:
    """Angles, residuals and torques of every joint and recording that a diagnosis fitted.

    ``torque`` is what the plain servo lacks: smoothed, from the recording (``missing``), and from
    the enriched model's motion (``effects``), which the named effects account for.
    """
    groups = list[SignalGroup]()
    for series in diagnosis.evidence:
        place, t = (series.recording, series.joint), series.t
        unit = "N m/(kg m²)" if diagnosis.model.joints[series.joint].per_inertia else "N m"
        models = {"plain": series.baseline, "enriched": series.enriched}
        angles = {COMMAND: series.command, MEASURED: series.position, **models}
        torques = {"missing": series.torque, "effects": series.effects_torque}
        groups += [
            SignalGroup((*place, "position"), "rad", t, angles),
            residual_group(series),
            SignalGroup((*place, "torque"), unit, t, torques),
        ]
    return Scene(tuple(groups))


def residual_group(series: JointSeries) -> SignalGroup:
    """Measured minus simulated angle of the plain servo and of the enriched model."""
    models = {"plain": series.baseline, "enriched": series.enriched}
    residuals = {name: series.position - angle for name, angle in models.items()}
    return SignalGroup((series.recording, series.joint, "residual"), "rad", series.t, residuals)


def axis_points(recording: Recording, robot: Robot) -> tuple[Mask, Array]:
    """Ends and joints of a swimming robot's links, in the plane z = 0.

    The pose is that of the head's centre of mass; a joint's angle turns the link behind it.
    Returns the mask of the samples without a missing pose or angle, shape (T,), and the points of
    those, shape (samples, links + 1, 3).
    """
    columns = [recording.joints.index(joint.name) for joint in robot.joints]
    angles = recording.position[:, columns]
    x, y, yaw = (recording.columns[name] for name in POSE)
    present: Mask = np.isfinite(np.column_stack([x, y, yaw, angles]).sum(axis=1))
    heading = np.cumsum(np.column_stack([yaw, angles])[present], axis=1)
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    length = np.array([link.length_m for link in robot.links])
    head = robot.links[0]
    com = head.length_m / 2 if head.com_m is None else head.com_m
    front = np.stack([x, y], axis=-1)[present] + com * forward[:, 0]
    behind = -np.cumsum(length[:, None] * forward, axis=1)
    points = np.zeros((front.shape[0], len(robot.links) + 1, 3))
    points[:, 0, :2] = front
    points[:, 1:, :2] = front[:, None] + behind
    return present, points


def _column(recording: Recording, column: str, name: str) -> SignalGroup:
    """A further column, ``J.velocity_rad_s`` or ``supply_V``, as signals."""
    component, _, quantity = column.rpartition(".")
    ending = next((end for end in _OTHER_UNITS if quantity.endswith(end)), "")
    unit = _OTHER_UNITS[ending] if ending else unit_of(quantity)
    shown = readable_name(quantity.removesuffix(ending) if ending else quantity)
    path = (recording.name, *([component] if component else []), shown)
    return SignalGroup(path, unit, recording.t, {name: recording.columns[column]})


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
