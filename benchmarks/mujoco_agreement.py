"""How far an exported MuJoCo model is from ``predict``, effect by effect.

Run: ``python -m benchmarks.mujoco_agreement``. Random steps and a sine that quickens to 2.6 Hz,
12 s each at 50 Hz with jitter, on a servo of 2.2 N m/rad; each effect at its typical size.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from sim2real.arrays import Array
from sim2real.effects import CATALOGUE
from sim2real.exporters.mujoco import HAS, INTEGRATOR, TIMESTEP_S, mujoco
from sim2real.exporters.mujoco_bench import CASES, simulate
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.recording import Load
from sim2real.servo.prediction import predict


def signals() -> tuple[Array, dict[str, Array]]:
    """Times in s, shape (T,), and set-points in rad by name."""
    rng = np.random.default_rng(3)
    t = 0.02 * np.arange(600)
    t[1:] += rng.uniform(-0.002, 0.002, t.size - 1)
    levels = np.concatenate([[0.0], rng.uniform(-0.6, 0.6, 40)])
    moves = 0.5 + np.cumsum(rng.uniform(0.3, 0.9, 40))
    sine = 0.5 * np.sin(2 * np.pi * (0.2 + 0.1 * t) * t)
    return t, {"steps": levels[np.searchsorted(moves, t, side="right")], "sine": sine}


def servo(load: Load, *effects: str) -> Model:
    """The servo with effects at their typical sizes."""
    typical = {e.name: {p.name: p.typical for p in e.parameters} for e in CATALOGUE}
    fitted = tuple(FittedEffect(name, typical[name]) for name in effects)
    joint = JointModel(2.2, 0.06, 0.0507, load.inertia_kgm2, load=load, effects=fitted)
    return Model({"j1": joint})


def print_agreement(
    models: Mapping[str, Model], simulate: Callable[[Model, Array, Array, float], Array]
) -> None:
    """Print how far another simulator is from ``predict``, RMS in mrad, by model and signal.

    Args:
        models: Of the joint ``j1``, by name.
        simulate: Angles in rad, shape (T,), of a model from times, set-points and the first angle.
    """
    t, sent = signals()
    seen = {
        name: {kind: simulate(model, t, command, 0.0) for kind, command in sent.items()}
        for name, model in models.items()
    }
    print_differences(models, seen, t, sent)


def print_agreement_at_once(simulate: Callable[[Sequence[Model], Array, Array], Array]) -> None:
    """Print how far another simulator is from ``predict`` for the servos of ``parts``.

    The option ``--seconds`` is the length of the signals.

    Args:
        simulate: Angles in rad of N models of the joint ``j1`` at times in s, shape (T,), on their
            set-points in rad; angles and set-points of shape (T, N).
    """
    options = argparse.ArgumentParser()
    options.add_argument("--seconds", type=float, default=12.0, help="length of the signals")
    t, sent = signals()
    t = t[t <= options.parse_args().seconds]
    sent = {kind: command[: t.size] for kind, command in sent.items()}
    models = parts()
    pairs = [(name, kind) for name in models for kind in sent]
    commands = np.stack([sent[kind] for _, kind in pairs], axis=1)
    angles = simulate([models[name] for name, _ in pairs], t, commands)
    seen: dict[str, dict[str, Array]] = {name: {} for name in models}
    for (name, kind), angle in zip(pairs, angles.T, strict=True):
        seen[name][kind] = angle
    print_differences(models, seen, t, sent)


def print_differences(
    models: Mapping[str, Model],
    seen: Mapping[str, Mapping[str, Array]],
    t: Array,
    sent: Mapping[str, Array],
) -> None:
    """Print how far simulated angles are from ``predict``, RMS in mrad, by model and signal.

    Args:
        models: Of the joint ``j1``, by name.
        seen: Simulated angles in rad, shape (T,), by model and signal.
        t: Times in s, shape (T,).
        sent: Set-points in rad, shape (T,), by signal.
    """
    print(f"{'servo':<22}" + "".join(f"{name:>8}" for name in sent) + "   (mrad RMS)")
    for name, model in models.items():
        apart = []
        for kind, command in sent.items():
            expected = predict(model, t, {"j1": command})["j1"]
            apart.append(1e3 * float(np.sqrt(np.mean((seen[name][kind] - expected) ** 2))))
        print(f"{name:<22}" + "".join(f"{value:8.2f}" for value in apart))


def parts(latency_s: float = 0.05) -> dict[str, Model]:
    """The plain servo, a motor with one further part each, and one with all of them."""
    load = Load(0.002)
    line = {"stall_torque_Nm": 0.5, "no_load_speed_rad_s": 6.0}
    friction, rotor = {"coulomb_Nm": 0.05}, {"rotor_inertia_kgm2": 0.001}
    kd = line["stall_torque_Nm"] / line["no_load_speed_rad_s"] + 0.01

    def motor(latency: float, parameters: dict[str, float]) -> Model:
        inertia = load.inertia_kgm2
        joint = JointModel(2.2, kd, latency, inertia, load=load, law="motor", motor=parameters)
        return Model({"j1": joint})

    return {
        "plain": servo(load),
        "torque-speed line": motor(0.0, line),
        "delay": motor(latency_s, line),
        "friction": motor(0.0, line | friction),
        "soft friction": motor(0.0, line | friction | {"stick_time_s": 0.01}),
        "rotor": motor(0.0, line | rotor),
        "all": motor(latency_s, line | friction | rotor),
    }


def bench(
    model: Model,
    times: Array,
    command: Array,
    start: float,
    integrator: str = INTEGRATOR,
    timestep_s: float = TIMESTEP_S,
) -> Array:
    """Angles in rad at ``times``, shape (T,), of the exported servo in MuJoCo."""
    options = {"integrator": integrator, "timestep_s": timestep_s}
    return simulate(mujoco(model).text, times, {"j1": command}, {"j1": start}, **options)["j1"]


def main() -> None:
    """Print tables of RMS differences in mrad: parts of a servo, and each effect."""
    print_agreement(parts(), bench)
    for integrator, timestep_s in CASES:
        print(f"{integrator}, {1e3 * timestep_s:g} ms")
        print_agreement(parts(), partial(bench, integrator=integrator, timestep_s=timestep_s))
    t, sent = signals()
    print(f"{'servo':<22}{'steps':>8}{'sine':>8}   effect itself, steps  (mrad RMS)")
    rows = [("plain", Load(0.002)), ("pendulum", Load(0.004, 0.1, 0.1))]
    rows += [(name, Load(0.002)) for name in sorted((*HAS, "torque_saturation"))]
    for name, load in rows:
        effects = (name,) if name not in ("plain", "pendulum") else ()
        model, bare = servo(load, *effects), servo(load)
        xml, apart, plain = mujoco(model).text, {}, {}
        for signal, command in sent.items():
            expected = predict(model, t, {"j1": command})["j1"]
            plain[signal] = predict(bare, t, {"j1": command})["j1"] - expected
            start = {"j1": float(predict(bare, t[:2], {"j1": command[:2]})["j1"][0])}
            seen = simulate(xml, t, {"j1": command}, start)["j1"]
            apart[signal] = 1e3 * np.sqrt(np.mean((seen - expected) ** 2))
        own = 1e3 * np.sqrt(np.mean(plain["steps"] ** 2))
        print(f"{name:<22}{apart['steps']:8.2f}{apart['sine']:8.2f}{own:12.1f}")


if __name__ == "__main__":
    main()
