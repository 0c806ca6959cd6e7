"""How much more precisely a designed recording identifies a servo than the usual ones.

Servos of three plants that share no dynamics with the library (``datasets/foreign``: MuJoCo, a
motor's circuit, and the plant of ``datasets/concealed``), each with cogging, an eccentric sensor, a
sampled controller, drift and rounding, are recorded for 30 s at 50 Hz on each signal and
identified.

    python benchmarks/design.py --servos 200 --processes 32 --out reports/design

Servos that ``servos.jsonl`` in that folder has are not run again. Those that fail are listed there
and counted.
"""

from __future__ import annotations

import argparse
import resource
import runpy
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

_HERE = Path(__file__).resolve().parent
# Without this folder, whose coverage.py numba would import in place of the package of that name.
sys.path[:] = [folder for folder in sys.path if Path(folder or ".").resolve() != _HERE]
for _folder in ("", "datasets/concealed", "datasets/foreign"):
    sys.path.insert(0, str(_HERE.parent / _folder))
import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

from benchmarks.harness import command_line, kept, read_lines, spread  # noqa: E402 - one thread

Array = NDArray[np.float64]
Row = dict[str, Any]

PLANTS = ("mujoco", "voltage", "own")
SECONDS, RATE_HZ = 30.0, 50.0
LIMITS_RAD = (-0.8, 0.8)
SLOW_RAD, FAST_RAD = 0.3, 0.04
"""Amplitudes of the set-points from which the truth is fitted; their torque is less than 0.35 rad
times kp, the smallest stall torque."""
USUAL = ("sine", "square", "chirp", "multisine", "swevers")
DESIGNS = ("design", "from the data sheet")
GAINS = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s")
DETERMINED = {"motor.stall_torque_Nm": 0.29, "motor.no_load_speed_rad_s": 0.21}
"""Half-width below which a parameter counts as above its detection limit: half that of the prior,
or half of the parameter itself."""


def drawn(plant: str, rng: np.random.Generator, nuisances: float) -> Any:  # noqa: ANN401
    """A servo of a plant, alone on its bus, on a pendulum or on a plain inertia.

    ``nuisances`` scales its cogging and the eccentricity of its sensor. Servos limited in current
    are left out: the no-load speed that their data sheets state is arbitrary.
    """
    from bench import Load
    from foreign_servos import draw_servos

    servo = draw_servos(plant, rng)[0]
    while servo.current_limited:
        servo = draw_servos(plant, rng)[0]
    if rng.random() < 0.5:
        servo.loads["a"] = Load(servo.loads["a"].inertia_kgm2)
    servo.nuisances["ripple_Nm"] *= nuisances
    return replace(servo, eccentric=(nuisances * servo.eccentric[0], *servo.eccentric[1:]))


def recorded(servo: Any, plant: str, command: Array, rng: np.random.Generator, name: str) -> Any:  # noqa: ANN401
    """A recording of the plant on commands (T,), by one clock, as ``record`` makes it.

    The inertia of these plants is all that turns. Of a pendulum its own is stated, as a user knows
    it: ``identify`` finds that of the rotor.
    """
    import mujoco_plant
    import own_plant
    import voltage_plant
    from bus import Bus, draw_packets
    from foreign_world import GRID_S, Take, arrivals, seen
    from foreign_world import recorded as noisy

    from sim2real.recording import Load, Recording

    t = np.arange(command.size) / RATE_HZ
    packets = draw_packets(Bus(), t.size, 1, rng)
    take = Take(t, command[:, None], packets, 0.0)
    grid = np.arange(0.0, t[-1] + 0.05, GRID_S)
    when, what = arrivals(take, 0, servo.latency_s, {})
    if plant == "own":
        angle = own_plant.simulate_all([servo], "a", [{}], grid, [when], [what], [[]])[0]
    else:
        simulate = {"mujoco": mujoco_plant, "voltage": voltage_plant}[plant].simulate
        angle = simulate(servo, servo.loads["a"], {}, grid, when, what, [])
    reading = seen(take, grid, angle, servo, {}, bent=True)
    position = noisy(take, reading, servo, {}, rng)
    load = servo.loads["a"]
    rotor = servo.rotor_inertia if load.gravity_Nm else 0.0
    stated = Load(load.inertia_kgm2 - rotor, load.pendulum_mass_kg, load.pendulum_length_m)
    return Recording(
        name=name,
        kind="servo",
        joints=("j1",),
        t=t,
        command=command[:, None],
        position=position[:, None],
        loads={"j1": stated},
    )


