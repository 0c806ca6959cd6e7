"""One small file of every kind that a command reads, all without a fault."""

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from good_input import ROBOT
from simulated import recording

from sim2real.recording import Load, write_recording

ROOT = Path(__file__).resolve().parents[1]
POOL = ROOT / "datasets" / "pool"
sys.path[:0] = [str(ROOT / "tests" / name) for name in ("arm", "design")]

import pendulum  # noqa: E402
from rival_pair import RIVALS  # noqa: E402

CONTEXTS_TOML = """[[contexts]]
name = "second arm"
supply_ratio = 0.8
[contexts.loads.j1]
inertia_kgm2 = 0.004
pendulum_mass_kg = 0.05
pendulum_length_m = 0.1
"""


def write_good_files(folder: Path) -> None:
    """Write the files."""
    friction = {"coulomb_friction": {"torque_Nm": 0.05}}
    weight = Load(0.002, 0.05, 0.1)
    for seed, name in enumerate("ab"):
        write_recording(recording(seed, name, seconds=3.0, **friction), folder / f"{name}.csv")
    write_recording(recording(3, "c", seconds=3.0, load=weight), folder / "c.csv")
    write_recording(pendulum.recording(1, "arm", seconds=2.5), folder / "arm.csv")
    pendulum.leg(folder)
    for name in ("calibrated.json", "ranges.json"):
        shutil.copy(POOL / name, folder)
    shutil.copy(POOL / "robot.toml", folder / "fish.toml")
    rows = (POOL / "p1.csv").read_text().splitlines(keepends=True)
    for name, number in (("swim", 150), ("few", 5)):
        (folder / f"{name}.csv").write_text("".join(rows[: number + 1]))
        shutil.copy(POOL / "p1.json", folder / f"{name}.json")
    (folder / "robot.toml").write_text(ROBOT)
    (folder / "contexts.toml").write_text(CONTEXTS_TOML)
    shutil.copy(ROOT / "rl" / "controllers" / "tuned.toml", folder / "gains.toml")
    joint = {"kp_Nm_per_rad": 2.2, "kd_Nms_per_rad": 0.06, "latency_s": 0.05, "inertia_kgm2": 0.002}
    of_effects = [
        {"effect": "coulomb_friction", "parameters": friction["coulomb_friction"]},
        {"effect": "backlash", "parameters": {"gap_rad": 0.01}},
    ]
    joint |= {"interval": {"kp_Nm_per_rad": [2.1, None]}, "effects": of_effects}
    motor = {"stall_torque_Nm": 1.6, "no_load_speed_rad_s": 5.0, "rotor_inertia_kgm2": 0.001}
    motor |= {"coulomb_Nm": 0.02}
    gears = joint | {"load": vars(weight), "law": "motor", "motor": motor, "effects": []}
    diagnosis = {"schema": "sim2real.diagnosis/1", "rival_sets": [RIVALS.content()]}
    bench = pd.read_csv(folder / "a.csv")
    t, command, angle = bench.to_numpy().T
    entries = bench.set_axis(["timestamp", "goal_position", "position"], axis=1)
    entries = entries.assign(torque_enable=True, input_volts=7.3).to_dict("records")
    log: dict[str, Any] = {"mass": 0.1, "length": 0.1, "kp": 200, "vin": 7.4, "motor": "xl330"}
    log["entries"] = entries
    contents = {
        "model": {"schema": "sim2real.model/1", "joints": {"j1": joint}},
        "gears": {"schema": "sim2real.model/1", "joints": {"j1": gears}},
        "diagnosis": diagnosis,
        "bam": log,
    }
    for name, content in contents.items():
        (folder / f"{name}.json").write_text(json.dumps(content))
    table = {"time": 1e3 * t, "goal": np.degrees(command), "angle": np.degrees(angle)}
    pd.DataFrame(table).to_csv(folder / "table.csv", index=False)
    _write_policies(folder)


def _write_policies(folder: Path) -> None:
    from stable_baselines3 import SAC

    from rl.controllers.discrete_cpg import TABLE, DiscreteCPGEnv, make_dqn
    from rl.deploy.export import policy_of, write_policy
    from rl.make import make_world
    from rl.observer import PAPER, View
    from rl.sac.plan import Settings
    from rl.sac.sac import make_sac
    from rl.task import TASKS
    from rl.vec_env import FishVecEnv
    from rl.world import Draws
    from sim2real.model import read_model
    from sim2real.robot import read_robot

    draws = Draws((read_model(folder / "calibrated.json"),))
    world = make_world(read_robot(folder / "fish.toml"), TASKS["near"], draws, n_envs=1, seed=0)
    agent = make_sac(world, Settings(hidden=(16, 8), memory=10), 0, view=View())
    agent.trained_over = {"j1.kp_Nm_per_rad": [0.5, 0.7]}
    column = np.linspace(-0.3, 0.3, 16).astype(np.float32)
    agent.by_price = {"prices": 2.0, "column": column, "share": 0.0}
    agent.save(folder / "sac.zip")
    SAC.save(agent, folder / "old.zip")
    write_policy(policy_of(agent), folder / "policy.npz", ("npz",))
    discrete = make_dqn(DiscreteCPGEnv(FishVecEnv(world, PAPER)), 0)
    discrete.gaits, discrete.joints = TABLE.content(), ["j1", "j2", "j3"]
    discrete.save(folder / "dqn.zip")
