"""Do 90 % intervals of a servo's parameters hold the truth, and do both verbs agree on them?

    python -m benchmarks.coverage --cases 67 --seed 1 --out build/coverage.jsonl
    python -m benchmarks.coverage --no-posterior                    # identify alone, minutes
    python -m benchmarks.coverage --swims 26 --seed 1               # calibrate

Servos are drawn for three plants that share no dynamics with the library. Each is recorded twice,
with all the noise that its generator adds, and has a data sheet that is off by 7 %:

- ``linear``: a PD servo, its motion a sum of closed-form step responses; white noise and noise of a
  correlation time of 0.05 to 1 s, 1.5 mrad each, readings in steps of 0.24 degrees;
- ``line``: the motor on its torque-speed line of ``datasets/servo_steps``;
- ``voltage``: the circuit of a DC motor of ``datasets/foreign`` with gear friction, a rotor and a
  pendulum; its clocks, sampled controller, cogging and eccentric sensor included.

Parameters count that both the plant and the model have. A stopped run with ``--out`` goes on.

Swims are those of ``yardstick_cases.twin_swim``: robots of a law of their own, an effect or two
hidden in three of four, calibrated in turn with gains that a bench leaves 12 % off and with fitted
gains.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.signal import lfilter

from benchmarks.harness import ROOT, command_line, kept, read_lines, spread, table
from sim2real.arrays import Array
from sim2real.identification.identify import identify
from sim2real.posterior.servo import sample_servo
from sim2real.recording import Load, Recording
from sim2real.robot import Joint, Link, Robot, Servo
from sim2real.servo.trace import traces

KP, KD, LATENCY = "kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s"
STALL, SPEED = "motor.stall_torque_Nm", "motor.no_load_speed_rad_s"
NOISE_RAD, STEP_RAD = 0.0015, float(np.deg2rad(0.24))
Row = dict[str, Any]
Drawn = tuple[list[Recording], Servo, dict[str, float]]
"""Recordings of a servo, what its data sheet states, and its parameters that are known."""


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """A number that is log-uniform."""
    return float(low * (high / low) ** rng.random())


def pd_servo(rng: np.random.Generator) -> tuple[dict[str, float], float]:
    """Gains and latency, and the load in kg m2."""
    load, frequency = between(rng, 0.001, 0.008), between(rng, 10.0, 60.0)
    kp, kd = load * frequency**2, 2 * load * frequency * rng.uniform(0.3, 1.2)
    return {KP: kp, KD: float(kd), LATENCY: float(rng.uniform(0.02, 0.12))}, load


def sheet(stall: float, speed: float, step: float, rng: np.random.Generator) -> Servo:
    """A data sheet that is nearly right."""
    off = np.exp(0.07 * rng.standard_normal(2)).tolist()
    return Servo("servo", stall * off[0], speed * off[1], step)


def recorded(name: str, t: Array, sent: Array, seen: Array, load: Load) -> Recording:
    """A recording of the joint ``j1``."""
    return Recording(name, "servo", ("j1",), t, sent[:, None], seen[:, None], {"j1": load})


def linear(rng: np.random.Generator) -> Drawn:
    """A PD servo whose drive never reaches its limit."""
    truth, load = pd_servo(rng)
    recordings = []
    for name in ("first", "second"):
        t = np.arange(1500) / 50.0 + rng.normal(0.0, 3e-4, 1500)
        edges = 0.5 + np.cumsum(rng.uniform(0.4, 1.5, 100))
        command = np.append(0.0, rng.uniform(-0.6, 0.6, 100))[np.searchsorted(edges, t)]
        keep, noise = np.exp(-0.02 / between(rng, 0.05, 1.0)), rng.standard_normal((2, 2000))
        noise[1] = lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], noise[1])
        angle = answered(t, command, truth, load) + NOISE_RAD * noise[:, 500:].sum(axis=0)
        rounded = np.round(angle / STEP_RAD) * STEP_RAD
        recordings.append(recorded(name, t, command, rounded, Load(load)))
    stall = 1.5 * truth[KP]  # set-points are within 1.2 rad of each other
    return recordings, sheet(stall, stall / truth[KD], STEP_RAD, rng), truth


def answered(t: Array, command: Array, servo: dict[str, float], inertia: float) -> Array:
    """Angles (T,): the sum of answers to every step, by partial fractions over the two poles."""
    root = np.sqrt(complex(servo[KD] ** 2 - 4 * inertia * servo[KP]))
    p, q = (-servo[KD] + root) / (2 * inertia), (-servo[KD] - root) / (2 * inertia)
    angle = np.full(t.size, command[0])
    for k in 1 + np.flatnonzero(np.diff(command)):
        x = np.maximum(t - t[k] - servo[LATENCY], 0.0)  # the answer at 0 is 0
        unit = 1 + (q * np.exp(p * x) - p * np.exp(q * x)) / (p - q)
        angle += (command[k] - command[k - 1]) * unit.real
    return angle


def line(rng: np.random.Generator) -> Drawn:
    """A motor on its torque-speed line, up to 30 % of its damping by the controller."""
    sys.path.insert(0, str(ROOT / "datasets" / "servo_steps"))
    import make  # type: ignore[import-not-found]

    truth, load = pd_servo(rng)
    truth[STALL] = truth[KP] * between(rng, 0.35, 1.5)
    truth[SPEED] = truth[STALL] / truth[KD] / float(rng.uniform(0.7, 1.0))
    servo = make.Servo(*[truth[n] for n in (KP, KD, LATENCY)], load, truth[STALL], truth[SPEED])
    recordings = []
    with patch.dict(make.SERVOS, {"j1": servo}, clear=True):
        for name in ("steps", "chirp"):
            t, command, position = make.record(name, rng).values()
            recordings.append(recorded(name, t, command, position, Load(load)))
    return recordings, sheet(truth[STALL], truth[SPEED], make.POSITION_STEP_RAD, rng), truth


def voltage(rng: np.random.Generator) -> Drawn:
    """A DC motor by its circuit, with gear friction, and a rotor beyond the stated load."""
    sys.path[:0] = [str(ROOT / "datasets" / name) for name in ("foreign", "concealed")]
    import foreign_cases as foreign  # type: ignore[import-not-found]

    case = foreign.draw_case("voltage", "null", "", rng)
    servo, rubs = case.servos[0], rng.uniform((0.01, 0.05), (0.06, 0.3)).tolist()
    rotor, coulomb, wait = servo.rotor_inertia, rubs[0] * servo.stall_Nm, 0.5 / servo.loop_Hz
    acting = {"coulomb_friction": {"torque_Nm": coulomb}, "load_friction": {"ratio": rubs[1]}}
    case.hidden = [foreign.Hidden(name, "j1", of, 1.0, "", 0) for name, of in acting.items()]
    recordings = []
    for name in ("a", "b"):
        take, load = case.takes[name], servo.loads[name]
        servo.loads[name] = replace(load, inertia_kgm2=load.inertia_kgm2 + rotor)
        reading = case.readings(name, which=[0])[:, 0]
        angle = foreign.recorded(take, reading, servo, acting, rng)
        recordings.append(recorded(name, take.t, take.command[:, 0], angle, Load(**vars(load))))
    # A controller that sees the angle late damps less; at a fast one set-points wait, too.
    truth = {
        KP: servo.kp, KD: servo.kd - servo.kp * wait,
        LATENCY: servo.latency_s + (wait if servo.loop_Hz >= foreign.SLOW_LOOP_HZ else 0.0),
        STALL: servo.stall_Nm, SPEED: servo.stall_Nm / servo.kd, "motor.rotor_inertia_kgm2": rotor,
        "motor.coulomb_Nm": coulomb, "motor.motor_friction": rubs[1],
    }  # fmt: skip
    return recordings, sheet(truth[STALL], truth[SPEED], servo.sensor.step_rad, rng), truth


PLANTS: dict[str, Callable[[np.random.Generator], Drawn]]
PLANTS = {plant.__name__: plant for plant in (linear, line, voltage)}


def examined(job: tuple[str, int, int], *, steps: int) -> Row:
    """True values of a servo, and estimates with their ends by either verb."""
    plant, *seeds = job
    recordings, servo, truth = PLANTS[plant](np.random.default_rng(seeds))
    link, joint = Link("link", 1.0, 0.1, 0.1, 0.1), Joint("j1", servo, (-2.0, 2.0))
    model = identify(recordings, Robot("bench", (link, link), (joint,))).joints["j1"]
    values = vars(model) | {f"motor.{name}": value for name, value in model.motor.items()}
    found: Row = {n: [values.get(n, 0.0), *model.interval[n]] for n in truth if n in model.interval}
    row: Row = {"job": job, "law": model.law, "truth": truth, "identify": found, "posterior": {}}
    if steps:
        seen = traces(recordings, "j1")
        chain = sample_servo(seen, model, servo, seed=job[2], steps=steps, walkers=40)
        each = zip(chain.names, chain.quantiles(0.5, 0.05, 0.95).T.tolist(), strict=True)
        row["posterior"] = {name: ends for name, ends in each if name in truth}
        row["short"] = not chain.chain.reached
    return row


def rows_of(rows: Sequence[Row]) -> Iterator[list[str]]:
    """Of each plant and parameter: intervals that hold, and posterior's width over identify's."""
    for plant, name in {(row["job"][0], name): 0 for row in rows for name in row["truth"]}:
        mine = [row for row in rows if row["job"][0] == plant]
        true = np.array([row["truth"][name] for row in mine])
        cells, widths = [plant, name.removeprefix("motor.")], []
        for verb in ("identify", "posterior"):
            ends = np.array([row[verb].get(name, 3 * [np.nan])[1:] for row in mine])
            held = (ends[:, 0] <= true) & (true <= ends[:, 1])
            cells.append(f"{held.sum()} of {np.isfinite(ends[:, 0]).sum()}")
            widths.append(np.diff(ends))
        ratio = widths[1] / widths[0]
        known = ratio[np.isfinite(ratio) & (ratio > 0)]  # 0 where one end is open
        shares = np.quantile(known, (0.5, 0.1, 0.9)) if known.size else ()
        yield [*cells, *(f"{share:.2f}" for share in shares)]


def calibrated(job: tuple[int, int], *, out: Path) -> Row:
    """True values of a swim's servos; by name the fitted value, centre and interval."""
    from benchmarks.yardstick_cases import SWIMS, twin_swim
    from sim2real import calibrate

    seed, k = job
    case = twin_swim(out / f"{seed}_{k}", (seed, k), SWIMS[k % len(SWIMS)])
    model = Path(case.options[-1])
    fit = calibrate(case.recordings, case.robot, model, fit_gains=k % 2 == 1).fitted
    rows = zip(fit.free, fit.best, fit.centre, *fit.interval().T, strict=True)
    found = {p.name: list(map(float, x)) for p, *x in rows if p.name in case.truth["estimates"]}
    true = {name: case.truth["estimates"][name] for name in found}
    return {"job": job, "hidden": case.truth["names"], "truth": true, "calibrate": found}


