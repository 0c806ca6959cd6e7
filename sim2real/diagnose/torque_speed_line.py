"""The motor's limit of torque, as the data sheet states it, of joints whose model has none."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.case import UNMODELLED_INERTIA, JointCase
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.gear_trains import of_inertia
from sim2real.diagnose.screening import NUISANCES, with_effects
from sim2real.diagnose.servo_search import BLOCKS, ServoSearch, evidence_of
from sim2real.effects import named
from sim2real.identification.problem import ServoProblem
from sim2real.identification.servo_problem import (
    FLAT_COLUMNS,
    SATURATION,
    Hypothesis,
    Set,
    Tried,
    minimise,
    plain_servos,
    without_flat_limit,
)
from sim2real.model import Law
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import COLUMNS, LINE_COLUMNS, stated
from sim2real.servo.trace import Trace

_SET_POINT_SPEED = COLUMNS.index("rate_limit.limit_rad_s")
_ROTORS = 0.05, 0.2, 0.4
"""Inertia of rotors over that of the load to start from, where torques may show it."""


def with_limits(
    search: ServoSearch, tried: Sequence[Tried], *, rivals: int = 6
) -> dict[int, JointCase]:
    """Joints that reach their motor's limit, with a plain model that has it.

    The limit is a line of torque and speed, or flat: the data sheet's torque at any speed. A line
    may have a lower limit of current as well: an effect, tried by the search. The limit joins what
    explains each joint best at first sight, or stands in for one of its effects, and is there where
    none of ``rivals`` further effects explains more. Where slow errors are part of the noise it is
    an effect like others: little of what tells it from a limited set-point shows at first sight.
    """
    limited: dict[int, JointCase] = {}
    for known in tried:
        joint, row = search.joints[known.case], known.best.fit.servos.theta[0]
        open_to_all = joint.references or joint.base or joint.traces[0].slow is not None
        if open_to_all or joint.stall_Nm is None or row[LINE_COLUMNS].any():
            continue
        limit = _better_limit(search, known)
        if limit is not None and known.best.members != known.base:
            best = known.best
            further = search.additions(known, best.members, rivals)
            search.try_all([(known, best.members | {name}, start) for name, start in further])
            limit = limit if known.best is best else _better_limit(search, known)
        if limit is None:
            continue
        law: Law = "motor"
        theta, also = limit.fit.servos.theta[0].copy(), joint.stated
        if theta[LINE_COLUMNS].any() and SATURATION in limit.members:
            found = limit.members - {e.name for e in NUISANCES}
            rows = [of_inertia(theta, joint.traces[0].load.inertia_kgm2, x) for x in _ROTORS]
            sets = [(found | {UNMODELLED_INERTIA}, row) for row in rows]
            also = (*also, (found, theta.copy()), *sets)
            theta[FLAT_COLUMNS] = 0.0
        elif SATURATION in limit.members:
            theta, law = without_flat_limit(theta), "current_limited"
        model = stated(theta, joint.traces[0].load, law=law)
        limited[known.case] = replace(joint, model=model, stated=also)
    return limited


def _better_limit(search: ServoSearch, tried: Tried) -> Hypothesis | None:
    """The best limit with the best set of effects, or in place of one of them, if it is better."""
    best = tried.best
    alike = [e for e in best.members - tried.base if named(e).site in ("command", "motor")]
    sets = [best.members, *(best.members - {e} for e in alike)]
    limits = [limit for members in sets for limit in _limits(search, tried, members)]
    limit = max(limits, key=lambda one: one.evidence)
    without = tried.tried.get(limit.members - {SATURATION}, tried.plain)
    least = max(best.evidence, without.evidence + DECISION.decisive_gain)
    return limit if limit.evidence > least else None


def _limits(search: ServoSearch, tried: Tried, members: Set) -> Iterator[Hypothesis]:
    """Fits of a joint's effects together with a limit of its motor."""
    joint = search.joints[tried.case]
    assert joint.servo is not None and joint.stall_Nm is not None
    line = tried.best.fit.servos.theta[0].copy()
    line[LINE_COLUMNS] = joint.stall_Nm, joint.servo.no_load_speed_rad_s
    line[FLAT_COLUMNS] = 0.0
    yield _fitted(search, tried, members - {SATURATION}, line)
    line[FLAT_COLUMNS] = 0.5 * joint.stall_Nm, 0.05
    both = _fitted(search, tried, members | {SATURATION}, line)
    yield replace(both, evidence=both.evidence - DECISION.decisive_gain)
    flat = tried.best.fit.servos.theta[0].copy()
    flat[FLAT_COLUMNS] = joint.stall_Nm, 1.0
    found = _fitted(search, tried, members | {SATURATION}, flat)
    if found.fit.servos.theta[0, FLAT_COLUMNS[0]] > DECISION.data_sheet_share * joint.stall_Nm:
        # At the data sheet's torque it is the motor's law by another name.
        yield replace(found, evidence=found.evidence - LOG_PRIOR)


def _fitted(search: ServoSearch, tried: Tried, members: Set, row: Array) -> Hypothesis:
    """The fit of a joint with these effects from a row (P,), whose line is free if it has one."""
    batch, j = search.batch, tried.case
    inertia = batch.inertia[[j]]
    plain = plain_servos(np.array([j]), row[None], inertia, batch.period, free_line=True)
    start = with_effects(plain, members, row, float(inertia[0]))
    fit = minimise(batch, start, iterations=15, blocks=BLOCKS)
    return Hypothesis(members, fit, evidence_of(fit, members - tried.base))


def with_stated_line(
    traces: Sequence[Trace], servo: Servo, row: Array, *, largest_cost: float = 2.0
) -> Array:
    """A servo's parameters (P,) with its data sheet's line, if the recordings do not determine it.

    Without a line, faster motions would be predicted with unlimited torque; but where the speed of
    the set-point is limited, so are the errors of control, and no line is needed. If the recordings
    exclude the stated torque, the smallest larger one that they allow is used, up to twice the
    stated one, otherwise no line; likewise if the load is unknown. A line is excluded if it costs
    more than ``largest_cost`` of log-likelihood, about the effect of chance on one parameter.
    """
    known = row[LINE_COLUMNS].any() or row[_SET_POINT_SPEED] > 0
    if known or traces[0].load is PER_INERTIA:
        return row
    larger = np.linspace(1.0, 2.0, 26)
    rows = np.tile(row, (1 + larger.size, 1))
    rows[1:, LINE_COLUMNS[0]] = servo.max_torque_Nm * larger
    rows[1:, LINE_COLUMNS[1]] = servo.no_load_speed_rad_s
    residuals = ServoProblem(traces, rows[1], ()).row_residuals(rows)
    squares = np.sum(residuals**2, axis=1)
    allowed = 0.5 * residuals.shape[1] * np.log(squares[1:] / squares[0]) < largest_cost
    return np.asarray(rows[1 + np.argmax(allowed)] if allowed.any() else row)
