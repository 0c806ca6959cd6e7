"""What one who knows a plant, its parameters and its noise can tell; nuisances count as noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from bench import JOINTS
from foreign_cases import ForeignCase, with_gains
from foreign_world import Hidden, acting_on
from likelihood import whiten
from numpy.typing import NDArray
from sensor import stick

Array = NDArray[np.float64]

GIVEN = ("a", "b")
ROUNDS = 3
STEPS = np.array([0.01, 0.02, 0.1])
PRACTICAL = 0.05
"""Share of the held-out error by which an effect must change it to matter."""


def consult(case: ForeignCase, given: Sequence[str] = GIVEN) -> dict[str, Any]:
    """What the answers say under ``oracle``; rms in rad, ratios in natural logarithms.

    Args:
        case: The bench.
        given: Names of the recordings that are known; ``c`` is held out.
    """
    said: dict[str, Any] = {"heldout_floor_rad": _floor(case)}
    if not case.hidden:
        return said
    said |= {"llr": {}, "missing_rms_rad": {}, "heldout_plain_rad": {}, "heldout_share": {}}
    for j in _affected(case, case.hidden):
        llr, rms, plain, bare = _told(case, case.hidden, [], j, given)
        name = JOINTS[j]
        said["llr"][name], said["missing_rms_rad"][name] = llr, rms
        said["heldout_plain_rad"][name] = plain
        said["heldout_share"][name] = plain / bare - 1
    said["llr_total"] = float(sum(said["llr"].values()))
    shares = list(said["heldout_share"].values())
    said["practical"] = bool(max(shares) > PRACTICAL)
    if len(case.hidden) > 1:
        said["llr_of_each"], said["practical_of_each"] = {}, {}
        for one in case.hidden:
            rest = [h for h in case.hidden if h is not one]
            told = [_told(case, case.hidden, rest, j, given) for j in _affected(case, [one])]
            label = f"{one.effect}@{one.component}"
            said["llr_of_each"][label] = float(sum(t[0] for t in told))
            said["practical_of_each"][label] = bool(max(t[2] / t[3] - 1 for t in told) > PRACTICAL)
    return said


def _affected(case: ForeignCase, hidden: list[Hidden]) -> list[int]:
    if any(h.joint is None for h in hidden):
        return list(range(len(case.servos)))
    return sorted({h.joint for h in hidden if h.joint is not None})


def _readings(
    case: ForeignCase, recording: str, hidden: list[Hidden], j: int, offsets: Array
) -> Array:
    servos = list(case.servos)
    servos[j] = with_gains(servos[j], offsets)
    reading = case.readings(recording, hidden, servos, [j])[:, j]
    take = case.takes[recording]
    if "stuck_sensor" in acting_on(hidden, j):
        # What it sticks to is the reading before, noise and all.
        stuck = stick(take.measured[:, j], take.t, take.windows)
        for start, stop in take.windows:
            inside = (take.t >= start) & (take.t < stop)
            reading[inside] = stuck[inside]
    return reading


def _told(
    case: ForeignCase, hidden: list[Hidden], without: list[Hidden], j: int, given: Sequence[str]
) -> tuple[float, float, float, float]:
    """Log-likelihood ratio, rms apart, and held-out error without and with; nuisances as noise."""
    servo, zero = case.servos[j], np.zeros(3)
    noise = _with_nuisances(case, hidden, j)
    coarse = acting_on(hidden, j).get("encoder_quantization", {}).get("step_rad")
    step = servo.sensor.step_rad if "encoder_quantization" in acting_on(without, j) else coarse
    sensor = replace(servo.sensor, white_rad=noise)

    def white(offsets: Array, world: list[Hidden], rounding: float) -> tuple[Array, float]:
        parts, total = [], 0.0
        for recording in given:
            take = case.takes[recording]
            left = take.measured[:, j] - _readings(case, recording, world, j, offsets)
            one, likely = whiten(left, take.t, sensor, rounding)
            parts.append(one)
            total += likely + np.isfinite(left).sum() * np.log(rounding / sensor.step_rad)
        return np.concatenate(parts), float(total)

    plain_step = servo.sensor.step_rad
    truth = white(zero, hidden, step or plain_step)[1]
    offsets, best = zero.copy(), -np.inf
    kept = offsets
    for _ in range(ROUNDS):
        residual, likely = white(offsets, without, plain_step)
        if likely <= best:
            break
        best, kept = likely, offsets
        columns = []
        for k in range(3):
            moved = offsets.copy()
            moved[k] += STEPS[k]
            columns.append((white(moved, without, plain_step)[0] - residual) / STEPS[k])
        slope = np.stack(columns, axis=1)
        offsets = offsets - np.clip(np.linalg.lstsq(slope, residual, rcond=1e-8)[0], -0.5, 0.5)
    apart = np.concatenate(
        [_readings(case, r, hidden, j, zero) - _readings(case, r, without, j, kept) for r in given]
    )
    take = case.takes["c"]
    unseen = take.measured[:, j] - _readings(case, "c", without, j, kept)
    known = take.measured[:, j] - _readings(case, "c", hidden, j, zero)
    more = noise**2 - servo.sensor.white_rad**2
    plain, bare = (float(np.sqrt(np.nanmean(x**2) + more)) for x in (unseen, known))
    return truth - best, float(np.sqrt(np.nanmean(apart**2))), plain, bare


def _with_nuisances(case: ForeignCase, hidden: list[Hidden], j: int) -> float:
    """White noise of a joint, rad, with cogging and eccentricity taken for noise."""
    servo = case.servos[j]
    smooth = replace(servo, nuisances={**servo.nuisances, "ripple_Nm": 0.0})
    servos = [smooth if k == j else s for k, s in enumerate(case.servos)]
    take = case.readings("a", hidden, None, [j])[:, j]
    clean = case.readings("a", hidden, servos, [j], bent=False)[:, j]
    return float(np.hypot(servo.sensor.white_rad, np.std(take - clean)))


def _floor(case: ForeignCase) -> dict[str, float]:
    """Held-out error of the truth without its nuisances, by joint, rad."""
    servos = [replace(s, nuisances={**s.nuisances, "ripple_Nm": 0.0}) for s in case.servos]
    seen = case.readings("c", None, servos, bent=False)
    left = case.takes["c"].measured - seen
    rms = np.sqrt(np.nanmean(left**2, axis=0))
    return {joint: float(x) for joint, x in zip(JOINTS, rms, strict=False)}
