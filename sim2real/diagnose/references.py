"""Against references: the question is what has changed since, not what a servo lacks.

A change that has no name shows in what the named ones leave: too much, or jumps, which no torque on
a shaft makes.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit

from sim2real.arrays import Array, Index
from sim2real.diagnose.case import Case, JointCase, batch_of, prepared
from sim2real.diagnose.change import LOAD, Change, Comparison, compared, mostly_left
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.effect_probabilities import EffectPosterior, Group
from sim2real.diagnose.explained import (
    LOAD_COLUMNS,
    Changes,
    Explained,
    explained,
    noise_of,
    way_of,
)
from sim2real.diagnose.investigate import ROUNDING, Finding, investigate
from sim2real.diagnose.link_effect import link_of
from sim2real.diagnose.result import Experiment
from sim2real.diagnose.screening import with_effects
from sim2real.diagnose.servo_search import BLOCKS, ServoSearch, plain_sets
from sim2real.diagnose.unmodelled import Windows, unmodelled
from sim2real.effects import named
from sim2real.identification.joint_fit import EXPLAINED, choose_motor
from sim2real.identification.priors import motor_prior, of_effects, plain_parameters
from sim2real.identification.problem import Fit, ServoProblem
from sim2real.identification.reading_noise import without_wrong_readings
from sim2real.identification.search import first_guess, fit
from sim2real.identification.servo_problem import (
    Fits,
    Hypothesis,
    Servos,
    Tried,
    joined,
    minimise,
    plain_servos,
)
from sim2real.inference.correlated_noise import correlation_samples
from sim2real.inference.evidence import student
from sim2real.inference.least_squares import rms
from sim2real.inference.segments import Window
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.progress import Progress
from sim2real.robot import Servo
from sim2real.servo.batch import Batch
from sim2real.servo.linearised import Residual
from sim2real.servo.parameters import COLUMNS, FIRST_COLUMN, LOSSES, RATE_LIMIT, joint_row, stated
from sim2real.servo.trace import Trace, sensor_noise, traces

_LIMIT = COLUMNS.index(RATE_LIMIT)


def with_known_servos(case: Case, rng: np.random.Generator) -> Case:
    """The case, its model the law of the servos that made its references where none is given.

    InputError if references and robot do not agree, or no joint moves in them.
    """
    if not case.references:
        return case
    prepared(replace(case, recordings=case.references, references=()))
    if case.model is not None:
        return case
    joints = {}
    for joint in case.robot.joints:
        references = [without_wrong_readings(t) for t in traces(case.references, joint.name)]
        now = traces(case.recordings, joint.name)
        if references and now:
            joints[joint.name] = law_of(references, now, joint.servo, rng)
    return replace(case, model=Model(joints=joints))


def law_of(
    references: list[Trace], case: Sequence[Trace], servo: Servo, rng: np.random.Generator
) -> JointModel:
    """The law of the servo that made the references; the linear one where only rests count."""
    load = references[0].load
    starts = first_guess(references, rng)
    parameters = plain_parameters(references, starts[0])
    plain = fit(ServoProblem(references, starts[0], parameters), starts)
    if way_of(references, case) == "rest":
        return stated(plain.row, load)
    motor = choose_motor(plain, servo, rng)
    if rms([motor.error]) < EXPLAINED * sensor_noise(references):
        return stated(motor.row, load, motor.effects, motor.law)
    row = _with_losses(motor, servo)
    limit = float(row[_LIMIT])
    limits = (FittedEffect("rate_limit", {"limit_rad_s": limit}),) if limit else ()
    return stated(row, load, (*motor.effects, *limits), motor.law)


def _with_losses(motor: Fit, servo: Servo) -> Array:
    """A motor with losses and a limit of its set-point's speed, as far as references show these."""
    # Noise that grows with speed hides in one common scale what slow motions show.
    row, traces = motor.row.copy(), motor.problem.traces
    row[3:5] = 0.0
    limit = of_effects([named("rate_limit")], row, motor.inertia)
    free = {p.name: p for p in (*motor_prior(servo, traces).of(LOSSES), *motor.parameters)}
    starts = np.tile(row, (6, 1))
    starts[:, _LIMIT] = servo.no_load_speed_rad_s * np.array([0.0, 0.75, 1.1, 0.0, 0.75, 1.1])
    starts[3:, [COLUMNS.index(name) for name in LOSSES[2:6]]] = 0.1
    starts[:, COLUMNS.index(LOSSES[6])] = row[COLUMNS.index(LOSSES[6])] or 0.5
    for parameters in ((*free.values(), *limit), tuple(free.values())):
        problem = Changes(traces, row, parameters, motor.problem.ties)
        noise = noise_of(problem.error, problem.speed, 1e-6)
        times = [correlation_samples(x) for x in problem.by_trace(problem.error)]
        problem = problem.weighted(noise, times, law_error=0.0)
        better = fit(problem, starts, rounds=2, first=15, later=10, last=20)
        before = problem.loss(problem.searched(row[None]), problem.error[None], 1.0, 1.0)[0]
        if 0.5 * (before - better.loss(1.0)) > DECISION.decisive_gain:
            return better.row
    return motor.row


