"""Randomization ranges from recordings and a model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sim2real.density import Density, normalised_density
from sim2real.display import NotebookDisplay, from_report
from sim2real.errors import InputError
from sim2real.identification.advice import ABOVE_NOISE
from sim2real.model import Model
from sim2real.plausible import validate_recording
from sim2real.posterior.convergence import require
from sim2real.posterior.predictive_check import PredictiveCheck, predictive_check
from sim2real.posterior.servo import STEPS, WALKERS, ServoPosterior, sample_servo
from sim2real.ranges.entry import Range, Ranges, normal, uniform
from sim2real.ranges.episodes import labelled, listed
from sim2real.ranges.latency import Latencies, Spread, latencies, spread
from sim2real.ranges.sources import (
    body_ranges,
    camera_noise,
    density_ranges,
    from_model,
    from_posterior,
    joint_noise,
    shared_ranges,
)
from sim2real.recording import Recording
from sim2real.robot import Robot, match_recordings
from sim2real.servo.trace import check_runs, split, traces

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CLEAR = 3.0
"""Standard deviations above which an offset between joints, or a spread, is significant."""


@dataclass(frozen=True)
class Gathered(NotebookDisplay):
    """Ranges and the estimates that they are derived from.

    Attributes:
        ranges: The ranges.
        posteriors: Posterior of each sampled joint.
        checks: Posterior predictive check of each joint on the held-out recording, if there is one.
        latencies: Latency fitted to each recording or window; None if no joint moves.
        spread: Distribution of the latencies; None if no joint moves.
        density: Normalised density of the links, if they state mass and length.
    """

    ranges: Ranges
    posteriors: Mapping[str, ServoPosterior]
    checks: Mapping[str, PredictiveCheck]
    latencies: Latencies | None
    spread: Spread | None
    density: Density | None

    def __str__(self) -> str:
        """One line per range, and notes."""
        return str(self.ranges)

    def plot(self) -> Figure:
        """Latencies and their range, or else the normalised densities.

        Raises:
            InputError: If there is neither.
        """
        if self.latencies is not None and self.spread is not None:
            figure: Figure = from_report("range_plots.latency_figure")(self.latencies, self.spread)
            return figure
        if self.density is None:
            raise InputError("ranges", "plot", "no latencies and no masses", "one of them")
        return self.density.plot()


@dataclass(frozen=True)
class Sampling:
    """Settings of the posterior sampling.

    Attributes:
        steps, walkers: Steps and walkers of each chain.
        seed: Seed of the random numbers.
        held_out: Name of the recording to check on and not to sample; by default the last one.
        file: Function from a joint to the file of its chain; None keeps the chain in memory.
        progress: Called with a joint and the number of completed steps.
    """

    steps: int = STEPS
    walkers: int = WALKERS
    seed: int = 0
    held_out: str | None = None
    file: Callable[[str], Path | None] = lambda joint: None
    progress: Callable[[str, int], None] = lambda joint, steps: None


def gather(
    recordings: Sequence[Recording], robot: Robot, model: Model, sampling: Sampling | None = None
) -> Gathered:
    """Make ranges.

    Latency and noise come from all recordings. Gains and effects come from posteriors of bench
    recordings (``kind`` ``servo``), the one held out left aside; without any, from the model.

    Args:
        recordings: Bench and pool recordings.
        robot: The robot.
        model: Its fitted servos, and its body where that was calibrated.
        sampling: How posteriors are sampled.

    Raises:
        InputError: If recordings, robot and model do not agree, or a chain has not converged.
    """
    sampling = sampling or Sampling()
    _check(recordings, robot, model)
    bench = [recording for recording in recordings if recording.kind == "servo"]
    posteriors, checks = sample_joints(bench, model, sampling)
    found = latencies(recordings, model)
    drawn = spread(found.seconds, found.sd) if found is not None else None
    density = normalised_density(robot) if robot.weighed else None
    labels = labelled(recordings)
    entries = _latency_ranges(found, drawn, model)
    entries += camera_noise(recordings)
    noises = [joint_noise(recordings, joint) for joint in model.joints]
    entries += [noise for noise in noises if noise is not None]
    for joint, one in model.joints.items():
        mine: list[Range] = []
        if joint in posteriors:
            fitted = [labels[one.file] for one in posteriors[joint].data.traces]
            mine = from_posterior(joint, posteriors[joint], listed(fitted))
        entries += mine + from_model(joint, one, [entry.parameter for entry in mine])
    entries += density_ranges(density) if density is not None else []
    entries += body_ranges(model) + shared_ranges(model)
    notes = _notes(recordings, model, posteriors, checks, found, drawn)
    return Gathered(Ranges(tuple(entries), notes=notes), posteriors, checks, found, drawn, density)


def _check(recordings: Sequence[Recording], robot: Robot, model: Model) -> None:
    match_recordings(recordings, robot)
    for recording in recordings:
        validate_recording(recording, robot)
    for joint in model.joints:
        if robot.joint(joint) is None:
            known = ", ".join(one.name for one in robot.joints)
            raise InputError("model", f"joints.{joint}", "a joint not of the robot", known)


def sample_joints(
    bench: Sequence[Recording], model: Model, sampling: Sampling
) -> tuple[dict[str, ServoPosterior], dict[str, PredictiveCheck]]:
    """Posteriors of every joint that moves on the bench, and what they predict of what they miss.

    Raises:
        InputError: If a chain has not converged, or no recording has the name held out.
    """
    names = [recording.name for recording in bench]
    if sampling.held_out is not None and sampling.held_out not in names:
        known = ", ".join(names) or "no bench recording"
        raise InputError("--held-out", "", repr(sampling.held_out), f"one of {known}")
    posteriors, checks = {}, {}
    for number, (joint, one) in enumerate(model.joints.items()):
        given = traces(bench, joint)
        if not given:
            continue
        fitted, scored, _ = split(given, sampling.held_out)
        check_runs(fitted, joint)
        posteriors[joint] = sample_servo(
            fitted,
            one,
            seed=sampling.seed + number,
            steps=sampling.steps,
            walkers=sampling.walkers,
            file=sampling.file(joint),
            progress=lambda steps, joint=joint: sampling.progress(joint, steps),  # type: ignore[misc]
        )
        if scored and scored[0].used.any():
            rng = np.random.default_rng([sampling.seed, number])
            checks[joint] = predictive_check(posteriors[joint], one, scored[0], rng)
    for joint, found in posteriors.items():
        require(found.convergence, f"posterior of {joint}", found.names)
    return posteriors, checks


def _latency_ranges(found: Latencies | None, drawn: Spread | None, model: Model) -> list[Range]:
    """The latency of all joints, and what each has beyond it where joints clearly differ."""
    if found is None or drawn is None:
        ends = [
            joint.interval.get("latency_s", (joint.latency_s,) * 2)
            for joint in model.joints.values()
        ]
        values = [x for pair in ends for x in pair if np.isfinite(x)]
        values += [joint.latency_s for joint in model.joints.values()]
        source = "the model: 90 % intervals of all joints; no recording shows a latency"
        return [uniform("command_latency_s", min(values), max(values), "s", source)]
    low, high = max(drawn.centre - drawn.half_width, 0.0), drawn.centre + drawn.half_width
    what = "windows" if found.windows else "recordings"
    ends_ms = " to ".join(f"{1e3 * end:.2g}" for end in drawn.half_width_90)
    source = (
        f"latency fitted to each of {len(found.episodes)} {what}: medians of the posterior of the "
        f"uniform distribution behind them; 90 % interval of its half-width {ends_ms} ms"
    )
    out = [uniform("command_latency_s", low, high, "s", source)]
    if any(abs(value) > _CLEAR * sd for value, sd in found.offset.values()):
        source = f"the same {what}: mean of the joint less that of all, and its standard error"
        out += [
            normal(f"{joint}.latency_offset_s", value, sd, "s", source)
            for joint, (value, sd) in found.offset.items()
        ]
    return out


def _on_check(joint: str, check: PredictiveCheck, noise: Range | None) -> list[str]:
    """What the recording held out says against the ranges of a joint."""
    where = f"{joint}: {check.recording}, held out,"
    if not check.holds:
        share = 100 * check.covered[0.95]
        return [
            f"{where} lies within the 95 % band of predictions only {share:.0f} % of the time: "
            "ranges are too narrow; diagnose first"
        ]
    if noise is not None and check.rmse > ABOVE_NOISE * noise.second:
        times = check.rmse / noise.second
        return [
            f"{where} is off by {times:.1f} times its noise: physics is missing from the model, "
            "and these ranges imitate it; diagnose first"
        ]
    return []


def _notes(
    recordings: Sequence[Recording],
    model: Model,
    posteriors: Mapping[str, ServoPosterior],
    checks: Mapping[str, PredictiveCheck],
    found: Latencies | None,
    drawn: Spread | None,
) -> tuple[str, ...]:
    """What a user must know of these ranges."""
    notes = []
    missing = [joint for joint in model.joints if joint not in posteriors]
    if missing:
        notes.append(f"no bench recording moves {', '.join(missing)}: gains are those of the model")
    for joint, check in checks.items():
        notes += _on_check(joint, check, joint_noise(recordings, joint))
    if found is not None and found.windows:
        notes.append(
            "latency is known by windows of few recordings: it may differ more between days"
        )
    if found is not None and found.dropped:
        notes.append(f"{found.dropped} fits of latency were too unsure to count")
    if drawn is not None and posteriors and drawn.half_width_90[0] > 1e-3:
        notes.append(
            "latency varies within these recordings, and the gains were sampled with one of it: "
            "their ranges may be off"
        )
    if not any(recording.has_poses for recording in recordings):
        notes.append("no camera columns: position and direction have no range")
    return tuple(notes)
