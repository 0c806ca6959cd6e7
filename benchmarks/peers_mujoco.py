"""Fit a MuJoCo servo in the environment of ``mujoco[sysid]``; called by ``benchmarks/peers.py``.

    SYSID_PYTHON benchmarks/peers_mujoco.py JOB.json ANSWER.json

Three ways, by ``job["method"]``: ``hand`` (gains from a grid, nothing else), ``position``
(``mujoco.sysid`` on a position actuator) and ``dcmotor`` (``mujoco.sysid`` on MuJoCo's motor, whose
torque falls with speed).
"""

from __future__ import annotations

import json
import sys
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout, sysid

STEP_S = 0.002
"""MuJoCo's default time step."""
XML = """
<mujoco>
  <option timestep="{step}" integrator="implicitfast"><flag contact="disable"/></option>
  <worldbody>
    <body name="load">
      <joint name="j" type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 {below}" mass="{mass}" diaginertia="{about} {about} {about}"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="j" kp="1"/></actuator>
  <sensor><jointpos name="angle" joint="j"/></sensor>
</mujoco>
"""
HAND_ERRORS_RAD = (0.1, 10.0)
"""Full torque at so large an error: the range of kp that is tried by hand."""
HAND_KD_SPREAD = 10.0
"""kd is tried up to so many times above and below stall torque over no-load speed."""
HAND_COARSE, HAND_FINE = (13, 9), (5, 5)
"""Values of kp and kd on the first grid, and on the second one between its neighbours."""
LARGEST_DELAY_S = 0.1
STARTS = 4
"""The gains tuned by hand, then points drawn by ``ParameterDict.randomize``."""
MAX_ITERATIONS = 200
"""The default of ``sysid.optimize``."""
SPREAD = 2.0
"""How far stall torque and no-load speed may be from the data sheet, as a factor."""


def main() -> None:
    """Tune or fit, predict, write the answer."""
    job = json.loads(Path(sys.argv[1]).read_text())
    spec = mujoco.MjSpec.from_string(_xml(job["fit"][0]))
    start = tuned_by_hand(spec, job)
    if job["method"] == "hand":
        fitted, intervals = start | {"delay": 0.0, "armature": 0.0, "frictionloss": 0.0}, {}
    else:
        fitted, intervals = identified(spec, job, start)
    model = build(spec, job, fitted | {"kp": fitted["kp"] * job["kp_ratio"]})
    answer = {
        "parameters": fitted,
        "intervals": intervals,
        "version": mujoco.__version__,
        "predictions": {r["name"]: predict(model, r, fitted["delay"]) for r in job["score"]},
    }
    Path(sys.argv[2]).write_text(json.dumps(answer))


def _xml(recording: dict[str, Any]) -> str:
    """A body with the load's inertia about the joint; its weight hangs straight down at 0 rad."""
    mass, length = recording["pendulum_mass_kg"], recording["pendulum_length_m"]
    about = max(recording["inertia_kgm2"] - mass * length**2, 1e-9)
    return XML.format(step=STEP_S, below=-length, mass=mass or 1e-6, about=about)


def build(spec: mujoco.MjSpec, job: dict[str, Any], values: dict[str, float]) -> mujoco.MjModel:
    """The model with these gains; torque limited by the data sheet (``position``: at any speed)."""
    joint, servo = spec.joint("j"), spec.actuator("servo")
    joint.armature, joint.frictionloss = values["armature"], values["frictionloss"]
    stall = values.get("stall_torque", job["max_torque_Nm"])
    fastest = values.get("no_load_speed", job["no_load_speed_rad_s"])
    if job["method"] == "dcmotor":
        # One volt drives the motor at full duty: torque = K/R (1 - K speed).
        constant = 1.0 / fastest
        gains = [values["kp"], 0.0, values["kd"], 0.0, 0.0, 1.0]
        servo.set_to_dcmotor([constant, 0.0], constant / stall, controller=gains, ctrlspec=SPEC)
    else:
        servo.set_to_position(values["kp"], values["kd"])
        servo.forcerange = [-stall, stall]
        servo.forcelimited = True
    return spec.compile()


def _position_input() -> int:
    """The control signature of ``<dcmotor input="pos">``."""
    xml = XML.format(step=STEP_S, below=0, mass=1, about=1).replace(
        '<position name="servo" joint="j" kp="1"/>',
        '<dcmotor name="servo" joint="j" motorconst="1" resistance="1" input="pos"/>',
    )
    return mujoco.MjSpec.from_string(xml).actuator("servo").ctrlspec


SPEC = _position_input()


def tuned_by_hand(spec: mujoco.MjSpec, job: dict[str, Any]) -> dict[str, float]:
    """The gains of a position actuator with the least square error on two logarithmic grids."""
    torque = job["max_torque_Nm"]
    kp = np.geomspace(torque / HAND_ERRORS_RAD[1], torque / HAND_ERRORS_RAD[0], HAND_COARSE[0])
    slope = torque / job["no_load_speed_rad_s"]
    kd = slope * np.geomspace(1 / HAND_KD_SPREAD, HAND_KD_SPREAD, HAND_COARSE[1])
    best = _best_of(spec, job, kp, kd)
    kp, kd = (
        value * np.geomspace(grid[0] / grid[1], grid[1] / grid[0], count)
        for value, grid, count in zip(best, (kp, kd), HAND_FINE, strict=True)
    )
    best = _best_of(spec, job, kp, kd)
    return {"kp": best[0], "kd": best[1]}


