"""From recordings to a diagnosis: is something missing, where, what, and what to do next."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim2real.arm.arm_loads import with_arm_loads
from sim2real.arrays import Array
from sim2real.diagnose.calibrated_odds import judged_and_offered
from sim2real.diagnose.case import (
    Case,
    JointCase,
    batch_of,
    on_one_clock,
    prepared,
    simulated,
    with_slow_errors,
)
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.effect_search import first_look
from sim2real.diagnose.investigate import placed
from sim2real.diagnose.joint_result import JointFindings
from sim2real.diagnose.references import findings_of, with_known_servos
from sim2real.diagnose.result import Diagnosis
from sim2real.diagnose.rival_sets import with_open_sets
from sim2real.diagnose.screening import NUISANCES
from sim2real.diagnose.servo_search import ServoSearch, baselines, plain_sets
from sim2real.diagnose.torque_speed_line import with_limits
from sim2real.diagnose.wording import diagnosis
from sim2real.effects import named
from sim2real.identification.held_out import Unseen, held_out
from sim2real.identification.identify import fitted_joint
from sim2real.identification.joint_fit import refitted
from sim2real.identification.reading_noise import without_releases
from sim2real.identification.servo_problem import (
    Hypothesis,
    Servos,
    Tried,
    joined,
    minimise,
    minimise_robustly,
    residual_angles,
    stacked,
)
from sim2real.inference.normal import LEVEL
from sim2real.model import JointModel, Model
from sim2real.noise import ABOVE_NOISE
from sim2real.output import sha256_of
from sim2real.plausible import admitted
from sim2real.progress import Progress
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import BASE, COLUMNS, FIRST_COLUMN, LOOP, joint_row
from sim2real.servo.trace import Trace, at_one_gain, firmware_gain

__all__ = ["Case", "diagnose", "diagnose_case"]
_GIVEN = (*BASE[3:], *LOOP)
"""Parameters that are not fitted again: the load's, and the times of a sampled controller."""


def diagnose(
    recordings: Sequence[Recording],
    robot: Robot,
    *,
    model: Model | None = None,
    references: Sequence[Recording] = (),
    earlier: str | os.PathLike[str] | None = None,
    negligible: float = DECISION.negligible,
    effort: float = 1.0,
    interval: float = LEVEL,
    seed: int = 0,
    progress: Progress = lambda share: None,
) -> Diagnosis:
    """Find the physics that fitted servos leave out, see ``sim.verbs.diagnose``.

    Of ``earlier``, a diagnosis.json, the sets of effects that it left open are tried again;
    ``progress`` is called with the share that is done.

    Raises:
        InputError: If the recordings and the robot do not agree, or no joint moves.
    """
    if earlier is not None:
        recordings = with_open_sets(recordings, earlier)
    gain = None if model is None else model.firmware_p_gain
    everything = at_one_gain([*references, *recordings], gain)
    loaded = with_arm_loads(everything, robot, model)
    references, recordings = loaded[: len(references)], loaded[len(references) :]
    case = Case(recordings, robot, model, references, effort)
    result = diagnose_case(case, negligible=negligible, seed=seed, progress=progress)
    if model is None:
        gain = next(filter(None, map(firmware_gain, everything)), None)
    result = replace(result, model=replace(result.model, firmware_p_gain=gain))
    return result.with_intervals(interval)


def diagnose_case(
    given: Case,
    *,
    negligible: float = DECISION.negligible,
    seed: int = 0,
    progress: Progress = lambda share: None,
) -> Diagnosis:
    """Diagnose one robot."""
    case, joints = examined(given, seed=seed, progress=progress)
    result = diagnosis(case, joints, negligible, seed)
    progress(1.0)
    return result


def examined(
    case: Case, *, seed: int = 0, progress: Progress = lambda share: None
) -> tuple[Case, list[JointFindings]]:
    """The case with the servos that were taken for granted, and what is known of each joint."""
    kept, warnings = admitted((*case.recordings, *case.references), case.robot)
    count, rng = len(case.recordings), np.random.default_rng(seed)
    case = replace(case, recordings=kept[:count], references=kept[count:], warnings=warnings)
    case = with_known_servos(_with_laws_open(case), rng)
    recorded = prepared(case)
    joints, first = _first_look(recorded, rng)
    joints = [with_slow_errors(*pair) for pair in zip(joints, (x.best for x in first), strict=True)]
    if not any(joint.references for joint in joints):
        batch = batch_of(joints)
        joints = on_one_clock(batch, joints, [tried.best for tried in first])
    batch = batch_of(joints)
    aligned, findings = findings_of(
        batch, joints, first, rng=rng, progress=lambda share: progress(0.8 * share)
    )
    joints, batch = list(aligned), batch_of(aligned)
    found = judged_and_offered(joints, findings)
    plain = [one.finding.tried.plain for one in found]
    before = residual_angles(batch, joined([servo.fit for servo in plain]))
    after = residual_angles(batch, joined([one.offered.fit for one in found]))
    # As they were recorded, whatever the clocks say.
    as_read = [
        [replace(t, position=x.position) for t, x in zip(joint.traces, old.traces, strict=True)]
        for joint, old in zip(joints, recorded, strict=True)
    ]
    robust = [_least_squares(*of_joint) for of_joint in zip(joints, as_read, plain, strict=True)]
    return case, [
        replace(
            one,
            before=before[j],
            after=after[j],
            least_squares=robust[j],
            robust=_robust(joints[j], as_read[j], one.offered) if one.adds_effects else robust[j],
            identified=_identified(joints[j], recorded[j].traces, one, seed),
        )
        for j, one in enumerate(found)
    ]


