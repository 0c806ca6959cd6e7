"""How exact the gear train of the servo law is, against a reference with steps of one microsecond.

python -m benchmarks.gear_train [--trains 200] [--seed 1] [--processes 2] [--cache FOLDER]

Trains are drawn: gains, inertias, gap, spring, dry friction on neither, either or both sides. The
reference advances each mass by itself, semi-implicitly, at 1e-6 and 5e-7 s; where the two differ by
more than the limit, the motion does not determine the answer, and the train is excluded and
counted. Needs ``pip install numba``.
"""

from __future__ import annotations

import json
import time
from functools import partial
from pathlib import Path

import numpy as np
from numba import njit

from benchmarks.harness import command_line, spread
from sim2real.arrays import Array

LIMIT_RAD = 1e-4
PERIOD_S, DURATION_S = 0.02, 30.0
STEPS_S = (1e-6, 5e-7)


@njit(cache=True)
def reference(
    command: Array, step: float, kp: float, kd: float, weight: float, motor: float, output: float,
    half: float, spring: float, damper: float, dry: float, rub: float,
) -> Array:  # fmt: skip
    """Angles of motor and output, shape (T, 2), of a train without latency, from rest."""
    per = int(round(PERIOD_S / step))
    out = np.empty((command.size, 2))
    q = command[0]
    x = weight * np.sin(q) / spring if spring > 0 else 0.0
    for _ in range(50):
        carried = weight * np.sin(q - x)
        x = np.sign(carried) * half + (carried / spring if spring > 0 else 0.0)
        q = command[0] - carried / kp
    o, v, w = q - x, 0.0, 0.0
    for k in range(command.size):
        out[k, 0], out[k, 1] = q, o
        for _ in range(per):
            lead = q - o
            through = 0.0
            if spring > 0 and (half == 0 or abs(lead) > half):
                through = spring * (lead - np.sign(lead) * half) + damper * (v - w)
            v += step * (kp * (command[k] - q) - kd * v - through) / motor
            most = step * dry / motor
            v -= min(max(v, -most), most)
            w += step * (through - weight * np.sin(o)) / output
            most = step * rub / output
            w -= min(max(w, -most), most)
            if spring == 0:
                lead = q - o + step * (v - w)
                if abs(lead) >= half and lead * (v - w) > 0:  # an inelastic contact
                    v = w = (motor * v + output * w) / (motor + output)
            q += step * v
            o += step * w
    return out


def draw(rng: np.random.Generator) -> dict[str, float]:
    """A train: gains, inertias, coupling and friction."""

    def log(low: float, high: float) -> float:
        return float(low * (high / low) ** rng.random())

    inertia, share = log(1e-3, 6e-3), float(rng.uniform(0.15, 0.6))
    kp = log(1.0, 6.0)
    train = {
        "kp": kp, "kd": float(2 * rng.uniform(0.3, 1.1) * np.sqrt(kp * inertia)),
        "load": (1 - share) * inertia, "rotor": share * inertia,
        "weight": float(rng.choice([0.0, rng.uniform(0.0, 0.3)])),
        "gap": 0.0, "compliance": 0.0,
        "dry": float(rng.choice([0.0, log(0.01, 0.1)])),
        "rub": float(rng.choice([0.0, log(0.01, 0.1)])),
    }  # fmt: skip
    if rng.random() < 0.5:
        return train | {"gap": log(0.002, 0.04)}
    return train | {"compliance": log(0.003, 0.08), "rub": 0.0}


