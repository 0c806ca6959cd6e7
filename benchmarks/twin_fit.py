"""Fit the reduced-order twin's coefficients to the fluid, and say how well it stands in for it.

    python -m benchmarks.twin_fit --fluid [--device cuda:0] [--cell-m 0.01]   # makes fluid.npz
    python -m benchmarks.twin_fit                                             # fits, prints

The fit of ``sim2real fit-twin`` (``sim/twin/fit.py``) for the shipped robot, in cells of 1 cm and
with its uncertainty. Writes ``reports/twin/`` and the library's coefficients,
``sim/twin/fitted.json``.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from scipy.optimize import OptimizeResult

import sim2real as s2r
from benchmarks.harness import ROOT, command_line, spread, table
from sim.twin.fit import HELD_OUT, NAMES, STARTS, Swims, hull_alone, law_of, swum
from sim.twin.law import FILE, links_of
from sim2real.arrays import Array
from sim2real.model import JointModel, Model
from sim2real.output import write_json
from sim2real.progress import progress_bar

ROBOT = s2r.read_robot(ROOT / "datasets" / "pool" / "robot.toml")
MODEL = Model(joints={j.name: JointModel(2.0, 0.07, 0.066, 0.002) for j in ROBOT.joints})
OUT = ROOT / "reports" / "twin"
SECONDS = 10.0
UNSTEADY = ("square 0.5 Hz", "wave that rests")
"""Swims that are no steady waves; the bar is on the others."""


def fluid(device: str, cell_m: float) -> None:
    """Swim all signals in the fluid, keep the tracks."""
    with progress_bar("fluid") as progress:
        swims = swum(ROBOT, MODEL, SECONDS, progress, cell_m=cell_m, device=device)
    OUT.mkdir(parents=True, exist_ok=True)
    tracks = swims.track.astype(np.float32)
    np.savez_compressed(OUT / "fluid.npz", track=tracks, cell_m=cell_m, signal=swims.names)


def kept(path: Path) -> tuple[Swims, float]:
    """The swims in a file, and the size of the cells."""
    file = np.load(path)
    names = tuple(str(name) for name in file["signal"])
    track = file["track"].astype(np.float64)
    return Swims(hull_alone(ROBOT), MODEL, names, track), float(file["cell_m"])


def uncertainty(found: OptimizeResult, count: int) -> tuple[Array, float]:
    """Relative standard deviations of the coefficients, and the condition of the fit.

    The deviations come from the scatter of the swims' scores (the sandwich of White, Econometrica
    48 (1980) 817, a swim a cluster); the condition is that of the slopes, each scaled to length 1.
    """
    bread = np.linalg.pinv(found.jac.T @ found.jac)
    score = (found.jac * found.fun[:, None]).reshape(count, -1, found.x.size).sum(axis=1)
    spread = bread @ (score.T @ score * count / max(count - 1, 1)) @ bread
    length = np.linalg.norm(found.jac, axis=0)
    return np.sqrt(np.diag(spread)), float(np.linalg.cond(found.jac / np.where(length, length, 1)))


def fit() -> None:
    """Fit, score on the swims held out, write."""
    swims, cell_m = kept(OUT / "fluid.npz")
    held = np.array([name in HELD_OUT for name in swims.names])
    seen = np.flatnonzero(~held)
    found = list(spread(partial(swims.fitted, seen), STARTS, len(STARTS), unit="start"))
    best = min(found, key=lambda one: one.cost)
    chosen = law_of(best.x)
    deviation, condition = uncertainty(best, seen.size)
    error, rms = swims.errors(chosen), swims.rms
    result = {
        "coefficients": vars(chosen),
        "relative_sd": dict(zip(NAMES, deviation.tolist(), strict=True)),
        "condition": condition,
        "costs": [float(one.cost) for one in found],
        "cell_m": cell_m,
        "rows": [
            {"signal": name, "held_out": bool(held[k]), "steady": name not in UNSTEADY,
             "error": error[k].tolist(), "rms": rms[k].tolist()}
            for k, name in enumerate(swims.names)
        ],
    }  # fmt: skip
    write_json(OUT / "fit.json", result)
    print(table(("coefficient", "fitted", "standard deviation"), [
        (name, f"{value:.3g}", f"{100 * sd:.0f} %")
        for (name, value), sd in zip(vars(chosen).items(), deviation, strict=True)
    ]))  # fmt: skip
    print(f"condition {condition:.0f}; errors in the root mean square of each swim")
    rows = [
        (f"{name} (held out)" if held[k] else name, *(f"{100 * x:.1f} %" for x in error[k, :3]))
        for k, name in enumerate(swims.names)
    ]
    print(table(("swim", "surge", "sway", "yaw rate"), rows))
    law = {name: float(f"{v:.4g}") for name, v in vars(chosen).items()}
    print(write_json(FILE, {**law, "links_m": links_of(ROBOT)}))


if __name__ == "__main__":
    only = (False, "swim in the fluid, fit nothing")
    options = command_line(__doc__, fluid=only, device="cpu", cell_m=0.01).parse_args()
    if options.fluid:
        fluid(options.device, options.cell_m)
    else:
        fit()
