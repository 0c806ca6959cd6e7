"""How far a servo exported for Isaac Lab is from ``predict``: its own actuator classes on a shaft.

Run: ``python -m benchmarks.isaaclab_agreement FOLDER``, the folder that holds the package
``isaaclab`` (2.3; ``source/isaaclab`` of its wheel). Only what needs Omniverse is stood in for: the
actuators compute as they do in Isaac Lab, on a shaft that is integrated here in place of PhysX, so
friction and armature, which PhysX adds, are not tried. The signals are those of
``mujoco_agreement``. Isaac Lab's motor has no delay: its set-points are held back by the latency.
"""

from __future__ import annotations

import sys
from unittest.mock import MagicMock

import numpy as np
import torch

from benchmarks.mujoco_agreement import print_agreement, servo
from sim2real.arrays import Array
from sim2real.exporters.isaaclab import isaaclab
from sim2real.model import JointModel, Model
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


def simulate(model: Model, times: Array, command: Array, start: float) -> Array:
    """Angles in rad at ``times``, shape (T,), of a shaft that Isaac Lab's actuator turns."""
    from isaaclab.utils.types import ArticulationActions

    joint, made = model.joints["j1"], {}
    exec(isaaclab(model).text, made)  # noqa: S102 - the very text that users get
    given = made["actuators"](STEP_S)["j1"]
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
    delayed = hasattr(given, "max_delay")
    grid = STEP_S * np.arange(round(times[-1] / STEP_S) + 1)
    late = np.searchsorted(times, grid - (0 if delayed else joint.latency_s), side="right") - 1
    angle, speed, seen = start, 0.0, []
    for k in late:
        seen.append(angle)
        target = torch.tensor([[command[k] if k >= 0 else start]])
        action = ArticulationActions(target, torch.zeros(1, 1), torch.zeros(1, 1), [0])
        state = torch.tensor([[angle]]), torch.tensor([[speed]])
        torque = float(actuator.compute(action, *state).joint_efforts[0, 0])
        speed += STEP_S * torque / joint.inertia_kgm2
        angle += STEP_S * speed
    return np.interp(times, grid, seen)


def main(folder: str) -> None:
    """Print a table of RMS differences in mrad."""
    sys.modules |= {name: MagicMock() for name in OMNIVERSE}
    sys.path.insert(0, folder)
    load = Load(0.002)
    line = {"stall_torque_Nm": 0.5, "no_load_speed_rad_s": 6.0}
    motor = JointModel(2.2, 0.09, 0.0507, load.inertia_kgm2, load=load, law="motor", motor=line)
    print_agreement({"plain": servo(load), "motor": Model({"j1": motor})}, simulate)


if __name__ == "__main__":
    main(sys.argv[1])
