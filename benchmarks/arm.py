"""Servos of a whole arm: identified with and without the load that its joints exert on one another.

A simulated SO-101 (``datasets/so101``: MuJoCo, which shares no dynamics with what is fitted) plays
steps and multisines in all six joints at once. Two recordings are fitted, two others predicted from
their commands alone. Cases: ``plain`` (motors at their voltage limit), ``worn`` (with dry friction
and play besides). Methods: ``coupled`` (loads from the URDF, coupled prediction) and ``alone``
(each joint by itself, its load unknown).

    python -m benchmarks.arm [--processes 4] [--seconds 30]
"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.harness import ROOT, command_line, spread, table
from sim2real import verbs
from sim2real.arrays import Array
from sim2real.model import JointModel, Model
from sim2real.recording import Recording

sys.path.insert(0, str(ROOT / "datasets" / "so101"))
import arm_plant  # noqa: E402 - made importable above

CASES = {"plain": arm_plant.Physics(), "worn": arm_plant.WORN}
EFFECTS = {"plain": (), "worn": ("coulomb_friction", "backlash")}
METHODS = ("coupled", "alone")
PERIOD_S = 0.02


def recordings(case: str, seconds: float) -> tuple[list[Recording], list[Array]]:
    """Four recordings, two to fit and two to predict, and the true angles of each."""
    rng = np.random.default_rng(20)
    t = PERIOD_S * np.arange(round(seconds / PERIOD_S))
    signals = {"steps1": arm_plant.steps, "multisines1": arm_plant.multisines}
    signals |= {"steps2": arm_plant.steps, "multisines2": arm_plant.multisines}
    played = [
        arm_plant.recorded(name, signal(t, rng), t, CASES[case], rng)
        for name, signal in signals.items()
    ]
    return [recording for recording, _ in played], [true for _, true in played]


def result(task: tuple[str, str, float]) -> tuple[Array, list[dict[str, float]]]:
    """Errors on the two unseen recordings over the noise, (joints, 2), and the parameters."""
    case, method, seconds = task
    robot = verbs.robot_of(arm_plant.FOLDER / "robot.toml")
    recorded, true = recordings(case, seconds)
    model = verbs.identify(
        recorded[:3],  # the last of them is held out
        robot if method == "coupled" else replace(robot, arm=None),
        law="motor",
        effects=EFFECTS[case],
    )
    seen = np.array([one.position for one in recorded[2:]])
    noise = _rms((seen - np.array(true[2:])).reshape(-1, seen.shape[2]))
    left = np.array(verbs.predict(recorded[2:], None, model).angles) - seen
    errors = np.stack([_rms(one) / noise for one in left], axis=1)
    return errors, [_estimates(model.joints[name], model) for name in arm_plant.NAMES]


def _rms(error: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


def _estimates(joint: JointModel, model: Model) -> dict[str, float]:
    if model.arm is None:  # gains are per unit of inertia
        return {"latency_s": joint.latency_s}
    names = ("latency_s", "kp_Nm_per_rad", "kd_Nms_per_rad")
    effects = {name: x for e in joint.effects for name, x in e.parameters.items()}
    renamed = {"torque_Nm": "coulomb_Nm"}
    found = {name: float(getattr(joint, name)) for name in names} | dict(joint.motor)
    return found | {renamed.get(name, name): x for name, x in effects.items()}


def _truth(case: str, j: int) -> dict[str, float]:
    names = ("latency_s", "kp_Nm_per_rad", "kd_Nms_per_rad", "rotor_inertia_kgm2")
    names += ("coulomb_Nm", "gap_rad") if case == "worn" else ()
    return {name: float(getattr(CASES[case], name)[j]) for name in names}


def tell(case: str, found: dict[str, tuple[Array, list[dict[str, Any]]]]) -> None:
    """Print errors in units of the noise, and parameters (truth in brackets)."""
    heading = [f"{method}: {kind}" for method in found for kind in ("steps", "multisines")]
    rows = [
        (name, *(f"{x:.2f}" for errors, _ in found.values() for x in errors[j]))
        for j, name in enumerate(arm_plant.NAMES)
    ]
    print(f"\n{case}: errors on two recordings that no fit used, over the sensor noise\n")
    print(table(("joint", *heading), rows))
    if "coupled" not in found:
        return
    rows = []
    for j, name in enumerate(arm_plant.NAMES):
        cells = []
        for parameter, true in _truth(case, j).items():
            estimate = found["coupled"][1][j].get(parameter)
            cells.append(f"{'none' if estimate is None else f'{estimate:.4g}'} ({true:.4g})")
        rows.append((name, *cells))
    print("\ncoupled: estimate (truth)\n\n" + table(("joint", *_truth(case, 0)), rows))


def main() -> None:
    """Run the cases and print the tables."""
    parser = command_line(__doc__, seconds=(30.0, "length of a recording"), processes=2)
    parser.add_argument("--cases", nargs="+", choices=tuple(CASES), default=list(CASES))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    options = parser.parse_args()
    tasks = [(c, method, options.seconds) for c in options.cases for method in options.methods]
    results = dict(zip(tasks, spread(result, tasks, options.processes), strict=True))
    for case in options.cases:
        tell(case, {method: results[case, method, options.seconds] for method in options.methods})


if __name__ == "__main__":
    main()