def commands(rng: np.random.Generator) -> Array:
    """Steps and a sine whose frequency rises, rad, shape (T,)."""
    t = PERIOD_S * np.arange(int(DURATION_S / PERIOD_S))
    levels = rng.uniform(-0.6, 0.6, t.size)[(t // 0.5).astype(int)]
    sine = 0.4 * np.sin(2 * np.pi * (0.2 + 0.06 * t) * t)
    return np.where(t < 0.4, 0.0, np.where(t < 15.0, sine, levels))


def law(train: dict[str, float]) -> tuple[Array, Array]:
    """Rows of parameters of a train and of the same servo without effects, shape (P,) each."""
    from sim2real.model import FittedEffect, JointModel
    from sim2real.recording import Load
    from sim2real.servo.parameters import joint_row

    rotor = {"rotor_inertia_kgm2": train["rotor"]}
    effects = []
    if train["gap"]:
        play = {"gap_rad": train["gap"], "output_friction_Nm": train["rub"]}
        effects.append(FittedEffect("backlash", play | rotor))
    else:
        give = {"compliance_rad_per_Nm": train["compliance"], "sensor_on_output": 1.0}
        effects.append(FittedEffect("compliance", give | rotor))
    if train["dry"]:
        effects.append(FittedEffect("coulomb_friction", {"torque_Nm": train["dry"]}))
    arm = 0.1
    load = Load(train["load"], train["weight"] / (9.80665 * arm), arm)
    gains = (train["kp"], train["kd"], 0.0, train["load"])
    rigid, joint = JointModel(*gains), JointModel(*gains, effects=tuple(effects))
    return joint_row(joint, load), joint_row(rigid, load)


def answer(job: tuple[int, int]) -> tuple[dict[str, float], Array, Array]:
    """A train, its commands (T,), and the output's angle at both steps of the reference (2, T)."""
    from sim2real.servo.gear_train import SPRING_DAMPING

    rng = np.random.default_rng(job)
    train, command = draw(rng), commands(rng)
    spring = 1 / train["compliance"] if train["compliance"] else 0.0
    reduced = train["rotor"] * train["load"] / (train["rotor"] + train["load"])
    damper = 2 * SPRING_DAMPING * np.sqrt(spring * reduced)
    angles = [
        reference(
            command, step, train["kp"], train["kd"], train["weight"], train["rotor"],
            train["load"], train["gap"] / 2, spring, damper, train["dry"], train["rub"],
        )[:, 1]
        for step in STEPS_S
    ]  # fmt: skip
    return train, command, np.stack(angles)


def errors(train: dict[str, float], command: Array, angles: Array) -> dict[str, float]:
    """RMS errors in rad of the law and of the reference itself."""
    from sim2real.servo.rollout import rollout

    t = PERIOD_S * np.arange(command.size)
    angle = rollout(law(train)[0][None], t, command)[0]

    def rms(x: Array) -> float:
        return float(np.sqrt(np.mean(x**2)))

    return train | {"error": rms(angle - angles[1]), "unsure": rms(angles[0] - angles[1])}


def cost(train: dict[str, float], command: Array, *, members: int = 8, repeats: int = 7) -> float:
    """Processor time of a rollout of two masses over that of one, for equal sub-steps."""
    from sim2real.servo.rollout import rollout

    t = PERIOD_S * np.arange(command.size)
    seconds = np.full(2, np.inf)
    for _ in range(repeats):  # in turns, as the machine may be busy with other work
        for k, row in enumerate(law(train)):
            rows = np.repeat(row[None], members, axis=0)
            start = time.thread_time()
            rollout(rows, t, command, substep_s=1e-3)
            seconds[k] = min(seconds[k], time.thread_time() - start)
    return float(seconds[0] / seconds[1])


def main() -> None:
    """Print the errors and how much slower two masses are than one."""
    folder = (Path, "folder to keep the reference's angles in")
    options = command_line(__doc__, trains=200, seed=1, processes=2, cache=folder).parse_args()
    jobs = [(options.seed, k) for k in range(options.trains)]
    answers = list(spread(partial(cached, options.cache), jobs, options.processes, unit="train"))
    rows = [errors(*values) for values in answers]
    ratios = np.array([cost(train, command) for train, command, _ in answers[:40]])
    for name, kind in (("gap", "play"), ("compliance", "spring")):
        mine = [row for row in rows if row[name]]
        kept = [row["error"] for row in mine if row["unsure"] <= LIMIT_RAD]
        print(
            f"{kind}: {len(mine)} trains, {len(mine) - len(kept)} excluded; "
            f"{1e3 * LIMIT_RAD:g} mrad or less in {np.mean(np.array(kept) <= LIMIT_RAD):.1%}, "
            f"median {1e3 * np.median(kept):.3f}, 95 % {1e3 * np.quantile(kept, 0.95):.3f} mrad"
        )
        of_kind = ratios[[train[name] > 0 for train, _, _ in answers[: ratios.size]]]
        print(f"  cost {np.median(of_kind):.2f} times one mass, at most {of_kind.max():.2f}")
    worst = [row | {"train": k} for k, row in enumerate(rows) if row["unsure"] <= LIMIT_RAD]
    for row in sorted(worst, key=lambda row: -row["error"])[:8]:
        print({k: float(f"{x:.3g}") for k, x in row.items()})


def cached(folder: Path | None, job: tuple[int, int]) -> tuple[dict[str, float], Array, Array]:
    """The answer to a job, read from a folder if it is there, and kept there."""
    if folder is None:
        return answer(job)
    file = folder / f"train_{job[0]}_{job[1]}.npz"
    if not file.exists():
        train, command, angles = answer(job)
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(file, train=json.dumps(train), command=command, angles=angles)
    stored = np.load(file)
    return json.loads(str(stored["train"])), stored["command"], stored["angles"]


if __name__ == "__main__":
    main()
