"""Latency of recordings, its distribution, and its causes as far as recordings show them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.special import ndtr

from sim2real.arrays import Array
from sim2real.display import NotebookDisplay, from_report
from sim2real.identification.priors import gains, scale_inertia
from sim2real.identification.problem import ServoProblem
from sim2real.identification.search import fit
from sim2real.inference.correlated_noise import correlation_samples
from sim2real.inference.least_squares import OUTLIER_SD
from sim2real.inference.variance_components import grid_quantiles
from sim2real.model import JointModel, Model
from sim2real.noise import quantization_step
from sim2real.posterior.servo import loaded
from sim2real.ranges.entry import Range, Ranges, normal, uniform
from sim2real.ranges.sources import labelled
from sim2real.recording import Recording
from sim2real.robot import Joint, Robot, Servo
from sim2real.servo.parameters import joint_row
from sim2real.servo.trace import Trace, context_of, traces

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LAW_SD_S = 2e-4
"""Smallest standard deviation of a latency, due to errors of the servo's law."""


def episode_latencies(traces: Sequence[Trace], joint: JointModel) -> tuple[Array, Array]:
    """Latency of each trace of a joint and its standard deviation in s, each of shape (N,).

    Latency and damping are not distinguishable in the response to a sine. Gains are therefore
    shared by the traces and fitted together with one latency per trace, in three rounds: a fit of
    gains and a common latency, and a Gauss-Newton step of all. The standard deviation includes the
    gains of one episode about the shared ones, by 2 %. A prior of 50 ms about the common latency
    keeps that of a trace that hardly moves. The search starts from the joint's model, whose effects
    are fixed.
    """
    row = joint_row(joint, traces[0].load)
    own = np.zeros(len(traces))  # latency of each beyond the common one
    for _ in range(3):
        shifted = [
            replace(trace, sample_delay_s=trace.sample_delay_s - later)
            for trace, later in zip(traces, own, strict=True)
        ]
        problem = ServoProblem(shifted, row, gains(scale_inertia(traces, row)))
        best = fit(problem, row[None], rounds=2)
        row, unit = best.row, problem.unit
        loose = np.append(unit[:2] / 0.02, unit[2] / 0.05) ** 2
        normal = np.diag([0.0, 0.0, *np.full(own.size, loose[2])])
        slope = np.array([0.0, 0.0, *own / unit[2] * loose[2]])
        sd = np.empty(own.size)
        parts = zip(best.residuals, problem.by_trace(best.slopes), strict=True)
        for k, (error, slopes) in enumerate(parts):
            weight = 1 / (1 + (error / (OUTLIER_SD * best.scale_rad)) ** 2) ** 0.5
            weight /= best.scale_rad**2 * correlation_samples(error)
            curvature = slopes.T @ (slopes * weight[:, None])
            place = [0, 1, 2 + k]
            normal[np.ix_(place, place)] += curvature
            slope[place] += slopes.T @ (weight * error)
            sd[k] = np.linalg.inv(curvature + np.diag(loose))[2, 2] ** 0.5 * unit[2]
        own -= np.linalg.lstsq(normal, slope)[0][2:] * unit[2]
    return float(row[2]) + own, sd


@dataclass(frozen=True)
class Spread:
    """Estimate of the uniform distribution of latencies."""

    centre: float  # centre in s
    half_width: float  # half-width in s
    half_width_90: tuple[float, float]  # 90 % interval of the half-width in s


def spread(seconds: Array, sd: Array, *, smallest_s: float = 1e-4) -> Spread:
    """Posterior of uniformly distributed latencies with errors ``sd``, in s, shape (E,) both.

    Medians of centre and half-width, above ``smallest_s``, under a prior that is flat in the centre
    and in the logarithm of the half-width.
    """
    reach = float(np.ptp(seconds)) + 3 * float(np.median(sd)) + 10 * smallest_s
    half = np.geomspace(smallest_s, 3 * reach, 160)
    middle = 0.5 * float(seconds.max() + seconds.min())
    centre = middle + np.linspace(-1.0, 1.0, 201) * reach
    log_density = np.zeros((half.size, centre.size))  # the prior is uniform on the grid
    for value, error in zip(seconds, np.maximum(sd, _LAW_SD_S), strict=True):
        above = ndtr((centre[None] + half[:, None] - value) / error)
        below = ndtr((centre[None] - half[:, None] - value) / error)
        log_density += np.log(np.maximum(above - below, 1e-300)) - np.log(2 * half[:, None])
    weight = np.exp(log_density - log_density.max())
    low, median, high = grid_quantiles(half, weight.sum(axis=1))
    _, best, _ = grid_quantiles(centre, weight.sum(axis=0))
    return Spread(best, median, (low, high))