def findings_of(
    batch: Batch,
    joints: Sequence[JointCase],
    known: Sequence[Tried],
    *,
    rng: np.random.Generator,
    progress: Progress = lambda share: None,
) -> tuple[Sequence[JointCase], list[Finding]]:
    """What each joint of a robot is missing, or what of it has changed if it has references.

    ``known`` is what a first look tried. The joints are returned as their recordings were aligned.
    """
    referred = [j for j, x in enumerate(joints) if x.references and x.model and x.servo]
    if len(referred) < len(joints):
        joints, findings = investigate(batch, joints, known, rng=rng, progress=progress)
        batch = batch_of(joints, period=batch.period)
    else:
        findings = _not_searched(batch, joints, rng)
    for count, j in enumerate(referred):
        findings[j] = _against_references(batch, joints[j], findings[j])
        progress((count + 1) / len(referred))
    return joints, findings


def _not_searched(
    batch: Batch, joints: Sequence[JointCase], rng: np.random.Generator
) -> list[Finding]:
    """Findings of joints that are compared with their references: nothing as yet."""
    rows = [joint_row(x.model, x.references[0].load, x.name) for x in joints if x.model]
    places = np.arange(len(joints))
    plain = _evaluated(batch, plain_servos(places, np.array(rows), batch.inertia, batch.period))
    cases = plain_sets(plain, [joint.base for joint in joints])
    without = unmodelled(batch, [x.traces for x in joints], joined([t.plain.fit for t in cases]))
    search = ServoSearch(batch, joints, DECISION.false_alarms / len(joints), rng)
    return [
        Finding(
            tried=tried,
            search=search,
            posterior=EffectPosterior((tried.base,), np.ones(1)),
            best=tried.plain,
            mismatch=False,
            unexplained=False,
            groups=(),
            unmodelled=one,
            excess=1.0,
            noise=joint.noise,
        )
        for joint, tried, one in zip(joints, cases, without, strict=True)
    ]


def _evaluated(batch: Batch, servos: Servos) -> Fits:
    """Servos as they are, with what a fit states of them."""
    return minimise(batch, servos, iterations=1, blocks=BLOCKS)


