"""Latency split by its causes, as far as recordings show them, with a range for each.

The servo's law shows the time from a set-point to its effect on the angles that are read: of a
system that does not change with time, set-points and angles show only this sum. What the recordings
have besides (round trips on the bus, when angles are sampled, clocks, times of set-points) splits
it further, and adds what happens before a set-point is sent.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sim2real.arrays import Array
from sim2real.display import NotebookDisplay, from_report
from sim2real.model import Model
from sim2real.noise import quantization_step
from sim2real.ranges.entry import Ranges, uniform
from sim2real.ranges.gather import latency_ranges
from sim2real.ranges.latency import latencies
from sim2real.recording import Recording
from sim2real.robot import Joint, Robot, Servo
from sim2real.servo.trace import context_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Cause(NamedTuple):
    """Latency by one cause in s: median and 90 % interval, NaN where it is not seen."""

    name: str
    median_s: float
    low_s: float
    high_s: float
    source: str


@dataclass(frozen=True)
class LatencySplit(NotebookDisplay):
    """Latency of a robot by its causes, and randomization ranges of it.

    ``causes`` are ``inference`` (from a measurement's arrival to the set-points that answer it),
    ``observation`` (age of a measurement when it is used), ``bus``, ``command`` (from a set-point
    to its effect, with what is not seen apart) and ``sensor``.
    """

    causes: tuple[Cause, ...]
    ranges: Ranges
    by_joint_s: Mapping[str, float]  # latency of the command of each joint
    model: Model  # the servos that it was fitted with

    def plot(self) -> Figure:
        """Median and interval of each cause that is seen."""
        figure: Figure = from_report("ranges.latency_split_figure")(self.causes)
        return figure


def unknown_robot(recordings: Sequence[Recording]) -> Robot:
    """A robot with the joints of recordings and no data sheets."""
    names = dict.fromkeys(joint for one in recordings for joint in one.joints)
    return Robot("robot", (), tuple(Joint(name, Servo("servo")) for name in names))


def split_latency(
    recordings: Sequence[Recording], models: Sequence[Model], origin: Mapping[str, Any]
) -> LatencySplit:
    """Split the latency that recordings and models fitted to them show; ``origin``: provenance.

    The range of the command's latency contains those of all models.
    """
    fits = [latencies(recordings, one) for one in models]
    found = [*map(latency_ranges, fits, models)]
    command = found[0]
    by_joint = {joint: one.latency_s for joint, one in models[0].joints.items()}
    if fits[0] is not None:
        by_joint = {j: fits[0].spread.centre + later for j, (later, _) in fits[0].offset.items()}
    low, high = min(one[0].first for one in found), max(one[0].second for one in found)
    source = command[0].source + "; the range contains that of a linear servo" * (len(found) > 1)
    why = "fitted to set-points and angles: their sum, but for what is seen apart"
    fitted = Cause("command", 0.5 * (low + high), low, high, why)
    before = _inference(recordings), _observation(recordings), _bus(recordings)
    causes = (*before, fitted, _sensor(recordings))
    entries = [replace(command[0], first=low, second=high, source=source), *command[1:]]
    entries += [
        uniform(f"{cause.name}_latency_s", cause.low_s, cause.high_s, "s", cause.source, "step")
        for cause in causes
        if cause is not fitted and np.isfinite(cause.median_s)
    ]
    return LatencySplit(causes, Ranges(entries, provenance=origin), by_joint, models[0])


def _of(name: str, values: Sequence[Array], source: str) -> Cause | None:
    """A cause by its values at every step; None if there are none."""
    all_values = np.concatenate([np.zeros(0), *values])
    seen = all_values[np.isfinite(all_values)]
    if not seen.size:
        return None
    low, median, high = (float(x) for x in np.quantile(seen, (0.05, 0.5, 0.95)))
    return Cause(name, median, max(low, 0.0), high, f"{source}, {seen.size} values")


def _column(recordings: Sequence[Recording], name: str) -> list[Array]:
    """A column of the recordings that have it."""
    return [one.columns[name] for one in recordings if name in one.columns]


def _unseen(name: str, why: str) -> Cause:
    """A cause that the recordings do not show."""
    return Cause(name, float("nan"), float("nan"), float("nan"), why)


def _inference(recordings: Sequence[Recording]) -> Cause:
    """From the column of a swim; otherwise a loop that keeps its rate takes a period at most."""
    if seen := _of("inference", _column(recordings, "inference_s"), "column inference_s"):
        return seen
    period = max(1 / one.rate_hz for one in recordings)
    why = "not recorded: less than a period, if the loop keeps its rate"
    return Cause("inference", 0.5 * period, 0.0, period, why)


def _observation(recordings: Sequence[Recording]) -> Cause:
    """Age of the newest measurement when set-points are sent, or its varying way over a link."""
    swims = [one for one in recordings if one.kind == "pool" and "device_t_s" in one.columns]
    late = [_beyond_shortest(one.t, one.columns["device_t_s"]) for one in swims]
    source = "arrival by the robot's clock, beyond the shortest"
    ages = [age for one in recordings if (age := _ages(one)).size]
    return (
        _of("observation", late, source)
        or _of("observation", ages, "age of the newest angles when a set-point is sent")
        or _unseen("observation", "within inference: angles and set-points share their times")
    )


def _beyond_shortest(t: Array, device_t: Array, parts: int = 8) -> Array:
    """Delays (T,) in s beyond the shortest, of clocks whose difference drifts evenly."""
    late = t - device_t
    blocks = [b for b in np.array_split(np.flatnonzero(np.isfinite(late)), parts) if b.size]
    shortest = [int(b[np.argmin(late[b])]) for b in blocks]
    if len(shortest) > 1:
        late = late - np.polyval(np.polyfit(t[shortest], late[shortest], 1), t)
    return np.asarray(late - np.nanmin(late))


def _ages(recording: Recording, fewest: int = 5) -> Array:
    """Ages in s of the newest angles at set-points in rows of their own."""
    measured = np.isfinite(recording.position).any(axis=1)
    changed = np.r_[False, (np.diff(recording.command, axis=0) != 0).any(axis=1)]
    alone = np.flatnonzero(changed & ~measured)
    if alone.size < max(fewest, 0.5 * changed.sum()):
        return np.zeros(0)
    before = np.maximum.accumulate(np.where(measured, recording.t, -np.inf))[alone]
    return np.asarray((recording.t[alone] - before)[np.isfinite(before)])


def _bus(recordings: Sequence[Recording]) -> Cause:
    """Round trips, which ``record`` measures."""
    found = _of("bus", _column(recordings, "round_trip_s"), "round trips on the bus")
    return found or _unseen("bus", "within command: round trips are not recorded")


def _sensor(recordings: Sequence[Recording]) -> Cause:
    """When angles are sampled after set-points arrive, and how old those that repeat are."""
    known = [context_of(one)["sample_delay_s"] for one in recordings]
    held = [age for one in recordings for age in _held(one)]
    if not any(known) and not any(held):
        return _unseen("sensor", "within command: set-points and angles show only the sum")
    low, high = min(known), max(known) + max(held, default=0.0)
    why = "sampling after the arrival of set-points" if any(known) else "angles that repeat"
    return Cause("sensor", 0.5 * (low + high), low, high, why)


def _held(recording: Recording) -> Iterator[float]:
    """By joint, the age in s that 95 % of angles do not exceed where they repeat in a fast motion.

    Fast is a change by five steps of the sensor before and after the repetition, to the same side.
    """
    for angle in recording.position.T:
        change = np.diff(angle[np.isfinite(angle)])
        new = np.flatnonzero(change)
        size = change[new] / max(5 * quantization_step(angle), 1e-12)
        fast = (np.minimum(np.abs(size[:-1]), np.abs(size[1:])) > 1) & (size[:-1] * size[1:] > 0)
        steps = np.diff(new)[fast]
        if steps.size:
            yield float(np.quantile(steps, 0.95) - 1) / recording.rate_hz
