"""How far an exported servo is from ``predict`` in each simulator, RMS in mrad.

    python -m benchmarks.agreement mujoco [--step-ms 2] [--integrator Euler]
    python -m benchmarks.agreement isaaclab --isaaclab FOLDER [--step-ms 2]
    python -m benchmarks.agreement mjlab [--seconds 4]        # newton, usd, genesis likewise

The exported text as a user has it. Random steps and a sine that quickens to 2.6 Hz, 12 s each at 50
Hz with jitter, on a servo of 2.2 N m/rad; each effect at its typical size. MuJoCo is an extra of
the library; the others run in environments of their own, with ``PYTHONPATH=.``: ``mjlab==1.6.0``,
``newton[sim]==1.8.0`` (for usd with ``usd-core newton-usd-schemas``), or ``genesis-world==1.4.5
torch warp-lang``, and scipy, pandas, emcee and tqdm. FOLDER has the package ``isaaclab`` (2.3, 3.0;
``source/isaaclab`` of its wheel): its actuators turn a shaft that is integrated here in place of
PhysX, so friction and armature, which PhysX adds, are not tried. Genesis has no delay: set-points
are held back by the latency, as the exported text says.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
from tqdm import tqdm

from benchmarks.harness import command_line
from sim2real.arrays import Array
from sim2real.effects import CATALOGUE
from sim2real.exporters.mujoco import HAS
from sim2real.exporters.simulators import TARGETS
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.recording import Load
from sim2real.servo.prediction import predict

STEP_S = 0.001
LINE = {"stall_torque_Nm": 0.5, "no_load_speed_rad_s": 6.0}
LOAD = Load(0.002)
OMNIVERSE = (
    "carb", "omni", "omni.client", "omni.kit", "omni.kit.app", "omni.log", "omni.usd", "pxr",
    "h5py", "prettytable", "toml", "trimesh", "isaacsim", "isaacsim.core", "isaacsim.core.utils",
    "isaacsim.core.utils.extensions",
)  # fmt: skip
"""What Isaac Lab's actuators import and do not need."""
URDF = """<robot name="bench"><link name="base"/>
  <link name="horn"><inertial><mass value="0.1"/>
    <inertia ixx="0.002" iyy="0.002" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="j1" type="revolute"><parent link="base"/><child link="horn"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1000" velocity="1000"/></joint></robot>
"""
MJCF = """<mujoco><compiler angle="radian"/><worldbody><body name="link">
<joint name="j1" type="hinge" axis="0 1 0"/>
<inertial pos="0 0 0" mass="0.1" diaginertia="{inertia} {inertia} {inertia}"/>
</body></worldbody></mujoco>"""


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


def motor(latency_s: float, **parameters: float) -> Model:
    """The servo with a motor on its torque-speed line, and its losses."""
    kd = LINE["stall_torque_Nm"] / LINE["no_load_speed_rad_s"] + 0.01
    joint = JointModel(2.2, kd, latency_s, LOAD.inertia_kgm2, load=LOAD, law="motor")
    return Model({"j1": replace(joint, motor=LINE | parameters)})


def parts() -> dict[str, Model]:
    """The plain servo, a motor with one further part each, and one with all of them."""
    friction, rotor = {"coulomb_Nm": 0.05}, {"rotor_inertia_kgm2": 0.001}
    return {
        "plain": servo(LOAD),
        "torque-speed line": motor(0.0),
        "delay": motor(0.05),
        "friction": motor(0.0, **friction),
        "soft friction": motor(0.0, **friction, stick_time_s=0.01),
        "rotor": motor(0.0, **rotor),
        "all": motor(0.05, **friction, **rotor),
    }


def with_effects() -> dict[str, Model]:
    """The parts, a pendulum, and each effect that a MuJoCo model has."""
    effects = {name: servo(LOAD, name) for name in sorted((*HAS, "torque_saturation"))}
    return parts() | {"pendulum": servo(Load(0.004, 0.1, 0.1))} | effects


def without_friction() -> dict[str, Model]:
    """What Isaac Lab's actuators have themselves."""
    (joint,) = motor(0.0507).joints.values()
    limit = (FittedEffect("torque_saturation", {"limit_Nm": 0.25}),)
    models = {"motor": joint, "current limit": replace(joint, effects=limit)}
    return {"plain": servo(LOAD)} | {name: Model({"j1": one}) for name, one in models.items()}


def made_by(simulator: str, model: Model) -> dict[str, Any]:
    """The names that the exported text for a simulator defines."""
    made: dict[str, Any] = {}
    exec(TARGETS[simulator].write(model).text, made)  # noqa: S102 - the text that users get
    return made


def held(times: Array, step_s: float) -> tuple[Array, Array]:
    """Ends of time steps in s, and the row of the set-point in force in each."""
    grid = step_s * np.arange(1, round(times[-1] / step_s) + 2)
    return grid, np.searchsorted(times, grid - step_s, side="right") - 1


