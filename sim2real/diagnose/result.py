"""What a diagnosis says, as values and as ``diagnosis.json``."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy.special import ndtri

from sim2real.arrays import Array
from sim2real.diagnose.rival_sets import SCHEMA, JointRivals, Separation, SwimRivals
from sim2real.display import NotebookDisplay, from_report
from sim2real.inference.normal import LEVEL, Z90
from sim2real.model import Model
from sim2real.noise import ABOVE_NOISE
from sim2real.output import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DESIGN = "sim2real design --robot robot.toml --diagnosis diagnosis.json --out next.csv"
Verdict = Literal[
    "consistent", "unchanged", "explained", "ambiguous", "partly_explained", "unexplained"
]
Errors = Mapping[str, Mapping[str, float | None]]
"""By signal, ``train`` and ``heldout`` error and ``noise``, rad."""


@dataclass(frozen=True)
class Mismatch:
    """Where simulation and recording differ by more than noise."""

    signal: str  # the measured signal, "j2.position_rad"
    component: str  # the part that it belongs to: a joint, ``supply`` or ``link``
    rmse: float  # error of the plain servo on held-out data, rad
    noise: float  # standard deviation of the measurement noise, rad
    # share of the error's variance that is not noise, 0 to 1; of swims, of the residual of all
    # signals, in standard deviations, that is in this one
    share: float
    windows_s: Mapping[str, tuple[tuple[float, float], ...]]  # its segments, by recording, s
    where: str  # description of the states in which it occurs
    dependence: Mapping[str, float] = field(default_factory=dict)
    """Share of the residual torque's variance that each state explains alone."""
    remainder: str = ""  # where that error is which the enriched model leaves, and what to record

    def __str__(self) -> str:
        return self.described(None)

    def described(self, remaining: float | None) -> str:
        """The error, that of the enriched model where there is one, and the noise.

        In mrad for a joint, m/s or rad/s for a body.
        """
        name, unit, scale, digits = self.component, "mrad", 1e3, 2
        if self.signal.startswith("body."):
            name = self.signal.removeprefix("body.").replace("_", " ")
            unit, scale, digits = ("rad/s" if name == "yaw rate" else "m/s"), 1.0, 4

        def told(value: float) -> str:
            return f"{scale * value:.{digits}f} {unit}"

        removed = "" if remaining is None else f", {told(remaining)} with the enriched model"
        where = f"; {self.where}" if self.where else ""
        return f"{name}: RMSE {told(self.rmse)}{removed}, noise {told(self.noise)}{where}"


@dataclass(frozen=True)
class Estimate:
    """A parameter of an effect: mean, standard deviation and the ends of its interval.

    The interval is that of ``Diagnosis.interval_level``, 90 % unless another one was asked for.
    """

    mean: float
    sd: float
    q05: float
    q95: float

    @classmethod
    def normal(cls, mean: float, sd: float, low: float = -np.inf, high: float = np.inf) -> Estimate:
        """With the interval of 90 % of a normal distribution, cut to what is possible."""
        q05, q95 = max(mean - Z90 * sd, low), min(mean + Z90 * sd, high)
        return cls(mean, sd, min(q05, mean), max(q95, mean))

    def widened(self, ratio: float) -> Estimate:
        """The interval's ends further from the mean by a factor, but never beyond 0."""
        low, high = (self.mean + ratio * (end - self.mean) for end in (self.q05, self.q95))
        low = max(low, 0.0) if self.q05 >= 0 else low
        return replace(self, q05=low, q95=min(high, 0.0) if self.q95 <= 0 else high)


