"""How far a servo exported for Genesis is from ``predict``.

Run: ``python -m benchmarks.genesis_agreement``, where ``pip install genesis-world`` was done. The
signals and servos are those of ``mujoco_agreement``; set-points are held back by the latency, which
Genesis does not have, as the exported text says.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import genesis
import numpy as np

from benchmarks.mujoco_agreement import print_agreement, servo
from sim2real.arrays import Array
from sim2real.exporters.genesis import HAS
from sim2real.exporters.genesis import genesis as exported
from sim2real.model import Model
from sim2real.recording import Load

STEP_S = 0.0005
BODY = """<robot name="bench"><link name="base"/>
  <link name="horn"><inertial><mass value="0.1"/>
    <inertia ixx="0.002" iyy="0.002" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="j1" type="revolute"><parent link="base"/><child link="horn"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1000" velocity="1000"/></joint></robot>
"""


def simulate(model: Model, times: Array, command: Array, start: float) -> Array:
    """Angles in rad at ``times``, shape (T,), of the exported servo in Genesis."""
    joint = model.joints["j1"]
    scene = genesis.Scene(
        sim_options=genesis.options.SimOptions(dt=STEP_S, gravity=(0.0, 0.0, 0.0)),
        show_viewer=False,
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.urdf"
        path.write_text(BODY.format(inertia=joint.inertia_kgm2))
        entity = scene.add_entity(genesis.morphs.URDF(file=str(path), fixed=True))
        scene.build()
    made: dict[str, object] = {}
    exec(exported(model).text, made)  # noqa: S102 - the very text that users get
    dofs = made["set_actuators"](entity)  # type: ignore[operator]
    entity.set_dofs_position([start], dofs)
    seen, grid = [start], STEP_S * np.arange(1, round(times[-1] / STEP_S) + 2)
    late = np.searchsorted(times, grid - STEP_S - joint.latency_s, side="right") - 1
    for k in late:
        entity.control_dofs_position([command[k] if k >= 0 else start], dofs)
        scene.step()
        seen.append(float(entity.get_dofs_position(dofs)[0]))
    return np.interp(times, np.concatenate([[0.0], grid]), seen)


def main() -> None:
    """Print a table of RMS differences in mrad."""
    genesis.init(backend=genesis.cpu, precision="64", logging_level="error")
    load = Load(0.002)
    models = {"plain": servo(load)} | {name: servo(load, name) for name in HAS}
    print_agreement(models, simulate)


if __name__ == "__main__":
    main()