def sampled(times: Array, grid: Array, rows: Sequence[Array]) -> Array:
    """Angles at ``times`` (T, N) of rows at 0 and the ends of time steps."""
    ends = np.concatenate([[0.0], grid])
    return np.stack([np.interp(times, ends, row) for row in np.array(rows).T], axis=1)


def mujoco(models: Sequence[Model], times: Array, commands: Array, options: Any) -> Array:  # noqa: ANN401
    """Each exported MJCF, by itself, from where ``predict`` starts."""
    from sim2real.exporters.mujoco_bench import simulate

    step_s = 1e-3 * options.step_ms if options.step_ms else None
    given = {"integrator": options.integrator, "timestep_s": step_s}
    angles = []
    for model, sent in zip(models, commands.T, strict=True):
        start = {"j1": float(predict(model, times[:2], {"j1": sent[:2]})["j1"][0])}
        text = TARGETS["mujoco"].write(model).text
        angles.append(simulate(text, times, {"j1": sent}, start, **given)["j1"])
    return np.stack(angles, axis=1)


def genesis(models: Sequence[Model], times: Array, commands: Array, _: Any) -> Array:  # noqa: ANN401
    """Every servo is an entity of one scene."""
    import genesis

    genesis.init(backend=genesis.cpu, precision="64", logging_level="error")
    physics = genesis.options.SimOptions(dt=STEP_S, gravity=(0.0, 0.0, 0.0))
    scene = genesis.Scene(sim_options=physics, show_viewer=False)
    entities = []
    with tempfile.TemporaryDirectory() as folder:
        for number, model in enumerate(models):
            path = Path(folder) / f"bench{number}.urdf"
            path.write_text(URDF.format(inertia=model.joints["j1"].inertia_kgm2))
            morph = genesis.morphs.URDF(file=str(path), fixed=True, pos=(0.0, float(number), 0.0))
            entities.append(scene.add_entity(morph))
        scene.build()
    pairs = zip(models, entities, strict=True)
    dofs = [made_by("genesis", model)["set_actuators"](one) for model, one in pairs]
    grid, _ = held(times, STEP_S)
    latencies = np.array([model.joints["j1"].latency_s for model in models])
    late = np.searchsorted(times, grid[:, None] - STEP_S - latencies, side="right") - 1
    seen = [np.zeros(len(models))]
    for row in tqdm(np.maximum(late, 0), disable=None):
        for n, (entity, dof) in enumerate(zip(entities, dofs, strict=True)):
            entity.control_dofs_position([float(commands[row[n], n])], dof)
        scene.step()
        angles = zip(entities, dofs, strict=True)
        seen.append(np.array([float(entity.get_dofs_position(dof)[0]) for entity, dof in angles]))
    return sampled(times, grid, seen)


def newton(models: Sequence[Model], times: Array, commands: Array, options: Any) -> Array:  # noqa: ANN401
    """Every servo is a joint of one model, which Newton's solver of MuJoCo simulates.

    For ``usd``, Newton reads joints and actuators from one file.
    """
    import newton
    import warp as wp
    from newton.solvers import SolverMuJoCo

    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    SolverMuJoCo.register_custom_attributes(builder)
    joints = {f"servo{k:03}": model.joints["j1"] for k, model in enumerate(models)}
    if options.simulator == "usd":
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "bench.usda"
            path.write_text(TARGETS["usd"].write(Model(joints)).text)
            assert builder.add_usd(str(path))["actuator_count"] == len(models)
    else:
        for name, joint in joints.items():
            load = joint.inertia_kgm2
            link = builder.add_link(mass=0.1, inertia=wp.mat33(load, 0, 0, 0, load, 0, 0, 0, load))
            axis = newton.Axis.Y
            hinge = builder.add_joint_revolute(parent=-1, child=link, axis=axis, label=name)
            builder.add_articulation([hinge])
        made_by("newton", Model(joints))["add_actuators"](builder, STEP_S)
    model = builder.finalize(device="cpu")
    physics = {"use_mujoco_cpu": True, "integrator": "implicitfast", "disable_contacts": True}
    solver = SolverMuJoCo(model, **physics)
    state, after, control = model.state(), model.state(), model.control()
    memories = [(actuator.state(), actuator.state()) for actuator in model.actuators]
    grid, rows = held(times, STEP_S)
    seen = [np.zeros(len(models))]
    for k in tqdm(rows, disable=None):
        control.joint_target_q.assign(commands[k].astype(np.float32))
        control.joint_f.zero_()
        for actuator, memory in zip(model.actuators, memories, strict=True):
            actuator.step(state, control, *memory, dt=STEP_S)
        memories = [(second, first) for first, second in memories]
        solver.step(state, after, control, None, STEP_S)
        state, after = after, state
        seen.append(state.joint_q.numpy().astype(float))
    return sampled(times, grid, seen)


