"""How large changes look where nothing has changed: writes ``diagnose/unchanged.json``.

    python -m benchmarks.unchanged_bank

A bank of real recordings that are never the case of a sealed T2 from the third on:
``lift_and_drop`` of the XL330 at either gain, against the other three trajectories, and each
stretch of the STS3215 log ``single`` against the others. Takes the recordings from
SIM2REAL_REALDATA (default ../shared/realdata). No log of the bank repeats a command, so that
repeats are judged by what their references leave.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.harness import ROOT, real_recordings
from sim2real.diagnose.change import largest_jump
from sim2real.diagnose.contrast import BANK, directions, first_look, unit
from sim2real.diagnose.explained import Explained, explained
from sim2real.diagnose.references import law_of
from sim2real.output import write_json
from sim2real.recording import PER_INERTIA, Load
from sim2real.robot import Servo
from sim2real.servo.parameters import joint_row
from sim2real.servo.trace import Trace

SAFETY = 4.0
"""On mean squares: banks are small, and the next servo is another."""
JUMPS = {"law": 4.0, "rest": 4.0, "repeat": 25.0}
"""Times the references' largest step; chosen, and above all that the bank shows."""


def main() -> None:
    """Look at every recording of the bank as if it were a case."""
    found: dict[str, list[tuple[dict[str, float], float]]] = {"law": [], "rest": []}
    for name, of in bank():
        by = directions(of)
        gone, _, left = first_look(of, by, of.case)
        shares = gone / unit(of.way == "law", of.scale2, left)
        null = {
            effect: max(float(g) for g, n in zip(shares, by.names, strict=True) if n == effect)
            for effect in dict.fromkeys(by.names)
        }
        usual = largest_jump(of, range(of.references))
        ratio = largest_jump(of, of.case) / usual if usual > 0 else 0.0
        found[of.way].append((null, ratio))
        largest = max(null.values())
        print(f"{name:24} {of.way:6} jump {ratio:.2f}  largest {largest:.2f}")
    ways = {way: entry(some, way) for way, some in found.items()}
    repeats = {name: SAFETY for name in ways["law"]["null"]}
    ways["repeat"] = {"known": 2.0, "jump": JUMPS["repeat"], "null": repeats}
    write_json(BANK, {"schema": "sim2real.unchanged/1", "made_by": "benchmarks/unchanged_bank.py",
                      "ways": ways})  # fmt: skip
    print(f"written: {BANK}")


def entry(some: list[tuple[dict[str, float], float]], way: str) -> dict[str, object]:
    """Null sizes of one way, with the safety: of each effect its own, and at least that of all."""
    if max(ratio for _, ratio in some) > JUMPS[way]:
        raise SystemExit(f"{way}: an unchanged recording jumps by more than {JUMPS[way]:g}")
    names = dict.fromkeys(name for null, _ in some for name in null)
    own = {n: float(np.mean([null[n] for null, _ in some if n in null])) for n in names}
    common = float(np.mean(list(own.values())))
    null = {n: round(SAFETY * max(x, common), 4) for n, x in own.items()}
    return {"known": float(len(some)), "jump": JUMPS[way], "null": null}


def bank() -> Iterator[tuple[str, Explained]]:
    """Each recording with the others of its rig as references, joint by joint."""
    sys.path.insert(0, str(ROOT / "datasets" / "concealed"))
    from backgrounds import backgrounds
    from real_files import SERVOS

    groups = backgrounds(real_recordings())
    for group, cases in (("xl330_200", [3]), ("xl330_800", [3]), ("single", range(4))):
        logs = [powered(log) for log in groups[group]]
        for k in cases:
            rest = [log for log in logs if log is not logs[k]]
            for j, joint in enumerate(logs[k].joints):
                references, case = [trace(log, j) for log in rest], [trace(logs[k], j)]
                references = [one for one in references if one.moves()]
                if not references or not case[0].moves():
                    continue
                servo = Servo("servo", *SERVOS[logs[k].family])
                law = law_of(references, case, servo, np.random.default_rng(0))
                row = joint_row(law, references[0].load)
                of = explained(references, case, row, servo)
                if of.scale2 > 1.01 * servo.position_step_rad**2 / 12:  # else nothing is left
                    yield f"{logs[k].name} {joint}", of


def powered(log: Any) -> Any:  # noqa: ANN401 - of a module imported late
    """A log up to where its torque goes off."""
    on = np.isfinite(log.command).all(axis=1)
    return log if on.all() else log.rows(np.arange(int(np.argmin(on))))


def trace(log: Any, joint: int) -> Trace:  # noqa: ANN401
    """A joint of a log, as the library fits it."""
    load = Load(**log.load) if joint == 0 and log.load else PER_INERTIA
    part = (log.t, log.command[:, joint], log.position[:, joint])
    return Trace(log.name, log.name, *part, load, np.isfinite(part[2]))


if __name__ == "__main__":
    main()
