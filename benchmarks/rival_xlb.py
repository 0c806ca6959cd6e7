"""The same empty box in XLB 0.3.1 and here, in one run on one CPU, with ratios.

    python benchmarks/rival_xlb.py [--rounds 3] [--size 128] [--venv DIR] [--out FILE]

XLB wants an older Warp, so it gets a virtual environment of its own. Each measurement is a process
of its own; they take turns, so that what else the machine does falls on all. The box is periodic,
D3Q19, single precision, with a shear wave whose decay must show the viscosity asked for.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

VERSIONS = ("xlb==0.3.1", "warp-lang==1.10.1")
VISCOSITY, SPEED = 0.1, 0.04
WHO = {
    "sim2real": (1, 2),
    "xlb warp": (1,),  # its launches on a CPU have one thread
    "xlb jax": (1, 2),
    "xlb jax fused": (1, 2),
}
"""Who runs, on how many threads. Fused: XLB's step in a loop that JAX compiles as a whole, in
place, which its own examples do not do."""
Box = tuple[Callable[[int], None], Callable[[], Any]]
"""Advance by some steps; velocity along x at one column of cells, which only the check reads."""


def main() -> None:
    """Measure in turns, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    parser.add_argument("--venv", type=Path, default=cache / "sim2real" / "xlb-0.3.1")
    parser.add_argument("--size", type=int, default=128, help="cells along each edge")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=6.0, help="for one measurement")
    parser.add_argument("--patience", type=float, default=30.0, help="s to wait for an idle CPU")
    parser.add_argument("--out", type=Path, default=Path("reports/speed/xlb.json"))
    parser.add_argument("--only", help=argparse.SUPPRESS)
    parser.add_argument("--threads", type=int, default=1, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        print(json.dumps(measured(options.only, options.size, options.threads, options.seconds)))
        return
    rival, runs = environment(options.venv), []
    for _ in range(options.rounds):
        for who, counts in WHO.items():
            for threads in counts:
                busy = calmest(options.patience)
                python = sys.executable if who == "sim2real" else str(rival)
                runs.append(in_process(python, who, threads, options) | {"busy_before": busy})
                print("  ".join(f"{k} {v}" for k, v in runs[-1].items()), flush=True)
    report = {"versions": VERSIONS, "size": options.size, "best": best(runs), "runs": runs}
    print(table(report["best"]))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(report, indent=1) + "\n")


def calmest(patience: float) -> float:
    """Wait until the processors are idle, or patience is over; the share of them that is busy."""
    end = time.perf_counter() + patience
    while True:
        before = processor_times()
        time.sleep(1)
        spent = processor_times() - before
        busy = 1 - spent[3] / spent.sum()
        if busy < 0.1 or time.perf_counter() > end:
            return round(float(busy), 2)


def processor_times() -> Any:  # noqa: ANN401
    """Time since the start in user, nice, system, idle and other states."""
    return np.array([int(x) for x in Path("/proc/stat").read_text().split()[1:9]])


def environment(where: Path) -> Path:
    """Python of XLB's environment, made where it is missing."""
    python = where / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(where)], check=True)
    if subprocess.run([str(python), "-c", "import xlb"], capture_output=True).returncode:
        subprocess.run([str(python), "-m", "pip", "install", "--quiet", *VERSIONS], check=True)
    return python


def in_process(python: str, who: str, threads: int, options: argparse.Namespace) -> dict[str, Any]:
    """One measurement in a process of its own; its last line is the result."""
    command = [python, __file__, "--only", who, "--threads", str(threads)]
    command += ["--size", str(options.size), "--seconds", str(options.seconds)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{who}: {done.stderr[-2000:]}")
    return dict(json.loads(done.stdout.splitlines()[-1]))


def measured(who: str, size: int, threads: int, seconds: float) -> dict[str, Any]:
    """Fastest and middle of many blocks of steps, and the viscosity that the wave shows."""
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-threads:])
    step, column = (ours if who == "sim2real" else xlb)(who, size, threads)
    step(4)
    first, steps, wall, cpu = amplitude(column()), 0, [], []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(wall) < 3:
        began, worked = time.perf_counter(), time.process_time()
        step(4)
        wall.append(4 * size**3 / 1e6 / (time.perf_counter() - began))
        cpu.append(4 * size**3 / 1e6 / (time.process_time() - worked))
        steps += 4
    decay = np.log(first / amplitude(column()))
    return {
        "who": who, "threads": threads, "MLUPS": round(max(wall), 2),
        "median": round(float(np.median(wall)), 2), "per_cpu_second": round(max(cpu), 2),
        "blocks": len(wall),
        "viscosity": round(float(decay / steps / (2 * np.pi / size) ** 2), 5),
    }  # fmt: skip