def _with_laws_open(case: Case) -> Case:
    """The case without the laws of servos that were identified from these same recordings."""
    # They tell nothing that the recordings do not, so that the answer is that without a model.
    # Effects of a given servo remain part of it, as does what other recordings told of it.
    if case.model is None or case.references:
        return case
    files = [recording.path for recording in case.recordings if recording.path]
    known = case.model.provenance.get("inputs")
    told = set(known.values()) if isinstance(known, Mapping) else set()
    if len(files) < len(case.recordings) or not told.issuperset(map(sha256_of, files)):
        return case
    joints = {name: joint for name, joint in case.model.joints.items() if joint.effects}
    return replace(case, model=replace(case.model, joints=joints))


def _first_look(
    joints: Sequence[JointCase], rng: np.random.Generator
) -> tuple[list[JointCase], list[Tried]]:
    """The joints, with their motor's limit where that shows, and every set that was tried."""
    joints = list(joints)
    batch = batch_of(joints)
    tried, search = _looked(batch, joints, rng)
    limited = with_limits(search, tried)
    changed = set(limited)
    for j, joint in enumerate(joints):
        row = tried[j].best.fit.servos.theta[0]
        kept = [without_releases(x, simulated(x, row)) for x in joint.traces]
        if any(new is not old for new, old in zip(kept, joint.traces, strict=True)):
            changed.add(j)
        joints[j] = replace(limited.get(j, joint), traces=kept)
    order = sorted(changed)
    if order:
        some = [joints[j] for j in order]
        again = batch_of(some, period=batch.period)
        for j, one in zip(order, _looked(again, some, rng)[0], strict=True):
            tried[j] = placed(one, j)
    return joints, tried


def _looked(
    batch: Batch, joints: Sequence[JointCase], rng: np.random.Generator
) -> tuple[list[Tried], ServoSearch]:
    """What was tried on each joint at first sight, and what may be asked further."""
    plain = baselines(batch, [joint.model for joint in joints])
    tried = plain_sets(plain, [joint.base for joint in joints])
    search = ServoSearch(batch, joints, DECISION.false_alarms, rng)
    if not all(joint.references for joint in joints):
        first_look(search, tried)
    return tried, search


def _least_squares(joint: JointCase, traces: Sequence[Trace], servo: Hypothesis) -> Array:
    """A servo as ``identify`` fits it, with what every servo has a little of fixed, shape (P,)."""
    # A fit with a free noise model takes what is missing for noise, and predicts worse.
    if joint.references:  # as fitted to these, and to the case what has changed since
        return np.asarray(servo.fit.servos.theta[0])
    effects = [named(effect) for effect in sorted(servo.members)]
    theta = servo.fit.servos.theta[0]
    return refitted(traces, theta, [e for e in effects if e.fitted and not e.everywhere]).row


def _robust(joint: JointCase, traces: Sequence[Trace], servo: Hypothesis) -> Array:
    """The same, each reading weighted by its error where that differs between them, shape (P,)."""
    if joint.references or traces[0].spread is None:
        return _least_squares(joint, traces, servo)
    servos = servo.fit.servos
    owners = [COLUMNS[c].partition(".")[0] for c in servos.columns[0]]
    fixed = [owner in {e.name for e in NUISANCES} for owner in owners]
    columns = np.where(fixed, -1, servos.columns).astype(np.int32)
    start = replace(servos, columns=columns).of_joints([0])
    traces = [replace(trace, spread=trace.error_ratio, slow=None) for trace in traces]
    # Stiffness and friction stand in for one another at rest, in a long valley which the search of
    # effects leaves open and a prediction does not.
    frictions = [FIRST_COLUMN[e] for e in servo.members if named(e).site == "friction"]
    valley = np.isin(np.arange(len(COLUMNS)), [0, 1, *frictions])
    factors = np.where(valley, [[1.0], [1.4], [2.0]], 1.0)
    along = [replace(start, theta=start.theta * factor) for factor in factors]
    starts = stacked([one.at(one.values()) for one in along])  # within their bounds
    white = minimise(Batch([traces], white=True), starts, iterations=20)
    best = white.servos[np.array([int(np.nanargmin(white.error2))])]
    fit = minimise_robustly([traces], best, iterations=20)
    return np.asarray(fit.servos.theta[0])


def _identified(
    joint: JointCase, recorded: list[Trace], found: JointFindings, seed: int
) -> tuple[JointModel, Unseen] | None:
    """The servo as ``identify`` fits it, and its errors on held-out data, where these are smaller.

    None where what is offered leaves little more than noise.
    """
    offered, lasting = found.unseen.get(found.offered.members), joint.traces[0].slow is not None
    if joint.references or joint.base or offered is None:
        return None
    if not lasting and offered.error < ABOVE_NOISE * joint.noise:
        return None
    model = fitted_joint(recorded, joint.servo, seed)
    row = joint_row(model, joint.traces[0].load)
    present = np.flatnonzero(row)
    columns = np.array([c for c in present if COLUMNS[c] not in _GIVEN], dtype=np.int32)
    value, none = np.abs(row[columns])[None], np.zeros(1, dtype=np.int32)
    start = Servos(none, row[None], columns[None], value, value / 4, 4 * value)
    (unseen,) = held_out([joint.traces], [start])
    if unseen is None:
        return None
    if lasting:  # which no search can tell from physics
        servos, several = [start, found.offered.fit.servos], len(joint.traces) > 1
        less, more = held_out([joint.traces] * 2, servos, whole=several)
        if less is None or more is None:
            return None
        chosen = not more.clearly_better(less, DECISION.negligible)
    else:
        chosen = unseen.error < (1 - DECISION.min_improvement) * offered.error
    return (model, unseen) if chosen else None
