"""Servos of a whole arm: identified with and without the load that its joints exert on one another.

A simulated SO-101 (``datasets/so101``: MuJoCo, which shares no dynamics with what is fitted) plays
steps and multisines in all six joints at once. Two recordings are fitted, two others predicted from
their commands alone. Cases: ``plain`` (motors at their voltage limit), ``worn`` (with dry friction
and play besides). Methods: ``coupled`` (loads from the URDF, coupled prediction) and ``alone``
(each joint by itself, its load unknown).

    python benchmarks/arm.py --processes 4 --out reports/arm

writes arm.json, arm.md and arm.png.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from harness import command_line, spread

from sim2real import verbs
from sim2real.arrays import Array
from sim2real.model import JointModel, Model
from sim2real.output import write_json, write_whole
from sim2real.recording import Recording

sys.path.insert(0, str(Path(__file__).parents[1] / "datasets" / "so101"))
import arm_plant  # noqa: E402 - made importable above

ROBOT = arm_plant.FOLDER / "robot.toml"
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


def result(task: tuple[str, str, float]) -> dict[str, Any]:
    """Errors on the two unseen recordings and the parameters, of every joint."""
    case, method, seconds = task
    robot = verbs.robot_of(ROBOT)
    recorded, true = recordings(case, seconds)
    model = verbs.identify(
        recorded[:3],  # the last of them is held out
        robot if method == "coupled" else replace(robot, arm=None),
        law="motor",
        effects=EFFECTS[case],
    )
    predicted = verbs.predict(recorded[2:], None, model).angles
    joints = {}
    for j, name in enumerate(arm_plant.NAMES):
        residuals = [
            a[:, j] - r.position[:, j] for a, r in zip(predicted, recorded[2:], strict=True)
        ]
        noise = [r.position[:, j] - x[:, j] for r, x in zip(recorded[2:], true[2:], strict=True)]
        joints[name] = {
            "noise_rad": _rms(np.concatenate(noise)),
            "rmse_steps_rad": _rms(residuals[0]),
            "rmse_multisines_rad": _rms(residuals[1]),
            "residual_steps_rad": residuals[0].round(6).tolist(),
            "estimates": _estimates(model.joints[name], model),
            "truth": _truth(case, j),
        }
    return {"case": case, "method": method, "joints": joints}


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _estimates(joint: JointModel, model: Model) -> dict[str, float]:
    found = {"latency_s": joint.latency_s}
    if model.arm is not None:  # gains of the other method are per unit of inertia
        found |= {"kp_Nm_per_rad": joint.kp_Nm_per_rad, "kd_Nms_per_rad": joint.kd_Nms_per_rad}
        rotor = joint.motor.get("rotor_inertia_kgm2")
        found |= {} if rotor is None else {"rotor_inertia_kgm2": rotor}
    for effect in joint.effects:
        if effect.effect == "coulomb_friction" and model.arm is not None:
            found["coulomb_Nm"] = effect.parameters["torque_Nm"]
        if effect.effect == "backlash":
            found["gap_rad"] = effect.parameters["gap_rad"]
    return found


def _truth(case: str, j: int) -> dict[str, float]:
    physics = CASES[case]
    names = ("latency_s", "kp_Nm_per_rad", "kd_Nms_per_rad", "rotor_inertia_kgm2")
    if case == "worn":
        names += ("coulomb_Nm", "gap_rad")
    return {name: float(getattr(physics, name)[j]) for name in names}


def table(results: list[dict[str, Any]]) -> str:
    """Markdown: errors in units of the noise, and parameters against the truth."""
    text = "# Servos of an arm\n\nMade by `benchmarks/arm.py`. Errors on two recordings that no fit"
    text += " used, relative to the sensor noise\n(encoder noise and quantisation).\n"
    for case in dict.fromkeys(r["case"] for r in results):
        found = {r["method"]: r["joints"] for r in results if r["case"] == case}
        text += f"\n## {case}\n\n| joint | noise (mrad) |"
        text += "".join(f" {m}: steps | {m}: multisines |" for m in found)
        text += "\n|---|---|" + "---|---|" * len(found) + "\n"
        for name in arm_plant.NAMES:
            noise = next(iter(found.values()))[name]["noise_rad"]
            text += f"| {name} | {1e3 * noise:.2f} |"
            for joints in found.values():
                for kind in ("steps", "multisines"):
                    text += f" {joints[name][f'rmse_{kind}_rad'] / noise:.2f} |"
            text += "\n"
        if "coupled" in found:
            text += "\n" + _parameters(found["coupled"])
    return text


def _parameters(joints: dict[str, Any]) -> str:
    names = list(next(iter(joints.values()))["truth"])
    text = "Coupled: estimate (truth).\n\n| joint |" + "".join(f" {name} |" for name in names)
    text += "\n|---|" + "---|" * len(names) + "\n"
    for joint, found in joints.items():
        text += f"| {joint} |"
        for name in names:
            estimate = found["estimates"].get(name)
            shown = "none" if estimate is None else f"{estimate:.4g}"
            text += f" {shown} ({found['truth'][name]:.4g}) |"
        text += "\n"
    return text


def plot(results: list[dict[str, Any]], path: Path) -> None:
    """Residuals of the unseen steps of each joint, a row for each joint, a column for each case."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    cases = list(dict.fromkeys(r["case"] for r in results))
    figure, axes = plt.subplots(
        len(arm_plant.NAMES), len(cases), sharex=True, squeeze=False, figsize=(6 * len(cases), 9)
    )
    colours = {"alone": "tab:orange", "coupled": "tab:blue"}
    for column, case in enumerate(cases):
        axes[0, column].set_title(case)
        axes[-1, column].set_xlabel("time (s)")
        for r in sorted((r for r in results if r["case"] == case), key=lambda r: r["method"]):
            for axis, name in zip(axes[:, column], arm_plant.NAMES, strict=True):
                residual = 1e3 * np.array(r["joints"][name]["residual_steps_rad"])
                t = PERIOD_S * np.arange(residual.size)
                axis.plot(t, residual, lw=0.7, color=colours[r["method"]], label=r["method"])
                axis.set_ylabel(f"{name}\n(mrad)", fontsize=8)
    axes[0, 0].legend(loc="upper right", fontsize=8)
    figure.suptitle("Predicted minus measured angle on unseen steps")
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def main() -> None:
    """Run the cases and write the report."""
    parser = command_line(
        __doc__, out=Path("reports/arm"), seconds=(30.0, "length of a recording"), processes=2
    )
    parser.add_argument("--cases", nargs="+", choices=tuple(CASES), default=list(CASES))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    tasks = [(c, method, options.seconds) for c in options.cases for method in options.methods]
    results = list(spread(result, tasks, options.processes))
    plot(results, options.out / "arm.png")
    for joints in (found["joints"] for found in results):
        for found in joints.values():
            del found["residual_steps_rad"]
    write_json(options.out / "arm.json", {"seconds": options.seconds, "results": results})
    text = table(results)
    write_whole(options.out / "arm.md", text)
    print(text)


if __name__ == "__main__":
    main()
