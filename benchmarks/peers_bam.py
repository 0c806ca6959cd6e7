"""Fit one BAM friction model in BAM's own environment; called by ``benchmarks/peers.py``.

    BAM_PYTHON benchmarks/peers_bam.py JOB.json ANSWER.json

Needs ``better-actuator-models[identification]`` (Python 3.12) and ``numba``. The recordings pass
through ``python -m bam.process`` and ``python -m bam.fit`` unchanged: objective (mean absolute
error), sampler (CMA-ES with BIPOP restarts), parameters and their ranges are BAM's. One thing is
replaced: the loop over time steps of ``bam.simulate.Simulator`` is compiled, so that its default of
100 000 trials comes within reach of a benchmark. ``verify`` compares the compiled loop with BAM's
own on every job.
"""

from __future__ import annotations

import json
import runpy
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numba
import numpy as np
import optuna
from bam import simulate
from bam.actuators import actuators
from bam.logs import Logs
from bam.model import Model, load_model, models

STEP_S = 0.005
"""BAM's default time step (``bam.process --dt``)."""
GRAVITY_M_S2 = 9.80665
AGREEMENT_RAD = 1e-9
OPTIONAL = (
    "friction_stribeck", "load_friction_base", "load_friction_motor", "load_friction_external",
    "load_friction_stribeck", "load_friction_motor_stribeck", "load_friction_external_stribeck",
    "load_friction_motor_quad", "load_friction_external_quad",
)  # fmt: skip
own_rollout = simulate.Simulator.rollout_log