@dataclass(frozen=True)
class Latencies:
    """Latency of the commands of each episode."""

    episodes: Sequence[str]  # description of each episode: a recording, or a window of one
    seconds: Array  # latency that all joints share in s, shape (E,)
    sd: Array  # its standard deviations in s, shape (E,)
    # deviation of each joint in s, and its standard deviation
    offset: Mapping[str, tuple[float, float]]
    windows: bool  # whether episodes are windows
    dropped: int  # number of fits that were too uncertain to be used
    spread: Spread  # distribution of the latencies


def latencies(
    recordings: Sequence[Recording], model: Model, *, enough: int = 5, largest_sd_s: float = 0.01
) -> Latencies | None:
    """Fit the latency of every episode; None where no joint of the model moves.

    Gains are shared by all episodes of a joint with the same load and medium. Below ``enough``
    recordings windows of them count as episodes. Latencies with a standard deviation above
    ``largest_sd_s`` are not used.
    """
    labels = labelled(recordings)
    episodes = [
        (recording, labels[recording.file], joint, loaded(trace, model.joints[joint]))
        for recording in recordings
        for joint in model.joints
        for trace in traces([recording], joint)
    ]
    windows = len({name for _, name, _, _ in episodes}) < enough
    if windows:
        episodes = [
            (r, n, j, part) for r, name, j, trace in episodes for n, part in _windows(name, trace)
        ]
    if not episodes:
        return None
    conditions = [(joint, r.kind, r.medium, trace.load) for r, _, joint, trace in episodes]
    value, sd = np.empty(len(episodes)), np.empty(len(episodes))
    for condition in set(conditions):
        alike = [k for k, one in enumerate(conditions) if one == condition]
        of_joint = model.joints[condition[0]]
        value[alike], sd[alike] = episode_latencies([episodes[k][3] for k in alike], of_joint)
    used = sd < largest_sd_s
    if not used.any():
        return None
    kept = [(n, j) for (_, n, j, _), good in zip(episodes, used, strict=True) if good]
    return _combined(kept, value[used], sd[used], windows, int(np.sum(~used)))


def _windows(name: str, whole: Trace, *, length_s: float = 6.0) -> list[tuple[str, Trace]]:
    """Windows of one recording, simulated from its start but scored separately."""
    windows = []
    for start in np.arange(whole.t[0], whole.t[-1], length_s):
        within = (whole.t >= start) & (whole.t < start + length_s)
        inside = whole.used & within
        if inside.sum() >= 100 and np.ptp(whole.command[within]) > 0:
            windows.append((f"{name} from {start:.0f} s", replace(whole, used=inside)))
    return windows


def _combined(
    kept: Sequence[tuple[str, str]], value: Array, sd: Array, windows: bool, dropped: int
) -> Latencies:
    """Split latencies into a part common to an episode's joints and one for each, of sum 0.

    Weighted least squares; errors are increased to match the residual, if that is larger.
    """
    episodes = list(dict.fromkeys(name for name, _ in kept))
    joints = list(dict.fromkeys(joint for _, joint in kept))
    E, J = len(episodes), len(joints)
    design = np.zeros((len(kept), E + J))
    for k, (name, joint) in enumerate(kept):
        design[k, episodes.index(name)] = 1.0
        design[k, E + joints.index(joint)] = 1.0
    weight = 1 / np.maximum(sd, _LAW_SD_S)
    tie = np.concatenate([np.zeros(E), np.full(J, weight.max() * 1e3)])
    matrix = np.vstack([design * weight[:, None], tie])
    target = np.append(value * weight, 0.0)
    covariance = np.linalg.pinv(matrix.T @ matrix)
    answer = covariance @ matrix.T @ target
    freedom = len(kept) - E - J + 1
    residual = float(np.sum((matrix @ answer - target) ** 2))
    inflated = np.sqrt(np.diag(covariance) * max(residual / freedom if freedom > 0 else 1.0, 1.0))
    offset = {j: (float(answer[E + k]), float(inflated[E + k])) for k, j in enumerate(joints)}
    common, sd = answer[:E], inflated[:E]
    return Latencies(episodes, common, sd, offset, windows, dropped, spread(common, sd))


