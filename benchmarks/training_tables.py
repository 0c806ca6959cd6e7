"""The tables of reports/training: policies by group, mean and spread over seeds, and controllers.

    python benchmarks/training_tables.py reports/training/fresh/fluid-rand-turn.json [...]

Each file is one that ``sim2real evaluate --out`` or ``benchmarks/energy_curve.py`` has written; a
group is what stands before a policy's seed, as in ``fluid-710/policy.npz``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

HEADER = "| | arrive | time | faces the target | energy | reward |\n|---|---|---|---|---|---|"


def main() -> None:
    """Print a table a file."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("files", type=Path, nargs="+")
    for path in parser.parse_args().files:
        told = json.loads(path.read_text())
        water = told["fidelity"] + (", randomized" if told.get("randomized") else "")
        print(f"\n{path}: {told['task']}, {water}\n\n{HEADER}")
        for name, rows in groups(told["results"]).items():
            print(line(name, rows))


def groups(results: Mapping[str, Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Rows by what is compared: all seeds of a group of policies, or one controller."""
    out: dict[str, list[Mapping[str, Any]]] = {}
    for name, row in results.items():
        out.setdefault(group_of(name) or name, []).append(row)
    return out


def group_of(name: str) -> str:
    """What a policy's seeds have in common in their names; empty where it is no policy."""
    path = Path(name)
    own = path.parent.name if path.stem == "policy" else path.stem
    return own.rsplit("-", 1)[0] if path.suffix in (".zip", ".npz") else ""


def line(name: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """One row of the table."""

    def told(key: str, digits: int, scale: float = 1.0) -> str:
        values = scale * np.array([row[key] if row[key] is not None else np.nan for row in rows])
        spread = f" ± {values.std(ddof=1):,.{digits}f}" if len(rows) > 1 else ""
        return f"{values.mean():,.{digits}f}{spread}".replace(",", " ")

    won = [100 * row["success"] for row in rows]
    many = f"{len(rows)} x " if len(rows) > 1 else ""
    least = f" (least {min(won):.0f})" if min(won) < max(won) else ""
    return (
        f"| {name} | {many}{np.mean(won):.0f} %{least} | {told('time_s', 2)} s "
        f"| {told('faced_target_s', 2)} s | {told('energy', 0)} | {told('reward', 1)} |"
    )


if __name__ == "__main__":
    main()
