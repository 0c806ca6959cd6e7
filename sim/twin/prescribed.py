"""Swims that were only filmed: the twin with prescribed joint angles and a free body.

The commands of a filmed robot are not known. Its servos are replaced by servos so stiff that the
joints follow the measured angles, and the body moves by the force law.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from scipy.interpolate import CubicSpline

from sim.inference.swims import Simulator
from sim.robot.swimmer import CONTROL_S
from sim.twin.kernel import start_twin
from sim.twin.twin import Twin
from sim2real.arrays import Array
from sim2real.model import JointModel, Model
from sim2real.robot import Robot

RUN_UP_S = 12.0
"""Seconds of simulated motion before a film begins, which shows steady swimming."""
SUBSTEPS = 4
"""Sub-steps of a control period: four times as many move the mean surge by less than 1 %."""
_STIFF_NM_PER_RAD = 1e5
_START_M_S = 0.1
_STEP_S = CONTROL_S / SUBSTEPS


def follower() -> JointModel:
    """A servo that reaches its set-point after one sub-step, independent of the load."""
    return JointModel(_STIFF_NM_PER_RAD, _STIFF_NM_PER_RAD * _STEP_S, 0.0, 0.0)


def by_film(robot: Robot, *, run_up_s: float = RUN_UP_S) -> Simulator:
    """The reduced-order twin with prescribed joints; its models' servos are ``follower``.

    The commands are the joints' angles in rad, and begin ``run_up_s`` before the film: shape
    (run-up + T, J), a row every control period. The robots start at 0.1 m/s. When the film begins
    they are moved to its first pose, and keep their velocities in the body frame. Tracks have T
    rows.
    """
    before = round(run_up_s / CONTROL_S)

    def run(models: Sequence[Model], command: Array, start: Array) -> Array:
        E, J = len(models), command.shape[1]
        angle, set_points = _fine(command)
        twin = Twin(robot, models, n_envs=E, substeps=1, period_s=_STEP_S)
        twin.reset(pose=np.tile(start, (E, 1)), joint=angle[0])
        v = np.zeros((E, 3 + J))
        v[:, 0], v[:, 1] = _START_M_S * np.cos(start[2]), _START_M_S * np.sin(start[2])
        twin.motion.v.assign(v)
        twin.swim(set_points[: SUBSTEPS * before])
        carry(twin, start)
        state = twin.state()
        first = np.concatenate([state.pose, state.measured], axis=1)
        track = twin.swim(set_points[SUBSTEPS * before :])[:, SUBSTEPS - 1 :: SUBSTEPS]
        return np.concatenate([first[:, None], track], axis=1)

    return run


def _fine(command: Array) -> tuple[Array, Array]:
    """Angles at each sub-step, and the set-points with which ``follower`` reaches them.

    With kd = h kp and negligible inertia, the law of ``robot.joints.drive`` turns a joint by
    u - q - h v / 2 in a step h: half of the last step's turn is added.
    """
    rows = np.arange(len(command))
    angle = CubicSpline(rows, command)(np.arange(SUBSTEPS * (len(command) - 1) + 1) / SUBSTEPS)
    turn = np.diff(angle, axis=0, prepend=angle[:1])
    return angle, np.asarray(angle[1:] + turn[:-1] / 2)


def carry(twin: Twin, pose: Array) -> None:
    """Move robots and their wake to a pose in the pool; velocities in the body frame are kept."""
    clock = np.array(twin.motion.clock.numpy())
    q, v = np.array(twin.motion.q.numpy()), np.array(twin.motion.v.numpy())
    turn = pose[2] - q[:, 2]
    c, s = np.cos(turn), np.sin(turn)
    v[:, 0], v[:, 1] = c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1]
    q[:, :2] = pose[:2] - twin.outside.current * clock[:, None]
    q[:, 2] = pose[2]
    twin.motion.q.assign(q)
    twin.motion.v.assign(v)
    moved = np.array(twin.water.moved.numpy())
    x, y = moved[..., 0], moved[..., 1]
    rotated = np.stack([c[:, None] * x - s[:, None] * y, s[:, None] * x + c[:, None] * y], axis=-1)
    twin.water.moved.assign(rotated)
    everyone: Any = wp.ones(twin.n_envs, dtype=wp.int32, device=twin.device)
    inputs = [twin.chain, twin.motion, twin.water, everyone]
    wp.launch(start_twin, dim=twin.n_envs, inputs=inputs, device=twin.device)
