"""``sim2real export-servo``."""

from __future__ import annotations

import argparse
import sys

from sim2real.exporters.genesis import genesis
from sim2real.exporters.isaaclab import isaaclab
from sim2real.exporters.mujoco import mujoco
from sim2real.exporters.plain import plain
from sim2real.exporters.urdf import urdf
from sim2real.model import read_model
from sim2real.output import check_writable, write_whole
from sim2real.robot import read_robot

TARGETS = {
    "mujoco": mujoco,
    "isaaclab": isaaclab,
    "genesis": genesis,
    "urdf": urdf,
    "json": plain,
}


def run(options: argparse.Namespace) -> int:
    """Write the model's actuators for another simulator; print what that simulator lacks."""
    check_writable(options.out)
    robot = read_robot(options.robot) if options.robot else None
    export = TARGETS[options.to](read_model(options.model), robot)
    write_whole(options.out, export.text)
    options.result = {"file": str(options.out), "not_expressed": [*map(str, export.left_out)]}
    print(f"{options.out}: for {options.to}")
    if export.left_out:
        print("not expressed there (the file says so too):")
        sys.stdout.writelines(f"  {line}\n" for line in export.left_out)
    return 0