@dataclass(frozen=True)
class NamedEffect:
    """An effect that a diagnosis reports as missing from the model."""

    effect: str  # most probable member of the group
    component: str  # the joint, ``supply`` or ``link``
    probability: float  # that one of the group is present
    group: tuple[str, ...]  # effects that the recordings cannot distinguish, most probable first
    parameters: Mapping[str, Estimate]  # of ``effect``
    heldout: Mapping[str, float | None]
    """``rmse_before``, ``rmse_after`` in rad and ``recoverable_removed``, from refits that do not
    use the recording they are scored on."""
    baseline_shift: Mapping[str, float]  # change of the plain servo when the effect is added
    statement: str  # the finding, in one sentence


@dataclass(frozen=True)
class Rival:
    """An effect that was considered and not named."""

    effect: str
    component: str
    probability: float


@dataclass(frozen=True)
class DetectionLimit:
    """Lower bound of the size of an effect that these recordings could have shown."""

    effect: str
    component: str
    smallest: Mapping[str, float | None]


@dataclass(frozen=True)
class Experiment:
    """A recommended recording."""

    component: str  # the joint or the body that it is about
    separates: tuple[str, ...]  # the members of a group that it is to distinguish
    command: str  # the command signal, or the shell command that designs it
    context: str  # change of the experiment: ``none``
    separation: float | None  # of the closest rivals, in standard deviations of the noise
    duration_s: float | None  # None if it is yet to be designed
    statement: str  # the recommendation, in one sentence
    file: str | None = None  # commands that ``record`` can play, relative to the diagnosis
    t: Array | None = None  # times of the commands, s, shape (T,)
    signal: Array | None = None  # the commands, rad, shape (T,)


def to_design(groups: Iterable[tuple[str, Sequence[str]]]) -> Experiment | None:
    """The recording for the first group (component, members) of several; None if there is none."""
    for component, members in groups:
        if len(members) > 1:
            text = f"To tell apart what is left open of {component}, design a recording: {DESIGN}"
            return Experiment(component, tuple(members), DESIGN, "none", None, None, text)
    return None


@dataclass(frozen=True)
class JointSeries:
    """Signals of one joint in one recording, for figures; arrays have the shape (T,)."""

    joint: str
    recording: str
    t: Array  # times, s
    command: Array  # set-points, rad
    position: Array  # measured angles, rad, NaN where missing
    baseline: Array  # angles of the plain servo, rad
    enriched: Array  # angles of the enriched model, rad
    speed: Array  # smoothed speed, rad/s
    torque: Array  # residual torque of the plain servo, smoothed, N m, or per kg m2
    torque_sd: Array  # its standard deviation
    effects_torque: Array  # what the named effects account for of it, smoothed likewise


