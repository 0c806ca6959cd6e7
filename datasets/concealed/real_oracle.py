"""What could be seen of the changes in T2 by one who knows the rig, for the grader.

    python datasets/concealed/real_oracle.py SET --realdata DIR

Writes ``SET/oracle.json``, which ``grade.py`` reads. The oracle knows all recordings of a rig as
they were before anything was put in, those that are held out included, and the change itself. What
it cannot know is what the rig does beyond the best law there is. So it explains each untouched
recording as well as it can:

- a rig that repeats one command (EMPS): by the law and by the mean of what the law leaves of the
  other recordings;
- one sampled so slowly that it is mostly seen at rest (STS3215): by the mean of where the other
  recordings came to rest, after the same set-points of all joints and from the same side;
- any other (XL330): by the motor's law, fitted to all recordings of one condition.

What is left of unchanged recordings has a part along the direction in which the change would move
each of them. Its mean square over the recordings of the rig, and not less than rounding, is how
large a change of this kind looks where there is none, and ``llr`` half the mean square of the
change in the case over that: the log-likelihood ratio of the change against none, this being all
that hides it. Coarser rounding is read off the numbers: ``llr`` counts log(step ratio) for every
reading that differs from the one before.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from backgrounds import Array, Log, backgrounds
from numpy.typing import NDArray
from real_effects import EFFECTS, Parameters
from real_files import SERVOS

from sim2real.diagnose.explained import freed_of_the_common
from sim2real.identification.first_guess import first_guess
from sim2real.identification.motor_choice import choose_motor
from sim2real.identification.plain_fit import best_of
from sim2real.identification.search import errors_of
from sim2real.noise import noise_floor
from sim2real.recording import PER_INERTIA, Load
from sim2real.robot import Servo
from sim2real.servo.trace import Trace

SETTLED, STEADY = 3, 2.5
"""Samples without a new set-point, and most steps of the sensor to the last or next reading, of a
slowly sampled servo at rest."""


class Rig:
    """One joint of a rig in one condition, as well explained as it can be.

    Args:
        logs: All untouched recordings of it.
        joint: Which joint.
    """

    def __init__(self, logs: Sequence[Log], joint: int) -> None:
        self.logs, self.joint = [powered(log) for log in logs], joint
        self.at_rest = logs[0].family == "sts"
        if not self.at_rest:
            self.row, self.left = self._by_law()
        else:
            self.left = [self._from_rest(log) for log in self.logs]

    def moves(self, log: Log, name: str, p: Parameters, rng: np.random.Generator) -> Array:
        """How a change moves what is left of a log, rad, NaN where it is not looked at, (T,)."""
        after = EFFECTS[name].put(log.fine(), self.joint, p, rng)
        moved = after.position[:, self.joint] - log.fine().position[:, self.joint]
        if not np.array_equal(after.command, log.command):
            before, now = (errors_of(self.row, [trace(x, self.joint)])[0] for x in (log, after))
            moved = before - now
        return moved

    def null2(self, name: str, p: Parameters, rng: np.random.Generator) -> list[float]:
        """Mean square, in rad2, of what looks like the change in each recording that has none."""
        found = []
        for log, left in zip(self.logs, self.left, strict=True):
            moved = self.moves(log, name, p, rng)
            seen = np.isfinite(moved) & np.isfinite(left)
            size2 = float(moved[seen] @ moved[seen])
            if size2 > 0:
                found.append(float(moved[seen] @ left[seen]) ** 2 / size2 / np.count_nonzero(seen))
        return found

    def shows2(self, name: str, background: str, p: Parameters, rng: np.random.Generator) -> float:
        """Mean square of what a change moves in one recording where it is looked at, rad2."""
        k = [log.name for log in self.logs].index(background)
        moved = self.moves(self.logs[k], name, p, rng)
        seen = np.isfinite(moved) & np.isfinite(self.left[k])
        return float(np.mean(moved[seen] ** 2)) if seen.any() else 0.0

    def _by_law(self) -> tuple[Array, list[Array]]:
        given = [trace(log, self.joint) for log in self.logs]
        rng = np.random.default_rng(0)
        servo = Servo("servo", *SERVOS[self.logs[0].family])
        noise = max(noise_floor(t.t, t.command, t.position) for t in given)
        start, others = first_guess(given, rng)
        plain = best_of(given, np.vstack([start[None], others]))
        row = choose_motor(given, plain, servo, noise, rng).row
        errors = list(errors_of(row, given))
        freed, repeated = freed_of_the_common(given, errors, len(given))
        if repeated.all():
            pairs = zip(errors, freed, given, strict=True)
            errors = [e - (f.position - t.position) for e, f, t in pairs]
        return row, [-e for e in errors]

    def _from_rest(self, log: Log) -> Array:
        j = self.joint
        resting, side = _at_rest(log, j)
        known = [(other, *_at_rest(other, j)) for other in self.logs if other is not log]
        left = np.full(log.t.size, np.nan)
        for k in np.flatnonzero(resting):
            levels = []
            for other, rests, sides in known:
                same = rests & np.isclose(other.command, log.command[k], atol=1e-3).all(axis=1)
                same &= sides * side[k] >= 0  # from the same side, where that is known
                if same.any():
                    levels.append(float(other.position[same, j].mean()))
            if levels:
                left[k] = log.position[k, j] - np.mean(levels)
        return left


def _at_rest(log: Log, joint: int) -> tuple[NDArray[np.bool_], Array]:
    """Which samples of a joint are at rest, and from which side they came, 0 where not known."""
    changed = np.diff(log.command, axis=0, prepend=log.command[:1])
    still = np.convolve(changed.any(axis=1), np.ones(SETTLED + 1))[: log.t.size] == 0
    still[:SETTLED] = False
    quiet = np.abs(np.diff(log.position[:, joint])) < STEADY * log.step
    still &= np.append(True, quiet) | np.append(quiet, True)
    side = np.sign(changed[:, joint])
    last = np.maximum.accumulate(np.where(side != 0, np.arange(side.size), 0))
    return still, side[last]


def powered(log: Log) -> Log:
    """A log up to where its torque goes off."""
    on = np.isfinite(log.command).all(axis=1)
    return log if on.all() else log.rows(np.arange(int(np.argmin(on))))


def trace(log: Log, joint: int) -> Trace:
    """A joint of a log, as the library fits it."""
    load = Load(**log.load) if joint == 0 and log.load else PER_INERTIA
    part = (log.t, log.command[:, joint], log.position[:, joint])
    return Trace(log.name, log.name, *part, load, np.isfinite(part[2]))


def rounding_llr(angle: Array, ratio: float) -> float:
    """What speaks for a grid that is coarser by a ratio, in readings that all lie on it."""
    return float(np.count_nonzero(np.diff(angle)) * np.log(ratio))


def main() -> None:
    """Write what the oracle says of each case that has something put in by name."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("set", type=Path, metavar="SET")
    parser.add_argument("--realdata", type=Path, required=True, metavar="DIR")
    options = parser.parse_args()
    groups = backgrounds(options.realdata)
    said = consult(json.loads((options.set / "answers.json").read_text()), groups)
    (options.set / "oracle.json").write_text(json.dumps(said, indent=1) + "\n")


