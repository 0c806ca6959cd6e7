"""The ablation: its arms, and tests of their agents at the turn in simulation and in reality.

Without a technique the default of the old simulator is used (Lin, Liu, Wang, Sec. IV-D).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rl.deploy.export import read_zip
from rl.deploy.policy import Policy, PolicyController, read_npz
from rl.experiments.episodes import Episodes, energy, measured
from rl.experiments.testbeds import Testbed, trials_of
from rl.make import digest, draws_of, noise_of, with_density
from rl.sac.plan import Arm, Plan
from rl.task import TASKS, Task
from rl.world import Draws
from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.output import sha256_of, write_json
from sim2real.ranges.entry import Ranges
from sim2real.robot import Robot
from sim2real.structured import Fields, read_json

LISTING = "agents.json"
STIFF = JointModel(
    kp_Nm_per_rad=10.0,
    kd_Nms_per_rad=0.2,
    latency_s=0.0,
    inertia_kgm2=0.002,
    effects=(FittedEffect("torque_saturation", {"limit_Nm": 2.0}),),
)
"""An uncalibrated servo. FishGym drives the joints of its koi by torque, of at most 2 N m, without
damping, friction or latency (github.com/dongfangliu/gym-fish, ``assets/agents/koi_all_fins.json``).
The task commands angles, so the default is a stiff drive, at this limit from 0.2 rad on."""


@dataclass(frozen=True)
class Techniques:
    """Techniques of an arm: without servo joints are ``STIFF``, without density links are alike."""

    title: str
    servo: bool = True
    density: bool = True
    randomization: bool = True
    effects: bool = False


ARMS: Mapping[str, Techniques] = {
    "full": Techniques("all techniques"),
    "no-servo": Techniques("no servo calibration", servo=False),
    "no-density": Techniques("no density calibration", density=False),
    "no-randomization": Techniques("no randomization", randomization=False),
    "full-and-effects": Techniques("all, and the effects found", effects=True),
    "ceiling": Techniques("trained in reality itself"),
    "none": Techniques("no technique", servo=False, density=False, randomization=False),
}
"""The four arms of the paper; "full-and-effects", with diagnosed effects; "ceiling", trained with
the true parameters of the reality where they are known: an upper bound; and "none". Training of the
other arms can continue from agents of "none", which met no technique that an arm lacks: the time to
learn swimming, which differs by chance, is then not part of the comparison."""
PAPER = ("full", "no-servo", "no-density", "no-randomization")


def one_density(robot: Robot) -> list[float]:
    """Normalised densities of links of one material, elliptic cylinders; the total is kept."""
    section = np.array([link.width_m * link.height_m for link in robot.links])
    length = np.array([link.length_m for link in robot.links])
    return list((section * length.sum() / (section * length).sum()).tolist())


def model_of(
    techniques: Techniques, model: Model, robot: Robot, enriched: Model | None = None
) -> Model:
    """The simulator that an arm trains in; ``enriched`` is the model with diagnosed effects."""
    chosen = with_density(enriched if techniques.effects and enriched else model, robot)
    if not techniques.density:
        chosen = replace(chosen, body={**chosen.body, "normalised_density": one_density(robot)})
    if not techniques.servo:
        chosen = replace(chosen, joints=dict.fromkeys(chosen.joints, STIFF))
    return chosen


def arm_of(
    name: str,
    model: Model,
    robot: Robot,
    ranges: Ranges,
    enriched: Model | None = None,
    reality: Model | None = None,
) -> Arm:
    """An arm of ``ARMS`` to train, without the ranges of techniques that it does not use."""
    techniques = ARMS[name]
    if name == "ceiling":
        assert reality is not None, "the caller has looked"
        noise = noise_of(ranges, [joint.name for joint in robot.joints])
        return Arm(name, Draws((with_density(reality, robot),), noise))
    arm_model = model_of(techniques, model, robot, enriched)
    if not techniques.randomization:
        return Arm(name, draws_of(arm_model, None, robot, seed=0))
    joints = set(model.joints)

    def used(parameter: str) -> bool:
        servo = parameter.split(".")[0] in joints and not parameter.endswith("position_noise_rad")
        if not techniques.servo and (servo or parameter == "command_latency_s"):
            return False
        return techniques.density or not parameter.startswith("body.normalised_density")

    entries = tuple(entry for entry in ranges.entries if used(entry.parameter))
    return Arm(name, draws_of(arm_model, replace(ranges, entries=entries), robot, seed=0))


def ablate(
    folder: Path,
    robot: Robot,
    arms: Sequence[str],
    agents: Sequence[Path],
    plan: Plan,
    testbeds: Sequence[Testbed],
    *,
    repeats: int = 5,
    seed: int = 0,
) -> dict[str, Any]:
    """Test the agents of all arms; each testbed writes a file, and is skipped if it is up to date.

    ``agents`` are folders: all seeds of the first arm, then those of the next. ``repeats`` are
    episodes of each agent and testbed, with starts and noise by ``seed``. The result has
    ``agents``: for each, its arm, seed and, by testbed, return (the rewards discounted as in
    training), reward, ``paper`` (the measure of the paper: the reward with its weight of energy,
    0.001), success, time and energy of each repeat.
    """
    turn = TASKS["turn"]
    task, results = replace(turn, energy=plan.task.energy), dict[str, Any]()
    discount = plan.settings.gamma ** (1 / plan.view.period)
    policies = [policy_in(agent) for agent in agents]
    weights = [digest([x.tobytes() for x in one.weights]) for one in policies]
    for testbed in testbeds:
        path = folder / f"{testbed.name}.json"
        measures = (discount, task.energy, turn.energy)
        key = digest((weights, robot, testbed.key, measures, task.steps, repeats, seed))
        result = read_json(path) if path.exists() else {}
        if result.get("key") != key:
            steering = [PolicyController(one) for one in policies]
            swims = trials_of(testbed.swim, steering, robot, task, repeats, seed)
            result = {"key": key, "agents": [as_json(one, task, discount) for one in swims]}
            result["targets"] = swims[0].targets[:, 0].tolist()
            write_json(path, result)
        results[testbed.name] = result
    names = [(arm, s) for arm in arms for s in plan.seeds]
    return {
        "repeats": repeats,
        "testbeds": list(results),
        "said": {testbed.name: testbed.description for testbed in testbeds},
        "agents": [
            {"arm": arm, "seed": s, "folder": agents[a].name}
            | {testbed: result["agents"][a] for testbed, result in results.items()}
            for a, (arm, s) in enumerate(names)
        ],
        "targets": {testbed: result["targets"] for testbed, result in results.items()},
    }


def policy_in(agent: Path) -> Policy:
    """The policy in the folder of an agent: ``policy.npz`` if it exists, else ``policy.zip``."""
    small = agent / "policy.npz"
    return read_npz(small) if small.exists() else read_zip(agent / "policy.zip")


def as_json(episodes: Episodes, task: Task, discount: float) -> dict[str, Any]:
    """Episodes of an agent as JSON values; time and energy as in ``episodes.measured``."""
    figures, dearer = measured(episodes, task), TASKS["turn"].energy - task.energy
    columns = {
        "return": episodes.discounted(discount),
        "paper": episodes.reward - dearer * energy(episodes.rate),
        **{name: figures[name] for name in ("reward", "time_s", "energy")},
        "faced_s": episodes.faced_s(),
    }

    def numbers(values: Array) -> list[float | None]:
        return [round(float(x), 6) if np.isfinite(x) else None for x in values]

    paths = np.moveaxis(episodes.pose[::5, :2, :2], 1, 0)  # of two episodes
    return {
        **{name: numbers(values) for name, values in columns.items()},
        "success": episodes.success.tolist(),
        "path": [[numbers(at) for at in path if np.isfinite(at).all()] for path in paths],
    }


def read_pretrained(folder: Path, arms: Sequence[str]) -> tuple[list[Path], tuple[int, ...]]:
    """Folders of pretrained agents, all seeds of the first arm, then the next; and the seeds."""
    path = folder / LISTING
    listing = Fields(path, "", read_json(path))
    listed = listing.table("files").content
    seeds = listing.table("plan").numbers("seeds", "those of a training")
    if not any(name.startswith("full-") for name in listed):
        arms = [arm.replace("full", "all") for arm in arms]  # as earlier versions called it
    agents = [folder / f"{arm}-{seed:.0f}" for arm in arms for seed in seeds]
    for agent in agents:
        file = agent / "policy.npz"
        sha256 = listed.get(f"{agent.name}/policy.npz")
        if sha256 is None or not file.is_file():
            raise InputError(file, "", "no such agent", f"one of {LISTING}")
        if sha256_of(file) != sha256:
            raise InputError(file, "", "another file", f"the one listed in {LISTING}")
    return agents, tuple(map(int, seeds))
