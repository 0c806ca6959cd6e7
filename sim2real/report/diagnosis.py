"""Diagnosis section of a report: missing effects, where the model differs, next experiment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim2real.diagnose.result import Diagnosis, Experiment, JointSeries, Mismatch, NamedEffect
from sim2real.diagnose.rival_sets import SEPARATED
from sim2real.report.diagnosis_bars import Bar, bar_figure
from sim2real.report.diagnosis_plots import (
    command_figure,
    mean_figure,
    residual_figure,
    residual_live,
    torque_figure,
)
from sim2real.report.diagnosis_what import figure, what_blocks
from sim2real.report.diagnosis_words import how_sure, listed, per_inertia, plain, sure
from sim2real.report.page import Block, Note, Section, Table, Text
from sim2real.report.quantity import milliradians
from sim2real.units import readable

_LEAD = (
    "Does the simulated servo lack physics that the real one has? Where simulation and recording "
    "differ by more than noise, each effect of the catalogue is fitted. Probabilities are meant to "
    "be calibrated: of ten effects named at 90\u00a0%, nine should be present."
)
_VERDICTS = {
    "consistent": ("good", "The plain servo explains these recordings: no mismatch that matters."),
    "unchanged": ("good", "Nothing has changed since the references were recorded."),
    "explained": ("good", "The named effects account for the mismatch."),
    "ambiguous": (
        "info",
        "Several effects, which these recordings cannot distinguish, account equally well for the "
        "mismatch.",
    ),
    "partly_explained": (
        "warn",
        "The named effects account for a part of the mismatch; the rest is unexplained.",
    ),
    "unexplained": ("warn", "There is a mismatch that no effect in the catalogue explains."),
}
_STATES = {
    "position": "position",
    "speed": "speed",
    "error": "distance from the command",
    "time": "time since the start",
    "sensor": "position, through the angle sensor",
    "other_joint": "motion of another joint",
    "shaking": "vibration at one frequency",
    "jump": "a change at one instant",
}
_DRAWN_AGAINST = {"sensor": "position", "other_joint": "time", "shaking": "time", "jump": "time"}
_STRIPS = 5
_RESIDUAL = (
    "Residual of {joint} over time: measured minus simulated angle{which}. "
    "Dashed lines: ±\u00a02 standard deviations of the noise{shade}."
)
_TORQUE = (
    "Torque missing from the plain servo of {joint}, against speed and position. A pattern "
    "indicates missing physics; an unstructured cloud within the grey band is noise. The axes may "
    "cut off the outermost half percent."
)
_DEPENDENCE = (
    "Share of the missing torque of {joint} that each state explains by itself. Shares overlap, as "
    "the states are correlated."
)
_MEAN = (
    "Mean of the torque missing from the plain servo of {joint}, with two standard errors, against "
    "the state that it depends on most among those that can be plotted. Grey band: noise of a "
    "single sample."
)
_LIMITS = (
    "Smallest size of an effect that these recordings could have shown at best; reliable detection "
    "needs several times as much. For limits on torque, speed or acceleration, values below the "
    "number would have been detected. Dash: not detectable at any size tested."
)
_WORTH_A_BAR = 0.05


def diagnosis_section(diagnosis: Diagnosis) -> Section:
    """Text, tables and figures of a diagnosis."""
    blocks: list[Block] = [_verdict(diagnosis)]
    blocks += [Note("warn", sentence) for sentence in diagnosis.warnings]
    if diagnosis.unfinished:
        blocks.append(Note("warn", diagnosis.search_ended))
    blocks += [_effect(effect) for effect in diagnosis.effects]
    for mismatch in diagnosis.mismatch:
        blocks += _where(diagnosis, mismatch)
    blocks += _sound(diagnosis)
    if diagnosis.mismatch:
        blocks += what_blocks(diagnosis)
        for mismatch in diagnosis.mismatch:
            blocks += _unexplained(diagnosis, mismatch)
    blocks += _separations(diagnosis)
    if diagnosis.next_experiment is not None:
        blocks += _next(diagnosis.next_experiment)
    blocks += _limits(diagnosis)
    remarks = [sentence for sentence in diagnosis.gate if sentence not in diagnosis.warnings]
    if remarks:
        text = "Remarks of the check of the recordings; they may affect the diagnosis."
        blocks += [Text(text, heading="Data"), *(Note("info", x) for x in remarks)]
    blocks += [Note("info", note) for note in diagnosis.notes]
    return Section("Diagnosis", _LEAD, blocks)


def _separations(diagnosis: Diagnosis) -> list[Block]:
    """Which effects designed recordings were expected to separate, and whether they did."""
    if not diagnosis.separations:
        return []
    text = "What recordings were designed to separate, and what they have separated."
    separated = [(pair.found or 0.0) >= SEPARATED for pair in diagnosis.separations]
    notes = [
        Note("good" if found else "info", str(pair))
        for pair, found in zip(diagnosis.separations, separated, strict=True)
    ]
    return [Text(text, heading="Expected and found"), *notes]


def _verdict(diagnosis: Diagnosis) -> Note:
    kind, sentence = _VERDICTS[diagnosis.verdict]
    remains = [text for mismatch in diagnosis.mismatch if (text := _remains(diagnosis, mismatch))]
    text = " ".join([sentence, *remains])
    return Note("warn" if kind == "warn" else "good" if kind == "good" else "info", text)


def _remains(diagnosis: Diagnosis, mismatch: Mismatch) -> str:
    """Sentence on the error of the enriched model; empty if it has no added effects."""
    after = diagnosis.remaining(mismatch.signal)
    if after is None:
        return ""
    joint = mismatch.signal.rpartition(".")[0] or mismatch.component
    before, remaining, noise = map(milliradians, (mismatch.rmse, after, mismatch.noise))
    times = f"{after / mismatch.noise:.1f} times the noise" if mismatch.noise > 0 else "no noise"
    change = f"The effects reduce the error of {joint} from {before} to {remaining}"
    return f"{change}, {times} ({noise})."


def _effect(effect: NamedEffect) -> Note:
    if len(effect.group) < 2:
        return Note("info", f"{effect.statement} {how_sure(effect.probability)}")
    sentences = [effect.statement]
    if "cannot tell" not in effect.statement:
        name, *alternatives = map(plain, effect.group)
        sentences.append(f"These recordings cannot tell {name} from {listed(alternatives, 'or')}.")
    sentences.append(how_sure(effect.probability, of="that it is one of them"))
    return Note("info", " ".join(sentences))


def _where(diagnosis: Diagnosis, mismatch: Mismatch) -> list[Block]:
    joint = mismatch.signal.rpartition(".")[0] or mismatch.component
    sentence = (
        f"The error of the plain servo on held-out data is {milliradians(mismatch.rmse)} "
        f"(root mean square), the sensor's noise {milliradians(mismatch.noise)}: "
        f"{100 * mismatch.share:.0f} % of the squared error is not noise. "
        f"Where the error occurs: {mismatch.where or 'not known'}."
    )
    blocks: list[Block] = [Text(sentence, heading=f"Where {joint} differs")]
    evidence = _evidence(diagnosis, joint)
    if evidence:
        blocks.append(_residuals(diagnosis, mismatch, joint, evidence))
        drawing = torque_figure(evidence, _unit(diagnosis, joint))
        blocks.append(figure(drawing, _TORQUE.format(joint=joint)))
    if mismatch.dependence:
        ranked = sorted(mismatch.dependence.items(), key=lambda entry: -entry[1])
        bars = [
            Bar(_STATES.get(name, name), x, f"{100 * x:.0f} %", strong=k == 0)
            for k, (name, x) in enumerate(ranked)
            if k == 0 or x >= _WORTH_A_BAR
        ]
        drawing = bar_figure({"": bars}, f"{joint}: what the missing torque depends on", full=0.2)
        blocks.append(figure(drawing, _DEPENDENCE.format(joint=joint)))
    return blocks


def _residuals(
    diagnosis: Diagnosis, mismatch: Mismatch, joint: str, evidence: Sequence[JointSeries]
) -> Block:
    has_findings = any(not np.array_equal(series.baseline, series.enriched) for series in evidence)
    shown = sorted(evidence, key=lambda series: -_error(series))[:_STRIPS]
    details = ", of the plain servo and with the named effects" if has_findings else ""
    if len(shown) < len(evidence):
        details += f", in the {len(shown)} of {len(evidence)} recordings with the largest errors"
    shade = "; shaded: times with large residuals" if any(mismatch.windows_s.values()) else ""
    drawing = residual_figure(shown, mismatch.noise, mismatch.windows_s, enriched=has_findings)
    live = residual_live(shown, mismatch.noise, mismatch.windows_s, enriched=has_findings)
    return figure(drawing, _RESIDUAL.format(joint=joint, which=details, shade=shade), live)


def _error(series: JointSeries) -> float:
    residual = series.position - series.baseline
    finite = residual[np.isfinite(residual)]
    return float(np.mean(finite**2)) if finite.size else 0.0


def _evidence(diagnosis: Diagnosis, joint: str) -> list[JointSeries]:
    return [x for x in diagnosis.evidence if x.joint == joint and np.isfinite(x.position).any()]


def _unit(diagnosis: Diagnosis, joint: str) -> str:
    return "missing torque, N m" + ("/(kg m²)" if per_inertia(diagnosis, joint) else "")


def _sound(diagnosis: Diagnosis) -> list[Block]:
    differing = {mismatch.component for mismatch in diagnosis.mismatch}
    above = diagnosis.above_noise
    sound = [name for name in diagnosis.model.joints if name not in {*differing, *above}]
    warnings: list[Block] = [Note("warn", sentence) for sentence in above.values()]
    if not sound:
        return warnings
    follow = "follow" if len(sound) > 1 else "follows"
    sentence = f"{listed(sound)} {follow} the plain servo down to the noise"
    errors = [text for name in sound if (text := _error_and_noise(diagnosis, name))]
    text = f"{sentence}: {'; '.join(errors)}." if errors else f"{sentence}."
    return [*warnings, Note("good", text)]


def _error_and_noise(diagnosis: Diagnosis, joint: str) -> str:
    """``"j1 has an error of 1.6 mrad, with 1.5 mrad of noise"``; empty without an error."""
    fit = diagnosis.baseline_fit.get(f"{joint}.position_rad", {})
    rmse = fit.get("train") if fit.get("heldout") is None else fit["heldout"]
    if rmse is None:
        return ""
    noise = fit.get("noise")
    with_noise = "" if noise is None else f", with {milliradians(noise)} of noise"
    return f"{joint} has an error of {milliradians(rmse)}{with_noise}"


def _unexplained(diagnosis: Diagnosis, mismatch: Mismatch) -> list[Block]:
    joint = mismatch.component
    unknown = diagnosis.unknown.get(joint, 0.0)
    if unknown <= 0.5 and diagnosis.verdict != "unexplained":
        return []
    text = f"No effect in the catalogue explains the residual of {joint}."
    text += f" The probability of that is {sure(unknown)}." if unknown > 0.5 else ""
    blocks: list[Block] = [Text(text, heading=f"Unexplained residual of {joint}")]
    evidence = _evidence(diagnosis, joint)
    if evidence:
        states = {
            _DRAWN_AGAINST.get(k, k): v for k, v in reversed(list(mismatch.dependence.items()))
        }
        state = max(states, key=lambda name: states[name], default="position")
        drawing = mean_figure(evidence, state, _unit(diagnosis, joint))
        blocks.append(figure(drawing, _MEAN.format(joint=joint)))
    return blocks


def _next(experiment: Experiment) -> list[Block]:
    where = f" The command to play is in {experiment.file}." if experiment.file else ""
    blocks: list[Block] = [Text(experiment.statement + where, heading="What to record next")]
    t, signal = experiment.t, experiment.signal
    if t is not None and signal is not None and t.size and t.size == signal.size:
        caption = f"The command to play on {experiment.component}: {experiment.command}."
        blocks.append(figure(command_figure(experiment), caption))
    return blocks


def _limits(diagnosis: Diagnosis) -> list[Block]:
    cells: dict[str, dict[str, str]] = {}
    for limit in diagnosis.detection_limits:
        bare = per_inertia(diagnosis, limit.component)
        texts = [
            readable(n, x, per_inertia=bare) for n, x in limit.smallest.items() if x is not None
        ]
        cells.setdefault(limit.effect, {})[limit.component] = "\n".join(texts)
    places = tuple(dict.fromkeys(limit.component for limit in diagnosis.detection_limits))
    rows = [
        (plain(effect), *(by_place.get(place) or "–" for place in places))
        for effect, by_place in cells.items()
    ]
    if not rows:
        return []
    text = "Effects smaller than these cannot be detected in these recordings."
    return [Text(text, heading="Detection limits"), Table(("effect", *places), rows, _LIMITS)]
