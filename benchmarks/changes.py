"""What is said to have changed since references, on benches whose change is known.

    python -m benchmarks.changes [--seeds 0:40] [--rows FILE.jsonl]

Each seed draws a servo (with or without a pendulum, friction, limit of its set-point), two to four
references, recordings that repeat their commands or not, what runs differ by, and one change:
nothing, a parameter that is set anew, or an effect. Prints how often the right one is first.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import command_line
from sim2real.diagnose.references import law_of, what_changed
from sim2real.model import FittedEffect, JointModel
from sim2real.recording import Load
from sim2real.robot import Servo
from sim2real.servo.parameters import joint_row
from sim2real.servo.rollout import rollout
from sim2real.servo.trace import Trace

SHEET = Servo("servo", 3.0, 6.0, 0.00153)
EFFECTS = {
    "coulomb_friction": {"torque_Nm": 0.12},
    "deadband": {"halfwidth_rad": 0.02},
    "backlash": {"gap_rad": 0.03},
    "command_filter": {"time_constant_s": 0.05},
    "sensor_offset": {"offset_rad": 0.02},
    "rate_limit": {"limit_rad_s": 2.0},
}
SET = {"kp": (0.5, 0.7, 1.6), "kd": (0.5, 2.0), "latency": (0.02, 0.035), "load": (0.6, 1.5)}
NOTHING = "nothing"


def command(t: Any, seed: int) -> Any:  # noqa: ANN401 - arrays
    """Steps and sines, as benches send them."""
    rng = np.random.default_rng(seed)
    sines = sum(rng.uniform(0.1, 0.4) * np.sin(rng.uniform(1, 6) * t) for _ in range(3))
    levels = rng.uniform(-0.4, 0.4, 40)
    levels[0] = 0.0
    return sines + levels[(t / 0.8).astype(int)]


def bench(seed: int) -> tuple[str, list[Trace], list[Trace]]:
    """The change, references, and recordings since."""
    rng = np.random.default_rng(seed)
    kinds = [NOTHING, NOTHING, *SET, *EFFECTS]
    kind = kinds[seed % len(kinds)]
    pendulum = bool(rng.random() < 0.6) or kind == "load"
    mass = float(rng.uniform(0.3, 0.8)) if pendulum else 0.0
    load = Load(0.003 + 0.01 * mass, mass, 0.1 if pendulum else 0.0)
    kp, kd = float(rng.uniform(4, 15)), float(rng.uniform(0.2, 0.5))
    base = [FittedEffect("coulomb_friction", {"torque_Nm": 0.05})] if rng.random() < 0.5 else []
    if rng.random() < 0.3 and kind != "rate_limit":
        base.append(FittedEffect("rate_limit", {"limit_rad_s": 4.0}))
    if kind in EFFECTS:
        base = [e for e in base if kind not in ("coulomb_friction", "rate_limit")]
    ratio = float(rng.choice(SET.get(kind, (1.0,))))
    repeats, noise, period = rng.random() < 0.6, float(rng.uniform(5e-4, 2e-3)), 0.01

    def run(k: int, sent: int, *, changed: bool) -> Trace:
        own = {"kp": kp * rng.normal(1, 0.015), "kd": kd * rng.normal(1, 0.03), "latency": 0.02}
        own["latency"] += float(rng.normal(0, 0.0015))
        effects, now = list(base), load
        if changed and kind == "load":
            now = Load(load.inertia_kgm2 * ratio, mass * ratio, load.pendulum_length_m)
        elif changed and kind == "latency":
            own["latency"] += ratio
        elif changed and kind in own:
            own[kind] *= ratio
        elif changed and kind in EFFECTS:
            effects.append(FittedEffect(kind, EFFECTS[kind]))
        joint = JointModel(*own.values(), now.inertia_kgm2, effects=tuple(effects))
        t = period * np.arange(800)
        u = command(t, 1000 * seed + sent)
        angle = rollout(joint_row(joint, now)[None], t, u)[0] + rng.normal(0, noise, t.size)
        return Trace(f"r{k}", f"r{k}", t, u, angle, load, np.ones(t.size, dtype=bool))

    references = [run(k, k % 2, changed=False) for k in range(int(rng.choice([2, 4])))]
    case = [run(9 + k, k if repeats else 5 + k, changed=True) for k in range(2)]
    return kind, references, case


def main() -> None:
    """Run the seeds, and count."""
    seeds = ("0:40", "first and last but one, FIRST:END")
    given = command_line(__doc__, seeds=seeds, rows=Path).parse_args()
    first, end = (int(x) for x in given.seeds.split(":"))
    rows = []
    for seed in range(first, end):
        kind, references, case = bench(seed)
        law = law_of(references, case, SHEET, np.random.default_rng(0))
        found = what_changed(references, case, joint_row(law, references[0].load), SHEET)
        groups = [(g.members, g.probability) for g in found.groups if g.probability >= 0.5]
        rows.append({"seed": seed, "kind": kind, "named": groups, "nameless": found.nameless})
        print(json.dumps(rows[-1]), flush=True)
        if given.rows:
            given.rows.write_text("".join(json.dumps(row) + "\n" for row in rows))
    for changed in (False, True):
        some = [row for row in rows if (row["kind"] != NOTHING) == changed]
        right = sum(any(row["kind"] in g for g, _ in row["named"]) for row in some)
        first_right = sum(bool(x["named"]) and x["named"][0][0][0] == x["kind"] for x in some)
        silent = sum(not row["named"] and row["nameless"] < 0.5 for row in some)
        what = "changed" if changed else NOTHING
        print(f"{what}: {len(some)}, right {right}, first {first_right}, unchanged {silent}")


if __name__ == "__main__":
    main()
