"""Last stage of ``sim2real demo``: film of a swim of a trained policy."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rl.experiments.evaluate import run_episodes
from rl.experiments.film import Film
from rl.experiments.named import controller_of
from rl.make import make_world
from rl.task import TASKS, shortened
from rl.world import Draws
from sim.view.video import Video
from sim2real.model import Model
from sim2real.report.page import Film as Shown
from sim2real.report.page import Section
from sim2real.robot import Robot

LONGEST = 500
"""Longest film in control periods: ten seconds."""
_WIDTH = 480


def swim_section(policy: Path, robot: Robot, model: Model, film: Path, seed: int) -> Section:
    """A turn by 180 degrees in the fluid, which the policy was not trained in.

    Args:
        policy: ``policy.zip`` or ``policy.npz``, trained in the twin.
        robot: The robot.
        model: Its calibrated model.
        film: GIF to write; the page embeds it as well.
        seed: Seed of the start and the target.
    """
    task = shortened(TASKS["turn"], LONGEST)
    world = make_world(
        robot, task, Draws((model,)), n_envs=1, fidelity="fluid", seed=seed, threads=2
    )
    name = "trained in the twin, tested in the fluid"
    limits = [joint.limits_rad for joint in robot.joints]
    with Video(film) as video, Film(video, world, name, width=_WIDTH) as watch:
        trial = run_episodes(world, controller_of(str(policy), limits, 1), watch=watch)
    time_s = float(trial.time_s[0])
    if np.isfinite(time_s):
        outcome = f"It arrives after {time_s:.1f} s."
    else:
        outcome = f"It has not arrived after {LONGEST / 50:.0f} s."
    lead = (
        "Of the agents with all techniques, the one with the highest return in simulation turns by "
        "180° and swims to a target behind it, in a lattice-Boltzmann fluid with cells of 2 cm. "
        "It was trained in the twin only. "
    )
    caption = (
        "From above: the robot, its path, the target, and the vorticity of the water around it."
    )
    alt = "Film of the simulated fish as it turns and swims to a target, seen from above"
    return Section("A swim", lead + outcome, [Shown(film.read_bytes(), alt, caption)])