def bench(servo: Any) -> Any:  # noqa: ANN401
    """The robot's file of a servo: its data sheet, which is nearly right, and its limits."""
    from sim2real.robot import Joint, Link, Robot, Servo

    sheet = Servo(
        "servo",
        servo.stated["max_torque_Nm"],
        servo.stated["no_load_speed_rad_s"],
        servo.sensor.step_rad,
    )
    link = Link("link")
    return Robot("bench", (link, link), (Joint("j1", sheet, LIMITS_RAD),))


def swevers(robot: Any, rng: np.random.Generator, *, tries: int = 400) -> Array:  # noqa: ANN401
    """A periodic Fourier series of minimal condition number, shape (T,).

    Swevers et al., IEEE Trans. Robot. Autom. 13 (1997) 730: three periods of 10 s, five harmonics,
    the regressor of a linear servo, (q'', q', q - mean q), with columns scaled to the largest rate
    and acceleration of the series of equal amplitudes.
    """
    from sim2real.design.limits import limits_of

    limits = limits_of(robot)
    t = limits.times(SECONDS)
    base = 2 * np.pi * 0.1 * np.arange(1, 6)
    sine, cosine = np.sin(np.outer(base, t)), np.cos(np.outer(base, t))
    best, least = np.zeros(t.size), np.inf
    for _ in range(tries):
        a, b = rng.standard_normal((2, 5))
        q = a @ sine + b @ cosine
        scale = limits.reach_rad / np.abs(q).max()
        v = (a * base) @ cosine - (b * base) @ sine
        acceleration = -((a * base**2) @ sine + (b * base**2) @ cosine)
        regressor = np.stack([acceleration / base[-1] ** 2, v / base[-1], q - q.mean()], axis=1)
        number = float(np.linalg.cond(regressor))
        if number < least and scale * np.abs(v).max() < limits.rate_rad_s:
            best, least = scale * q, number
    return limits.within(limits.rest_rad + best[None])[0]


def usual(name: str, robot: Any, rng: np.random.Generator) -> Array:  # noqa: ANN401
    """A usual signal, shape (T,): those of ``record``, and Swevers' Fourier series."""
    from sim2real.signals import excitation

    if name == "swevers":
        return swevers(robot, rng)
    signal = excitation(name, robot.joints, seconds=SECONDS, rate_hz=RATE_HZ, rng=rng)
    return signal.command[:, 0]


def identified(recording: Any, others: Any, robot: Any) -> tuple[Any, Row]:  # noqa: ANN401
    """The model identified from a recording, and what is scored of it."""
    from sim2real.identification.identify import identify

    model = identify([recording, others], robot, held_out=others.name)
    joint = model.joints["j1"]
    values = {n: getattr(joint, n) for n in GAINS} | {
        f"motor.{n}": v for n, v in joint.motor.items()
    }
    figures = model.fit["j1.position_rad"]
    interval = {n: list(ends) for n, ends in joint.interval.items()}
    return model, {"values": values, "interval": interval, "figures": figures}


