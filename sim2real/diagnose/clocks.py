"""Corrects recordings for the drift between the clocks of set-points and angles.

Set-points and angles are stamped by two clocks. Quartz oscillators differ by
some 20 ppm, by another amount in each recording: a millisecond after half a minute, which a good
sensor detects, and which needs no action. A larger drift is an effect and is not corrected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.case import JointCase
from sim2real.diagnose.decision import DECISION
from sim2real.identification.servo_problem import Hypothesis, variants
from sim2real.servo.batch import STEPS_PER_RADIAN, Batch, Problems
from sim2real.servo.parameters import COLUMNS, INERTIA_LEFT_OUT
from sim2real.servo.rollout import LONGEST_SUBSTEP_S, rollout_on
from sim2real.servo.trace import Trace

_DRIFT = COLUMNS.index("clock_drift.s_per_s")


def on_one_clock(
    batch: Batch,
    joints: Sequence[JointCase],
    robots: Sequence[Sequence[int]],
    best: Sequence[Hypothesis],
) -> list[JointCase]:
    """The joints, their angles as the clock of the set-points would have stamped them.

    Args:
        batch: The recordings.
        joints: The joints.
        robots: Which of them were recorded together.
        best: What explains each best as yet.
    """
    corrected = list(joints)
    for robot in robots:
        files = sorted({trace.file for j in robot for trace in joints[j].traces})
        information, slope = np.zeros((len(files), len(files))), np.zeros(len(files))
        for j in robot:
            place = [files.index(trace.file) for trace in joints[j].traces]
            known, pull = _known(batch, best[j], len(place))
            information[np.ix_(place, place)] += known
            slope[place] += pull
        inverse = np.linalg.pinv(information, rcond=1e-10, hermitian=True)
        sd = np.sqrt(np.maximum(np.diag(inverse), 0.0))
        if (np.abs(inverse @ slope) > DECISION.clock_tolerance + 2 * sd).any():
            continue
        prior = np.eye(len(files)) * (2 / DECISION.clock_tolerance) ** 2
        drift = dict(zip(files, np.linalg.solve(information + prior, slope), strict=True))
        for j in robot:
            moved = []
            for trace in joints[j].traces:
                angle = _simulated(trace, best[j].fit.servos.theta[0])
                late = (trace.t - trace.t[0]) * np.gradient(angle, trace.t)
                moved.append(replace(trace, position=trace.position + drift[trace.file] * late))
            corrected[j] = replace(joints[j], traces=moved)
    return corrected


def _simulated(trace: Trace, theta: Array) -> Array:
    """Angles in rad of a servo (P,) on the command and load of a recording, shape (T,)."""
    kp, kd, inertia = float(theta[0]), float(theta[1]), trace.load.inertia_kgm2
    inertia += float(theta[INERTIA_LEFT_OUT])
    fastest = max(float(np.sqrt(max(kp, 0.0) / inertia)), 0.5 * kd / inertia, 1e-9)
    step = min(LONGEST_SUBSTEP_S, 1 / (STEPS_PER_RADIAN * fastest))
    return np.asarray(rollout_on(trace, theta[None], substep_s=step)[0])


def _known(
    batch: Batch, best: Hypothesis, recordings: int, *, step: float = 1e-4
) -> tuple[Array, Array]:
    """What a joint tells of a drift in each of its recordings: information (R, R), slope (R,).

    After the parameters that all recordings share have taken up what they can. The response to a
    drift of ``step`` stands for that to any.
    """
    servos = best.fit.servos
    own = variants(servos)
    kept = [0, *(1 + np.flatnonzero(servos.columns[0] != _DRIFT)), 0]
    theta, scale = own.theta[:, kept], own.scale[:, kept]
    theta[0, -1, _DRIFT] += step
    scale[0, -1] = 1 / step
    problem = Problems(servos.joint, theta, scale)
    gram = batch.evaluate(problem, autoregression=best.fit.autoregression).gram[0]
    gram = gram[:recordings] * float(best.fit.count[0] / best.fit.error2[0])
    shared = gram[:, 1:-1, 1:-1].sum(axis=0)
    across = gram[:, 1:-1, -1].T  # shape (F, R)
    taken = across.T @ np.linalg.pinv(shared, rcond=1e-12, hermitian=True)
    information = np.diag(gram[:, -1, -1]) - taken @ across
    slope = -(gram[:, 0, -1] - taken @ gram[:, 0, 1:-1].sum(axis=0))
    return information, slope + information.sum(axis=1) * servos.theta[0, _DRIFT]
