"""How far a servo exported for mjlab is from ``predict``.

    python3.11 -m venv /tmp/mjlab
    /tmp/mjlab/bin/pip install mjlab==1.6.0 scipy pandas emcee tqdm
    PYTHONPATH=. /tmp/mjlab/bin/python -m benchmarks.mjlab_agreement [--seconds 4]

The exported text as a user has it: actuators and ``set_friction`` in an entity of a scene, which
mjlab simulates by MuJoCo Warp, here on the CPU. The signals are those of ``mujoco_agreement``.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
from mjlab.scene import Scene, SceneCfg
from mjlab.sim import MujocoCfg, Simulation, SimulationCfg
from tqdm import tqdm

from benchmarks.mujoco_agreement import parts, print_differences, signals
from sim2real.arrays import Array
from sim2real.exporters.simulators import TARGETS
from sim2real.model import Model

STEP_S = 0.001
BODY = """<mujoco><compiler angle="radian"/><worldbody><body name="link">
<joint name="j1" type="hinge" axis="0 1 0"/>
<inertial pos="0 0 0" mass="0.1" diaginertia="{inertia} {inertia} {inertia}"/>
</body></worldbody></mujoco>"""


def entity(model: Model) -> EntityCfg:
    """A link with the model's inertia on a joint, which the exported actuator turns."""
    made: dict[str, Any] = {}
    exec(TARGETS["mjlab"].write(model).text, made)  # noqa: S102 - the very text that users get
    load = model.joints["j1"].inertia_kgm2

    def spec() -> mujoco.MjSpec:
        link = mujoco.MjSpec.from_string(BODY.format(inertia=load))
        if "set_friction" in made:
            made["set_friction"](link, STEP_S)
        return link

    articulation = EntityArticulationInfoCfg(actuators=made["actuators"](STEP_S))
    return EntityCfg(spec_fn=spec, articulation=articulation)


def simulate(
    models: Mapping[str, Model], times: Array, sent: Mapping[str, Array]
) -> dict[str, dict[str, Array]]:
    """Angles in rad at ``times``, shape (T,), by model and signal.

    Each model is an entity of one scene, each signal a world.
    """
    names = {f"servo{k}": name for k, name in enumerate(models)}
    cells = {key: entity(models[name]) for key, name in names.items()}
    scene = Scene(SceneCfg(num_envs=len(sent), entities=cells), "cpu")
    options = MujocoCfg(timestep=STEP_S, gravity=(0.0, 0.0, 0.0), integrator="implicitfast")
    cfg = SimulationCfg(mujoco=options)
    sim = Simulation(num_envs=len(sent), cfg=cfg, model=scene.compile(), device="cpu")
    scene.initialize(sim.mj_model, sim.model, sim.data)
    sim.reset()
    scene.reset()
    sim.forward()
    grid = STEP_S * np.arange(1, round(times[-1] / STEP_S) + 2)
    seen = {key: [np.zeros(len(sent))] for key in names}
    commands = np.stack(list(sent.values()), axis=1)
    for k in tqdm(np.searchsorted(times, grid - STEP_S, side="right") - 1, disable=None):
        target = torch.tensor(commands[k, :, None], dtype=torch.float32)
        for key in names:
            scene[key].set_joint_position_target(target)
        scene.write_data_to_sim()
        sim.step()
        scene.update(dt=STEP_S)
        for key in names:
            seen[key].append(scene[key].data.joint_pos[:, 0].numpy().astype(float))
    ends = np.concatenate([[0.0], grid])
    angles = {names[key]: np.array(rows) for key, rows in seen.items()}
    return {
        name: {kind: np.interp(times, ends, each[:, j]) for j, kind in enumerate(sent)}
        for name, each in angles.items()
    }


def main() -> None:
    """Print a table of RMS differences in mrad."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seconds", type=float, default=12.0, help="length of the signals")
    t, sent = signals()
    t = t[t <= options.parse_args().seconds]
    sent = {kind: command[: t.size] for kind, command in sent.items()}
    models = parts()
    print_differences(models, simulate(models, t, sent), t, sent)


if __name__ == "__main__":
    main()
