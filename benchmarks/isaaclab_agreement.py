"""How far a servo exported for Isaac Lab is from ``predict``: its own actuator classes on a shaft.

Run: ``python -m benchmarks.isaaclab_agreement FOLDER [STEP_MS]``, the folder that holds the package
``isaaclab`` (2.3; ``source/isaaclab`` of its wheel) and the time step (default 0.5 ms). Only what
needs Omniverse is stood in for: the actuators compute as they do in Isaac Lab, on a shaft that is
integrated here in place of PhysX, so friction and armature, which PhysX adds, are not tried. The
signals are those of ``mujoco_agreement``.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from unittest.mock import MagicMock

import numpy as np
import torch

from benchmarks.mujoco_agreement import print_agreement, servo
from sim2real.arrays import Array
from sim2real.exporters.simulators import TARGETS
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.recording import Load

STEP_S = 0.0005
OMNIVERSE = [
    "carb",
    "omni",
    "omni.client",
    "omni.kit",
    "omni.kit.app",
    "omni.log",
    "omni.usd",
    "pxr",
    "h5py",
    "prettytable",
    "toml",
    "trimesh",
    "isaacsim",
    "isaacsim.core",
    "isaacsim.core.utils",
    "isaacsim.core.utils.extensions",
]


def simulate(
    model: Model, times: Array, command: Array, start: float, step_s: float = STEP_S
) -> Array:
    """Angles in rad at ``times``, shape (T,), of a shaft that Isaac Lab's actuator turns."""
    from isaaclab.utils.types import ArticulationActions

    joint, made = model.joints["j1"], {}
    exec(TARGETS["isaaclab"].write(model).text, made)  # noqa: S102 - the very text that users get
    given = made["actuators"](step_s)["j1"]
    actuator = given.class_type(
        given,
        joint_names=["j1"],
        joint_ids=[0],
        num_envs=1,
        device="cpu",
        stiffness=given.stiffness,
        damping=given.damping,
    )
    actuator.reset([0])
    grid = step_s * np.arange(round(times[-1] / step_s) + 1)
    sent = np.searchsorted(times, grid, side="right") - 1
    angle, speed, seen = start, 0.0, []
    for k in sent:
        seen.append(angle)
        target = torch.tensor([[command[k] if k >= 0 else start]])
        action = ArticulationActions(target, torch.zeros(1, 1), torch.zeros(1, 1), [0])
        state = torch.tensor([[angle]]), torch.tensor([[speed]])
        torque = float(actuator.compute(action, *state).joint_efforts[0, 0])
        speed += step_s * torque / joint.inertia_kgm2
        angle += step_s * speed
    return np.interp(times, grid, seen)


def main(folder: str, step_ms: str = "0.5") -> None:
    """Print a table of RMS differences in mrad."""
    sys.modules |= {name: MagicMock() for name in OMNIVERSE}
    sys.path.insert(0, folder)
    load = Load(0.002)
    line = {"stall_torque_Nm": 0.5, "no_load_speed_rad_s": 6.0}
    motor = JointModel(2.2, 0.09, 0.0507, load.inertia_kgm2, load=load, law="motor", motor=line)
    limit = (FittedEffect("torque_saturation", {"limit_Nm": 0.25}),)
    models = {
        "plain": servo(load),
        "motor": Model({"j1": motor}),
        "current limit": Model({"j1": replace(motor, effects=limit)}),
    }
    print_agreement(models, partial(simulate, step_s=1e-3 * float(step_ms)))


if __name__ == "__main__":
    main(*sys.argv[1:])