def consult(answers: Sequence[Any], groups: dict[str, list[Log]]) -> dict[str, Any]:
    """For each case of T2 with named changes ``llr_of_each`` and ``llr_total``."""
    by_name = {log.name: group for group, logs in groups.items() for log in logs}

    @cache
    def rig(group: str, joint: int) -> Rig:
        return Rig(groups[group], joint)

    said = {}
    for one in answers:
        if one["tier"] == "T2" and one["kind"] in ("single", "double"):
            group = by_name[one["background"]["a"]]
            said[one["case"]] = _of_case(one, group, groups, rig)
    return said


def _of_case(
    one: Any,  # noqa: ANN401 - an answer
    group: str,
    groups: dict[str, list[Log]],
    rig: Callable[[str, int], Rig],
) -> dict[str, Any]:
    """Changes of one case; both conditions of the XL330 count as one rig."""
    logs = groups[group]
    log = next(x for x in logs if x.name == one["background"]["a"])
    alike = [name for name in groups if name.startswith("xl330")] if log.family == "xl330" else []
    each = {}
    for effect in one["effects"]:
        name, p = effect["effect"], effect["parameters"]
        joints = log.joints
        place = effect["component"]
        candidates = [joints.index(place)] if place in joints else range(len(joints))
        if name == "encoder_quantization":
            (j,) = candidates
            angle = np.round(log.position[:, j] / p["step_rad"]) * p["step_rad"]
            llr = rounding_llr(angle, p["step_rad"] / log.step)
        else:
            rng = np.random.default_rng(one["seed"] % 2**32)
            llr = 0.0
            for j in candidates:
                shows2 = rig(group, j).shows2(name, log.name, p, rng)
                null2 = [
                    x for other in (alike or [group]) for x in rig(other, j).null2(name, p, rng)
                ]
                hides2 = max(float(np.mean(null2 or [0.0])), log.step**2 / 12)
                llr += 0.5 * shows2 / hides2
        each[f"{name}@{place}"] = llr
    return {"llr_of_each": each, "llr_total": float(sum(each.values()))}


if __name__ == "__main__":
    main()
