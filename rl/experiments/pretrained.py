"""Pretrained agents of an ablation, in a form small enough to ship.

A folder holds ``ARM-SEED/policy.npz`` of each agent (only its policy, see ``rl.deploy.policy``),
the ``model.json`` and ``ranges.json`` that they were trained for, and ``agents.json``: the plan,
the SHA-256 of every file and the provenance.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rl.deploy.policy import npz
from rl.experiments.ablation import policy_in
from rl.sac.plan import Arm, Plan
from rl.sac.train import agent_names
from sim.inference.swims import Simulator, Swim, simulated
from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.model import Model, read_model, write_model
from sim2real.output import write_json, write_whole
from sim2real.ranges.entry import Ranges, write_ranges
from sim2real.robot import Robot

LISTING = "agents.json"
MODEL, RANGES, POLICY = "model.json", "ranges.json", "policy.npz"


@dataclass(frozen=True)
class Pretrained:
    """The agents of a folder.

    Attributes:
        folder: The folder.
        model: The calibrated model that they were trained for.
        plan: Plan of their training, see ``Plan.content``.
        seeds: Seeds; each arm has one agent per seed.
    """

    folder: Path
    model: Model
    plan: dict[str, Any]
    seeds: tuple[int, ...]

    def restore(
        self,
        folder: Path,
        robot: Robot,
        arms: Sequence[Arm],
        plan: Plan,
        note: dict[str, Any] | None = None,
    ) -> list[Path]:
        """Return the agents instead of training; same arguments as ``rl.sac.train.train``.

        Args:
            folder: Unused; nothing is written.
            robot: Unused.
            arms: The arms.
            plan: The plan with the seeds.
            note: Unused; the agents have their own provenance.

        Returns:
            The agents' folders: all seeds of the first arm, then those of the next.

        Raises:
            InputError: If an agent is missing, or its file differs from the listed one.
        """
        del folder, robot, note
        listed = _listing(self.folder)["files"]
        names = agent_names(arms, plan.seeds)
        for name in names:
            file = self.folder / name / POLICY
            sha256 = listed.get(f"{name}/{POLICY}")
            if sha256 is None or not file.is_file():
                raise InputError(file, "", "no such agent", f"one of {LISTING}")
            if _sha256(file) != sha256:
                raise InputError(file, "", "another file", f"the one listed in {LISTING}")
        return [self.folder / name for name in names]


def read_pretrained(folder: Path) -> Pretrained:
    """Read the agents of a folder.

    Raises:
        InputError: If it has none, or its listing is incomplete.
    """
    listing = _listing(folder)
    try:
        plan = dict(listing["plan"])
        seeds = tuple(int(seed) for seed in plan["seeds"])
        return Pretrained(folder, read_model(folder / MODEL), plan, seeds)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(folder / LISTING, "", f"{error}", "plan, files, provenance") from None


def write_pretrained(
    folder: Path, agents: Sequence[Path], plan: Plan, model: Model, ranges: Ranges,
    note: dict[str, Any],
) -> Path:  # fmt: skip
    """Write the policies of trained agents, and the model and ranges of their training.

    Args:
        folder: Destination; agents already in it are removed.
        agents: Folders of a training, ``ARM-SEED`` each.
        plan: Plan of their training.
        model: The calibrated model that they were trained for.
        ranges: Ranges that their episodes were drawn from.
        note: Provenance.

    Returns:
        The listing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob(f"*/{POLICY}"):
        shutil.rmtree(old.parent)
    write_model(model, folder / MODEL)
    write_ranges(ranges, folder / RANGES)
    for agent in agents:
        write_whole(folder / agent.name / POLICY, npz(policy_in(agent)))
    names = [MODEL, RANGES, *(f"{agent.name}/{POLICY}" for agent in agents)]
    files = {name: _sha256(folder / name) for name in names}
    content = {"plan": plan.content(), "files": files, "provenance": note}
    return write_json(folder / LISTING, content)


def drift(
    trained: Model, calibrated: Model, swim: Swim, simulator: Simulator, error: Array
) -> float:
    """Difference of two models relative to the held-out error of the newer one.

    Both are simulated on the commands of a recording. The root mean square difference of each
    signal is divided by the held-out error of the newer model; below 1 the recording can hardly
    distinguish the models.

    Args:
        trained: The model that agents were trained for.
        calibrated: The model of the present calibration.
        swim: The recording.
        simulator: The simulator.
        error: Held-out root mean square error of ``calibrated`` in each signal, shape (3 + J,).

    Returns:
        The largest ratio over the signals; infinite if a model cannot be simulated.
    """
    new, old = simulated(swim, [calibrated, trained], simulator)
    ratio = np.sqrt(np.mean((new - old) ** 2, axis=0)) / error
    return float(ratio.max()) if np.isfinite(ratio).all() else float("inf")


def _listing(folder: Path) -> dict[str, Any]:
    path = folder / LISTING
    if not path.is_file():
        raise InputError(path, "", "no such file", "pretrained agents")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(path, "", f"no JSON ({error})", "plan, files, provenance") from None
    if not isinstance(content, dict) or not isinstance(content.get("files"), dict):
        raise InputError(path, "files", "nothing", "the SHA-256 of each agent's file")
    return content


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
