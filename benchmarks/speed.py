"""Speed and memory, each beside its target or beside what a plain tool needs, in one run.

python -m benchmarks.speed
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping

import numpy as np
from scipy.optimize import differential_evolution

from benchmarks.harness import ROOT, seconds_per_ten_million_additions
from sim2real.arrays import Array

DATA = ROOT / "datasets" / "servo_steps"
LINE = {"stall_torque_Nm": 1.6, "no_load_speed_rad_s": 5.2}
LOSSES = LINE | {
    "resistance_rise": 1.0,
    "rotor_inertia_kgm2": 0.001,
    "coulomb_Nm": 0.02,
    "motor_friction": 0.2,
    "load_friction": 0.1,
    "stribeck_motor_friction": 0.1,
    "stribeck_load_friction": 0.05,
    "stribeck_speed_rad_s": 0.5,
}
FITTED = ("steps", "sine", "square")


def main() -> None:
    """Print the table."""
    print(f"A = {seconds_per_ten_million_additions():.2f} s: ten million additions in a loop")
    print(f"{'':58}{'measured':>12}{'target':>12}{'ratio':>8}")
    help_s = best_of(3, lambda: run_cli("--help"))
    row("sim2real --help", help_s, 0.5, "s")
    row("256 rollouts of 5000 sub-steps, one core", 1e3 * rollouts(256, 5000), 40.0, "ms")
    for law in (LINE, LOSSES):
        name = "  on the motor's line" if law is LINE else "  with all of its losses"
        row(name, 1e3 * rollouts(256, 5000, law), 40.0, "ms")
    base = rollouts(256, 5000)
    row("  cost of four times the rollouts", rollouts(1024, 5000) / base, 4.4, "times")
    row("  cost of four times the sub-steps", rollouts(256, 20000) / base, 4.4, "times")
    seconds, joint_seconds, loss = identification()
    row("identify, 3 joints, 3 x 30 s at 50 Hz", seconds, 3.0, "s")
    plain = plain_search(loss)
    row("  differential evolution on a NumPy rollout, one joint", plain, None, "s")
    row("  identify, one joint, against it: times faster", plain / joint_seconds, 50.0, "times")
    row("identify: peak memory of the whole command", identify_memory_mb(), 500.0, "MB")


def row(what: str, measured: float, target: float | None, unit: str) -> None:
    """Print one line; the ratio is measured / target."""
    goal = f"{target:g} {unit}" if target else ""
    ratio = f"{measured / target:.2f}" if target else ""
    print(f"{what:58}{f'{measured:.3g} {unit}':>12}{goal:>12}{ratio:>8}", flush=True)


def best_of(times: int, work: Callable[[], object]) -> float:
    """Shortest wall time of some runs, in s."""
    spent = []
    for _ in range(times):
        start = time.perf_counter()
        work()
        spent.append(time.perf_counter() - start)
    return min(spent)


def run_cli(*arguments: str) -> None:
    """Run the command line in a process of its own, silently."""
    subprocess.run(
        [sys.executable, "-m", "sim2real", *arguments], stdout=subprocess.DEVNULL, check=True
    )


def rollouts(batch: int, substeps: int, motor: Mapping[str, float] | None = None) -> float:
    """Time of a batch of rollouts of one joint, in s; of a linear servo without a motor."""
    from sim2real.servo.parameters import COLUMNS
    from sim2real.servo.rollout import rollout

    theta = np.zeros((batch, len(COLUMNS)))
    theta[:, :4] = (2.2, 0.06, 0.068, 0.002)
    theta[:, 0] *= np.linspace(0.9, 1.1, batch)
    for name, value in (motor or {}).items():
        theta[:, COLUMNS.index(f"motor.{name}")] = value
    t = 1e-3 * np.arange(substeps + 1)  # samples so close that each is one sub-step away
    command = 0.5 * np.sign(np.sin(np.pi * t))
    change = np.flatnonzero(np.diff(command)) + 1
    command[change] = command[change - 1]
    return best_of(5, lambda: rollout(theta, t, command, substep_s=1.01e-3))


def identification() -> tuple[float, float, float]:
    """Time of identify for all joints and for one, in s, and the mean square error of that one."""
    from sim2real.identification.identify import identify
    from sim2real.recording import read_recording
    from sim2real.robot import read_robot

    robot = read_robot(DATA / "robot.toml")
    recordings = [read_recording(DATA / f"{name}.csv") for name in FITTED]
    identify(recordings, robot)
    everything = best_of(3, lambda: identify(recordings, robot))
    loss = identify([recordings[0]], robot).fit["j1.position_rad"]["train"]
    return everything, everything / 3, float(loss or 0.0) ** 2


def plain_search(loss: float) -> float:
    """Time that differential evolution needs to come within 1 % of ``loss``, in s.

    It fits one joint of one recording with a rollout that is plain NumPy, vectorised over the
    population, at the 1 ms step that such scripts use.
    """
    from sim2real.recording import read_recording

    recording = read_recording(DATA / "steps.csv")
    t, command, measured = recording.t, recording.command[:, 0], recording.position[:, 0]
    early = np.isfinite(measured) & (t < 0.75 * t[-1])
    inertia = recording.loads["j1"].inertia_kgm2
    grid = np.arange(t[0], 0.75 * t[-1], 1e-3)
    sample = np.clip(np.searchsorted(grid, t[early]), 0, grid.size - 1)

    def error(x: Array) -> Array:
        kp, kd, latency = x.reshape(3, -1)
        q, v = np.full(kp.size, command[0]), np.zeros(kp.size)
        angle = np.empty((grid.size, kp.size))
        held = np.searchsorted(t, grid[:, None] - latency, side="right") - 1
        sent = command[np.maximum(held, 0)]
        for k in range(grid.size):
            angle[k] = q
            v = v + 1e-3 * (kp * (sent[k] - q) - kd * v) / inertia
            q = q + 1e-3 * v
        with np.errstate(over="ignore", invalid="ignore"):
            return np.nan_to_num(
                np.mean((angle[sample] - measured[early, None]) ** 2, axis=0), nan=1e9
            )

    start = time.perf_counter()
    differential_evolution(
        error,
        [(0.05, 20.0), (0.001, 1.0), (0.0, 0.3)],
        vectorized=True,
        updating="deferred",
        rng=1,
        tol=0.0,
        maxiter=300,
        polish=False,
        callback=lambda intermediate_result: intermediate_result.fun < 1.01 * loss,
    )
    return time.perf_counter() - start


def identify_memory_mb() -> float:
    """Peak resident memory of ``sim2real identify`` on the shipped recordings, in MB."""
    files = [str(DATA / f"{name}.csv") for name in FITTED]
    robot = ["--robot", str(DATA / "robot.toml")]
    run_cli("identify", *files, *robot, "--out", "/tmp/speed-model.json")
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024


if __name__ == "__main__":
    main()
