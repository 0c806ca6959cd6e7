"""Ship the agents of a quick ablation with the data, for ``sim2real demo``.

    cd datasets/pool
    sim2real ablate --robot robot.toml --model calibrated.json --ranges ranges.json \
        --reality reality.json --quick --first agents/none-*.zip --repeats 12 --out RUN
    python -m benchmarks.demo_agents RUN    # [--out datasets/pool/agents/ablation]

Keeps the policy of each agent, the calibrated model and the ranges that they were trained for, the
plan, and the SHA-256 of all these files and of the inputs.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.harness import ROOT, command_line
from rl.commands.demo import PRETRAINED, QUICK
from rl.deploy.policy import npz
from rl.experiments.ablation import LISTING, PAPER, policy_in
from rl.sac.plan import Plan
from sim2real.errors import InputError
from sim2real.output import provenance, sha256_of, write_json, write_whole
from sim2real.structured import read_json

POOL = ROOT / "datasets" / "pool"
FIRST = sorted((POOL / "agents").glob("*.zip"))
"""The agents that arms start from, trained with no technique."""
SEEDS = 5


def main() -> None:
    """Collect, check, keep."""
    options = command_line(__doc__, "run", out=POOL / PRETRAINED).parse_args()
    plan = replace(QUICK, seeds=tuple(range(SEEDS)))
    agents = trained(options.run / "train", plan)
    files = {"model.json": POOL / "calibrated.json", "ranges.json": POOL / "ranges.json"}
    made = provenance([POOL / "robot.toml", *files.values(), *FIRST], None)
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
    """The agents of a training: all seeds of the first arm, then those of the next.

    Raises:
        InputError: If the training is none, of another plan, or not finished.
    """
    run = folder / "run.json"
    if read_json(run)["plan"] != plan.content():
        raise InputError(run, "plan", "another plan", "that of the demo")
    agents = [folder / f"{arm}-{seed}" for arm in PAPER for seed in plan.seeds]
    for agent in agents:
        if not (agent / "policy.zip").exists():
            raise InputError(agent, "", "no policy.zip", "a training that is finished")
    return agents


if __name__ == "__main__":
    main()
