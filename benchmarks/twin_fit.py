"""Fit the reduced-order twin's coefficients to the fluid, and say how well it stands in for it.

    python -m benchmarks.twin_fit --fluid [--device cuda:0] [--cell-m 0.01]   # makes fluid.npz
    python -m benchmarks.twin_fit                                             # fits, prints

Swims of ten seconds under different commands; the fit does not see those held
out. It is least squares on surge, sway and yaw rate by the library's velocity estimator, and on the
joints' angles, which show what the water asks of the servos; each in the root mean square of its
own swim. Writes ``reports/twin/`` and the library's coefficients, ``sim/twin/fitted.json``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from tqdm import tqdm

import sim2real as s2r
from benchmarks.harness import ROOT, command_line, spread, table
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.twin.law import FILE, Coefficients
from sim.twin.twin import Twin
from sim2real.arrays import Array, Index
from sim2real.model import JointModel, Model
from sim2real.output import write_json
from sim2real.velocity import body_velocity

_FILE = s2r.read_robot(ROOT / "datasets" / "pool" / "robot.toml")
ROBOT = replace(_FILE, links=tuple(replace(link, appendages=()) for link in _FILE.links))
"""The hull alone: fluid and twin take the forces on appendages from the same figures."""
MODEL = Model(joints={j.name: JointModel(2.0, 0.07, 0.066, 0.002) for j in ROBOT.joints})
OUT = ROOT / "reports" / "twin"
Signal = Callable[[float], Array]

SECONDS = 10.0
_SIZE, _LAG = np.array([0.30, 0.45, 0.60]), 1.2 * np.arange(3)
_MOST = 0.78


def wave(hertz: float, scale: float, bias: float = 0.0, lag: float = 1.0) -> Signal:
    """A travelling wave about a bend."""
    return lambda t: np.clip(
        min(1.0, t)
        * (scale * _SIZE * np.sin(2 * np.pi * hertz * t - lag * _LAG) + bias * np.ones(3)),
        -_MOST,
        _MOST,
    )


def sine(hertz: float, size: float) -> Signal:
    """The same sine in all joints."""
    return lambda t: np.full(3, size * np.sin(2 * np.pi * hertz * t))


def square(hertz: float, size: float) -> Signal:
    """The same square in all joints, as in the paper."""
    return lambda t: np.full(3, size * np.sign(np.sin(2 * np.pi * hertz * t)))


def rests(moving: Signal, start: float, end: float) -> Signal:
    """A signal that fades to straight joints between two times, in half a second each way."""

    def fading(t: float) -> Array:
        out = np.clip((t - start) / 0.5, 0, 1) * np.clip((end - t) / 0.5, 0, 1)
        return np.asarray((1 - out) * moving(t))

    return fading


SIGNALS: dict[str, Signal] = {
    "wave 1 Hz": wave(1.0, 1.0),
    "wave 1.5 Hz": wave(1.5, 0.8),
    "wave 0.75 Hz": wave(0.75, 1.2),
    "weak wave": wave(1.0, 0.6),
    "left turn": wave(1.2, 0.7, 0.3),
    "square 0.5 Hz": square(0.5, 0.52),
    "long wave": wave(1.2, 0.9, 0.0, 0.5),
    "right turn": wave(1.5, 0.8, -0.4),
    "wave 1.75 Hz": wave(1.75, 0.7),
    "wave 2.25 Hz": wave(2.25, 0.5),
    "slow wave": wave(0.5, 1.3),
    "strong wave": wave(1.0, 1.25),
    "short wave": wave(1.2, 0.9, 0.0, 1.4),
    "sine 0.8 Hz, all joints": sine(0.8, 0.4),
    "sine 1.3 Hz, all joints": sine(1.3, 0.45),
    "tight left turn": wave(1.0, 0.8, 0.4),
    "slight right turn": wave(1.3, 0.9, -0.15),
    "wave that rests": rests(wave(1.2, 0.9), 4.0, 7.0),
    "sine 1 Hz, all joints": sine(1.0, 0.52),
    "wave 1.25 Hz": wave(1.25, 0.9),
    "gentle turn": wave(1.0, 1.0, 0.2),
    "wave 2 Hz": wave(2.0, 0.6),
    "longer wave 0.9 Hz": wave(0.9, 1.1, 0.0, 0.75),
    "right turn 1.1 Hz": wave(1.1, 0.9, -0.25),
}
HELD_OUT = tuple(SIGNALS)[18:]
"""Swims that the fit does not see: other waves, turns and sines than those before them."""
UNSTEADY = ("square 0.5 Hz", "wave that rests")
"""Swims that are no steady waves; the bar is on the others."""


def set_points(names: list[str]) -> Array:
    """Set-points in rad of the swims that are named, shape (signals, T, 3)."""
    times = CONTROL_S * np.arange(round(SECONDS / CONTROL_S))
    return np.array([[SIGNALS[name](t) for t in times] for name in names])


NAMES = tuple(field.name for field in fields(Coefficients))
BOUNDS = {
    "slender": (0.2, 20.0),
    "head": (0.05, 2.0),
    "wake": (1e-3, 0.95),
    "wake_s": (0.1, 10.0),
    "tail": (0.2, 5.0),
    "lag": (0.02, 10.0),
}
_LEAST, _MOST = 1e-3, 100.0
_STEP = 0.02
STARTS = (
    Coefficients(4.0, 1.0, 1.0, 0.3, 1.0, 2.0, 0.5, 0.3, 0.5, 1.0, 1.0, 0.5),
    Coefficients(2.0, 0.3, 0.8, 0.8, 0.3, 2.0, 0.8, 0.1, 0.2, 2.0, 1.0, 0.2),
    Coefficients(8.0, 2.0, 1.0, 0.1, 3.0, 1.0, 0.5, 0.5, 0.6, 0.5, 1.5, 1.0),
)


def fluid(device: str, cell_m: float) -> None:
    """Swim all signals in the fluid, keep the tracks."""
    names = list(SIGNALS)
    sent = set_points(names)
    swimmer = Swimmer(ROBOT, MODEL, n_envs=len(sent), device=device, cell_m=cell_m, threads=2)
    track = []
    for k in tqdm(range(sent.shape[1]), desc="fluid", disable=None):
        swimmer.step(sent[:, k])
        state = swimmer.state()
        track.append(np.concatenate([state.pose, state.measured], axis=1))
    OUT.mkdir(parents=True, exist_ok=True)
    tracks = np.moveaxis(np.array(track), 0, 1).astype(np.float32)
    np.savez_compressed(OUT / "fluid.npz", track=tracks, cell_m=cell_m, signal=names)


def shown(track: Array) -> Array:
    """Surge, sway, yaw rate and joints' angles of each swim (E, T, 3 + J), in the same shape."""
    t = CONTROL_S * np.arange(1, track.shape[1] + 1)
    velocity = np.array([body_velocity(t, one[:, :3]) for one in track])
    return np.concatenate([velocity, track[:, :, 3:]], axis=-1)


