"""How far a servo exported for mjlab is from ``predict``.

    python3.11 -m venv /tmp/mjlab
    /tmp/mjlab/bin/pip install mjlab==1.6.0 scipy pandas emcee tqdm
    PYTHONPATH=. /tmp/mjlab/bin/python -m benchmarks.mjlab_agreement

The exported text as a user has it: its actuators and ``set_friction`` in an entity of a scene, which
mjlab simulates by MuJoCo Warp, here on the CPU. The signals are those of ``mujoco_agreement``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
from mjlab.scene import Scene, SceneCfg
from mjlab.sim import MujocoCfg, Simulation, SimulationCfg

from benchmarks.mujoco_agreement import print_agreement, servo
from sim2real.arrays import Array
from sim2real.exporters.mjlab import mjlab as exported
from sim2real.model import JointModel, Model
from sim2real.recording import Load

STEP_S = 0.0005
BODY = """<mujoco><compiler angle="radian"/><worldbody><body name="link">
<joint name="j1" type="hinge" axis="0 1 0"/>
<inertial pos="0 0 0" mass="0.1" diaginertia="{inertia} {inertia} {inertia}"/>
</body></worldbody></mujoco>"""


def entity(model: Model, made: dict[str, Any]) -> EntityCfg:
    """A link with the model's inertia on a joint, which the exported actuator turns."""
    load = model.joints["j1"].inertia_kgm2

    def spec() -> mujoco.MjSpec:
        link = mujoco.MjSpec.from_string(BODY.format(inertia=load))
        if "set_friction" in made:
            made["set_friction"](link, STEP_S)
        return link

    articulation = EntityArticulationInfoCfg(actuators=made["actuators"](STEP_S))
    return EntityCfg(spec_fn=spec, articulation=articulation)


def simulate(model: Model, times: Array, command: Array, start: float) -> Array:
    """Angles in rad at ``times``, shape (T,), of the exported servo in mjlab."""
    made: dict[str, Any] = {}
    exec(exported(model).text, made)  # noqa: S102 - the very text that users get
    scene = Scene(SceneCfg(num_envs=1, entities={"bench": entity(model, made)}), "cpu")
    options = MujocoCfg(timestep=STEP_S, gravity=(0.0, 0.0, 0.0), integrator="implicitfast")
    sim = Simulation(
        num_envs=1, cfg=SimulationCfg(mujoco=options), model=scene.compile(), device="cpu"
    )
    scene.initialize(sim.mj_model, sim.model, sim.data)
    bench, grid = scene["bench"], STEP_S * np.arange(1, round(times[-1] / STEP_S) + 2)
    sim.reset()
    scene.reset()
    bench.write_joint_state_to_sim(torch.tensor([[start]]), torch.zeros(1, 1))
    sim.forward()
    seen = [start]
    for k in np.searchsorted(times, grid - STEP_S, side="right") - 1:
        bench.set_joint_position_target(torch.tensor([[float(command[k])]]))
        scene.write_data_to_sim()
        sim.step()
        scene.update(dt=STEP_S)
        seen.append(float(bench.data.joint_pos[0, 0]))
    return np.interp(times, np.concatenate([[0.0], grid]), seen)


def models(latency_s: float = 0.05) -> dict[str, Model]:
    """The plain servo, each of its parts, and all of them."""
    load = Load(0.002)
    line = {"stall_torque_Nm": 0.5, "no_load_speed_rad_s": 6.0}
    friction, rotor = {"coulomb_Nm": 0.05}, {"rotor_inertia_kgm2": 0.001}
    kd = line["stall_torque_Nm"] / line["no_load_speed_rad_s"]

    def motor(latency: float, parts: dict[str, float], more_kd: float = 0.01) -> Model:
        joint = JointModel(
            2.2, kd + more_kd, latency, load.inertia_kgm2, load=load, law="motor", motor=parts
        )
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


def main(simulate: Callable[[Model, Array, Array, float], Array] = simulate) -> None:
    """Print a table of RMS differences in mrad."""
    print_agreement(models(), simulate)


if __name__ == "__main__":
    main()