def wave(size: int) -> Any:  # noqa: ANN401 - XLB's environment has another NumPy
    """Velocity along x over z."""
    return SPEED * np.sin(2 * np.pi * np.arange(size) / size)


def amplitude(u: Any) -> float:  # noqa: ANN401
    """Amplitude of the wave."""
    return float(2 * np.mean(u * wave(len(u)) / SPEED))


def ours(_: str, size: int, threads: int) -> Box:
    """Our fluid."""
    from sim.fluid.fluid import Fluid
    from sim.lattice.velocities import D3Q19

    fluid = Fluid(D3Q19, (size,) * 3, viscosity=VISCOSITY, threads=threads)
    fluid.set(velocity=np.stack([wave(size), 0 * wave(size), 0 * wave(size)], axis=-1))
    return fluid.step, lambda: fluid.moments()[1][0, 0, 0, :, 0]


def xlb(who: str, size: int, _: int) -> Box:
    """XLB: BGK, no boundary conditions."""
    import jax
    import warp as wp
    import xlb
    from xlb.compute_backend import ComputeBackend
    from xlb.grid import grid_factory
    from xlb.helper.initializers import initialize_eq
    from xlb.operator.stepper import IncompressibleNavierStokesStepper

    backend = ComputeBackend.WARP if who == "xlb warp" else ComputeBackend.JAX
    policy = xlb.PrecisionPolicy.FP32FP32
    lattice = xlb.velocity_set.D3Q19(policy, backend)
    xlb.init(lattice, backend, policy)
    stepper = IncompressibleNavierStokesStepper(
        grid_factory((size,) * 3), boundary_conditions=[], collision_type="BGK"
    )
    start = np.zeros((3, size, size, size), dtype=np.float32)
    start[0] = wave(size)
    put = wp.array if who == "xlb warp" else jax.numpy.array
    f, other, *masks = stepper.prepare_fields(
        lambda grid, *rest: initialize_eq(grid.create_field(19), grid, *rest, u=put(start))
    )
    omega = 1 / (3 * VISCOSITY + 0.5)
    live = {"now": f, "next": other}

    def step(count: int) -> None:
        for k in range(count):
            _, live["next"] = stepper(live["now"], live["next"], *masks, omega, k)
            live["now"], live["next"] = live["next"], live["now"]
        wp.synchronize() if who == "xlb warp" else live["now"].block_until_ready()

    @jax.jit
    def advanced(f: Any, count: int, masks: Any) -> Any:  # noqa: ANN401
        return jax.lax.fori_loop(0, count, lambda k, f: stepper(f, f, *masks, omega, k)[1], f)

    def fused(count: int) -> None:
        live["now"] = jax.block_until_ready(advanced(live["now"], count, masks))

    def column() -> Any:  # noqa: ANN401
        f = live["now"].numpy() if who == "xlb warp" else np.asarray(live["now"])
        one = f[:, 0, 0, :].astype(np.float64)
        return np.tensordot(np.asarray(lattice._c)[0], one, 1) / one.sum(axis=0)

    return (fused if who == "xlb jax fused" else step), column


def best(runs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The fastest run of each, and how many times faster ours on as many threads is."""
    rows = []
    for who, counts in WHO.items():
        for threads in counts:
            mine = [r for r in runs if (r["who"], r["threads"]) == (who, threads)]
            rows.append({k: max(r[k] for r in mine) for k in ("who", "threads", "MLUPS")})
            rows[-1]["median"] = float(np.median([r["median"] for r in mine]))
            rows[-1]["per_cpu_second"] = max(r["per_cpu_second"] for r in mine)
            rows[-1]["viscosity"] = mine[0]["viscosity"]
            rows[-1]["busy_before"] = min(r["busy_before"] for r in mine)
    own = {r["threads"]: r for r in rows if r["who"] == "sim2real"}
    for r in rows:
        for key, by in (("ours_is_faster", "MLUPS"), ("ours_is_faster_by_cpu", "per_cpu_second")):
            r[key] = round(own[r["threads"]][by] / r[by], 2)
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """Who, threads, speed, ratio."""
    head = f"{'':16}{'threads':>8}{'MLUPS':>8}{'median':>8}{'ours is':>9}{'by CPU time':>13}"
    lines = [f"\n{head}{'viscosity':>11}"]
    lines += [
        f"{r['who']:16}{r['threads']:>8}{r['MLUPS']:>8.1f}{r['median']:>8.1f}"
        f"{r['ours_is_faster']:>8.1f}x{r['ours_is_faster_by_cpu']:>12.1f}x{r['viscosity']:>11.4f}"
        for r in rows
    ]
    one, two = (r["MLUPS"] for r in rows if r["who"] == "sim2real")
    return "\n".join([*lines, f"two threads against one: {two / one:.2f} times"])


if __name__ == "__main__":
    main()
