"""How far a servo exported for Newton is from ``predict``.

    python3.12 -m venv /tmp/newton
    /tmp/newton/bin/pip install 'newton[sim]==1.8.0' scipy pandas emcee tqdm
    PYTHONPATH=. /tmp/newton/bin/python -m benchmarks.newton_agreement [--seconds 4]

The exported text as a user has it, on a link that Newton's solver of MuJoCo simulates, here by
MuJoCo itself. Every servo and signal is a joint of one model. The signals are those of
``mujoco_agreement``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import newton
import numpy as np
import warp as wp
from newton.solvers import SolverMuJoCo
from tqdm import tqdm

from benchmarks.mujoco_agreement import print_agreement_at_once
from sim2real.arrays import Array
from sim2real.exporters.simulators import TARGETS
from sim2real.model import Model

STEP_S = 0.001


def bench(servos: Mapping[str, Model]) -> newton.Model:
    """One link for each servo, each with the model's inertia on a joint of the servo's name."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    SolverMuJoCo.register_custom_attributes(builder)
    for name, model in servos.items():
        load = model.joints["j1"].inertia_kgm2
        link = builder.add_link(mass=0.1, inertia=wp.mat33(load, 0, 0, 0, load, 0, 0, 0, load))
        joint = builder.add_joint_revolute(parent=-1, child=link, axis=newton.Axis.Y, label=name)
        builder.add_articulation([joint])
    joints = {name: model.joints["j1"] for name, model in servos.items()}
    made: dict[str, Any] = {}
    exec(TARGETS["newton"].write(Model(joints)).text, made)  # noqa: S102 - the very text that users get
    made["add_actuators"](builder, STEP_S)
    return builder.finalize(device="cpu")


def simulate(servos: Sequence[Model], times: Array, commands: Array) -> Array:
    """Angles in rad at ``times`` of N exported servos on their set-points, both of shape (T, N)."""
    model = bench({f"servo{k}": servo for k, servo in enumerate(servos)})
    solver = SolverMuJoCo(
        model, use_mujoco_cpu=True, integrator="implicitfast", disable_contacts=True
    )
    state, after, control = model.state(), model.state(), model.control()
    memories = [(actuator.state(), actuator.state()) for actuator in model.actuators]
    grid = STEP_S * np.arange(1, round(times[-1] / STEP_S) + 2)
    seen = [np.zeros(len(servos))]
    for k in tqdm(np.searchsorted(times, grid - STEP_S, side="right") - 1, disable=None):
        control.joint_target_q.assign(commands[k].astype(np.float32))
        control.joint_f.zero_()
        for actuator, memory in zip(model.actuators, memories, strict=True):
            actuator.step(state, control, *memory, dt=STEP_S)
        memories = [(second, first) for first, second in memories]
        solver.step(state, after, control, None, STEP_S)
        state, after = after, state
        seen.append(state.joint_q.numpy().astype(float))
    ends, rows = np.concatenate([[0.0], grid]), np.array(seen)
    return np.stack([np.interp(times, ends, row) for row in rows.T], axis=1)


def main() -> None:
    """Print a table of RMS differences in mrad."""
    print_agreement_at_once(simulate)


if __name__ == "__main__":
    main()
