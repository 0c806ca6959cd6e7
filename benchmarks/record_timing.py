"""How well the recorder keeps 50 Hz with three virtual servos, which run in a program of their own.

python benchmarks/record_timing.py [--minutes 10] [--udp]

On a busy computer a pseudo-terminal itself holds bytes back for tens of milliseconds (the kernel
passes them on at ordinary priority); replies are then missing. Datagrams are not held back.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from contextlib import closing, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from tqdm import tqdm

from sim2real.arrays import Array
from sim2real.hardware.lx_bus import LxBus, lx_servo
from sim2real.hardware.motion import approach, release
from sim2real.hardware.mounting import mount
from sim2real.hardware.priority import priority
from sim2real.hardware.recorder import columns, record
from sim2real.hardware.row_stream import RowStream
from sim2real.hardware.transport import open_transport
from sim2real.recording import SCHEMA, read_recording
from sim2real.robot import read_robot
from sim2real.signals import excitation

ROBOT = Path(__file__).parents[1] / "datasets" / "servo_steps" / "robot.toml"
RATE_HZ, IDS, LATE_S = 50.0, [1, 2, 3], 0.005
EDGES_MS = (0, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, np.inf)
BAR = 50


def main() -> None:
    """Record, and print how late the cycles began."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--plain", action="store_true", help="ask for no real-time priority")
    parser.add_argument("--udp", action="store_true", help="datagrams, not a pseudo-terminal")
    options = parser.parse_args()
    command = [sys.executable, "-m", "sim2real", "virtual-servo", "--ids", "1,2,3"]
    command += ["--udp", "127.0.0.1:0"] if options.udp else []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as servos:
        assert servos.stdout is not None
        port = servos.stdout.readline().removeprefix("port: ").strip()
        try:
            late = recorded(port, 60 * options.minutes, plain=options.plain)
        finally:
            servos.terminate()
    print(described(late))


def recorded(port: str, seconds: float, *, plain: bool) -> Array:
    """How late each cycle began, in s."""
    robot = read_robot(ROBOT)
    mountings = mount(robot, [lx_servo(servo_id) for servo_id in IDS])
    rng = np.random.default_rng(0)
    signal = excitation("steps", robot.joints, seconds=seconds, rate_hz=RATE_HZ, rng=rng)
    sidecar = {"schema": SCHEMA, "kind": "servo", "joints": list(signal.joints)}
    with (
        TemporaryDirectory() as folder,
        nullcontext(False) if plain else priority() as granted,
        closing(LxBus(open_transport(port))) as bus,
        RowStream(Path(folder) / "run.csv", columns(mountings), sidecar) as stream,
        tqdm(total=signal.t.size, unit="row", disable=None) as bar,
    ):
        approach(bus, mountings, list(signal.command[0]), hottest_C=65)
        begin = time.monotonic()
        outcome = record(
            bus,
            mountings,
            signal.command,
            stream.write,
            rate_hz=RATE_HZ,
            hottest_C=65,
            progress=bar.update,
        )
        took = time.monotonic() - begin
        held = [str(k) for k in release(bus, {servo_id: {} for servo_id in IDS})]
        rows = read_recording(Path(folder) / "run.csv").t.size
    print(
        f"{rows} rows in {took:.2f} s (planned {signal.t.size} in {seconds:.2f} s), "
        f"{outcome.skipped} skipped, missing positions {outcome.missing}, "
        f"real-time priority {'granted' if granted else 'not granted'}, "
        f"ended by {outcome.stopped or 'itself'}, not let go: {', '.join(held) or 'none'}"
    )
    return np.array(outcome.late_s)


def described(late: Array) -> str:
    """Percentiles, the share of late cycles and a histogram."""
    share = float(np.mean(late > LATE_S))
    lines = [
        f"{100 * (1 - share):.3f} % of {late.size} cycles began within {1e3 * LATE_S:g} ms "
        f"({int((late > LATE_S).sum())} later)",
        "late, ms: "
        + ", ".join(f"{q:g} % {1e3 * np.percentile(late, q):.3f}" for q in (50, 90, 99, 99.9, 100)),
        "",
        "late, ms        cycles",
    ]
    counts, _ = np.histogram(1e3 * late, EDGES_MS)
    for low, high, count in zip(EDGES_MS[:-1], EDGES_MS[1:], counts, strict=True):
        length = round(BAR * np.log1p(count) / np.log1p(late.size))
        lines.append(f"{low:>5g} to {high:<5g} {count:>7}  {'#' * length}")
    return "\n".join([*lines, "(length of the bars: logarithm of the count)"])


if __name__ == "__main__":
    main()
