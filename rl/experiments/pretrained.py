"""Agents of an ablation that were trained beforehand, kept small enough to ship.

A folder holds ``ARM-SEED/policy.npz`` of each agent (its policy alone, see ``rl.deploy.forward``),
the ``model.json`` and ``ranges.json`` that they were trained for, and ``agents.json``: the plan,
the SHA-256 of every file and where all of it came from.
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
from numpy.typing import NDArray

from rl.deploy.forward import npz
from rl.experiments.ablation import policy_in
from rl.sac.train import Arm, Plan, agent_names
from sim.inference.swims import Simulator, Swim, simulated
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
        folder: Where they are.
        model: The calibrated model that they were trained for.
        plan: How they were trained, as ``Plan.content`` has it.
        seeds: One agent of each arm for each.
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
        """The agents in place of a training; called as ``rl.sac.train.train``.

        Args:
            folder: Where a training would write; nothing is written.
            robot: The robot.
            arms: The arms.
            plan: Says the seeds.
            note: Provenance, which these agents have of their own.

        Returns:
            The agents' folders: all seeds of the first arm, then those of the next.

        Raises:
            InputError: If there is no such agent, or its file is not the one that was listed.
        """
        del folder, robot, note
        listed = _listing(self.folder)["files"]
        names = agent_names(arms, plan.seeds)
        for name in names:
            file = self.folder / name / POLICY
            known = listed.get(f"{name}/{POLICY}")
            if known is None or not file.is_file():
                raise InputError(file, "", "no such agent", f"one of {LISTING}")
            if _sha256(file) != known:
                raise InputError(file, "", "another file", f"the one listed in {LISTING}")
        return [self.folder / name for name in names]


def read_pretrained(folder: Path) -> Pretrained:
    """The agents of a folder.

    Raises:
        InputError: If it has none, or its listing says too little.
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
    made: dict[str, Any],
) -> Path:  # fmt: skip
    """Keep the policies of trained agents, and what they were trained for.

    Args:
        folder: Where to; agents of before are removed.
        agents: Folders of a training, ``ARM-SEED`` each.
        plan: How they were trained.
        model: The calibrated model that they were trained for.
        ranges: What their episodes were drawn from.
        made: Provenance.

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
    content = {"plan": plan.content(), "files": files, "provenance": made}
    return write_json(folder / LISTING, content)


def drift(
    trained: Model, now: Model, swim: Swim, simulator: Simulator, error: NDArray[np.float64]
) -> float:
    """How far two models are apart, as a share of what the newer one gets wrong anyway.

    Both swim the commands of a recording. The root mean square difference of each signal is
    divided by the newer model's held-out error in it; below 1 agents trained in the one meet in
    the other a robot that the recording can hardly tell from theirs.

    Args:
        trained: The model that agents were trained for.
        now: The model of the present calibration.
        swim: The recording whose commands are swum.
        simulator: What swims them.
        error: Held-out root mean square error of ``now`` in each signal, shape (3 + J,).

    Returns:
        The largest share over the signals; infinite where a model cannot be simulated.
    """
    ours, theirs = simulated(swim, [now, trained], simulator)
    apart = np.sqrt(np.mean((ours - theirs) ** 2, axis=0)) / error
    return float(apart.max()) if np.isfinite(apart).all() else float("inf")


def _listing(folder: Path) -> dict[str, Any]:
    path = folder / LISTING
    if not path.is_file():
        raise InputError(path, "", "no such file", "agents trained beforehand")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(path, "", f"no JSON ({error})", "plan, files, provenance") from None
    if not isinstance(content, dict) or not isinstance(content.get("files"), dict):
        raise InputError(path, "files", "nothing", "the SHA-256 of each agent's file")
    return content


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