class Swims:
    """The fluid's swims, and the twin's of the same commands.

    Attributes:
        names: Of the swims, E of them.
        truth: What the fluid shows, shape (E, T, 6).
        rms: Its root mean square, shape (E, 6).
        cell_m: Size of the fluid's cells.
    """

    def __init__(self, path: Path) -> None:
        """Read tracks; without names they are those of the first list, in its order."""
        kept = np.load(path)
        self.names = [str(name) for name in kept["signal"]]
        self.cell_m = float(kept["cell_m"])
        self.truth = shown(kept["track"].astype(np.float64))
        self.rms = np.sqrt(np.mean(self.truth**2, axis=1))
        self._sent = set_points(self.names)

    def by_twin(self, laws: list[Coefficients], which: Index) -> Array:
        """What the twin shows under each law, shape (laws, which, T, 6)."""
        models = [replace(MODEL, body={**MODEL.body, "twin": vars(law)}) for law in laws]
        each = [model for model in models for _ in which]
        twin = Twin(ROBOT, each, n_envs=len(each))
        seen = shown(twin.swim(self._sent, np.tile(which, len(laws))))
        return seen.reshape(len(laws), which.size, *seen.shape[1:])

    def errors(self, laws: list[Coefficients], which: Index) -> Array:
        """Errors in the swims' own root mean squares, shape (laws, which, T, 6)."""
        off = self.by_twin(laws, which) - self.truth[which]
        return np.asarray(np.nan_to_num(off / self.rms[which][:, None], nan=1e3))


def law_of(x: Array) -> Coefficients:
    """Coefficients of their logarithms."""
    return Coefficients(*np.exp(x).tolist())


def fitted(swims: Swims, seen: Index, start: Coefficients) -> OptimizeResult:
    """Least squares from one start, in the logarithms of the coefficients."""

    def residual(x: Array) -> Array:
        return swims.errors([law_of(x)], seen).ravel()

    def slope(x: Array) -> Array:
        both = [law_of(x + s * _STEP * unit) for unit in np.eye(x.size) for s in (1, -1)]
        swum = swims.errors(both, seen).reshape(x.size, 2, -1)
        return np.asarray(((swum[:, 0] - swum[:, 1]) / (2 * _STEP)).T)

    ends = np.log([BOUNDS.get(name, (_LEAST, _MOST)) for name in NAMES]).T
    x0 = np.clip(np.log([getattr(start, name) for name in NAMES]), ends[0], ends[1])
    return least_squares(residual, x0, slope, bounds=(ends[0], ends[1]), max_nfev=40, ftol=1e-5)


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
    swims = Swims(OUT / "fluid.npz")
    held = np.array([name in HELD_OUT for name in swims.names])
    seen = np.flatnonzero(~held)
    found = list(spread(partial(fitted, swims, seen), STARTS, len(STARTS), unit="start"))
    best = min(found, key=lambda one: one.cost)
    chosen = law_of(best.x)
    deviation, condition = uncertainty(best, seen.size)
    swum = swims.by_twin([chosen], np.arange(held.size))[0]
    off = np.sqrt(np.mean((swum - swims.truth) ** 2, axis=1))
    error = off / swims.rms
    result = {
        "coefficients": vars(chosen),
        "relative_sd": dict(zip(NAMES, deviation.tolist(), strict=True)),
        "condition": condition,
        "costs": [float(one.cost) for one in found],
        "cell_m": swims.cell_m,
        "rows": [
            {"signal": name, "held_out": bool(held[k]), "steady": name not in UNSTEADY,
             "error": error[k].tolist(), "rms": swims.rms[k].tolist()}
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
    print(write_json(FILE, {name: float(f"{v:.4g}") for name, v in vars(chosen).items()}))


if __name__ == "__main__":
    only = (False, "swim in the fluid, fit nothing")
    options = command_line(__doc__, fluid=only, device="cpu", cell_m=0.01).parse_args()
    if options.fluid:
        fluid(options.device, options.cell_m)
    else:
        fit()
