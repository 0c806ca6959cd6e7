"""``sim2real check``."""

from __future__ import annotations

import argparse

from tqdm import tqdm

from sim2real.check import check
from sim2real.recording import read_recording
from sim2real.robot import read_robot


def run(options: argparse.Namespace) -> int:
    """Print the check of each recording; status 2 if one of them would not be fitted."""
    robot = read_robot(options.robot) if options.robot else None
    paths = tqdm(options.recordings, desc="check", unit="recording", disable=None)
    checks = [check(read_recording(path), robot, seed=options.seed) for path in paths]
    options.result = checks
    print("\n\n\n".join(map(str, checks)) + "\n")
    refused = any(f.severity == "error" for checked in checks for f in checked.all_findings)
    return 2 if refused else 0