def truth(
    servo: Any,  # noqa: ANN401
    plant: str,
    robot: Any,  # noqa: ANN401
    rng: np.random.Generator,
    *,
    starts: int = 12,
) -> dict[str, float]:
    """Gains and latency of the PD servo that a servo behaves like.

    The pseudo-true parameters (White, Econometrica 50 (1982) 1-25), with the inertia of the rotor
    free wherever ``identify`` finds it: those of a fit without noise, cogging and eccentricity to
    set-points that no drive limits. They differ at every sample, and turn a pendulum slowly by
    ``SLOW_RAD``, as its weight sets the scale of the gains. The angle is the mean over ``starts``
    recordings, each a set-point later, so that the latency contains the mean wait for the
    controller's next sample. Sampling by the controller and the plant's own steps change damping,
    inertia and latency by about 1 % from the values set.
    """
    from sim2real.identification.identify import identify

    exact = replace(servo.sensor, step_rad=1e-6, white_rad=1e-6, wander_rad=0.0)
    nuisances = servo.nuisances | {"ripple_Nm": 0.0}
    clean = replace(servo, eccentric=(0.0, 1.0, 0.0), nuisances=nuisances, sensor=exact)
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    command = SLOW_RAD * np.sin(2 * np.pi * 0.1 * t) + rng.uniform(-FAST_RAD, FAST_RAD, t.size)
    command[0] = 0.0
    angles = []
    for late in range(starts):
        recording = recorded(clean, plant, np.append(np.zeros(late), command), rng, "clean")
        angles.append(recording.position[late:])
    recording = replace(recording, t=t, command=command[:, None], position=np.mean(angles, axis=0))
    effects = ("unmodelled_inertia",) if servo.loads["a"].gravity_Nm else ()
    model = identify([recording], robot, law="pd", effects=effects).joints["j1"]
    return {name: getattr(model, name) for name in GAINS}


