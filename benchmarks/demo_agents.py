"""Ship the agents that a ``sim2real demo --train`` has trained with the data.

    sim2real demo --train --out build/demo          # some minutes of two cores
    python -m benchmarks.demo_agents build/demo     # [--out datasets/pool/agents/ablation]

Keeps the policy of each of the ablation's agents, the calibrated model and the ranges that they
were trained for, the plan, and the SHA-256 of all these files and of the inputs.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.harness import ROOT, command_line
from rl.commands.demo_pool import PRETRAINED, QUICK, SEEDS, SWIM, agents_in
from rl.deploy.policy import npz
from rl.experiments.ablation import LISTING, PAPER, policy_in
from rl.sac.plan import Plan
from sim2real.errors import InputError
from sim2real.output import provenance, sha256_of, write_json, write_whole

POOL = ROOT / "datasets" / "pool"


def main() -> None:
    """Collect, check, keep."""
    options = command_line(__doc__, "run", out=POOL / PRETRAINED).parse_args()
    plan = replace(QUICK, seeds=tuple(range(SEEDS)))
    agents = trained(options.run / "trained" / "train", plan)
    inputs = [POOL / "robot.toml", POOL / "model.json", POOL / f"{SWIM}.csv"]
    made = provenance([*inputs, *agents_in(POOL)], None)
    files = {
        "model.json": options.run / "calibrated.json",
        "ranges.json": options.run / "ranges.json",
    }
    listing = write_pretrained(options.out, agents, plan, files, made)
    print(f"{listing}: {len(agents)} agents")


def write_pretrained(
    folder: Path,
    agents: Sequence[Path],
    plan: Plan,
    files: Mapping[str, Path],
    made: dict[str, Any],
) -> Path:
    """Write policies and files by name, and their listing with SHA-256; old policies go."""
    for old in folder.glob("*/policy.npz"):
        shutil.rmtree(old.parent)
    kept = {name: write_whole(folder / name, file.read_bytes()) for name, file in files.items()}
    for agent in agents:
        name = f"{agent.name}/policy.npz"
        kept[name] = write_whole(folder / name, npz(policy_in(agent)))
    digests = {name: sha256_of(file) for name, file in kept.items()}
    content = {"plan": plan.content(), "files": digests, "provenance": made}
    return write_json(folder / LISTING, content)


def trained(folder: Path, plan: Plan) -> list[Path]:
    """The agents of a training in two parts: all seeds of the first arm, then those of the next.

    Raises:
        InputError: If the training is none, of another plan, or not finished.
    """
    for run in sorted(folder.glob("part-*/run.json")):
        told = json.loads(run.read_text())["plan"]
        if told != replace(plan, seeds=tuple(told["seeds"])).content():
            raise InputError(run, "plan", "another plan", "that of today's sim2real demo --train")
    return [one_of(folder, f"{arm}-{seed}") for arm in PAPER for seed in plan.seeds]


def one_of(folder: Path, name: str) -> Path:
    """The folder of one agent, in any part."""
    found: Sequence[Path] = sorted(folder.glob(f"part-*/{name}/policy.zip"))
    if len(found) != 1:
        raise InputError(folder, name, f"{len(found)} policies", "one policy.zip in its parts")
    return found[0].parent


if __name__ == "__main__":
    main()
