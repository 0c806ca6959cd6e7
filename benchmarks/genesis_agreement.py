"""How far a servo exported for Genesis is from ``predict``.

    python3.11 -m venv /tmp/genesis
    /tmp/genesis/bin/pip install genesis-world==1.4.5 torch scipy pandas emcee tqdm warp-lang
    PYTHONPATH=. /tmp/genesis/bin/python -m benchmarks.genesis_agreement [--seconds 4]

The exported text as a user has it; every servo and signal is an entity of one scene. The signals
are those of ``mujoco_agreement``. Genesis has no delay: set-points are held back by the latency, as
the exported text says.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import genesis
import numpy as np
from tqdm import tqdm

from benchmarks.mujoco_agreement import print_agreement_at_once
from sim2real.arrays import Array
from sim2real.exporters.simulators import TARGETS
from sim2real.model import Model

STEP_S = 0.001
BODY = """<robot name="bench"><link name="base"/>
  <link name="horn"><inertial><mass value="0.1"/>
    <inertia ixx="0.002" iyy="0.002" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="j1" type="revolute"><parent link="base"/><child link="horn"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1000" velocity="1000"/></joint></robot>
"""


def simulate(servos: Sequence[Model], times: Array, commands: Array) -> Array:
    """Angles in rad at ``times`` of N exported servos on their set-points, both of shape (T, N)."""
    options = genesis.options.SimOptions(dt=STEP_S, gravity=(0.0, 0.0, 0.0))
    scene = genesis.Scene(sim_options=options, show_viewer=False)
    entities = []
    with tempfile.TemporaryDirectory() as folder:
        for number, model in enumerate(servos):
            path = Path(folder) / f"bench{number}.urdf"
            path.write_text(BODY.format(inertia=model.joints["j1"].inertia_kgm2))
            morph = genesis.morphs.URDF(file=str(path), fixed=True, pos=(0.0, float(number), 0.0))
            entities.append(scene.add_entity(morph))
        scene.build()
    dofs = []
    for model, entity in zip(servos, entities, strict=True):
        made: dict[str, Any] = {}
        exec(TARGETS["genesis"].write(model).text, made)  # noqa: S102 - the very text that users get
        dofs.append(made["set_actuators"](entity))
    grid = STEP_S * np.arange(1, round(times[-1] / STEP_S) + 2)
    latencies = np.array([model.joints["j1"].latency_s for model in servos])
    late = np.searchsorted(times, grid[:, None] - STEP_S - latencies, side="right") - 1
    seen = [np.zeros(len(servos))]
    for row in tqdm(late, disable=None):
        for n, (entity, dof) in enumerate(zip(entities, dofs, strict=True)):
            target = commands[row[n], n] if row[n] >= 0 else commands[0, n]
            entity.control_dofs_position([float(target)], dof)
        scene.step()
        angles = zip(entities, dofs, strict=True)
        seen.append(np.array([float(entity.get_dofs_position(dof)[0]) for entity, dof in angles]))
    ends, rows = np.concatenate([[0.0], grid]), np.array(seen)
    return np.stack([np.interp(times, ends, row) for row in rows.T], axis=1)


def main() -> None:
    """Print a table of RMS differences in mrad."""
    genesis.init(backend=genesis.cpu, precision="64", logging_level="error")
    print_agreement_at_once(simulate)


if __name__ == "__main__":
    main()