def _against_references(batch: Batch, joint: JointCase, finding: Finding) -> Finding:
    """The finding in which only what differs from the joint's references, if any, is named."""
    assert joint.model is not None and joint.servo is not None
    references, tried = joint.references, finding.tried
    row, load = joint_row(joint.model, references[0].load, joint.name), references[0].load
    change = what_changed(references, joint.traces, row, joint.servo, joint.step_rad or 0.0)
    best = tried.plain
    if change.named and change.link is None:
        row, members = change.row.copy(), tried.base | change.effects
        for k, effect in enumerate(LOAD_COLUMNS.values(), start=3):
            row[FIRST_COLUMN[effect]] += row[k]
        row[3:5] = 0.0
        servos = with_effects(best.fit.servos, members, row, load.inertia_kgm2, tried.base)
        fit = _evaluated(batch, replace(servos, theta=row[None]))
        best = Hypothesis(members, fit, float(fit.loglikelihood[0]))
    likely = {n: p for n, p in change.probability.items() if n not in tried.base}
    order = sorted(likely, key=lambda n: -likely[n])
    sets = (tried.base, *(tried.base | {n} for n in order))
    probability = np.array([1 - sum(likely.values()), *(likely[n] for n in order)])
    coarser = _coarser(joint)
    coarse = (Group((ROUNDING,), coarser),) if coarser >= DECISION.named else ()
    nameless = change.nameless > DECISION.named
    return replace(
        finding,
        mismatch=bool(change.named or nameless or coarse),
        best=best,
        posterior=EffectPosterior(sets, probability),
        groups=(*coarse, *change.groups),
        unexplained=nameless,
        unknown=change.nameless,
        unmodelled=replace(finding.unmodelled, windows=change.windows),
        excess=max(change.left / DECISION.change.misfit_ratio, 1.0),
        sizes=change.sizes,
        link=change.link,
        place=0,
    )


def _coarser(joint: JointCase) -> float:
    """Probability that a joint's sensor is coarser than the references', and that is no chance."""
    grid = max(trace.quantization_step() for trace in joint.references)
    if joint.step_rad is None or joint.step_rad <= DECISION.coarse_step_ratio * grid:
        return 0.0
    levels = [np.unique(np.round(t.position[t.used] / joint.step_rad)) for t in joint.traces]
    gaps = sum(max(values.size - 1, 0) for values in levels)
    return float(expit(gaps * np.log(joint.step_rad / max(grid, 1e-12)) + LOG_PRIOR))


def what_changed(
    references: Sequence[Trace],
    case: Sequence[Trace],
    row: Array,
    servo: Servo,
    step_rad: float = 0.0,
) -> Change:
    """What of a joint differs from its references, whose servo has the parameters ``row`` (P,).

    ``step_rad`` is the step of the case's sensor where that is coarser than stated.
    """
    of = explained(references, case, row, servo.position_step_rad)
    if not of.case.any():
        return Change((Group((LOAD,), 0.0),), {}, row)
    by = Comparison(of, servo)
    return _with_nameless(by, compared(by), step_rad)


def _with_nameless(by: Comparison, change: Change, step_rad: float) -> Change:
    """The change, and what is in the case besides that it does not explain."""
    of, numbers = by.of, DECISION.change
    remaining = replace(of, row=change.row).residual if change.named else of.residual
    # beyond what is named, a law is wrong by a share of what it explains
    _, size, place = _jumps(of, of.residual - remaining)
    jump = float(size[place >= of.references].max(initial=0.0))
    windows = jump_windows(of, remaining, max(step_rad, numbers.law_error * jump))
    left = change.left if change.named else by.start
    limit = numbers.foreign_misfit if of.way == "law" else numbers.misfit_ratio
    foreign = not change.named and left > limit
    if of.way == "repeat" and not change.named:
        # What a link does never stops.
        covered = sum(last - first for pieces in windows or () for first, last in pieces)
        lasting = covered > 0.5 * sum(trace.duration_s for trace in of.traces[of.references :])
        late = _irregular_timing(of) if windows is None or lasting else None
        if late is not None:
            return late
    badly = of.way != "law" and bool(change.named) and mostly_left(by, left)
    if windows is None and not foreign and not badly:
        return change
    known = 1 - DECISION.uncatalogued_probability
    return replace(
        change,
        groups=tuple(replace(g, probability=known * g.probability) for g in change.groups),
        probability={n: known * p for n, p in change.probability.items()},
        nameless=DECISION.uncatalogued_probability,
        windows=windows,
    )


