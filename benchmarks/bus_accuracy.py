"""How well servos on each bus are identified, through losses and noise.

python benchmarks/bus_accuracy.py [--seeds 8] [--processes 2] [--buses lx dynamixel feetech]
                                  [--baud 57600]

Each virtual servo has gains and a latency of its own and runs in a program of its own; ``record``
plays 30 s of steps, and ``identify`` fits the plain servo (``pd``) that it is. Prints the errors.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from tqdm import tqdm

from sim2real.arrays import Array
from sim2real.identification.identify import identify
from sim2real.recording import read_recording
from sim2real.robot import read_robot

BUSES = ("lx", "dynamixel", "feetech")
LOSS, NOISE, INERTIA_KGM2 = 0.02, 0.001, 0.002
BARS = (2.0, 2.0, 0.5)  # kp and kd in %, latency in ms
ROBOT = """
name = "bench"
[servos.s]
max_torque_Nm = 20.0
no_load_speed_rad_s = 20.0
[[links]]
name = "a"
[[links]]
name = "b"
[[joints]]
name = "j1"
servo = "s"
limits_rad = [-0.8, 0.8]
"""


def truth(seed: int) -> dict[str, float]:
    """Gains and latency of a virtual servo."""
    rng = np.random.default_rng(seed)
    kp = float(np.exp(rng.uniform(np.log(1.0), np.log(4.0))))
    damping = rng.uniform(0.3, 0.9)  # ratio
    kd = float(2 * damping * np.sqrt(kp * INERTIA_KGM2))
    return {"kp": kp, "kd": kd, "latency": float(rng.uniform(0.01, 0.08))}


def errors(
    bus: str, seed: int, seconds: float, baud: int | None
) -> tuple[float, float, float, float]:
    """Errors of kp and kd in % and of the latency in ms, and the share of missing positions."""
    servo = truth(seed)
    with TemporaryDirectory() as folder:
        robot, out = Path(folder, "robot.toml"), Path(folder, "steps.csv")
        robot.write_text(ROBOT)
        environment = os.environ | {"XDG_STATE_HOME": folder}
        program = [sys.executable, "-m", "sim2real"]
        given = [f"--{name}={value!r}" for name, value in servo.items()]
        given += ["--inertia", str(INERTIA_KGM2), "--loss", str(LOSS), "--noise", str(NOISE)]
        rate = [] if baud is None else ["--baud", str(baud)]
        command = [*program, "virtual-servo", *rate, "--bus", bus, "--seed", str(seed), *given]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as servos:
            assert servos.stdout is not None
            port = servos.stdout.readline().removeprefix("port: ").strip()
            record = [
                *program, "record", "steps", *rate, "--bus", bus, "--port", port, "--ids", "1",
                "--robot", str(robot), "--inertia", str(INERTIA_KGM2), "--seed", str(seed),
                "--seconds", str(seconds), "--out", str(out),
            ]  # fmt: skip
            try:
                subprocess.run(record, check=True, env=environment, capture_output=True)
            finally:
                servos.terminate()
        recording = read_recording(out)
        fit = identify([recording], read_robot(robot), law="pd").joints["j1"]
    return (
        100 * (fit.kp_Nm_per_rad / servo["kp"] - 1),
        100 * (fit.kd_Nms_per_rad / servo["kd"] - 1),
        1e3 * (fit.latency_s - servo["latency"]),
        float(np.isnan(recording.position).mean()),
    )


def described(bus: str, found: Array) -> str:
    """A line with the errors of one bus, shape (seeds, 4)."""
    inside = (np.abs(found[:, :3]) <= BARS).all(axis=1).sum()
    cells = [
        f"{name} {np.median(values):+.2f} (largest {np.abs(values).max():.2f}) {unit}"
        for name, unit, values in zip(
            ("kp", "kd", "latency"), ("%", "%", "ms"), found.T[:3], strict=True
        )
    ]
    missing = 100 * found[:, 3].mean()
    return f"{bus:<10} {inside} of {len(found)} within: {'; '.join(cells)}; {missing:.0f} % missing"


def main() -> None:
    """Record and identify, and print a line for each bus."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--buses", nargs="+", choices=BUSES, default=BUSES)
    parser.add_argument("--baud", type=int, help="bits per second; by default the bus's usual rate")
    options = parser.parse_args()
    cases = [(bus, seed) for bus in options.buses for seed in range(options.seeds)]
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        jobs = [
            pool.submit(errors, bus, seed, options.seconds, options.baud) for bus, seed in cases
        ]
        found = [job.result() for job in tqdm(jobs, unit="servo", disable=None)]
    table = np.array(found).reshape(len(options.buses), options.seeds, 4)
    for bus, values in zip(options.buses, table, strict=True):
        print(described(bus, values))


if __name__ == "__main__":
    main()
