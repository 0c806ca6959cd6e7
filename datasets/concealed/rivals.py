"""What a user would do today on the same cases, graded by the same script.

Needs ``pip install pysindy scikit-learn``.

python datasets/concealed/rivals.py SET OUT [--limit 60] [--methods refit iid_BIC SINDy GP_residual]
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from grade import grade
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from sim2real.effects import named
from sim2real.model import FittedEffect, JointModel, Model, write_model
from sim2real.output import write_json
from sim2real.recording import Commands, read_commands, read_recording
from sim2real.servo.enrich import fit_effects
from sim2real.servo.fit import Fit, fit
from sim2real.servo.predict import predict
from sim2real.servo.start import first_guess
from sim2real.servo.trace import Trace, traces

Array = NDArray[np.float64]
Residual = Callable[["State"], Array]

COMMON = (
    "coulomb_friction",
    "quadratic_drag",
    "backlash",
    "compliance",
    "deadband",
    "torque_saturation",
    "command_filter",
    "sensor_offset",
)
"""Effects that the ranking by BIC tries."""
ENOUGH = 10.0
"""Difference in BIC from which on an effect is named (Kass & Raftery, JASA 90 (1995) 773)."""
SMOOTHING_S = 0.12
"""Window of the local parabolas that give speed and acceleration."""
THRESHOLDS, RIDGE = (1.6, 0.8, 0.4, 0.2, 0.1, 0.05), 0.05
"""Of the sparse regression; of terms in units of their own and the residual's spread."""
NO_BETTER = 0.97
"""A lower threshold is taken if it leaves less than so much of the error on the other recording."""
STEP_S = 0.002
POINTS = 300
"""Samples of each joint for the Gaussian process."""
KEPT = 40
"""Samples at either end that the smoothing spoils, at least."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Answer the first cases with each method, grade them and say how long they took."""
    parser = argparse.ArgumentParser(description="What a user would do today.")
    parser.add_argument("set", type=Path, metavar="SET")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--limit", type=int, default=60)
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=list(METHODS))
    options = parser.parse_args(arguments)
    spent = dict.fromkeys(options.methods, 0.0)
    for folder in sorted((options.set / "inputs").iterdir())[: options.limit]:
        case = read_case(folder, options.set / "heldout" / folder.name / "c.csv")
        for method in options.methods:
            start = time.perf_counter()
            answer(case, METHODS[method](case), options.out / method / folder.name)
            spent[method] += time.perf_counter() - start
        said = ", ".join(f"{method} {seconds:.0f} s" for method, seconds in spent.items())
        print(f"{folder.name}: {said}", flush=True)
    for method in options.methods:
        found = grade(options.set, options.out / method, answered=True)
        write_json(options.out / f"{method}.json", found)


@dataclass(frozen=True)
class Case:
    """The recordings of each joint, the plain servos fitted to them, and what to predict."""

    given: dict[str, list[Trace]]
    plain: dict[str, Fit]
    wanted: Commands

    @property
    def model(self) -> Model:
        """The plain servos."""
        joints = {}
        for joint, one in self.plain.items():
            kp, kd, latency = (float(x) for x in one.parameters[:3])
            joints[joint] = JointModel(kp, kd, latency, one.inertia)
        return Model(joints=joints)


@dataclass(frozen=True)
class Said:
    """An answer: entries of ``effects``, the enriched model, or angles where it's no model."""

    effects: tuple[dict[str, Any], ...]
    model: Model
    angles: dict[str, Array] | None = None


def read_case(folder: Path, wanted: Path) -> Case:
    """Read a case and fit gains and latency of every joint to all recordings."""
    recordings = [read_recording(folder / f"{name}.csv") for name in "ab"]
    rng = np.random.default_rng(0)
    given = {joint: traces(recordings, joint) for joint in recordings[0].joints}
    plain = {joint: fit(some, first_guess(some, rng)[0]) for joint, some in given.items()}
    return Case(given, plain, read_commands(wanted))