def mjlab(models: Sequence[Model], times: Array, commands: Array, _: Any) -> Array:  # noqa: ANN401
    """Every servo is an entity of one scene, which MuJoCo Warp simulates."""
    import mujoco
    import torch
    from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
    from mjlab.scene import Scene, SceneCfg
    from mjlab.sim import MujocoCfg, Simulation, SimulationCfg

    def entity(model: Model) -> Any:  # noqa: ANN401
        made, inertia = made_by("mjlab", model), model.joints["j1"].inertia_kgm2

        def spec() -> Any:  # noqa: ANN401
            link = mujoco.MjSpec.from_string(MJCF.format(inertia=inertia))
            if "set_friction" in made:
                made["set_friction"](link, STEP_S)
            return link

        articulation = EntityArticulationInfoCfg(actuators=made["actuators"](STEP_S))
        return EntityCfg(spec_fn=spec, articulation=articulation)

    entities = {f"servo{k}": entity(model) for k, model in enumerate(models)}
    scene = Scene(SceneCfg(num_envs=1, entities=entities), "cpu")
    physics = MujocoCfg(timestep=STEP_S, gravity=(0.0, 0.0, 0.0), integrator="implicitfast")
    cfg = SimulationCfg(mujoco=physics)
    sim = Simulation(num_envs=1, cfg=cfg, model=scene.compile(), device="cpu")
    scene.initialize(sim.mj_model, sim.model, sim.data)
    sim.reset()
    scene.reset()
    sim.forward()
    grid, rows = held(times, STEP_S)
    seen = [np.zeros(len(models))]
    for k in tqdm(rows, disable=None):
        for n, key in enumerate(entities):
            target = torch.tensor([[commands[k, n]]], dtype=torch.float32)
            scene[key].set_joint_position_target(target)
        scene.write_data_to_sim()
        sim.step()
        scene.update(dt=STEP_S)
        seen.append(np.array([float(scene[key].data.joint_pos[0, 0]) for key in entities]))
    return sampled(times, grid, seen)


def isaaclab(models: Sequence[Model], times: Array, commands: Array, options: Any) -> Array:  # noqa: ANN401
    """Each servo is a shaft that Isaac Lab's actuator turns; only Omniverse is stood in for."""
    import torch

    sys.modules |= {name: MagicMock() for name in OMNIVERSE}
    sys.path.insert(0, str(options.isaaclab))
    from isaaclab.utils.types import ArticulationActions

    step_s = 1e-3 * (options.step_ms or 0.5)
    grid, rows = held(times, step_s)
    angles = []
    for model, command in zip(models, commands.T, strict=True):
        given = made_by("isaaclab", model)["actuators"](step_s)["j1"]
        more = {"stiffness": given.stiffness, "damping": given.damping, "device": "cpu"}
        actuator = given.class_type(given, joint_names=["j1"], joint_ids=[0], num_envs=1, **more)
        actuator.reset([0])
        angle, speed, seen = 0.0, 0.0, [0.0]
        for k in rows:
            none = torch.zeros(1, 1)
            action = ArticulationActions(torch.tensor([[command[k]]]), none, none, [0])
            state = torch.tensor([[angle]]), torch.tensor([[speed]])
            torque = float(actuator.compute(action, *state).joint_efforts[0, 0])
            speed += step_s * torque / model.joints["j1"].inertia_kgm2
            angle += step_s * speed
            seen.append(angle)
        angles.append(np.interp(times, np.concatenate([[0.0], grid]), seen))
    return np.stack(angles, axis=1)


Simulate = Callable[[Sequence[Model], Array, Array, Any], Array]
"""Angles in rad of N models of the joint ``j1`` at times in s, shape (T,), on their set-points in
rad; angles and set-points of shape (T, N)."""
SIMULATORS: Mapping[str, tuple[Simulate, Callable[[], dict[str, Model]]]] = {
    "mujoco": (mujoco, with_effects),
    "mjlab": (mjlab, parts),
    "newton": (newton, parts),
    "usd": (newton, parts),
    "genesis": (genesis, parts),
    "isaaclab": (isaaclab, without_friction),
}


def main() -> None:
    """Print the table."""
    parser = command_line(
        __doc__, seconds=(12.0, "length of the signals"), step_ms=float, integrator=str,
        isaaclab=Path,
    )  # fmt: skip
    parser.add_argument("simulator", choices=SIMULATORS)
    options = parser.parse_args()
    simulate, servos = SIMULATORS[options.simulator]
    models = servos()
    t, sent = signals()
    t = t[t <= options.seconds]
    pairs = [(name, kind) for name in models for kind in sent]
    commands = np.stack([sent[kind][: t.size] for _, kind in pairs], axis=1)
    angles = simulate([models[name] for name, _ in pairs], t, commands, options)
    print(f"{'servo':<22}" + "".join(f"{kind:>8}" for kind in sent) + "   (mrad RMS)")
    apart: dict[str, list[float]] = {}
    for (name, _), command, angle in zip(pairs, commands.T, angles.T, strict=True):
        off = angle - predict(models[name], t, {"j1": command})["j1"]
        apart.setdefault(name, []).append(1e3 * float(np.sqrt(np.mean(off**2))))
    for name, errors in apart.items():
        print(f"{name:<22}" + "".join(f"{error:8.2f}" for error in errors))


if __name__ == "__main__":
    main()
