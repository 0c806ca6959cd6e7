"""Do the intervals of ``identify`` hold, on servos that obey their data sheet?

Servos are drawn, each with a motor near its data sheet's line, sent the random steps of
``datasets/servo_steps`` (which ask for more speed than there is), and recorded by that folder's
program, which shares nothing with the library. ``identify`` gets half a minute and the data sheet.

    python benchmarks/line_coverage.py --cases 400 --processes 2 [--out reports/line_coverage]
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
from harness import command_line, kept, read_lines, spread

from sim2real.identification.identify import identify
from sim2real.recording import Load, Recording
from sim2real.robot import Joint, Link, Robot, Servo

ROOT = Path(__file__).parents[1]
SPEC = importlib.util.spec_from_file_location(
    "servo_steps_make", ROOT / "datasets" / "servo_steps" / "make.py"
)
assert SPEC is not None and SPEC.loader is not None
PLANT = importlib.util.module_from_spec(SPEC)
sys.modules["servo_steps_make"] = PLANT
SPEC.loader.exec_module(PLANT)

SHEET = Servo("lx824", 1.67, 5.24, PLANT.POSITION_STEP_RAD)
LINK = Link("link", 0.3, 0.1, 0.1, 0.1)
ROBOT = Robot("bench", (LINK, LINK), (Joint("j1", SHEET, (-1.0, 1.0)),))
OF_LINE = ("stall_torque_Nm", "no_load_speed_rad_s")
NAMES = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s", *(f"motor.{name}" for name in OF_LINE))
SHEET_SD = 0.1
LEVEL, BAND = 0.90, 0.05


def one_case(seed: np.random.SeedSequence) -> list[tuple[float, float, float, float]]:
    """Truth, estimate and interval of each parameter of ``NAMES``."""
    rng = np.random.default_rng(seed)
    kp, kd = np.exp(rng.uniform(np.log([0.9, 0.03]), np.log([2.2, 0.1])))
    truth = PLANT.Servo(
        float(kp),
        float(kd),
        float(rng.uniform(0.04, 0.09)),
        float(rng.uniform(0.0012, 0.0025)),
        stall_torque_Nm=float(SHEET.max_torque_Nm * np.exp(SHEET_SD * rng.standard_normal())),
        no_load_speed_rad_s=float(
            SHEET.no_load_speed_rad_s * np.exp(SHEET_SD * rng.standard_normal())
        ),
    )
    ticks = np.arange(PLANT.DURATION_S * PLANT.RATE_HZ + 1)
    t = ticks / PLANT.RATE_HZ + rng.normal(0.0, PLANT.JITTER_SD_S, ticks.size)
    t -= t[0]
    command = PLANT.steps(t - PLANT.REST_S, rng) * (t >= PLANT.REST_S)
    noisy = PLANT.simulate(truth, t, t, command)[:, 0]
    noisy = noisy + rng.normal(0.0, PLANT.NOISE_SD_RAD, t.size)
    measured = np.round(noisy / PLANT.POSITION_STEP_RAD) * PLANT.POSITION_STEP_RAD
    load = {"j1": Load(truth.inertia_kgm2)}
    recording = Recording("steps", "servo", ("j1",), t, command[:, None], measured[:, None], load)
    joint = identify([recording], ROBOT).joints["j1"]
    rows = []
    for name in NAMES:
        short = name.removeprefix("motor.")
        found = joint.motor.get(short, np.nan) if short != name else getattr(joint, name)
        rows.append((getattr(truth, short), found, *joint.interval.get(name, (np.nan, np.nan))))
    return rows


def main() -> None:
    """Run the cases, print and write."""
    default = ROOT / "reports" / "line_coverage"
    options = command_line(__doc__, cases=400, seed=2026, processes=1, out=default).parse_args()
    file = options.out / f"seed-{options.seed}.jsonl"  # a run that was killed goes on from here
    done = read_lines(file)
    seeds = np.random.SeedSequence(options.seed).spawn(options.cases)[len(done) :]
    done += kept(file, spread(one_case, seeds, options.processes, unit="servo"))
    text = report(np.array(done[: options.cases]), options.seed)
    (options.out / "README.md").write_text(text)
    print(text)


def report(table: np.ndarray, seed: int) -> str:
    """The page."""
    truth, estimate, low, high = np.moveaxis(table, 2, 0)
    held = (low <= truth) & (truth <= high)
    wide = (high - low) / 2 / truth
    lines = [
        "# Intervals of servos that obey their data sheet",
        "",
        f"{len(table)} servos drawn with seed {seed}: kp 0.9 to 2.2 N m/rad, kd 0.03 to 0.1",
        "N m s/rad, latency 40 to 90 ms, stall torque and no-load speed within 10 % (one",
        "standard deviation) of 1.67 N m and 5.24 rad/s. Half a minute of random steps at 50 Hz,",
        "0.24 degree sensor steps, 1.5 mrad of noise; the last quarter is held out; the data",
        "sheet is known.",
        "",
        f"| | 90 % intervals that hold the truth (bar: {100 * (LEVEL - BAND):.0f} to "
        f"{100 * (LEVEL + BAND):.0f}) | median error | 95th percentile | median half-width |",
        "| --- | --- | --- | --- | --- |",
    ]
    for k, name in enumerate(NAMES):
        error = np.abs(estimate[:, k] / truth[:, k] - 1)
        lines.append(
            f"| {name} | {100 * held[:, k].mean():.1f} % | {100 * np.median(error):.2f} % "
            f"| {100 * np.quantile(error, 0.95):.2f} % | {100 * np.median(wide[:, k]):.2f} % |"
        )
    lines += ["", "Made by `python benchmarks/line_coverage.py`.", ""]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