def answer(case: Case, said: Said, folder: Path) -> None:
    """Write what the grader reads."""
    folder.mkdir(parents=True, exist_ok=True)
    verdict = "explained" if said.effects else "consistent"
    content = {"verdict": verdict, "effects": list(said.effects), "mismatch": [], "rivals": []}
    write_json(folder / "diagnosis.json", content)
    write_model(case.model, folder / "baseline.json")
    write_model(said.model, folder / "enriched.json")
    if said.angles is not None:
        np.savez(folder / "enriched_c.npz", **said.angles)  # type: ignore[arg-type]


def refit(case: Case) -> Said:
    """Refit gains and latency; blame nothing."""
    return Said((), case.model)


def ranked_by_bic(case: Case) -> Said:
    """The effect with the least BIC, as if the residuals were independent."""
    joints, entries = dict(case.model.joints), []
    for joint, some in case.given.items():
        plain = case.plain[joint]
        every = {name: _with_effect(some, plain, name) for name in COMMON}
        fits = {name: one for name, one in every.items() if one is not None}
        gains = {name: _bic(plain) - _bic(one) for name, one in fits.items()}
        best = max(gains, key=lambda name: gains[name])
        if gains[best] > ENOUGH:
            weights = np.exp(0.5 * (np.array([0.0, *gains.values()]) - gains[best]))
            found = _fitted(fits[best])
            entries.append(_entry(best, joint, float(1 / weights.sum()), found))
            kp, kd, latency = (float(x) for x in fits[best].parameters[:3])
            joints[joint] = replace(
                joints[joint],
                kp_Nm_per_rad=kp,
                kd_Nms_per_rad=kd,
                latency_s=latency,
                effects=(FittedEffect(best, found),),
            )
    return Said(_surest_first(entries), Model(joints=joints))


def _with_effect(some: list[Trace], plain: Fit, name: str) -> Fit | None:
    """None where the search ends at zero of an effect that has no derivative there."""
    try:
        return fit_effects(some, plain, [named(name)])
    except np.linalg.LinAlgError:
        return None


def _bic(one: Fit) -> float:
    errors = np.concatenate(one.residuals)
    return float(errors.size * np.log(np.mean(errors**2)) + len(one.free) * np.log(errors.size))


def _fitted(one: Fit) -> dict[str, float]:
    pairs = zip(one.names[4:], one.parameters[4:], strict=True)
    return {name.partition(".")[2]: float(value) for name, value in pairs}


def _entry(effect: str, joint: str, probability: float, found: dict[str, float]) -> dict[str, Any]:
    estimates = {n: {"mean": x, "sd": 0.0, "q05": x, "q95": x} for n, x in found.items()}
    said = {"effect": effect, "component": joint, "probability": probability}
    return {**said, "group": [effect], "parameters": estimates}


def _surest_first(entries: list[dict[str, Any]]) -> tuple[dict[str, Any], ...]:
    return tuple(sorted(entries, key=lambda entry: -entry["probability"]))


@dataclass(frozen=True)
class State:
    """What a term may depend on; arrays of one shape. SI units, angles in rad.

    ``error`` is set-point less angle, ``torque`` the motor's as the plain servo has it, ``wound``
    the integral of the error.
    """

    t: Array
    q: Array
    v: Array
    acceleration: Array
    error: Array
    torque: Array
    wound: Array


TERMS: dict[str, tuple[str, Residual]] = {
    "error": ("", lambda s: s.error),
    "speed": ("", lambda s: s.v),
    "sign v": ("coulomb_friction", lambda s: np.tanh(s.v / 0.05)),
    "sign v, slow": (
        "stribeck_friction", lambda s: np.tanh(s.v / 0.05) * np.exp(-((s.v / 0.4) ** 2)),
    ),
    "|torque| sign v": ("load_friction", lambda s: np.abs(s.torque) * np.tanh(s.v / 0.05)),
    "|v| v": ("quadratic_drag", lambda s: np.abs(s.v) * s.v),
    "sin q": ("gravity_load", lambda s: np.sin(s.q)),
    "1": ("sensor_offset", lambda s: np.ones_like(s.q)),
    "acceleration": ("unmodelled_inertia", lambda s: s.acceleration),
    "|torque|": ("torque_asymmetry", lambda s: np.abs(s.torque)),
    "torque³": ("torque_saturation", lambda s: s.torque**3),
    "small error": ("deadband", lambda s: np.clip(s.error, -0.02, 0.02)),
    "integral": ("integral_action", lambda s: s.wound),
    "torque t": ("supply_droop", lambda s: s.torque * s.t),
}  # fmt: skip
"""Terms of the library: the effect that each is taken for, and its value."""


