"""Scenes, signals over time and lines that move in space: of recordings and of results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.diagnose.result import Diagnosis, JointSeries
from sim2real.recording import POSE, Recording
from sim2real.robot import Robot
from sim2real.units import readable_name, unit_of

COMMAND, MEASURED, PREDICTED = "command", "measured", "predicted"
"""Names of signals; a command holds until the next one."""
_OTHER_UNITS = {"_A": "A", "_V": "V", "_C": "°C"}
"""Units of columns that no parameter has."""


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