def rows_of_swims(rows: Sequence[Row]) -> Iterator[list[str]]:
    """Of each kind, without and with hidden effects: intervals that hold, errors, widths."""
    for kind, hidden in product((LATENCY, KP, KD), (False, True)):
        found = np.array(
            [[row["truth"][name], *row["calibrate"][name]]
             for row in rows if bool(row["hidden"]) == hidden
             for name in row["truth"] if name.endswith(kind)]
        ).reshape(-1, 5)  # fmt: skip
        true, best, centre, low, high = found.T
        unit = 1e-3 if kind == LATENCY else true / 100
        held = (low <= true) & (true <= high)
        sizes = (np.median(np.abs(x) / unit) for x in (best - true, centre - true, high - low))
        numbers = (f"{size:.2f}" for size in sizes)
        yield [kind, "yes" if hidden else "no", f"{held.sum()} of {held.size}", *numbers]


def of_swims(options: Namespace) -> None:
    """Draw swims, calibrate, print the table."""
    rows = read_lines(options.out) if options.out else []
    done = [row["job"] for row in rows]
    left = [(options.seed, k) for k in range(options.swims) if [options.seed, k] not in done]
    work = partial(calibrated, out=ROOT / "build" / "coverage")
    found = spread(work, left, options.processes, unit="swim", in_order=False)
    rows += kept(options.out, found) if options.out else found
    header = ("parameter", "hidden", "holds", "error", "error of the centre", "width in ms or %")
    print(table(header, rows_of_swims(rows)))


def main() -> None:
    """Draw, fit and sample, print the table."""
    options = command_line(
        __doc__, cases=(67, "servos of each plant"), seed=1, processes=2, out=Path,
        no_posterior=(False, "identify alone"), steps=(2000, "of the chains"),
        swims=(0, "number, in place of servos"),
    ).parse_args()  # fmt: skip
    if options.swims:
        return of_swims(options)
    jobs = [(plant, options.seed, case) for case in range(options.cases) for plant in PLANTS]
    rows = read_lines(options.out) if options.out else []
    left = [job for job in jobs if list(job) not in [row["job"] for row in rows]]
    work = partial(examined, steps=0 if options.no_posterior else options.steps)
    found = spread(work, left, options.processes, unit="servo", in_order=False)
    rows += kept(options.out, found) if options.out else found
    header = ("plant", "parameter", "identify", "posterior", "ratio of widths", "10 %", "90 %")
    print(table(header, rows_of(rows)))
    print(f"\n{sum(row.get('short', False) for row in rows)} of {len(rows)} chains are too short")


if __name__ == "__main__":
    main()