def one_servo(job: tuple[int, int, tuple[str, ...], float]) -> Row:
    """Every signal on one servo."""
    from excitation import signal

    from sim2real.design.plan import design

    seed, k, usual_signals, nuisances = job
    rng = np.random.default_rng([seed, k])
    plant = PLANTS[k % len(PLANTS)]
    servo = drawn(plant, rng, nuisances)
    robot = bench(servo)
    t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    held_out = recorded(servo, plant, signal("b", t, rng, SECONDS), rng, "held_out")
    set_values = dict(zip(GAINS, (servo.kp, servo.kd, servo.latency_s), strict=True))
    row: Row = {"plant": plant, "truth": truth(servo, plant, robot, np.random.default_rng(k)),
                "set": set_values, "loop_Hz": servo.loop_Hz,
                "noise_rad": servo.noise_rad, "pendulum": servo.loads["a"].gravity_Nm > 0,
                "stall_over_kp": servo.stall_Nm / servo.kp, "arms": {}, "seconds": {},
                "promised": {}}  # fmt: skip
    first = None
    for name in ("steps", *usual_signals):
        recording = recorded(servo, plant, usual(name, robot, rng), rng, name)
        model, row["arms"][name] = identified(recording, held_out, robot)
        first = first or model
    loads = {"j1": held_out.loads["j1"]}
    for name, model in zip(DESIGNS, (first, None), strict=True):
        start = time.process_time()
        plan = design(robot, model, seconds=SECONDS, loads=loads, seed=k)
        row["seconds"][name] = time.process_time() - start
        row["promised"][name] = plan.joints["j1"].expected
        command = plan.joints["j1"].found.command
        recording = recorded(servo, plant, command, rng, name.replace(" ", "_"))
        _, row["arms"][name] = identified(recording, held_out, robot)
    row["A"] = runpy.run_path(str(_HERE / "machine.py"))["seconds_per_ten_million_additions"](1)
    row["memory_MiB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return row


def widths(arm: Row) -> dict[str, float]:
    """Half-widths of the 90 % intervals, relative to the values; of the determined parameters."""
    found = {}
    for name, (low, high) in arm["interval"].items():
        value = arm["values"].get(name, 0.0)
        if value > 0 and np.isfinite([low, high]).all():
            width = (high - low) / 2 / value
            if 0 < width < DETERMINED.get(name, 0.5):  # 0: a bound of the fit, not an estimate
                found[name] = width
    return found


def ratio(row: Row, arm: str, other: str) -> float:
    """Widest interval of an arm over that of another, of the parameters that both determine.

    Where the other determines no parameter that the arm determines, 0; the reverse, infinity.
    """
    mine, theirs = widths(row["arms"][arm]), widths(row["arms"][other])
    common = mine.keys() & theirs.keys()
    if not common:
        return 0.0 if mine else np.inf
    return max(mine[n] for n in common) / max(theirs[n] for n in common)


def against_best(row: Row, arm: str) -> float:
    """The largest ratio to any of the usual signals: that to the best one."""
    return max(ratio(row, arm, name) for name in USUAL)


def covered(row: Row, arm: str) -> list[bool]:
    """Whether the intervals of gains and latency contain the truth."""
    found, interval = [], row["arms"][arm]["interval"]
    for name, value in row["truth"].items():
        low, high = interval.get(name, (-np.inf, np.inf))
        found.append(bool(low <= value <= high))
    return found


def summary(rows: list[Row], *, usual: bool) -> list[tuple[str, str]]:
    """What is stated: title and figures."""
    lines: list[tuple[str, str]] = []
    kept = {}
    for arm in DESIGNS:
        ratios = np.array([ratio(row, arm, "steps") for row in rows])
        kept[arm] = float(np.median(ratios))
        lines.append((f"{arm}: widest interval over that of steps", quantiles(ratios)))
        if usual:
            best = np.array([against_best(row, arm) for row in rows])
            lines.append((f"{arm}: over that of the best usual signal", quantiles(best)))
        promised = np.array([
            widths(row["arms"][arm])[n] / row["promised"][arm][n]
            for row in rows for n in GAINS if n in widths(row["arms"][arm])
        ])  # fmt: skip
        lines.append((f"{arm}: interval found over promised", quantiles(promised)))
        score = np.array([
            (row["arms"][arm]["values"][n] / row["truth"][n] - 1) / row["promised"][arm][n]
            for row in rows for n in GAINS
        ])  # fmt: skip
        lines.append((f"{arm}: error over promised half-width", quantiles(np.abs(score))))
        cost = np.array([row["seconds"][arm] / row["A"] for row in rows])
        lines.append((f"{arm}: processor time, A", quantiles(cost)))
    if kept[DESIGNS[0]] < 1:
        gain = (1 - kept[DESIGNS[1]]) / (1 - kept[DESIGNS[0]])
        lines.append(("share of the gain from the data sheet alone", f"{100 * gain:.0f} %"))
    for arm in rows[0]["arms"]:
        share = np.mean([covered(row, arm) for row in rows], axis=0)
        by = ", ".join(
            f"{n.split('_')[0]} {100 * x:.0f} %" for n, x in zip(GAINS, share, strict=True)
        )
        lines.append((f"{arm}: coverage of 90 % intervals", f"{100 * share.mean():.0f} % ({by})"))
    for arm in rows[0]["arms"]:
        held = [row["arms"][arm]["figures"]["heldout"] for row in rows]
        steps = [row["arms"]["steps"]["figures"]["heldout"] for row in rows]
        relative = np.array(held) / np.array(steps)
        lines.append((f"{arm}: held-out error over that of steps", quantiles(relative)))
        error = [
            abs(row["arms"][arm]["values"][n] / row["truth"][n] - 1) for row in rows for n in GAINS
        ]
        lines.append((f"{arm}: error of gains and latency, %", quantiles(100 * np.array(error))))
    lines.append(("peak memory of a process, MiB", f"{max(row['memory_MiB'] for row in rows):.0f}"))
    return lines


def quantiles(values: Array) -> str:
    """Median, and 10 and 90 % quantiles."""
    low, middle, high = np.quantile(values, (0.1, 0.5, 0.9), method="nearest")
    return f"{middle:.3g} ({low:.3g} to {high:.3g})"


def figure(rows: list[Row]) -> Any:  # noqa: ANN401 - Matplotlib is loaded when drawn
    """Widest interval of each arm over that of steps, one dot a servo."""
    from sim2real.report.style import ACCENT, FAINT, INK, MUTED, house_style, new_figure

    arms = [arm for arm in rows[0]["arms"] if arm != "steps"]
    with house_style():
        drawn_figure = new_figure(60 + 34 * len(arms), "widest interval over that of steps")
        axes = drawn_figure.add_subplot()
        for place, arm in enumerate(arms):
            for shade, plant in zip((ACCENT, INK, MUTED), PLANTS, strict=True):
                x = [ratio(row, arm, "steps") for row in rows if row["plant"] == plant]
                x = np.clip(x, 0.02, 50)
                axes.plot(x, [place] * len(x), "|", color=shade, markersize=11, alpha=0.7)
            middle = np.median([ratio(row, arm, "steps") for row in rows])
            axes.plot([np.clip(middle, 0.02, 50)], [place], "o", color=ACCENT, markersize=6)
        for bar in (0.5, 1.0):
            axes.axvline(bar, color=FAINT, linewidth=0.8)
        axes.set_xscale("log")
        axes.set_xticks([0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 50])
        axes.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
        axes.xaxis.set_minor_formatter(lambda x, _: "")
        axes.set_yticks(range(len(arms)), arms)
        axes.set_xlabel("widest 90 % interval over that of steps (dot: median), one line a servo")
        axes.set_title(f"red {PLANTS[0]}, black {PLANTS[1]}, grey {PLANTS[2]}")
    return drawn_figure


def numbered(job: tuple[int, int, tuple[str, ...], float]) -> Row:
    """The row of a servo, or the error that it ended in."""
    try:
        return {"number": job[1]} | one_servo(job)
    except Exception as refused:
        return {"number": job[1], "refused": str(refused)}


def write(rows: list[Row], options: argparse.Namespace) -> None:
    """Write every figure, the table and the plot."""
    from sim2real.output import write_whole
    from sim2real.report.drawing import save_png

    lines = summary(rows, usual=not options.quick)
    counted = ", ".join(f"{sum(row['plant'] == p for row in rows)} {p}" for p in PLANTS)
    text = [
        "# The best thirty seconds", "",
        f"{len(rows)} servos ({counted}), seed {options.seed}, nuisances scaled by "
        f"{options.nuisances:g}. Median, and 10 and 90 % quantiles over servos.", "",
        "| | |", "|---|---|",
        *(f"| {title} | {value} |" for title, value in lines), "",
        "![Widest interval of each signal](widths.png)", "",
        "Made by `python benchmarks/design.py`.", "",
    ]  # fmt: skip
    write_whole(options.out / "README.md", "\n".join(text))
    save_png(figure(rows), options.out / "widths.png")
    print("\n".join(f"{title}: {value}" for title, value in lines))


def main() -> None:
    """Run the servos, write every figure, print the table."""
    scale = "scale of cogging and eccentricity; 1: up to five times the noise each"
    options = command_line(
        __doc__, servos=200, seed=1, processes=1, out=Path("reports/design"),
        quick=(False, "leave out the usual signals"), nuisances=(1.0, scale),
    ).parse_args()  # fmt: skip
    signals = () if options.quick else USUAL
    jobs = [(options.seed, k, signals, options.nuisances) for k in range(options.servos)]
    file = options.out / "servos.jsonl"
    rows = {row["number"]: row for row in read_lines(file)}
    missing = [job for job in jobs if job[1] not in rows]
    made = spread(numbered, missing, options.processes, unit="servo", in_order=False)
    rows |= {row["number"]: row for row in kept(file, made)}
    write([rows[k] for k in sorted(rows) if "refused" not in rows[k]], options)
    print(f"{sum('refused' in row for row in rows.values())} servos without a result")


if __name__ == "__main__":
    main()
