"""``sim2real export``: a trained policy for NumPy, C or ONNX."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim2real.errors import InputError
from sim2real.output import check_writable

ENDINGS = {".npz": "npz", ".h": "c", ".onnx": "onnx"}


def run(options: argparse.Namespace) -> int:
    """Write a policy in each format asked for."""
    out: Path = check_writable(options.out)
    if not options.format and out.suffix not in ENDINGS:
        ending = f"the ending {out.suffix!r}" if out.suffix else "no ending"
        raise InputError(out, "--out", ending, f"{', '.join(ENDINGS)}, or --format")
    formats = tuple(dict.fromkeys(options.format or [ENDINGS[out.suffix]]))
    from rl.deploy.export import read_zip, write_policy

    policy = read_zip(options.policy, seed=options.seed, price=options.price)
    for file in write_policy(policy, out, formats):
        print(f"{file}: {len(policy.observation)} in, {len(policy.joints)} angles in rad out")
    return 0