def _jumps(of: Explained, residual: Array) -> tuple[Array, Array, Index]:
    """Times, sizes and recordings of steps of a residual (n,) between neighbouring samples."""
    t = np.concatenate([trace.t[trace.used] for trace in of.traces])
    period = np.array([float(np.median(np.diff(trace.t))) for trace in of.traces])
    apart, place = np.diff(t), of.problem.recording
    good = (place[1:] == place[:-1]) & (apart < 1.5 * period[place[1:]])
    return t[1:][good], np.abs(np.diff(residual))[good], place[1:][good]


def jump_windows(of: Explained, residual: Array, step_rad: float = 0.0) -> Windows | None:
    """From the first to the last jump that no reference has, in each recording of the case.

    To the recording's end where there is but one jump, or where the residual (n,) stays far larger
    than before. None where there are none.
    """
    _, size, place = _jumps(of, of.residual)
    usual = max(float(size[place < of.references].max(initial=0.0)), step_rad, of.least_sd)
    if of.way == "rest":  # the residual may be nothing but a step of the sensor
        usual = max(usual, float(np.sqrt(12)) * of.least_sd)
    numbers = DECISION.change
    ratio = numbers.repeated_jump_ratio if of.way == "repeat" else numbers.jump_ratio
    at, size, place = _jumps(of, residual)
    windows: list[tuple[Window, ...]] = []
    for r, trace in enumerate(of.traces[of.references :], start=of.references):
        when = at[(place == r) & (size > ratio * usual)]
        if not when.size:
            windows.append(())
            continue
        first, last = float(when[0]), float(when[-1])
        t, error2 = trace.t[trace.used], residual[of.problem.recording == r] ** 2
        before, after = error2[t < first], error2[t > last]
        stays = when.size == 1
        if before.size and after.size and not stays:
            usual2 = max(float(np.mean(before)), float(np.mean(of.residual[~of.case] ** 2)))
            stays = float(np.mean(after)) > numbers.lasting_ratio**2 * usual2
        if stays:
            last = float(trace.t[-1])
        windows.append(((first, last),))
    return tuple(windows) if any(windows) else None


def _irregular_timing(of: Explained) -> Change | None:
    """Jitter of the link that no repeat has, or None."""
    period, links = of.traces[0].period_s, []
    if not all(trace.used.any() for trace in of.traces):  # of commands that no other has
        return None
    for r, trace in enumerate(of.traces):
        error = np.zeros(trace.t.size)
        error[trace.used] = -of.residual[of.problem.recording == r]
        residual = Residual(trace, error, *of.row[:3].tolist())
        links.append(link_of([[residual]], lags=2, least_gain=1.0))
    late = [u.sizes.get("latency_jitter", (0.0, np.inf))[0] for u in links]
    worst = max(range(of.references, len(links)), key=lambda r: late[r])
    if late[worst] > period / 2:  # set-points would overtake each other
        return None
    null2 = max(DECISION.change.jitter_min_share * period, *late[: of.references]) ** 2
    known = DECISION.change.null_known + of.references
    odds = student(late[worst] ** 2 / null2, known) + LOG_PRIOR
    sure = min(float(expit(odds)), DECISION.most_certain)
    if sure < DECISION.named:
        return None
    effect = links[worst].effect
    return Change((Group((effect,), sure),), {effect: sure}, of.row, link=links[worst])


def repeat(joints: Sequence[JointCase]) -> Experiment | None:
    """The command to send again, where it would tell more than the references can: the case's own.

    A recording of the same command as before knows of no missing physics that is in both.
    """
    for joint in joints:
        if joint.references and way_of(joint.references, joint.traces) == "law":
            trace = max(joint.traces, key=Trace.activity)
            command = f"the command of {trace.name}"
            text = (
                f"Repeat {command} on {joint.name} in the state of the references: the error of "
                "the model is the same in a repeated recording, so far smaller changes are "
                "detected."
            )
            t, signal = trace.t - trace.t[0], trace.command
            return Experiment(
                joint.name, (), command, "none", 0.0, trace.duration_s, text, t=t, signal=signal
            )
    return None
