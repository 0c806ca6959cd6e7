"""The end of ``sim2real demo``: a swim to watch, by what was learned just before."""

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
"""Control periods of the film at most: ten seconds."""
_WIDTH = 480


def swim_section(policy: Path, robot: Robot, model: Model, film: Path, seed: int) -> Section:
    """A turn by 180 degrees in the fluid, where the policy has never been.

    Args:
        policy: Its ``policy.zip``, learned in the twin.
        robot: The robot.
        model: Its calibrated model.
        film: GIF to write; the page has it inside too.
        seed: Of where the turn is.
    """
    task = shortened(TASKS["turn"], LONGEST)
    world = make_world(
        robot, task, Draws((model,)), n_envs=1, fidelity="fluid", seed=seed, threads=2
    )
    name = "learned in the twin, swims in the fluid"
    limits = [joint.limits_rad for joint in robot.joints]
    with Video(film) as video, Film(video, world, name, width=_WIDTH) as watch:
        swum = run_episodes(world, controller_of(str(policy), limits, 1), watch=watch)
    took = float(swum.time_s[0])
    if np.isfinite(took):
        said = f"It arrives after {took:.1f} s."
    else:
        said = f"It has not arrived after {LONGEST / 50:.0f} s."
    lead = (
        "Of the agents with all techniques the one that did best in simulation is to turn by 180° "
        "and swim to a target behind it, in lattice-Boltzmann water with cells of 2 cm. It has "
        "been trained in the twin alone. "
    )
    caption = "From above: the robot, its way, the target, and the vorticity of the water near it."
    alt = "Film of the simulated fish as it turns and swims to a target, seen from above"
    return Section("A swim", lead + said, [Shown(film.read_bytes(), alt, caption)])