@dataclass(frozen=True)
class Diagnosis(NotebookDisplay):
    """Result of ``diagnose``; what is listed comes most probable first."""

    verdict: Verdict
    mismatch: tuple[Mismatch, ...]  # where simulation and recording differ by more than the noise
    effects: tuple[NamedEffect, ...]  # missing effects
    rivals: tuple[Rival, ...]  # effects that were considered and not reported
    unknown: Mapping[str, float]
    """By joint, the probability that missing physics is not in the catalogue."""
    baseline_fit: Errors  # of the plain servo
    enriched_fit: Errors  # of the enriched model
    model: Model
    """The enriched model: with the reported effects, or with all of the most probable set of
    effects if that predicts held-out recordings better."""
    detection_limits: tuple[DetectionLimit, ...] = ()
    next_experiment: Experiment | None = None  # if a group has several members
    gate: tuple[str, ...] = ()  # findings about timing, gaps and units of the data, as sentences
    warnings: tuple[str, ...] = ()  # those by which the result may be wrong
    baseline: Model | None = None  # the model without effects
    evidence: tuple[JointSeries, ...] = ()
    negligible: tuple[NamedEffect, ...] = ()  # effects that hardly change the held-out error
    unfinished: tuple[str, ...] = ()  # joints whose search was ended by its budget
    rival_sets: tuple[JointRivals, ...] = ()  # by joint, sets of effects that stay open
    swim_rivals: SwimRivals | None = None  # of swims, those of effects of body and camera
    separations: tuple[Separation, ...] = ()  # what recordings were designed to distinguish
    notes: tuple[str, ...] = ()  # of what is left out or taken for the rotor, one sentence each
    interval_level: float = LEVEL  # probability of the intervals of parameters
    provenance: Mapping[str, Any] = field(default_factory=dict)  # of ``output.provenance``

    def with_intervals(self, level: float) -> Diagnosis:
        """The diagnosis with intervals of another probability than 0.9."""
        if level == LEVEL:
            return self
        ratio = float(ndtri((1 + level) / 2) / ndtri((1 + LEVEL) / 2))

        def widened(effect: NamedEffect) -> NamedEffect:
            wider = {name: x.widened(ratio) for name, x in effect.parameters.items()}
            return replace(effect, parameters=wider)

        effects, negligible = map(widened, self.effects), map(widened, self.negligible)
        return replace(
            self, effects=tuple(effects), negligible=tuple(negligible), interval_level=level
        )

    def remaining(self, signal: str) -> float | None:
        """Error of the enriched model, on held-out data if there are any; None if unchanged."""
        plain, enriched = (
            errors.get("train") if errors.get("heldout") is None else errors["heldout"]
            for errors in (fit.get(signal, {}) for fit in (self.baseline_fit, self.enriched_fit))
        )
        return None if enriched == plain else enriched

    def __str__(self) -> str:
        """Verdict, effects and mismatches, one per line."""
        lines = [f"verdict: {self.verdict.replace('_', ' ')}"]
        lines += [f"  warning: {sentence}" for sentence in self.warnings]
        for effects, suffix in ((self.effects, ""), (self.negligible, " (negligible)")):
            lines += [f"  {percent(e.probability):>5}  {e.statement}{suffix}" for e in effects]
        for entry in self.mismatch:
            lines.append(f"  {entry.described(self.remaining(entry.signal))}")
            lines += [f"    {entry.remainder}"] if entry.remainder else []
        lines += [f"  {sentence}" for sentence in (*self.above_noise.values(), *self.notes)]
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
        for signal, errors in self.baseline_fit.items():
            joint = signal.rpartition(".")[0]
            error, noise = errors.get("heldout"), errors.get("noise") or 0.0
            if joint not in differing and error is not None and error >= ABOVE_NOISE * noise > 0:
                sentences[joint] = (
                    f"{joint}: RMSE {1e3 * error:.1f} mrad, {error / noise:.0f} times the noise of "
                    f"{1e3 * noise:.1f} mrad, although no effect explains it: single readings or "
                    "times of samples may be wrong."
                )
        return sentences

    @property
    def search_ended(self) -> str:
        """Statement on joints whose search was ended by its budget; empty if there are none."""
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
    """Write ``diagnosis.json``, which names the enriched model by its path relative to the file.

    Raises:
        InputError: If the folder can't be written.
    """
    lists = ("effects", "negligible", "rivals", "detection_limits", "separations")
    entries = {name: [asdict(entry) for entry in getattr(diagnosis, name)] for name in lists}
    plan = vars(diagnosis.next_experiment) if diagnosis.next_experiment else {}
    mismatch = []
    for one in diagnosis.mismatch:
        windows = sorted(window for each in one.windows_s.values() for window in each)
        more = {"windows_s": windows, "windows_by_recording": one.windows_s}
        mismatch.append(asdict(one) | more)
    content = entries | {
        "schema": SCHEMA,
        "verdict": diagnosis.verdict,
        "interval_level": diagnosis.interval_level,
        "mismatch": mismatch,
        "unknown": dict(diagnosis.unknown),
        "fit": {"baseline": diagnosis.baseline_fit, "enriched": diagnosis.enriched_fit},
        "next_experiment": {k: x for k, x in plan.items() if k not in ("t", "signal")} or None,
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
        "model": model,
        "provenance": dict(diagnosis.provenance),
    }
    write_json(path, content)
