"""``sim2real export-servo``."""

from __future__ import annotations

import argparse

from sim2real.commands.hand_over import hand_over
from sim2real.exporters.genesis import genesis
from sim2real.exporters.isaaclab import isaaclab
from sim2real.exporters.mujoco import mujoco
from sim2real.exporters.plain import plain
from sim2real.exporters.urdf import urdf
from sim2real.model import read_model
from sim2real.output import check_writable
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
    return hand_over(export, options)
