"""``sim2real identify``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from sim2real.identification.identify import identify
from sim2real.model import Model, write_model
from sim2real.output import check_writable
from sim2real.recording import Recording, read_recording
from sim2real.report.table import fit_report
from sim2real.robot import read_robot
from sim2real.servo.replay import Replay, replay


def run(options: argparse.Namespace) -> int:
    """Identify, print the table, write the model and a plot of each joint."""
    check_writable(options.out)
    robot = read_robot(options.robot)
    recordings = [read_recording(path) for path in options.recordings]
    model = identify(
        recordings,
        robot,
        held_out=options.held_out,
        effects=options.effects,
        law=options.law,
        together=options.together,
        seed=options.seed,
        progress=lambda joints: tqdm(joints, desc="identify", unit="joint", disable=None),
    )
    print(fit_report(model))
    write_model(model, options.out)
    if not options.no_plots:
        _plot(model, recordings, options.held_out, options.out)
    return 0


def _plot(model: Model, recordings: Sequence[Recording], held_out: str | None, out: Path) -> None:
    """One picture a joint: of the recording held out, or of the first."""
    try:
        from sim2real.report import fit_figure, save_png
    except ModuleNotFoundError as error:
        print(f"no plots: {error}", file=sys.stderr)
        return
    for joint, one in most_telling(replay(model, recordings, held_out)).items():
        noise = model.fit[f"{joint}.position_rad"].get("noise")
        figure = fit_figure(
            one.recording, joint, one.predicted, heldout=one.held_out, noise_rad=noise
        )
        save_png(figure, out.with_name(f"{out.stem}.{joint}.png"))


def most_telling(replays: Sequence[Replay]) -> dict[str, Replay]:
    """For each joint the replay of which the fit saw least."""
    best: dict[str, Replay] = {}
    for one in replays:
        if one.joint not in best or one.held_out.mean() > best[one.joint].held_out.mean():
            best[one.joint] = one
    return best
