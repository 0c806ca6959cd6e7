"""Answer a sealed set of swims with what a user would do today.

    python datasets/pool/sealed_rivals.py SET OUT [--processes N] [--share K/N]

``OUT/regression``: what the uncalibrated twin leaves is regressed on the library's terms, every
sample taken as independent, terms added while Schwarz's criterion falls. ``OUT/drags``: all of the
law's coefficients are fitted by least squares, and the one that moved most is what is wrong. Both
write what ``sealed_grade.py`` reads.
"""

from __future__ import annotations

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.inference.coordinates import LAW, Coordinates, signals_at
from sim.inference.followed import by_followed_twin
from sim.inference.swims import swim_of
from sim2real.model import Model, read_model, write_model
from sim2real.recording import read_recording
from sim2real.robot import read_robot

Array = NDArray[np.float64]

MOST = 3
STEPS = 4
MEANS = {
    "along": ("form_drag", "body"), "linear": ("linear_drag", "body"),
    "across": ("added_mass", "body"), "added_mass": ("added_mass", "body"),
    "head": ("added_mass", "body"), "tail": ("form_drag", "body"),
    "thrust": ("form_drag", "body"), "wake": ("linear_drag", "body"),
    "slender": ("linear_drag", "body"),
}  # fmt: skip
"""What a coefficient that is off is called."""


def answer(folder: Path, out: Path) -> str:
    """Both rivals' answers to one case."""
    start = time.perf_counter()
    robot = read_robot(folder.parent / "robot.toml")
    model = read_model(folder.parent / "model.json")
    simulate = by_followed_twin(robot, threads=1)
    c = Coordinates.of(robot, model)
    (swim,) = [swim_of(read_recording(path), robot) for path in sorted(folder.glob("*.csv"))]
    scale = np.maximum(np.broadcast_to(swim.noise, swim.signals.shape[1]), 1e-6)

    def rows(points: Array) -> Array:
        error = (signals_at(c, swim, c.clipped(points), simulate) - swim.signals) / scale
        return np.nan_to_num(error).reshape(len(points), -1)

    def slope(x: Array) -> tuple[Array, Array]:
        points, base = c.about(x)
        found = rows(points)
        return found[0], ((found[1:] - found[base.astype(int)]) / c.steps(x)[:, None]).T

    error, columns = slope(c.nominal)
    names, point, sure = _regressed(c, error, columns)
    cost = {"wall_s": time.perf_counter() - start, "cpu_s": time.perf_counter() - start}
    plain = c.model_at(c.nominal)
    _write(out / "regression" / folder.name, names, sure, c, point, plain, cost)
    x, law = c.nominal, np.array([c.place[f"twin.{name}"] for name in LAW])
    for _ in range(STEPS):
        error, columns = slope(x)
        step, *_ = np.linalg.lstsq(columns[:, law], -error, rcond=1e-8)
        trials = np.tile(x, (3, 1))
        for trial, share in zip(trials, (1.0, 0.4, 0.1), strict=True):
            trial[law] += share * step
        losses = np.sum(rows(trials) ** 2, axis=1)
        if losses.min() >= float(error @ error):
            break
        x = c.clipped(trials[int(np.argmin(losses))])
    spread = np.sqrt(np.diag(np.linalg.pinv(columns[:, law].T @ columns[:, law])))
    off = np.abs(x[law] - c.nominal[law]) / np.maximum(spread, 1e-9)
    most = MEANS[LAW[int(np.argmax(off))]]
    cost = {"wall_s": time.perf_counter() - start, "cpu_s": time.perf_counter() - start}
    sure = [float(min(0.999, 1 - np.exp(-0.5 * off.max() ** 2)))]
    _write(out / "drags" / folder.name, [most], sure, c, x, plain, cost)
    return folder.name


def _regressed(
    c: Coordinates, error: Array, columns: Array
) -> tuple[list[tuple[str, str]], Array, list[float]]:
    """Effects that Schwarz's criterion adds, the point that they make, how sure it is of each."""
    n, chosen, sure = error.size, [], []
    own: list[int] = []
    x = c.nominal
    left = float(error @ error)
    for _ in range(MOST):
        found = []
        for effect in c.effects:
            if effect not in chosen:
                some = [*own, *c.of_effect(effect)]
                weights, *_ = np.linalg.lstsq(columns[:, some], -error, rcond=1e-8)
                rest = float(np.sum((error + columns[:, some] @ weights) ** 2))
                better = 0.5 * n * np.log(left / rest) - 0.5 * len(effect.free) * np.log(n)
                found.append((float(better), effect, some, weights, rest))
        better, effect, own_now, weights, rest = max(found, key=lambda one: one[0])
        if better <= 0:
            break
        own, left = own_now, rest
        x = c.nominal
        x[own] = weights
        chosen.append(effect)
        sure.append(float(min(0.999, 1 / (1 + np.exp(-min(better, 50.0))))))
    return [(e.name, e.component) for e in chosen], c.clipped(x), sure


def _write(
    target: Path, names: list[tuple[str, str]], sure: list[float], c: Coordinates, x: Array,
    plain: Model, cost: dict[str, float],
) -> None:  # fmt: skip
    target.mkdir(parents=True, exist_ok=True)
    fitted = c.parameters(x)
    effects: list[dict[str, Any]] = []
    for (name, of), p in zip(names, sure, strict=True):
        values = {k: v for k, v in fitted.items() if k.split(".")[0] == name}
        parameters = {
            k.rpartition(".")[2]: {"mean": v, "sd": 0.0, "q05": v, "q95": v}
            for k, v in values.items()
        }
        effects.append({"effect": name, "component": of, "probability": p, "group": [name],
                        "parameters": parameters})  # fmt: skip
    diagnosis = {
        "verdict": "explained" if effects else "consistent",
        "effects": effects,
        "unknown": {},
    }
    (target / "diagnosis.json").write_text(json.dumps(diagnosis) + "\n")
    write_model(plain, target / "baseline.json")
    write_model(c.model_at(x), target / "enriched.json")
    (target / "cost.json").write_text(json.dumps(cost) + "\n")


def main() -> None:
    """Answer the cases."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("set", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--share", default="0/1", metavar="K/N")
    options = parser.parse_args()
    first, step = (int(x) for x in options.share.split("/"))
    cases = sorted((options.set / "inputs").glob("robot_*/case_*/case.json"))[first::step]
    with ProcessPoolExecutor(options.processes) as pool:
        for name in pool.map(answer, [p.parent for p in cases], [options.out] * len(cases)):
            print(name, flush=True)


if __name__ == "__main__":
    main()