def sparse_regression(case: Case) -> Said:
    """SINDy of the torque that the plain servo lacks (Brunton et al., PNAS 113 (2016) 3932).

    Its terms come without probabilities: those that stay are taken as claims.
    """
    entries, weights = [], {}
    for joint, some in case.given.items():
        first, *others = [_regressors([one], case.plain[joint]) for one in some]
        found = _solved(*first, THRESHOLDS[0])
        for threshold in THRESHOLDS[1:]:
            trial = _solved(*first, threshold)
            if _left(trial, others or [first]) < NO_BETTER * _left(found, others or [first]):
                found = trial
        weights[joint] = found
        size = np.abs(found) * np.sqrt(np.mean(first[0] ** 2, axis=0))
        kept = {n: x for (n, _), x in zip(TERMS.values(), size, strict=True) if n and x > 0}
        entries += [(x, _entry(name, joint, 1.0, {})) for name, x in kept.items()]
    joints = list(case.given)
    scales = np.stack([weights[joint] for joint in joints])

    def residual(state: State) -> Array:
        values = np.stack([value(state) for _, value in TERMS.values()], axis=1)
        return np.asarray((values * scales).sum(axis=1))

    ordered = tuple(entry for _, entry in sorted(entries, key=lambda pair: -pair[0]))
    return Said(ordered, case.model, _predicted(case, residual))


def _regressors(some: list[Trace], plain: Fit) -> tuple[Array, Array]:
    """Values of all terms, shape (n, terms), and the torque to explain, shape (n,)."""
    states, lacking = _lacking(some, plain)
    return np.stack([value(states) for _, value in TERMS.values()], axis=1), lacking


def _solved(columns: Array, lacking: Array, threshold: float) -> Array:
    """Sequentially thresholded least squares: a coefficient for each term."""
    from pysindy import STLSQ

    spread, unit = np.sqrt(np.mean(columns**2, axis=0)), lacking.std()
    spread[spread < 1e-12] = 1.0
    solver = STLSQ(threshold=threshold, alpha=RIDGE * lacking.size)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that nothing is left is an answer
        solver.fit(columns / spread, (lacking / unit)[:, None])
    return np.asarray(solver.coef_).ravel() / spread * unit