def _best_of(
    spec: mujoco.MjSpec, job: dict[str, Any], kp: np.ndarray, kd: np.ndarray
) -> tuple[float, float]:
    plain, best = job | {"method": "hand"}, (np.inf, (0.0, 0.0))
    for gains in product(kp.tolist(), kd.tolist()):
        values = {"kp": gains[0], "kd": gains[1], "armature": 0.0, "frictionloss": 0.0}
        model = build(spec, plain, values)
        errors = [
            np.array(predict(model, r, 0.0)) - np.array(_powered(r, "position_rad"), float)
            for r in job["fit"]
        ]
        best = min(best, (float(np.nanmean(np.concatenate(errors) ** 2)), gains))
    return best[1]


def identified(
    spec: mujoco.MjSpec, job: dict[str, Any], start: dict[str, float]
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """The best of several runs of ``sysid.optimize``, and its own 90 % intervals."""
    parameters = sysid.ParameterDict()
    ranges = {
        "kp": (start["kp"], start["kp"] / 20, start["kp"] * 20),
        "kd": (start["kd"], 0.0, start["kd"] * 20),
        "armature": (0.1 * job["fit"][0]["inertia_kgm2"], 0.0, 3 * job["fit"][0]["inertia_kgm2"]),
        "frictionloss": (0.02 * job["max_torque_Nm"], 0.0, 0.5 * job["max_torque_Nm"]),
        "delay": (0.01, 0.0, LARGEST_DELAY_S),
    }
    if job["method"] == "dcmotor":
        for name, sheet in (
            ("stall_torque", "max_torque_Nm"),
            ("no_load_speed", "no_load_speed_rad_s"),
        ):
            ranges[name] = (job[sheet], job[sheet] / SPREAD, job[sheet] * SPREAD)
    for name, (nominal, low, high) in ranges.items():
        parameters.add(sysid.Parameter(name, nominal, low, high))
    transform = sysid.SignalTransform()
    transform.delay("angle", parameters["delay"])

    def build_model(candidate: sysid.ParameterDict, _: mujoco.MjSpec) -> mujoco.MjModel:
        return build(spec, job, {n: float(candidate[n].value[0]) for n in ranges})

    first = build(spec, job, {n: nominal for n, (nominal, _, _) in ranges.items()})
    residual = sysid.build_residual_fn(
        models_sequences=[sequence(spec, first, r) for r in job["fit"]],
        build_model=build_model,
        modify_residual=transform.apply,
        n_threads=1,
    )
    rng, fits = np.random.default_rng(0), []
    for start_index in range(STARTS):
        if start_index:
            parameters.randomize(rng)
        best, result = sysid.optimize(parameters, residual, verbose=False, max_iters=MAX_ITERATIONS)
        left = [np.ravel(r) for r in residual(result.x, best)[0]]
        fits.append((float(np.sum(np.concatenate(left) ** 2)), best, result, left))
    _, best, result, left = min(fits, key=lambda fit: fit[0])
    _, half = sysid.calculate_intervals(left, result.jac, alpha=0.1)
    values = {n: float(best[n].value[0]) for n in ranges}
    names = list(ranges)
    intervals = {n: (values[n] - h, values[n] + h) for n, h in zip(names, half, strict=True)}
    return values, intervals


def sequence(
    spec: mujoco.MjSpec, model: mujoco.MjModel, recording: dict[str, Any]
) -> sysid.ModelSequences:
    """One recording while its torque is on; each command holds until the next."""
    t, angle = (np.array(_powered(recording, key), float) for key in ("t_s", "position_rad"))
    grid, command = _held(recording)
    seen = np.isfinite(angle)
    measured = sysid.TimeSeries.from_names(t[seen], angle[seen, None], model)
    control = sysid.TimeSeries.from_control_names(grid, command, model)
    start = sysid.create_initial_state(model, angle[seen][:1], np.zeros(1), np.zeros(model.na))
    return sysid.ModelSequences(recording["name"], spec, "recorded", start, control, measured)


def predict(model: mujoco.MjModel, recording: dict[str, Any], delay_s: float) -> list[float]:
    """Angles in rad while the torque is on, from the first angle recorded, at rest."""
    grid, command = _held(recording)
    angle = np.array(_powered(recording, "position_rad"), float)
    first = angle[np.isfinite(angle)][:1]
    start = sysid.create_initial_state(model, first, np.zeros(1), np.zeros(model.na))
    _, sensed = rollout.rollout(model, mujoco.MjData(model), start, command[None])
    angles = np.concatenate([first, sensed[0, :-1, 0]])
    return np.interp(np.array(_powered(recording, "t_s")) - delay_s, grid, angles).tolist()


def _held(recording: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Time steps in s, shape (T,), and commands held from one to the next, shape (T, 1)."""
    t, command = (np.array(_powered(recording, key)) for key in ("t_s", "command_rad"))
    grid = np.arange(t[0], t[-1] + 2 * STEP_S, STEP_S)
    last = np.clip(np.searchsorted(t, grid + 1e-9, side="right") - 1, 0, None)
    return grid, command[last, None]


def _powered(recording: dict[str, Any], key: str) -> list[float]:
    return recording[key][: recording["powered"]]


if __name__ == "__main__":
    main()