def latency_ranges(fits: Latencies | None, model: Model, *, clear_sd: float = 3.0) -> list[Range]:
    """The latency of all joints, and offsets of single joints if one is ``clear_sd`` from 0."""
    if fits is None:
        ends = [
            joint.interval.get("latency_s", (joint.latency_s,) * 2)
            for joint in model.joints.values()
        ]
        values = [x for pair in ends for x in pair if np.isfinite(x)]
        values += [joint.latency_s for joint in model.joints.values()]
        source = "the model: intervals of all joints; no recording shows a latency"
        return [uniform("command_latency_s", min(values), max(values), "s", source)]
    centre, half_width = fits.spread.centre, fits.spread.half_width
    low, high = max(centre - half_width, 0.0), centre + half_width
    what = "windows" if fits.windows else "recordings"
    ends_ms = " to ".join(f"{1e3 * end:.2g}" for end in fits.spread.half_width_90)
    source = (
        f"latency fitted to each of {len(fits.episodes)} {what}: medians of the posterior of the "
        f"uniform distribution behind them; 90 % interval of its half-width {ends_ms} ms"
    )
    out = [uniform("command_latency_s", low, high, "s", source)]
    if any(abs(value) > clear_sd * sd for value, sd in fits.offset.values()):
        source = f"the same {what}: mean of the joint less that of all, and its standard error"
        out += [
            normal(f"{joint}.latency_offset_s", value, sd, "s", source)
            for joint, (value, sd) in fits.offset.items()
        ]
    return out


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

    The law shows the time from a set-point to its effect on the angles that are read, of which the
    range contains those of all models: of a system that does not change with time, set-points and
    angles show only this sum. What recordings have besides (round trips on the bus, when angles are
    sampled, clocks, times of set-points) splits it further, and adds what happens before a
    set-point is sent.
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
    causes = (*_before(recordings), fitted, _sensor(recordings))
    entries = [replace(command[0], first=low, second=high, source=source), *command[1:]]
    entries += [
        uniform(f"{cause.name}_latency_s", cause.low_s, cause.high_s, "s", cause.source, "step")
        for cause in causes
        if cause is not fitted and np.isfinite(cause.median_s)
    ]
    return LatencySplit(causes, Ranges(entries, provenance=origin), by_joint, models[0])


def _cause(name: str, values: Sequence[Array], source: str, otherwise: str) -> Cause:
    """A cause by its values at every step; not seen, for the reason ``otherwise``, without any."""
    all_values = np.concatenate([np.zeros(0), *values])
    seen = all_values[np.isfinite(all_values)]
    if not seen.size:
        return Cause(name, np.nan, np.nan, np.nan, otherwise)
    low, median, high = (float(x) for x in np.quantile(seen, (0.05, 0.5, 0.95)))
    return Cause(name, median, max(low, 0.0), high, f"{source}, {seen.size} values")


def _before(recordings: Sequence[Recording]) -> tuple[Cause, Cause, Cause]:
    """Inference, observation and bus."""

    def column(name: str) -> list[Array]:
        return [one.columns[name] for one in recordings if name in one.columns]

    why = "not recorded: less than a period, if the loop keeps its rate"
    inference = _cause("inference", column("inference_s"), "column inference_s", why)
    if np.isnan(inference.median_s):
        period = max(1 / one.rate_hz for one in recordings)
        inference = Cause("inference", 0.5 * period, 0.0, period, why)
    swims = [one for one in recordings if one.kind == "pool" and "device_t_s" in one.columns]
    delays = [_beyond_shortest(one.t, one.columns["device_t_s"]) for one in swims]
    source = "arrival by the robot's clock, beyond the shortest"
    if not any(np.isfinite(x).any() for x in delays):
        source = "age of the newest angles when a set-point is sent"
        delays = [_ages(one) for one in recordings]
    why = "within inference: angles and set-points share their times"
    observation = _cause("observation", delays, source, why)
    why = "within command: round trips are not recorded"
    return (
        inference,
        observation,
        _cause("bus", column("round_trip_s"), "round trips on the bus", why),
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


def _sensor(recordings: Sequence[Recording]) -> Cause:
    """When angles are sampled after set-points arrive, and how old those that repeat are."""
    known = [context_of(one)["sample_delay_s"] for one in recordings]
    held = [age for one in recordings for age in _held(one)]
    if not any(known) and not any(held):
        return _cause("sensor", (), "", "within command: set-points and angles show only the sum")
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
