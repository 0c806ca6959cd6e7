"""``sim2real example``."""

from __future__ import annotations

import argparse

from sim2real.example import copy_example


def run(options: argparse.Namespace) -> int:
    """Copy the recordings and say what to do with them."""
    files = copy_example(options.out)
    bench = options.out / "bench"
    print(f"{options.out}: {len(files)} files, of servos on a bench and of a swim in a pool")
    print(f"next: sim2real identify {bench}/*.csv --robot {bench}/robot.toml --out model.json")
    return 0
