"""Scenes as files of the Rerun viewer (``.rrd``)."""

from __future__ import annotations

import os
import tempfile
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.errors import library
from sim2real.output import write_whole
from sim2real.viewers.signal_group import (
    COMMAND,
    TRACK_COLOURS,
    MovingLine,
    Scene,
    SignalGroup,
)

TIMELINE = "time"


def rerun_library() -> Any:  # noqa: ANN401 - a module
    """The library that writes the file.

    Raises:
        InputError: If it is not installed.
    """
    return library("rerun", "--rerun")


def write_rerun(scene: Scene, path: str | os.PathLike[str]) -> Path:
    """Write a scene, with a layout of one plot per group and one view of the moving lines.

    Every signal is an entity ``/RECORDING/JOINT/QUANTITY/SIGNAL`` of scalars on the timeline
    ``time``; a missing sample is NaN, which the viewer shows as a gap.

    Raises:
        InputError: If the file cannot be written, or Rerun is not installed.
    """
    rr = rerun_library()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.rrd"
        # A stream of its own: the caller may use Rerun's global one.
        stream = rr.RecordingStream("sim2real", recording_id=Path(path).stem)
        stream.save(file, default_blueprint=_layout(rr, scene))
        for group in scene.groups:
            _write_channel(rr, stream, group)
        for track, colour in zip(scene.tracks, cycle(TRACK_COLOURS), strict=False):
            _write_track(rr, stream, track, colour)
        stream.flush()
        stream.disconnect()
        return write_whole(path, file.read_bytes())


def _write_channel(rr: Any, stream: Any, group: SignalGroup) -> None:  # noqa: ANN401 - Rerun
    times = [rr.TimeColumn(TIMELINE, duration=group.t)]
    for name, values in group.signals.items():
        entity = rr.new_entity_path([*group.path, name])
        label = f"{name}, {group.unit}" if group.unit else name
        held = "StepAfter" if name == COMMAND else None
        stream.log(entity, rr.SeriesLines(names=label, interpolation_mode=held), static=True)
        stream.send_columns(entity, indexes=times, columns=rr.Scalars.columns(scalars=values))


def _write_track(
    rr: Any,  # noqa: ANN401 - Rerun
    stream: Any,  # noqa: ANN401
    track: MovingLine,
    colour: tuple[int, int, int],
) -> None:
    """The moving line and, from the start, the path of its first point."""
    entity, path = (rr.new_entity_path([*track.path, *more]) for more in ((), ("path",)))
    stream.log(entity, rr.LineStrips3D.from_fields(colors=[colour]), static=True)
    stream.log(path, rr.LineStrips3D([track.points[:, 0]], colors=[colour]), static=True)
    strips = rr.LineStrips3D.columns(strips=list(track.points.astype(np.float32)))
    times = [rr.TimeColumn(TIMELINE, duration=track.t)]
    stream.send_columns(entity, indexes=times, columns=strips)


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
    space = []
    if contents:
        above = _from_above(layout, scene)
        space = [layout.Spatial3DView(contents=contents, name="motion", eye_controls=above)]
    shown: list[Any] = [*space, *([layout.Tabs(*series)] if series else [])]
    return layout.Blueprint(layout.Horizontal(*shown), collapse_panels=True)


def _from_above(layout: Any, scene: Scene) -> Any:  # noqa: ANN401 - Rerun
    """An eye above the middle of all tracks, high enough to see them; x to the right, y up."""
    points = np.concatenate([track.points.reshape(-1, 3) for track in scene.tracks])
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2
    height = 1.5 * float(np.linalg.norm(high - low)) or 1.0
    return layout.EyeControls3D(
        position=middle + [0.0, 0.0, height], look_target=middle, eye_up=(0.0, 1.0, 0.0)
    )