def _left(found: Array, others: list[tuple[Array, Array]]) -> float:
    errors = [lacking - columns @ found for columns, lacking in others]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def gaussian_process(case: Case) -> Said:
    """The torque that the plain servo lacks, as any smooth function of angle, speed and error."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    centres, lengths, weights, units = [], [], [], []
    rng = np.random.default_rng(0)
    for joint, some in case.given.items():
        states, lacking = _lacking(some, case.plain[joint])
        chosen = rng.choice(lacking.size, min(POINTS, lacking.size), replace=False)
        points = _features(states)
        size, unit = points.std(axis=0), lacking.std()
        kernel = ConstantKernel(0.5) * RBF([1.0, 1.0, 1.0], (0.1, 100.0)) + WhiteKernel(0.5)
        process = GaussianProcessRegressor(kernel)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an input that does not matter
            process.fit((points / size)[chosen], lacking[chosen] / unit)
        fitted = process.kernel_.k1
        centres.append(process.X_train_)
        lengths.append(np.broadcast_to(fitted.k2.length_scale, 3))
        weights.append(process.alpha_.ravel() * fitted.k1.constant_value * unit)
        units.append(size)
    X, alpha = np.stack(centres), np.stack(weights)
    length, size = np.stack(lengths)[:, None], np.stack(units)

    def residual(state: State) -> Array:
        apart = ((_features(state) / size)[:, None] - X) / length
        return np.asarray((np.exp(-0.5 * (apart**2).sum(axis=2)) * alpha).sum(axis=1))

    return Said((), case.model, _predicted(case, residual))


def _features(state: State) -> Array:
    return np.stack([state.q, state.v, state.error], axis=1)


def _lacking(some: list[Trace], plain: Fit) -> tuple[State, Array]:
    """States of all recordings of a joint and the torque that the plain servo lacks in them."""
    kp, kd, latency = plain.parameters[:3]
    parts, torques = [], []
    for trace in some:
        step = float(np.median(np.diff(trace.t)))
        even = np.arange(trace.t[0], trace.t[-1], step)
        angle = np.interp(even, trace.t[trace.used], trace.position[trace.used])
        window = 2 * max(int(SMOOTHING_S / step / 2), 2) + 1
        q, v, acceleration = (
            savgol_filter(angle, window, 3, deriv=order, delta=step) for order in range(3)
        )
        around = even[:, None] + step * (np.arange(8) - 3.5) / 8 - latency
        at = np.searchsorted(trace.t, around, side="right") - 1
        target = trace.command[np.maximum(at, 0)].mean(axis=1)
        # Smoothed as the angle is, so that the plain servo's own equation still holds.
        error = savgol_filter(target, window, 3) - q
        torque = kp * error - kd * v
        outer = trace.load.gravity_Nm * np.sin(q)
        lacking = trace.load.inertia_kgm2 * acceleration - torque + outer
        kept = slice(max(window, KEPT), -max(window, KEPT))
        wound = np.cumsum(error) * step
        values = (even - even[0], q, v, acceleration, error, torque, wound)
        parts.append([value[kept] for value in values])
        torques.append(lacking[kept])
    return State(*(np.concatenate(c) for c in zip(*parts, strict=True))), np.concatenate(torques)


def _predicted(case: Case, residual: Residual) -> dict[str, Array]:
    """Angles on the wanted commands with ``residual`` N m added.

    The difference that it makes is marched by the midpoint rule and added to the exact motion of
    the plain servos, so that the march's own error cancels.
    """
    wanted, joints = case.wanted, list(case.plain)
    exact = predict(case.model, wanted.t, wanted.by_joint, wanted.loads)
    kp, kd, latency = np.stack([case.plain[joint].parameters[:3] for joint in joints], axis=1)
    inertia, gravity = np.array(
        [(wanted.loads[j].inertia_kgm2, wanted.loads[j].gravity_Nm) for j in joints]
    ).T
    commands = np.stack([wanted.by_joint[joint] for joint in joints], axis=1)
    times = np.arange(wanted.t[0], wanted.t[-1] + STEP_S, STEP_S)
    at = np.searchsorted(wanted.t, times[:, None] - latency, side="right") - 1
    targets = np.take_along_axis(commands, np.maximum(at, 0), axis=0)
    most = 0.5 * kp

    def accelerations(t: float, target: Array, q: Array, v: Array, wound: Array) -> Array:
        """Of the plain servos (row 0) and of those with the residual (row 1)."""
        error = target - q
        torque = kp * error - kd * v
        plain = (torque - gravity * np.sin(q)) / inertia
        time = np.full(len(joints), t)
        state = State(time, q[1], v[1], plain[1], error[1], torque[1], wound)
        plain[1] += np.clip(np.nan_to_num(residual(state)), -most, most) / inertia
        return np.asarray(plain)

    q, v = np.tile(commands[0], (2, 1)), np.zeros((2, len(joints)))
    wound, differences = np.zeros(len(joints)), np.zeros((times.size, len(joints)))
    for k, (t, target) in enumerate(zip(times, targets, strict=True)):
        differences[k] = q[1] - q[0]
        half = v + 0.5 * STEP_S * accelerations(t, target, q, v, wound)
        middle = accelerations(t, target, q + 0.5 * STEP_S * v, half, wound)
        q, v = q + STEP_S * half, v + STEP_S * middle
        q[1] = np.clip(q[1], q[0] - 1.0, q[0] + 1.0)
        wound = wound + STEP_S * (target - q[1])
    return {
        joint: exact[joint] + np.interp(wanted.t, times, differences[:, j])
        for j, joint in enumerate(joints)
    }


METHODS: dict[str, Callable[[Case], Said]] = {
    "refit": refit,
    "iid_BIC": ranked_by_bic,
    "SINDy": sparse_regression,
    "GP_residual": gaussian_process,
}

if __name__ == "__main__":
    main()
