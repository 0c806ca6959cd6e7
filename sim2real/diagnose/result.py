"""What a diagnosis says, as values and as ``diagnosis.json``."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from sim2real.arrays import Array
from sim2real.diagnose.rival_sets import SCHEMA, JointRivals
from sim2real.diagnose.separation import Separation
from sim2real.diagnose.swim_rivals import SwimRivals
from sim2real.display import NotebookDisplay, from_report
from sim2real.model import Model
from sim2real.noise import ABOVE_NOISE
from sim2real.output import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DESIGN = "sim2real design --robot robot.toml --diagnosis diagnosis.json --out next.csv"
Verdict = Literal[
    "consistent", "unchanged", "explained", "ambiguous", "partly_explained", "unexplained"
]


@dataclass(frozen=True)
class Mismatch:
    """Where simulation and recording differ by more than noise.

    Attributes:
        signal: The measured signal, ``"j2.position_rad"``.
        component: The part that the mismatch belongs to: a joint, ``supply`` or ``link``.
        rmse: Root mean square error of the plain servo on held-out data, rad.
        noise: Standard deviation of the measurement noise, rad.
        share: Share of the error's variance that is not noise, 0 to 1.
        windows_s: For each recording, by name, the segments in which the mismatch is largest, in s.
        where: Description of the states in which it occurs.
        dependence: Share of the residual torque's variance that each state explains alone.
    """

    signal: str
    component: str
    rmse: float
    noise: float
    share: float
    windows_s: Mapping[str, tuple[tuple[float, float], ...]]
    where: str
    dependence: Mapping[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        """The error and the noise: mrad for a joint, m/s or rad/s for a body."""
        return self.described()

    def described(self, remaining: float | None = None) -> str:
        """Description of the error and the noise.

        Args:
            remaining: Error of the enriched model, in the unit of ``rmse``; omitted if None.
        """
        unit, scale, digits = "mrad", 1e3, 2
        name = self.component
        if self.signal.startswith("body."):
            name = self.signal.removeprefix("body.").replace("_", " ")
            unit, scale, digits = ("rad/s" if name == "yaw rate" else "m/s"), 1.0, 4
        error, after, noise = (
            "" if x is None else f"{scale * x:.{digits}f} {unit}"
            for x in (self.rmse, remaining, self.noise)
        )
        removed = f", {after} with the enriched model" if after else ""
        where = f"; {self.where}" if self.where else ""
        return f"{name}: RMSE {error}{removed}, noise {noise}{where}"


@dataclass(frozen=True)
class Estimate:
    """A parameter of an effect: mean, standard deviation and 90 % interval."""

    mean: float
    sd: float
    q05: float
    q95: float


@dataclass(frozen=True)
class NamedEffect:
    """An effect that a diagnosis reports as missing from the model.

    Attributes:
        effect: Most probable member of the group.
        component: The joint, ``supply`` or ``link``.
        probability: Probability that one of the group is present.
        group: Effects that these recordings cannot distinguish, most probable first.
        parameters: Estimated parameters of ``effect``.
        heldout: ``rmse_before``, ``rmse_after`` in rad and ``recoverable_removed``, from refits
            that do not use the recording they are scored on.
        baseline_shift: Change of each parameter of the plain servo when the effect is added.
        stability: Share of block bootstraps in which one of the group was the most probable.
        statement: The finding, in one sentence.
    """

    effect: str
    component: str
    probability: float
    group: tuple[str, ...]
    parameters: Mapping[str, Estimate]
    heldout: Mapping[str, float | None]
    baseline_shift: Mapping[str, float]
    stability: float
    statement: str


@dataclass(frozen=True)
class Rival:
    """An effect that was considered and not named."""

    effect: str
    component: str
    probability: float


@dataclass(frozen=True)
class DetectionLimit:
    """Lower bound of the size of an effect that these recordings could have shown.

    The refitted noise model absorbs a part of a weak effect: to be detected in nine of ten cases,
    an effect must be several times as large.
    """

    effect: str
    component: str
    smallest: Mapping[str, float | None]


@dataclass(frozen=True)
class Experiment:
    """A recommended recording.

    Attributes:
        component: The joint or the body that it is about.
        separates: The members of a group that it is to distinguish.
        command: Description of the command signal, or the shell command that designs it.
        context: Change of the experiment: ``none``.
        separation: Distance of the two closest rivals in standard deviations of the noise, or None.
        duration_s: Length of the recording; None if it is yet to be designed.
        statement: The recommendation, in one sentence.
        file: Command CSV that ``record`` can play, relative to the diagnosis file.
        t: Times of the commands, s, shape (T,).
        signal: The commands, rad, shape (T,).
    """

    component: str
    separates: tuple[str, ...]
    command: str
    context: str
    separation: float | None
    duration_s: float | None
    statement: str
    file: str | None = None
    t: Array | None = None
    signal: Array | None = None


@dataclass(frozen=True)
class Ladder:
    """Held-out errors of several predictors of one signal, rad.

    Attributes:
        baseline: The plain servo.
        enriched: The enriched model; equal to ``baseline`` if it has no effects.
        noise: Standard deviation of the measurement noise, a lower bound.
    """

    baseline: float
    enriched: float
    noise: float


def to_design(groups: Iterable[tuple[str, Sequence[str]]]) -> Experiment | None:
    """The recording for the first group (component, members) of several; None if there is none."""
    for component, members in groups:
        if len(members) > 1:
            text = f"To tell apart what is left open of {component}, design a recording: {DESIGN}"
            return Experiment(component, tuple(members), DESIGN, "none", None, None, text)
    return None


@dataclass(frozen=True)
class JointSeries:
    """Signals of one joint in one recording, for figures.

    Attributes:
        joint: Name of the joint.
        recording: Name of the recording.
        t: Times in s, shape (T,).
        command: Set-points in rad, shape (T,).
        position: Measured angles in rad, NaN where missing, shape (T,).
        baseline: Angles of the plain servo in rad, shape (T,).
        enriched: Angles of the enriched model in rad, shape (T,).
        speed: Smoothed speed in rad/s, shape (T,).
        torque: Residual torque of the plain servo, smoothed, in N m (per kg m2 if the load is
            unknown), shape (T,).
        torque_sd: Its standard deviation, shape (T,).
        effects_torque: Torque by which the enriched model's motion differs from the plain servo's,
            smoothed likewise: what the named effects account for, shape (T,).
    """

    joint: str
    recording: str
    t: Array
    command: Array
    position: Array
    baseline: Array
    enriched: Array
    speed: Array
    torque: Array
    torque_sd: Array
    effects_torque: Array


@dataclass(frozen=True)
class Diagnosis(NotebookDisplay):
    """Result of ``diagnose``.

    Attributes:
        verdict: ``consistent``, ``unchanged``, ``explained``, ``ambiguous``,
            ``partly_explained`` or ``unexplained``.
        mismatch: Where simulation and recording differ by more than the noise.
        effects: Missing effects, most probable first.
        negligible: Missing effects that hardly change the held-out error, most probable first.
        rivals: Effects that were considered and not reported, most probable first.
        unknown: By joint, the probability that missing physics is not in the catalogue.
        baseline_fit: By signal, ``train`` and ``heldout`` error of the plain servo, rad.
        enriched_fit: By signal, the same errors of the enriched model.
        ladders: By signal, held-out errors of several predictors.
        detection_limits: Sizes of effects that the recordings could have shown.
        next_experiment: Recommended recording, if a group has several members.
        gate: Findings about timing, gaps and units of the data, one sentence each.
        warnings: Those by which the result may be wrong, as of ``plausible.admitted``.
        model: The enriched model: with the reported effects, or with the whole most probable set
            of effects if that predicts held-out recordings better.
        baseline: The model without effects.
        evidence: Signals of the joints, for the report.
        unfinished: Joints whose search for sets of effects was ended by its budget.
        rival_sets: By joint, the sets of effects that the recordings leave open.
        swim_rivals: Of swims, the sets of effects of body and camera that they leave open.
        separations: Sets of effects that recordings were designed to distinguish, and the outcome.
        notes: Of what turns in addition to a stated load and is taken for the rotor, one sentence
            each.
        provenance: As returned by ``sim2real.output.provenance``.
    """

    verdict: Verdict
    mismatch: tuple[Mismatch, ...]
    effects: tuple[NamedEffect, ...]
    rivals: tuple[Rival, ...]
    unknown: Mapping[str, float]
    baseline_fit: Mapping[str, Mapping[str, float | None]]
    enriched_fit: Mapping[str, Mapping[str, float | None]]
    model: Model
    ladders: Mapping[str, Ladder] = field(default_factory=dict)
    detection_limits: tuple[DetectionLimit, ...] = ()
    next_experiment: Experiment | None = None
    gate: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    baseline: Model | None = None
    evidence: tuple[JointSeries, ...] = ()
    negligible: tuple[NamedEffect, ...] = ()
    unfinished: tuple[str, ...] = ()
    rival_sets: tuple[JointRivals, ...] = ()
    swim_rivals: SwimRivals | None = None
    separations: tuple[Separation, ...] = ()
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def remaining(self, signal: str) -> float | None:
        """Error of the enriched model, on held-out data if there are any; None if unchanged.

        Args:
            signal: The measured signal, ``"j2.position_rad"``.
        """
        plain, enriched = (
            errors.get("train") if errors.get("heldout") is None else errors["heldout"]
            for errors in (fit.get(signal, {}) for fit in (self.baseline_fit, self.enriched_fit))
        )
        return None if enriched == plain else enriched

    def __str__(self) -> str:
        """Verdict, effects and mismatches, one per line."""
        lines = [f"verdict: {self.verdict.replace('_', ' ')}"]
        lines += [f"  warning: {sentence}" for sentence in self.warnings]
        for effect in self.effects:
            lines.append(f"  {percent(effect.probability):>5}  {effect.statement}")
        for effect in self.negligible:
            lines.append(f"  {percent(effect.probability):>5}  {effect.statement} (negligible)")
        for entry in self.mismatch:
            lines.append(f"  {entry.described(self.remaining(entry.signal))}")
        lines += [f"  {sentence}" for sentence in self.above_noise.values()]
        lines += [f"  {note}" for note in self.notes]
        if self.unfinished:
            lines.append(f"search: {self.search_ended}")
        lines += [f"design: {separation}" for separation in self.separations]
        if self.next_experiment is not None:
            lines.append(f"next: {self.next_experiment.statement}")
        return "\n".join(lines)

    @property
    def above_noise(self) -> dict[str, str]:
        """Joints without a mismatch whose error is far above their noise, each with a sentence."""
        differing = {mismatch.component for mismatch in self.mismatch}
        sentences = {}
        for signal, errors in self.ladders.items():
            joint = signal.rpartition(".")[0]
            if joint not in differing and errors.baseline >= ABOVE_NOISE * errors.noise > 0:
                sentences[joint] = (
                    f"{joint}: RMSE {1e3 * errors.baseline:.1f} mrad, "
                    f"{errors.baseline / errors.noise:.0f} times the noise of "
                    f"{1e3 * errors.noise:.1f} mrad, although no effect explains it: single "
                    "readings or times of samples may be wrong."
                )
        return sentences

    @property
    def search_ended(self) -> str:
        """Statement on joints whose search was ended by its budget; empty if there are none.

        The budget is ``search_substeps`` of ``decision.json``, times ``effort`` of ``diagnose``.
        """
        if not self.unfinished:
            return ""
        return (
            f"The search for combinations of effects on {', '.join(self.unfinished)} was ended by"
            " its simulation budget: every effect was tested alone, but not every promising"
            " combination; --effort multiplies the budget."
        )

    def plot(self) -> Figure:
        """Probabilities of the reported effects and of their rivals."""
        figure: Figure = from_report("diagnosis_plots.candidate_figure")(self)
        return figure


def percent(share: float) -> str:
    """A probability for display, between ``"<1 %"`` and ``">99 %"``."""
    return ">99 %" if share > 0.99 else "<1 %" if share < 0.01 else f"{100 * share:.0f} %"


def write_diagnosis(diagnosis: Diagnosis, path: str | os.PathLike[str], model: str) -> None:
    """Write ``diagnosis.json``.

    Args:
        diagnosis: What was found.
        path: The file to write.
        model: Path of the enriched model, relative to it.

    Raises:
        InputError: If the folder can't be written.
    """
    write_json(path, _content(diagnosis) | {"model": model})


def _content(diagnosis: Diagnosis) -> dict[str, Any]:
    plan = vars(diagnosis.next_experiment) if diagnosis.next_experiment else {}
    return {
        "schema": SCHEMA,
        "verdict": diagnosis.verdict,
        "mismatch": [_mismatch(m) for m in diagnosis.mismatch],
        "effects": [asdict(effect) for effect in diagnosis.effects],
        "negligible": [asdict(effect) for effect in diagnosis.negligible],
        "rivals": [asdict(rival) for rival in diagnosis.rivals],
        "unknown": dict(diagnosis.unknown),
        "fit": {"baseline": diagnosis.baseline_fit, "enriched": diagnosis.enriched_fit},
        "heldout_ladder": {signal: asdict(x) for signal, x in diagnosis.ladders.items()},
        "detection_limits": [asdict(limit) for limit in diagnosis.detection_limits],
        "next_experiment": {k: x for k, x in plan.items() if k not in ("t", "signal")} or None,
        "separations": [asdict(pair) for pair in diagnosis.separations],
        "rival_sets": [joint.content() for joint in diagnosis.rival_sets],
        "swim_rivals": None if diagnosis.swim_rivals is None else diagnosis.swim_rivals.content(),
        "gate": list(diagnosis.gate),
        "warnings": list(diagnosis.warnings),
        "notes": [*diagnosis.above_noise.values(), *diagnosis.notes],
        "search": {
            "complete": not diagnosis.unfinished,
            "unfinished": list(diagnosis.unfinished),
            "statement": diagnosis.search_ended,
        },
        "provenance": dict(diagnosis.provenance),
    }


def _mismatch(mismatch: Mismatch) -> dict[str, Any]:
    """One entry; ``windows_s`` lists those of all recordings, ``windows_by_recording`` tells which.

    A time alone says nothing where there are several recordings.
    """
    content = asdict(mismatch)
    by_recording = content.pop("windows_s")
    windows = sorted(window for each in by_recording.values() for window in each)
    return content | {"windows_s": windows, "windows_by_recording": by_recording}
