"""Whether servos are released and their limits restored after recordings are killed at any moment.

python benchmarks/kill_recording.py [--kills 100] [--bus dynamixel] [--seed 0]

Virtual servos with losses and noise are recorded by programs that are killed at random moments:
with SIGTERM, which they handle, and with SIGKILL, after which the next command on the port has to
restore the servos. Prints for each signal how often torque and limits were as before.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import multiprocessing
import os
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from tqdm import tqdm

from sim2real.cli import main as sim2real
from sim2real.hardware.servo_models import model_named
from sim2real.hardware.virtual_bus import VirtualBus
from sim2real.hardware.virtual_dynamixel import DYNAMIXEL, dynamixel_servo
from sim2real.hardware.virtual_feetech import FEETECH, feetech_servo
from sim2real.hardware.virtual_link import serve_terminal
from sim2real.hardware.virtual_lx import LX, VirtualServo
from sim2real.hardware.virtual_registers import RegisterServo
from sim2real.hardware.virtual_shaft import Law

LIMITS = {"profile_velocity": 60, "profile_acceleration": 9}
LOSS, NOISE = 0.02, 0.001
SECONDS = 1.0  # of a recording
LATEST_S = 2.6  # of a kill, after the start of the program
ROBOT = """
name = "bench"
[servos.s]
max_torque_Nm = 2.0
no_load_speed_rad_s = 6.0
[[links]]
name = "a"
[[links]]
name = "b"
[[joints]]
name = "j1"
servo = "s"
limits_rad = [-0.8, 0.8]
"""


@dataclass
class Tally:
    """What was found after the kills by one signal."""

    kills: int = 0
    ended_before: int = 0
    powered_at_kill: int = 0
    restored: int = 0
    slowest_s: float = 0.0

    def __str__(self) -> str:
        return (
            f"{self.restored} of {self.kills} restored ({self.powered_at_kill} killed with the "
            f"torque on, {self.ended_before} had ended before; torque off at most "
            f"{1e3 * self.slowest_s:.0f} ms after)"
        )


class Bench:
    """A virtual servo with limits of its own, on a pseudo-terminal."""

    def __init__(self, bus: str, rng: np.random.Generator) -> None:
        self.bus, law, now = bus, Law(), time.monotonic()
        if bus == "lx":
            self.servo, speech, baud = VirtualServo(1, law, now), LX, 115_200
        elif bus == "dynamixel":
            model = model_named(bus, "XL330-M288")
            self.servo, speech, baud = dynamixel_servo(1, model, law, now), DYNAMIXEL, 1_000_000
        else:
            model = model_named(bus, "STS3215")
            self.servo, speech, baud = feetech_servo(1, model, law, now), FEETECH, 1_000_000
        if isinstance(self.servo, RegisterServo):
            for name, value in LIMITS.items():
                self.servo.put(name, value)
        self._stop, announced = threading.Event(), threading.Event()

        def announce(port: str) -> None:
            self.port = port
            announced.set()

        line = VirtualBus([self.servo], speech, rng, baud=baud, loss=LOSS, noise=NOISE)
        arguments = (line, announce, self._stop.is_set)
        self._thread = threading.Thread(target=serve_terminal, args=arguments)
        self._thread.start()
        announced.wait(10)

    @property
    def restored(self) -> bool:
        """Whether torque and limits are as before."""
        if self.servo.powered:
            return False
        if not isinstance(self.servo, RegisterServo):
            return True
        watchdog = self.bus == "dynamixel" and self.servo.get("bus_watchdog")
        return not watchdog and all(self.servo.get(name) == x for name, x in LIMITS.items())

    def close(self) -> None:
        """End the simulation."""
        self._stop.set()
        self._thread.join()


def record(bus: str, port: str, folder: str) -> None:
    """Record, in a program of its own."""
    os.environ["XDG_STATE_HOME"] = folder
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        sim2real(
            ["record", "sine", "--bus", bus, "--port", port, "--ids", "1", "--seconds",
             str(SECONDS), "--robot", f"{folder}/robot.toml", "--out", f"{folder}/run.csv",
             "--overwrite"]
        )  # fmt: skip


def kill_once(
    bench: Bench, number: signal.Signals, moment_s: float, folder: str, tally: Tally
) -> None:
    """Start a recording, kill it, and see what is left."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["sim2real.commands.record", "scipy.signal", "serial"])
    program = context.Process(target=record, args=(bench.bus, bench.port, folder))
    program.start()
    program.join(moment_s)
    tally.kills += 1
    if not program.is_alive():
        tally.ended_before += 1
    tally.powered_at_kill += bench.servo.powered
    killed = time.monotonic()
    with contextlib.suppress(ProcessLookupError):
        os.kill(program.pid, number)
    if number == signal.SIGTERM:
        while bench.servo.powered and time.monotonic() < killed + 5:
            time.sleep(0.001)
        tally.slowest_s = max(tally.slowest_s, time.monotonic() - killed)
    program.join(20)
    if number == signal.SIGKILL:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            scan = ["scan", "--bus", bench.bus, "--port", bench.port, "--ids", "1"]
            began = time.monotonic()
            sim2real(scan)
        tally.slowest_s = max(tally.slowest_s, time.monotonic() - began)
    tally.restored += bench.restored


def kills(bus: str, number: signal.Signals, count: int, seed: int) -> Tally:
    """The tally of so many kills at random moments."""
    rng, tally = np.random.default_rng(seed), Tally()
    with TemporaryDirectory() as folder:
        Path(folder, "robot.toml").write_text(ROBOT)
        os.environ["XDG_STATE_HOME"] = folder
        bench = Bench(bus, np.random.default_rng(seed + 1))
        try:
            for _ in tqdm(range(count), desc=f"{bus} {number.name}", disable=None):
                kill_once(bench, number, float(rng.uniform(0, LATEST_S)), folder, tally)
        finally:
            bench.close()
    return tally


def main() -> None:
    """Kill, and print the tallies."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--bus", choices=("lx", "dynamixel", "feetech"), default="dynamixel")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for number in (signal.SIGTERM, signal.SIGKILL):
        print(number.name, kills(options.bus, number, options.kills, options.seed), flush=True)


if __name__ == "__main__":
    main()
