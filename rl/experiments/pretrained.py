"""Pretrained agents of an ablation, in a form small enough to ship.

A folder holds ``ARM-SEED/policy.npz`` of each agent (only its policy, see ``rl.deploy.forward``),
the ``model.json`` and ``ranges.json`` that they were trained for, and ``agents.json``: the plan,
the SHA-256 of every file and the provenance.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rl.deploy.forward import npz
from rl.experiments.ablation import policy_in
from rl.sac.train import Plan
from sim2real.errors import InputError
from sim2real.model import Model, write_model
from sim2real.output import write_json, write_whole
from sim2real.ranges.entry import Ranges, write_ranges
from sim2real.structured import Fields, read_json

LISTING = "agents.json"
MODEL, RANGES, POLICY = "model.json", "ranges.json", "policy.npz"


@dataclass(frozen=True)
class Pretrained:
    """The agents of a folder, one per arm and seed, and the plan of their training."""

    folder: Path
    plan: dict[str, Any]
    seeds: tuple[int, ...]
    files: dict[str, Any]

    def agents(self, arms: Sequence[str]) -> list[Path]:
        """Folders of the agents: all seeds of the first arm, then those of the next.

        Raises:
            InputError: If an agent is missing, or its file differs from the listed one.
        """
        names = [f"{arm}-{seed}" for arm in arms for seed in self.seeds]
        for name in names:
            file = self.folder / name / POLICY
            sha256 = self.files.get(f"{name}/{POLICY}")
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
    path = folder / LISTING
    if not path.is_file():
        raise InputError(path, "", "no such file", "pretrained agents")
    listing = Fields(path, "", read_json(path))
    files, plan = (dict(listing.table(name).content) for name in ("files", "plan"))
    try:
        return Pretrained(folder, plan, tuple(int(seed) for seed in plan["seeds"]), files)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(path, "plan", f"{error}", "the plan of a training") from None


def write_pretrained(
    folder: Path, agents: Sequence[Path], plan: Plan, model: Model, ranges: Ranges,
    note: dict[str, Any],
) -> Path:  # fmt: skip
    """Write the policies of trained agents, ``ARM-SEED`` each, and their listing.

    Agents already in the folder are removed. ``model`` and ``ranges`` are those of the training.
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


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
