"""``sim2real identify``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from sim2real import verbs
from sim2real.commands.verb import arguments_of
from sim2real.commands.views import check_views, write_views
from sim2real.errors import if_installed
from sim2real.model import Model, write_model
from sim2real.output import beside, check_writable
from sim2real.robot import read_robot
from sim2real.servo.prediction import Replay, replay
from sim2real.viewers.scenes import with_prediction
from sim2real.viewers.signal_group import Scene


def run(options: argparse.Namespace) -> int:
    """Identify, print the table, write the model and a plot of each joint."""
    check_writable(options.out)
    check_views(options)
    robot = read_robot(options.robot)
    recordings = verbs.recordings_of(options.recordings)
    model = verbs.identify(
        **arguments_of(verbs.identify, options, recordings=recordings, robot=robot)
    )
    write_model(model, options.out)
    print(model)
    replays = cache(lambda: replay(model, recordings, options.held_out))
    if not options.no_plots:
        with if_installed("plots"):
            _plot(model, replays, options.out)
    write_views(options, lambda: _scene(replays()))
    return 0


def _scene(replays: Sequence[Replay]) -> Scene:
    """Every joint of every recording, with its prediction."""
    scenes = [with_prediction(r.recording, r.joint, r.predicted) for r in replays]
    return sum(scenes, start=Scene())


def _plot(model: Model, replays: Callable[[], Sequence[Replay]], out: Path) -> None:
    """One figure per joint: of the held-out recording, or of the first."""
    from sim2real.report.drawing import save_png
    from sim2real.report.fit_plot import fit_figure

    for joint, shown in most_held_out(replays()).items():
        noise = model.fit[f"{joint}.position_rad"].get("noise")
        figure = fit_figure(
            shown.recording, joint, shown.predicted, heldout=shown.held_out, noise_rad=noise
        )
        save_png(figure, beside(out, f"{out.stem}.{joint}.png"))


def most_held_out(replays: Sequence[Replay]) -> dict[str, Replay]:
    """For each joint the replay with the largest share of held-out samples."""
    best: dict[str, Replay] = {}
    for shown in replays:
        if shown.joint not in best or shown.held_out.mean() > best[shown.joint].held_out.mean():
            best[shown.joint] = shown
    return best
