"""Randomization ranges from recordings and a model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sim2real.display import NotebookDisplay, from_report
from sim2real.errors import InputError
from sim2real.identification.reading_noise import while_powered, with_reading_noise
from sim2real.inference.normal import LEVEL
from sim2real.model import Model
from sim2real.noise import ABOVE_NOISE
from sim2real.plausible import admitted
from sim2real.posterior.chain import require
from sim2real.posterior.servo import (
    STEPS,
    WALKERS,
    PredictiveCheck,
    ServoPosterior,
    predictive_check,
    sample_servo,
    servo_problem,
)
from sim2real.ranges.entry import Range, Ranges
from sim2real.ranges.latency import Latencies, latencies, latency_ranges
from sim2real.ranges.population import TypeParameter
from sim2real.ranges.sources import (
    body_ranges,
    camera_noise,
    density_ranges,
    from_model,
    from_posterior,
    joint_noise,
    labelled,
    listed,
    shared_ranges,
)
from sim2real.recording import Recording
from sim2real.robot import Density, Robot, match_recordings, normalised_density
from sim2real.servo.trace import at_one_gain, check_samples, split, traces

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Gathered(NotebookDisplay):
    """Ranges and the estimates that they are derived from.

    Attributes:
        ranges: The ranges.
        posteriors: Posterior of each sampled joint.
        checks: Posterior predictive check of each joint on the held-out recording, if there is one.
        latencies: Latency fitted to each recording or window, and their distribution; None if no
            joint moves.
        density: Normalised density of the links, if they state mass and length.
        population: Parameters of a type of servo, if the ranges are of one.
    """

    ranges: Ranges
    posteriors: Mapping[str, ServoPosterior] = field(default_factory=dict)
    checks: Mapping[str, PredictiveCheck] = field(default_factory=dict)
    latencies: Latencies | None = None
    density: Density | None = None
    population: tuple[TypeParameter, ...] = ()

    def plot(self) -> Figure:
        """Parameters by unit, latencies and their range, or else the normalised densities.

        Raises:
            InputError: If there is neither.
        """
        if self.latencies is not None:
            figure: Figure = from_report("ranges.latency_figure")(self.latencies)
        elif self.population:
            figure = from_report("ranges.population_figure")(self.population)
        elif self.density is not None:
            figure = self.density.plot()
        else:
            raise InputError("ranges", "plot", "no latencies and no masses", "one of them")
        return figure


@dataclass(frozen=True)
class Sampling:
    """Settings of the posterior sampling."""

    steps: int = STEPS  # of each chain
    walkers: int = WALKERS
    seed: int = 0
    held_out: str | None = None  # recording to check a fit to the others on; by default the last
    file: Callable[[str], Path | None] = lambda joint: None  # of a joint's chain; None: in memory
    progress: Callable[[str, int], None] = lambda joint, steps: None  # steps are completed ones
    level: float = LEVEL  # probability of the intervals of the posteriors


def gather(
    recordings: Sequence[Recording], robot: Robot, model: Model, sampling: Sampling | None = None
) -> Gathered:
    """Make ranges.

    Latency and noise are estimated from all recordings, gains and effects from posteriors of the
    bench recordings (``kind`` ``servo``), or else from the model.
    """
    sampling = sampling or Sampling()
    match_recordings(recordings, robot)
    for joint in model.joints:
        if robot.joint(joint) is None:
            names = ", ".join(known.name for known in robot.joints)
            raise InputError("model", f"joints.{joint}", "a joint not of the robot", names)
    recordings, warnings = admitted(at_one_gain(recordings, model.firmware_p_gain), robot)
    bench = [recording for recording in recordings if recording.kind == "servo"]
    posteriors, checks = sample_joints(bench, robot, model, sampling)
    fits = latencies(recordings, model)
    density = normalised_density(robot) if robot.weighed else None
    labels = labelled(recordings)
    entries = latency_ranges(fits, model)
    entries += camera_noise(recordings)
    noise = {joint: joint_noise(recordings, joint) for joint in model.joints}
    entries += [noise_range for noise_range in noise.values() if noise_range is not None]
    without_range: list[str] = []
    for joint, servo in model.joints.items():
        sampled: list[Range] = []
        if joint in posteriors:
            fitted = [labels[trace.file] for trace in posteriors[joint].problem.traces]
            sampled = from_posterior(joint, posteriors[joint], listed(fitted))
        existing = [entry.parameter for entry in sampled]
        stated, missing = from_model(joint, servo, model.interval_level, existing)
        entries += sampled + stated
        without_range += missing
    entries += density_ranges(density) if density is not None else []
    entries += body_ranges(model) + shared_ranges(model)
    notes = _notes(recordings, posteriors, checks, fits, noise)
    ranges = Ranges(
        tuple(entries), notes=(*warnings, *notes, *without_range), interval_level=sampling.level
    )
    return Gathered(ranges, posteriors, checks, fits, density)


def sample_joints(
    bench: Sequence[Recording], robot: Robot, model: Model, sampling: Sampling
) -> tuple[dict[str, ServoPosterior], dict[str, PredictiveCheck]]:
    """Posteriors of every joint that moves on the bench, and their predictive checks."""
    names = [recording.name for recording in bench]
    if sampling.held_out is not None and sampling.held_out not in names:
        expected = ", ".join(names) or "no bench recording"
        raise InputError("--held-out", "", repr(sampling.held_out), f"one of {expected}")
    posteriors, checks = {}, {}
    for number, (joint, servo) in enumerate(model.joints.items()):
        joint_traces = with_reading_noise(traces(bench, joint), slow=True)
        if not joint_traces:
            continue
        whole = servo_problem(joint_traces, servo)
        joint_traces = while_powered(whole.traces, whole.row)
        fitted, scored, _ = split(joint_traces, sampling.held_out)
        check_samples(fitted, joint)
        described = robot.joint(joint)
        sheet = None if described is None else described.servo
        posteriors[joint] = sample_servo(
            joint_traces,
            servo,
            sheet,
            seed=sampling.seed + number,
            steps=sampling.steps,
            walkers=sampling.walkers,
            file=sampling.file(joint),
            level=sampling.level,
            progress=partial(sampling.progress, joint),
        )
        if scored and scored[0].used.any():
            rng = np.random.default_rng([sampling.seed, number])
            checks[joint] = predictive_check(posteriors[joint], servo, fitted, scored[0], rng)
    chains = {joint: posterior.chain for joint, posterior in posteriors.items()}
    for joint in sorted(chains, key=lambda name: (chains[name].reached, -chains[name].needed)):
        require(chains[joint], f"posterior of {joint}", posteriors[joint].names)
    return posteriors, checks


def _notes(
    recordings: Sequence[Recording],
    posteriors: Mapping[str, ServoPosterior],
    checks: Mapping[str, PredictiveCheck],
    fits: Latencies | None,
    noise: Mapping[str, Range | None],
) -> tuple[str, ...]:
    """Notes on the limitations of these ranges."""
    notes = []
    missing = [joint for joint in noise if joint not in posteriors]
    if missing:
        notes.append(f"no bench recording moves {', '.join(missing)}: gains are those of the model")
    for joint, posterior in posteriors.items():
        if posterior.undetermined:
            names = ", ".join(posterior.undetermined)
            notes.append(
                f"{joint}: these recordings do not determine {names}: not sampled, the model's "
                "interval or value is its range"
            )
    for joint, check in checks.items():
        where, of_joint = f"{joint}: {check.recording}, held out,", noise[joint]
        if not check.holds:
            notes.append(
                f"{where} lies within the 95 % band of predictions only "
                f"{100 * check.covered[0.95]:.0f} % of the time: ranges are too narrow; diagnose "
                "first"
            )
        elif of_joint is not None and check.rmse > ABOVE_NOISE * of_joint.second:
            notes.append(
                f"{where} is off by {check.rmse / of_joint.second:.1f} times its noise: physics is "
                "missing from the model, and these ranges imitate it; diagnose first"
            )
    if fits is not None and fits.windows:
        notes.append(
            "latency was fitted to windows of few recordings: it may differ more between days"
        )
    if fits is not None and fits.dropped:
        notes.append(f"{fits.dropped} fits of latency were too uncertain and are not used")
    if fits is not None and posteriors and fits.spread.half_width_90[0] > 1e-3:
        notes.append(
            "latency varies between these recordings, but the gains were sampled with a constant "
            "latency: their ranges may be biased"
        )
    if not any(recording.has_poses for recording in recordings):
        notes.append("no camera columns: position and direction have no range")
    return tuple(notes)
