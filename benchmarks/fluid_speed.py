"""Speed of the fluid and of swimming robots on one device, beside what its memory can do.

    python -m benchmarks.fluid_speed [--device cuda:0] [--tiny] [--out FILE.json]

Prints million lattice updates a second (MLUPS), the share of a device-to-device copy's bandwidth,
control steps a second of batches of swimmers, and memory for each. Writes the same as JSON.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from benchmarks.harness import command_line
from sim.fluid.fluid import Fluid, find_device
from sim.lattice.velocities import D2Q9, D3Q19, Lattice
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.twin.twin import Twin
from sim2real.model import JointModel, Model
from sim2real.robot import Joint, Link, Robot, Servo

SERVO = Servo("lx824", 1.67, 5.24, 0.00419)
ROBOT = Robot(
    "three-joint fish",
    (
        Link("head", 0.52, 0.20, 0.09, 0.12),
        Link("middle", 0.26, 0.11, 0.08, 0.11),
        Link("peduncle", 0.18, 0.10, 0.05, 0.10),
        Link("tail", 0.14, 0.11, 0.02, 0.12),
    ),
    tuple(Joint(f"j{k}", SERVO, (-0.8, 0.8)) for k in (1, 2, 3)),
)
MODEL = Model(joints={joint.name: JointModel(2.2, 0.06, 0.068, 0.002) for joint in ROBOT.joints})


def main() -> None:
    """Measure, print, write."""
    options = command_line(
        __doc__, device="cpu", threads=2, out=Path, tiny=(False, "seconds only: does it run?")
    ).parse_args()
    device = find_device(options.device)
    rows: list[dict[str, Any]] = []

    def note(**row: Any) -> None:  # noqa: ANN401 - numbers and names
        rows.append(row)
        print(
            "  ".join(
                f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()
            ),
            flush=True,
        )

    copy = copied(device, 2**20 if options.tiny else (2**28 if device.is_cuda else 2**26))
    note(what="copy", GB_s=copy / 1e9)
    for lattice, size in empty_boxes(device.is_cuda, options.tiny):
        for threads in (1,) if device.is_cuda else (1, options.threads):
            fluid = Fluid(lattice, size, viscosity=0.01, device=str(device), threads=threads)
            rate = fluid.cells * paced(device, partial(graph_steps, fluid), 10)
            used = rate * traffic(lattice)
            note(what="empty", lattice=lattice.name, size=size, threads=threads,
                 MLUPS=rate / 1e6, share_of_copy=used / copy)  # fmt: skip
    for cell, boxes in batches(device.is_cuda, options.tiny):
        for E in boxes:
            note(**swimming(cell, E, str(device), options.threads, copy))
    if not device.is_cuda:
        flat = swimming(0.02, 1, "cpu", options.threads, copy, dimensions=2)
        note(**flat)
    note(what="twin", robots=256, times_real_time=twin(256, options.device))
    if options.out:
        options.out.write_text(json.dumps({"device": device.name, "rows": rows}, indent=1))


def traffic(lattice: Lattice) -> int:
    """Bytes that one update of one cell reads and writes: its populations and its flag."""
    return 2 * lattice.Q * 4 + 1


def empty_boxes(cuda: bool, tiny: bool) -> list[tuple[Lattice, tuple[int, ...]]]:
    """Lattices, and cells of a box for each."""
    if tiny:
        return [(D3Q19, (32, 32, 32)), (D2Q9, (32, 32))]
    if not cuda:
        return [(D3Q19, (128, 128, 128)), (D2Q9, (1024, 1024))]
    return [(D3Q19, (384, 384, 384)), (D3Q19, (1024, 256, 256)), (D2Q9, (8192, 4096))]


def batches(cuda: bool, tiny: bool) -> list[tuple[float, tuple[int, ...]]]:
    """Cell sizes, and numbers of boxes for each."""
    if tiny:
        return [(0.04, (1, 2))]
    if not cuda:
        return [(0.02, (1, 4))]
    return [(0.02, (1, 16, 64, 256, 1024)), (0.01, (1, 8, 32, 128))]


def graph_steps(fluid: Fluid) -> None:
    """Ten steps, replayed from a graph on a GPU."""
    if not fluid.device.is_cuda:
        fluid.step(10)
        return
    graph = getattr(fluid, "_graph", None)
    if graph is None:
        fluid.step(2)
        with wp.ScopedCapture(device=fluid.device) as capture:
            fluid.step(10)
        graph = fluid._graph = capture.graph  # type: ignore[attr-defined]
    wp.capture_launch(graph)


def swimming(
    cell: float,
    E: int,
    device: str,
    threads: int,
    copy: float,
    dimensions: int = 3,
) -> dict[str, Any]:
    """Control steps a second of E robots that swim, each its own wave."""
    swimmer = Swimmer(
        ROBOT, MODEL, n_envs=E, device=device, cell_m=cell, dimensions=dimensions,
        threads=threads,
    )  # fmt: skip
    lag, amplitude = 1.2 * np.arange(3), np.array([0.3, 0.45, 0.6])
    phase = np.linspace(0, 2 * np.pi, E, endpoint=False)[:, None]
    waves = [
        wp.array(
            amplitude * np.sin(2 * np.pi * 1.5 * 0.02 * k - lag + phase),
            dtype=wp.float64,
            device=device,
        )
        for k in range(33)
    ]
    state = {"k": 0}

    def step() -> None:
        swimmer.step(waves[state["k"] % 33])
        state["k"] += 1

    rate = paced(swimmer.fluid.device, step, 1)
    lattice = swimmer.fluid.lattice
    updates = rate * E * swimmer.fluid.cells * swimmer.substeps
    memory = 4 * lattice.Q + 1 + 4
    return {
        "what": "swimming", "lattice": lattice.name, "cell_m": cell, "boxes": E,
        "cells": swimmer.fluid.cells, "substeps": swimmer.substeps, "control_steps_s": E * rate,
        "MLUPS": updates / 1e6, "share_of_copy": updates * traffic(lattice) / copy,
        "MB_per_box": swimmer.fluid.cells * memory / 1e6,
        "stopped": int((swimmer.state().stopped >= 0).sum()), "seconds": 0.02 * state["k"],
    }  # fmt: skip


def twin(robots: int, device: str, seconds: float = 12.0) -> float:
    """How much faster than life the reduced-order twin swims a batch, the best of three times."""
    times = CONTROL_S * np.arange(round(seconds / CONTROL_S))
    wave = np.sin(2 * np.pi * times[:, None] - 1.2 * np.arange(3))
    sent = np.minimum(1.0, times)[:, None] * np.array([0.3, 0.45, 0.6]) * wave
    batch = Twin(ROBOT, MODEL, n_envs=robots, device=device)
    batch.swim(sent[:10])  # compiles
    best = np.inf
    for _ in range(3):
        start = time.perf_counter()
        batch.swim(sent)
        best = min(best, time.perf_counter() - start)
    return robots * seconds / best


def paced(device: Any, work: Callable[[], None], each: int) -> float:  # noqa: ANN401 - Warp's
    """How many units of work a second, after a warm start, over at least half a second."""
    work()
    work()
    wp.synchronize_device(device)
    count, start = 0, time.perf_counter()
    while time.perf_counter() - start < 0.7:
        for _ in range(3):
            work()
        wp.synchronize_device(device)
        count += 3 * each
    return count / (time.perf_counter() - start)


def copied(device: Any, size: int) -> float:  # noqa: ANN401 - Warp's
    """Bytes read and written a second by a copy on the device."""
    a: Any = wp.zeros(size, dtype=wp.float32, device=device)
    b: Any = wp.zeros_like(a)
    return 8.0 * size * paced(device, lambda: wp.copy(b, a), 1)


if __name__ == "__main__":
    main()
