"""Diagnosis section of a report: where the model differs, missing effects, next experiment."""

from typing import Literal

import numpy as np

from sim2real.diagnose.result import Diagnosis, Mismatch, NamedEffect, percent
from sim2real.diagnose.rival_sets import SEPARATED
from sim2real.report.diagnosis_plots import (
    candidate_figure,
    listed,
    plain,
    residual_panels,
    sure,
    torque_figure,
)
from sim2real.report.drawing import svg
from sim2real.report.page import Block, Figure, Note, Section, Table, Text
from sim2real.report.quantity import change_text, milliradians, quantities
from sim2real.report.series import Panel, series_block
from sim2real.units import readable, readable_name
from sim2real.viewers.scenes import COMMAND, SignalGroup

_LEAD = (
    "Does the simulated servo lack physics that the real one has? Where simulation and recording "
    "differ by more than noise, each effect of the catalogue is fitted. Probabilities are meant to "
    "be calibrated: of ten effects named at 90\u00a0%, nine should be present."
)
_VERDICTS: dict[str, tuple[Literal["good", "warn", "info"], str]] = {
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
    "error": "distance from the command",
    "time": "time since the start",
    "sensor": "position, through the angle sensor",
    "other_joint": "motion of another joint",
    "shaking": "vibration at one frequency",
    "jump": "a change at one instant",
}
_STRIPS = 5
_WORTH_A_ROW = 0.05
_RESIDUAL = (
    "Residual of {joint} over time: measured minus simulated angle{which}. "
    "Band: ±\u00a02 standard deviations of the noise{shade}."
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
_LADDER = (
    "Error (root mean square) on held-out recordings or parts of recordings. No simulation can be "
    "below the sensor noise."
)
_NEGLIGIBLE = (
    "Detectable but negligible: these effects are present as well and hardly change the held-out "
    "error."
)
_SHIFTS = (
    "Bias of the plain fit: without the missing effect, its stiffness (kp), damping (kd) and "
    "latency compensate for it in part. Change of each with the effect, with the values before and "
    "after below."
)
_LIMITS = (
    "Smallest size of an effect that these recordings could have shown at best; reliable detection "
    "needs several times as much. For limits on torque, speed or acceleration, values below the "
    "number would have been detected. Dash: not detectable at any size tested."
)


def diagnosis_section(diagnosis: Diagnosis) -> Section:
    """Text, tables and figures of a diagnosis."""
    kind, sentence = _VERDICTS[diagnosis.verdict]
    remains = [_remains(diagnosis, mismatch) for mismatch in diagnosis.mismatch]
    blocks: list[Block] = [Note(kind, " ".join(filter(None, [sentence, *remains])))]
    blocks += [Note("warn", sentence) for sentence in diagnosis.warnings]
    if diagnosis.unfinished:
        blocks.append(Note("warn", diagnosis.search_ended))
    blocks += [Note("info", told(effect)) for effect in diagnosis.effects]
    for mismatch in diagnosis.mismatch:
        blocks += _where(diagnosis, mismatch)
    blocks += _sound(diagnosis)
    if diagnosis.mismatch:
        blocks += _what(diagnosis)
    if diagnosis.separations:
        text = "What recordings were designed to separate, and what they have separated."
        blocks.append(Text(text, heading="Expected and found"))
        blocks += [
            Note("good" if (pair.found or 0.0) >= SEPARATED else "info", str(pair))
            for pair in diagnosis.separations
        ]
    blocks += [*_next(diagnosis), *_limits(diagnosis)]
    remarks = [sentence for sentence in diagnosis.gate if sentence not in diagnosis.warnings]
    if remarks:
        text = "Remarks of the check of the recordings; they may affect the diagnosis."
        blocks += [Text(text, heading="Data"), *(Note("info", x) for x in remarks)]
    blocks += [Note("info", note) for note in diagnosis.notes]
    return Section("Diagnosis", _LEAD, blocks)


def _per_inertia(diagnosis: Diagnosis, component: str) -> bool:
    """Whether the torques of a component are per unit of inertia."""
    joints = diagnosis.model.joints
    return any(joints[n].per_inertia for n in ([component] if component in joints else joints))


def _remains(diagnosis: Diagnosis, mismatch: Mismatch) -> str:
    """Sentence on the error of the enriched model; empty if it has no added effects."""
    after = diagnosis.remaining(mismatch.signal)
    if after is None:
        return ""
    joint = mismatch.signal.rpartition(".")[0] or mismatch.component
    before, remaining, noise = map(milliradians, (mismatch.rmse, after, mismatch.noise))
    times = f"{after / mismatch.noise:.1f} times the noise" if mismatch.noise > 0 else "no noise"
    named = any(e.component in (joint, "supply", "link") for e in diagnosis.effects)
    what = "named effects change" if named else "model chosen for prediction changes"
    return f"The {what} the error of {joint} from {before} to {remaining}, {times} ({noise})."


def told(effect: NamedEffect) -> str:
    """The statement of an effect, its alternatives and its probability."""
    chance = sure(effect.probability).capitalize()
    if len(effect.group) < 2:
        return f"{effect.statement} {chance} sure."
    sentences = [effect.statement]
    if not any(words in effect.statement for words in ("cannot tell", "not distinguish")):
        name, *alternatives = map(plain, effect.group)
        sentences.append(f"These recordings cannot tell {name} from {listed(alternatives, 'or')}.")
    return " ".join([*sentences, f"{chance} sure that it is one of them."])


def _where(diagnosis: Diagnosis, mismatch: Mismatch) -> list[Block]:
    joint = mismatch.signal.rpartition(".")[0] or mismatch.component
    sentence = (
        f"The error of the plain servo on held-out data is {milliradians(mismatch.rmse)} "
        f"(root mean square), the sensor's noise {milliradians(mismatch.noise)}: "
        f"{100 * mismatch.share:.0f} % of the squared error is not noise. "
        f"Where the error occurs: {mismatch.where or 'not known'}."
    )
    blocks: list[Block] = [Text(sentence, heading=f"Where {joint} differs")]
    evidence = [x for x in diagnosis.evidence if x.joint == joint and np.isfinite(x.position).any()]
    if evidence:
        enriched = any(not np.array_equal(x.baseline, x.enriched) for x in evidence)
        squares = lambda x: -float(np.nanmean((x.position - x.baseline) ** 2))  # noqa: E731
        shown = sorted(evidence, key=squares)[:_STRIPS]
        details = ", of the plain servo and with the named effects" if enriched else ""
        if len(shown) < len(evidence):
            of_all = f"{len(shown)} of {len(evidence)}"
            details += f", in the {of_all} recordings with the largest errors"
        shade = "; shaded: times with large residuals" if any(mismatch.windows_s.values()) else ""
        panels = residual_panels(shown, mismatch.noise, mismatch.windows_s, enriched=enriched)
        caption = _RESIDUAL.format(joint=joint, which=details, shade=shade)
        label = f"{joint}: measured minus simulated, over time"
        blocks.append(series_block(panels, label, caption))
        unit = "missing torque, N m" + ("/(kg m²)" if _per_inertia(diagnosis, joint) else "")
        blocks.append(Figure(svg(torque_figure(evidence, unit)), _TORQUE.format(joint=joint)))
    ranked = sorted(mismatch.dependence.items(), key=lambda entry: -entry[1])
    shares = [
        (_STATES.get(name, name), f"{100 * x:.0f} %")
        for k, (name, x) in enumerate(ranked)
        if k == 0 or x >= _WORTH_A_ROW
    ]
    if shares:
        blocks.append(Table(("state", "share"), shares, _DEPENDENCE.format(joint=joint)))
    return blocks


def _sound(diagnosis: Diagnosis) -> list[Block]:
    """Joints that follow the plain servo down to the noise."""
    differing = {mismatch.component for mismatch in diagnosis.mismatch}
    above = diagnosis.above_noise
    sound = [name for name in diagnosis.model.joints if name not in {*differing, *above}]
    warnings: list[Block] = [Note("warn", sentence) for sentence in above.values()]
    if not sound:
        return warnings
    errors = []
    for joint in sound:
        fit = diagnosis.baseline_fit.get(f"{joint}.position_rad", {})
        rmse = fit.get("train") if (heldout := fit.get("heldout")) is None else heldout
        if rmse is not None:
            sd = fit.get("noise")
            noise = "" if sd is None else f", with {milliradians(sd)} of noise"
            errors.append(f"{joint} has an error of {milliradians(rmse)}{noise}")
    follow = "follow" if len(sound) > 1 else "follows"
    text = f"{listed(sound)} {follow} the plain servo down to the noise"
    return [*warnings, Note("good", ": ".join(filter(None, [text, "; ".join(errors)])) + ".")]


def _what(diagnosis: Diagnosis) -> list[Block]:
    """Probabilities, held-out errors, sizes, the bias of the plain fit, what is unexplained."""
    blocks: list[Block] = []
    if diagnosis.effects or diagnosis.rivals:
        text = "Every effect of the catalogue was fitted, alone and in combination."
        named = {x for effect in diagnosis.effects for x in (effect.group or (effect.effect,))}
        fitted = {e.effect for joint in diagnosis.model.joints.values() for e in joint.effects}
        if others := listed([plain(name) for name in sorted(fitted - named)]):
            text += " The written model was selected for prediction and also contains "
            text += f"{others}; this does not imply that they are present."
        coloured = " Coloured: effects named above." if diagnosis.effects else ""
        caption = f"Probability of each candidate.{coloured}"
        drawing = svg(candidate_figure(diagnosis))
        blocks += [Text(text, heading="What is missing"), Figure(drawing, caption)]
    blocks += [*_ladders(diagnosis), *effect_tables(diagnosis), *_shifts(diagnosis)]
    for mismatch in diagnosis.mismatch:
        joint, text = mismatch.component, mismatch.remainder
        unknown = diagnosis.unknown.get(joint, 0.0)
        if unknown > 0.5 or diagnosis.verdict == "unexplained":
            chance = f" The probability of that is {sure(unknown)}." if unknown > 0.5 else ""
            text = f"No effect in the catalogue explains the residual of {joint}.{chance} {text}"
        if text:
            blocks.append(Text(text.strip(), heading=f"Unexplained residual of {joint}"))
    return blocks


def _ladders(diagnosis: Diagnosis) -> list[Block]:
    differing = {mismatch.signal for mismatch in diagnosis.mismatch}
    rows = []
    for signal, fit in diagnosis.baseline_fit.items():
        joint, before, noise = signal.rpartition(".")[0], fit.get("heldout"), fit.get("noise")
        after = diagnosis.enriched_fit.get(signal, {}).get("heldout")
        if signal not in differing or before is None or after is None or noise is None:
            continue
        named = any(e.component in (joint, "supply", "link") for e in diagnosis.effects)
        with_effects = milliradians(after) if named else "–"
        rows.append((joint, milliradians(before), with_effects, milliradians(noise)))
    header = ("error of", "plain servo", "with the named effects", "sensor noise")
    return [Table(header, rows, _LADDER)] if rows else []


def effect_tables(diagnosis: Diagnosis) -> list[Block]:
    """Probability and size of each effect, with 90 % intervals."""
    blocks: list[Block] = []
    for effects, caption in (
        (diagnosis.effects, "Size of each effect, with its 90 % interval below."),
        (diagnosis.negligible, _NEGLIGIBLE),
    ):
        rows = []
        for effect in effects:
            bare = _per_inertia(diagnosis, effect.component)
            sizes = []
            for name, x in effect.parameters.items():
                value, low, high = (
                    readable(name, end, per_inertia=bare) for end in (x.mean, x.q05, x.q95)
                )
                estimate = value if low == high else f"{value}\n{low} – {high}"
                sizes.append((readable_name(name), estimate))
            what = (plain(effect.effect), effect.component, percent(effect.probability))
            rows += [(*what, *size) for size in sizes or [("", "")]]
        if rows:
            header = ("effect", "of", "probability", "number", "estimate")
            blocks.append(Table(header, rows, caption))
    return blocks


def _shifts(diagnosis: Diagnosis) -> list[Block]:
    """Change of each parameter of the servos in percent, values before and after."""
    joints = diagnosis.model.joints
    rows: dict[str, list[str]] = {}
    for effect in diagnosis.effects:
        holders = (n for n, j in joints.items() if effect.effect in {e.effect for e in j.effects})
        joint = effect.component if effect.component in joints else next(holders, "")
        if not joint or joint in rows:  # of effects that joints share, the first
            continue
        rows[joint] = []
        names = (("kp_Nm_per_rad", 1.0), ("kd_Nms_per_rad", 1.0), ("latency_s", 1e3))
        for (name, scale), shown in zip(names, quantities(joints[joint]), strict=False):
            before = shown.value - scale * effect.baseline_shift.get(name, 0.0)
            change = change_text(before, shown.value).replace("-", "−")
            rows[joint].append(f"{change}\n{before:.3g} to {shown.value:.3g} {shown.unit}")
    moved = [(name, *cells) for name, cells in rows.items() if any(x[:4] != "0 %\n" for x in cells)]
    return [Table(("servo", "kp", "kd", "latency"), moved, _SHIFTS)] if moved else []


def _next(diagnosis: Diagnosis) -> list[Block]:
    experiment = diagnosis.next_experiment
    if experiment is None:
        return []
    where = f" The command to play is in {experiment.file}." if experiment.file else ""
    blocks: list[Block] = [Text(experiment.statement + where, heading="What to record next")]
    if experiment.t is not None and experiment.signal is not None:
        group = SignalGroup(("next", COMMAND), "rad", experiment.t, {COMMAND: experiment.signal})
        caption = f"The command to play on {experiment.component}: {experiment.command}."
        blocks.append(series_block([Panel(group, "command, rad")], "next command", caption))
    return blocks


def _limits(diagnosis: Diagnosis) -> list[Block]:
    cells: dict[str, dict[str, str]] = {}
    for limit in diagnosis.detection_limits:
        bare = _per_inertia(diagnosis, limit.component)
        sizes = ((name, x) for name, x in limit.smallest.items() if x is not None)
        text = "\n".join(readable(name, x, per_inertia=bare) for name, x in sizes)
        cells.setdefault(limit.effect, {})[limit.component] = text or "–"
    places = tuple(dict.fromkeys(limit.component for limit in diagnosis.detection_limits))
    rows = [(plain(x), *(row.get(place, "–") for place in places)) for x, row in cells.items()]
    if not rows:
        return []
    text = "Effects smaller than these cannot be detected in these recordings."
    return [Text(text, heading="Detection limits"), Table(("effect", *places), rows, _LIMITS)]