def main() -> None:
    """Fit, predict, write the answer."""
    source, out = map(Path, sys.argv[1:])
    job, folder = json.loads(source.read_text()), out.with_suffix("")
    for name in ("raw", "fit", "score"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    write_logs(job["fit"], folder / "raw")
    process(folder / "raw", folder / "fit")
    error, own_s = verify(job["model"], folder / "fit")
    simulate.Simulator.rollout_log = compiled_rollout
    parameters = folder / f"{job['model']}.json"
    if job["published"]:
        shipped = Path(simulate.__file__).parent / "params" / "xl330" / f"{job['model']}.json"
        parameters.write_text(shipped.read_text())
    else:
        fit(job, folder / "fit", parameters)
    answer = {
        "parameters": json.loads(parameters.read_text()),
        "predictions": {
            r["name"]: predict(parameters, r, folder / "score")[: r["powered"]]
            for r in job["score"]
        },
        "version": version("better-actuator-models"),
        "trials": job["trials"],
        "compiled_minus_own_rad": error,
        "own_cpu_s_a_trial": own_s,
    }
    out.write_text(json.dumps(answer))


def write_logs(recordings: list[dict[str, Any]], folder: Path) -> None:
    """Write recordings as BAM's raw logs.

    After the torque is switched off the last goal is repeated, as BAM's recorder does.
    """
    for recording in recordings:
        rows = zip(
            recording["t_s"],
            recording["command_rad"],
            recording["position_rad"],
            recording["velocity_rad_s"],
            strict=True,
        )
        entries = [
            {
                "timestamp": t,
                "position": position,
                "speed": speed,
                "goal_position": goal,
                "torque_enable": index < recording["powered"],
            }
            for index, (t, goal, position, speed) in enumerate(rows)
        ]
        log = {
            "mass": recording["pendulum_mass_kg"],
            "arm_mass": 0.0,
            "length": recording["pendulum_length_m"],
            "kp": recording["firmware_gain"],
            "vin": recording["supply_V"],
            "motor": "xl330",
            "trajectory": recording["name"],
            "entries": entries,
        }
        (folder / f"{recording['name']}.json").write_text(json.dumps(log))


def process(raw: Path, out: Path) -> None:
    """Run ``python -m bam.process``: resample to a constant time step."""
    sys.argv = ["bam.process", "--raw", str(raw), "--logdir", str(out), "--dt", str(STEP_S)]
    runpy.run_module("bam.process", run_name="__main__")


def fit(job: dict[str, Any], logs: Path, out: Path) -> None:
    """Run ``python -m bam.fit`` with its defaults but a seed, and ``job["trials"]`` trials."""
    sampler = optuna.samplers.CmaEsSampler
    optuna.samplers.CmaEsSampler = lambda **options: sampler(seed=job["seed"], **options)
    command = ["bam.fit", "--actuator", "xl330", "--model", job["model"], "--logdir", str(logs)]
    sys.argv = [*command, "--output", str(out), "--trials", str(job["trials"])]
    runpy.run_module("bam.fit", run_name="__main__")


def predict(parameters: Path, recording: dict[str, Any], folder: Path) -> list[float]:
    """Angles in rad at the recording's own times, simulated by BAM from its first sample."""
    raw, out = (folder / f"{recording['name']}_{kind}" for kind in ("raw", "fit"))
    raw.mkdir(exist_ok=True)
    out.mkdir(exist_ok=True)
    write_logs([recording], raw)
    process(raw, out)
    (log,) = Logs(str(out)).logs
    simulator = simulate.Simulator(load_model(str(parameters)))
    angles, _, _ = own_rollout(simulator, log, simulate_control=True)
    times = [entry["timestamp"] for entry in log["entries"]]
    return np.interp(recording["t_s"], times, np.ravel(angles)).tolist()


def verify(name: str, logs: Path) -> tuple[float, float]:
    """Largest difference of the compiled loop from BAM's own, and the CPU time of the latter."""
    batch = Logs(str(logs)).make_batch()
    rng = np.random.default_rng(0)
    worst, spent = 0.0, 0.0
    for _ in range(5):
        model = models[name]()
        model.set_actuator(actuators["xl330"]())
        for parameter in model.get_parameters().values():
            parameter.value = rng.uniform(parameter.min, parameter.max)
        start = time.process_time()
        own = own_rollout(simulate.Simulator(model), batch, simulate_control=True)
        spent += time.process_time() - start
        compiled = compiled_rollout(simulate.Simulator(model), batch, simulate_control=True)
        worst = max(worst, float(np.abs(np.array(own[0]) - np.array(compiled[0])).max()))
    if worst > AGREEMENT_RAD:
        raise SystemExit(f"compiled simulation is {worst} rad from BAM's own")
    return worst, spent / 5


_batches: dict[int, tuple[np.ndarray, np.ndarray]] = {}


def compiled_rollout(
    simulator: simulate.Simulator,
    log: dict[str, Any],
    reset_period: float | None = None,
    simulate_control: bool = False,
) -> tuple[np.ndarray, None, None]:
    """``Simulator.rollout_log`` for a batch of logs with simulated control."""
    assert reset_period is None and simulate_control
    model = simulator.model
    model.actuator.load_log(log)
    if id(log) not in _batches:
        goals = np.array([entry["goal_position"] for entry in log["entries"]])
        powered = np.array([entry["torque_enable"] for entry in log["entries"]], float)
        _batches[id(log)] = goals, powered
    goals, powered = _batches[id(log)]
    first, bench, actuator = log["entries"][0], model.actuator.testbench, model.actuator
    angles = _simulate(
        goals,
        powered,
        np.array(first["position"], float),
        np.array(first["speed"], float),
        np.asarray(log["dt"], float),
        bench.compute_mass(0.0, 0.0) + actuator.get_extra_inertia(),
        (bench.mass + bench.arm_mass / 2) * -GRAVITY_M_S2 * bench.length,
        np.asarray(actuator.kp * actuator.error_gain, float),
        np.asarray(actuator.vin, float),
        _constants(model),
        (model.load_dependent, model.directional, model.stribeck),
    )
    return angles, None, None


def _constants(model: Model) -> np.ndarray:
    named = ("kt", "R", "q_offset", "friction_base", "friction_viscous")
    optional = [getattr(model, n).value if hasattr(model, n) else 0.0 for n in OPTIONAL]
    stribeck = (model.dtheta_stribeck.value, model.alpha.value) if model.stribeck else (1.0, 1.0)
    limits = (model.actuator.max_pwm, model.actuator.max_current)
    return np.array([*(getattr(model, n).value for n in named), *optional, *stribeck, *limits])


@numba.njit(cache=True)
def _simulate(
    goals: np.ndarray,
    powered: np.ndarray,
    angle: np.ndarray,
    speed: np.ndarray,
    step_s: np.ndarray,
    inertia: np.ndarray,
    weight: np.ndarray,
    gain: np.ndarray,
    volts: np.ndarray,
    constants: np.ndarray,
    terms: tuple[bool, bool, bool],
) -> np.ndarray:
    """The equations of BAM 1.0.2: control, motor, friction and Euler step, log by log."""
    kt, resistance, offset, base, viscous = constants[:5]
    stick, load, load_motor, load_external = constants[5:9]
    load_stick, motor_stick, external_stick, motor_quad, external_quad = constants[9:14]
    slow, power, duty_limit, current_limit = constants[14:]
    load_dependent, directional, stribeck = terms
    out = np.empty(goals.shape)
    for log in range(goals.shape[1]):
        q, dq, dt = angle[log], speed[log], step_s[log]
        for k in range(goals.shape[0]):
            out[k, log] = q
            duty = (goals[k, log] - q) * gain[log]
            center = kt * dq / volts[log]
            span = resistance * current_limit / volts[log]
            duty = min(max(duty, center - span), center + span)
            duty = min(max(duty, -duty_limit), duty_limit)
            motor = kt / resistance * (volts[log] * duty - kt * dq) * powered[k, log]
            external = weight[log] * np.sin(q + offset)
            near = np.exp(-(np.abs(dq / slow) ** power)) if stribeck else 0.0
            friction = base + near * stick
            if load_dependent and directional:
                friction += np.abs(external * load_external - motor * load_motor)
                friction += near * np.abs(external * external_stick - motor * motor_stick)
                if np.sign(external) != np.sign(motor):
                    if np.abs(external) < np.abs(motor):
                        friction += near * external_quad * external**2
                    elif np.abs(external) > np.abs(motor):
                        friction += near * motor_quad * motor**2
            elif load_dependent:
                friction += (load + near * load_stick) * np.abs(external - motor)
            net = motor + external
            stop = inertia[log] / dt * dq + net
            net -= np.sign(stop) * min(np.abs(stop), friction + viscous * np.abs(dq))
            acceleration = net / inertia[log]
            dq = min(max(dq + acceleration * dt, -100.0), 100.0)
            q += dq * dt + 0.5 * acceleration * dt**2
    return out


if __name__ == "__main__":
    main()
