"""Commands on recordings of servos: ``example``, ``check``, ``identify``, ``predict``, ``ranges``.

Also ``density`` and ``completion``.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from sim2real import verbs
from sim2real.commands.command import arguments_of
from sim2real.commands.files import check_written, save_plot, write_views
from sim2real.errors import InputError, if_installed, library
from sim2real.model import Model, read_model, write_model
from sim2real.output import beside, check_writable, is_stream
from sim2real.recording import read_commands, write_recording
from sim2real.robot import read_robot, with_density
from sim2real.servo.prediction import Prediction, Replay, replay
from sim2real.viewers.scenes import Scene, with_prediction

POSTERIOR = "posterior.npz"


def example(options: argparse.Namespace) -> int:
    """Copy the recordings and say what to do with them."""
    from sim2real.example import copy_example

    files = copy_example(options.out)
    bench = options.out / "bench"
    print(f"{options.out}: {len(files)} files, of servos on a bench and of a swim in a pool")
    print(f"next: sim2real identify {bench}/*.csv --robot {bench}/robot.toml --out model.json")
    return 0


def check(options: argparse.Namespace) -> int:
    """Print the check of each recording; status 2 if one of them would not be fitted."""
    checks = verbs.check(**arguments_of(verbs.check, options))
    options.result = list(checks)
    print(f"{checks}\n")
    refused = any(finding.severity == "error" for finding in checks.all_findings)
    return 2 if refused else 0


def identify(options: argparse.Namespace) -> int:
    """Identify, print the table, write the model and a plot of each joint."""
    check_written(options)
    robot, recordings = read_robot(options.robot), verbs.recordings_of(options.recordings)
    given = arguments_of(verbs.identify, options, recordings=recordings, robot=robot)
    model = verbs.identify(**given)
    write_model(model, options.out)
    print(model)
    replays = cache(lambda: replay(model, recordings, options.held_out))
    if not options.no_plots:
        with if_installed("plots"):
            _plot(model, replays, options.out)
    write_views(
        options,
        lambda: sum(
            (with_prediction(r.recording, r.joint, r.predicted) for r in replays()), start=Scene()
        ),
    )
    return 0


def _plot(model: Model, replays: Callable[[], Sequence[Replay]], out: Path) -> None:
    """One figure per joint: of the held-out recording, or of the first."""
    from sim2real.report.drawing import save_png
    from sim2real.report.series import fit_figure

    for joint, shown in most_held_out(replays()).items():
        noise = model.fit[f"{joint}.position_rad"].get("noise")
        figure = fit_figure(shown.recording, joint, shown.predicted, shown.held_out, noise)
        save_png(figure, beside(out, f"{out.stem}.{joint}.png"))


def most_held_out(replays: Sequence[Replay]) -> dict[str, Replay]:
    """For each joint the replay with the largest share of held-out samples."""
    best: dict[str, Replay] = {}
    for shown in replays:
        if shown.joint not in best or shown.held_out.mean() > best[shown.joint].held_out.mean():
            best[shown.joint] = shown
    return best


def predict(options: argparse.Namespace) -> int:
    """Write the commands with the predicted angles as a recording."""
    check_written(options)
    model = verbs.model_of(options.model)
    commands = read_commands(options.commands)
    prediction = verbs.predict(commands, None, model)
    source = f"Simulated, not measured: {options.model.name} on {options.commands.name}."
    write_recording(prediction.recording(source=source), options.out)
    write_views(options, lambda: _predicted(options.commands, prediction))
    print(f"{options.out}: {commands.t.size} rows, {len(commands.joints)} joints")
    return 0


def _predicted(file: Path, prediction: Prediction) -> Scene:
    """The commands and the prediction, and what was measured if the file is a recording."""
    (shown,) = verbs.recordings_of(file, or_commands=True)
    columns = enumerate(prediction.recordings[0].joints)
    scenes = [with_prediction(shown, joint, prediction.angles[0][:, j]) for j, joint in columns]
    return sum(scenes, start=Scene())


def density(options: argparse.Namespace) -> int:
    """Print the table; write the model and the plot if requested."""
    check_written(options)
    if (options.model is None) != (options.out is None):
        missing, partner = ("--out", "--model") if options.out is None else ("--model", "--out")
        raise InputError(missing, "", "nothing", f"a file, to go with {partner}")
    found = verbs.density(options.robot)
    if options.out is not None:
        write_model(with_density(read_model(options.model), found), options.out)
    options.result = found
    print(found)
    save_plot(found, options.plot)
    return 0


def latency(options: argparse.Namespace) -> int:
    """Print the causes; write their ranges and the plot if requested."""
    from sim2real.ranges.entry import write_ranges

    check_written(options)
    found = verbs.latency(**arguments_of(verbs.latency, options))
    if options.out is not None:
        write_ranges(found.ranges, options.out)
    options.result = found
    print(found)
    save_plot(found, options.plot)
    return 0


def ranges(options: argparse.Namespace) -> int:
    """Generate ranges; print them; write them, the posterior sample and a page."""
    from sim2real.posterior.posteriors import joint_sample, write_sample
    from sim2real.ranges.entry import write_ranges

    out = check_writable(options.out)
    gathered = verbs.ranges(**arguments_of(verbs.ranges, options, chains=out))
    if gathered.posteriors and not is_stream(out):
        gathered = replace(gathered, ranges=replace(gathered.ranges, posterior=POSTERIOR))
        sample = joint_sample(gathered.posteriors, np.random.default_rng(options.seed))
        write_sample(sample, out.with_name(POSTERIOR), gathered.ranges.interval_level)
    write_ranges(gathered.ranges, out)
    print(gathered)
    if options.no_page:
        return 0
    with if_installed("page"):
        from sim2real.report.page import write_page
        from sim2real.report.ranges import posterior_section, ranges_section

        page = beside(out, f"{out.stem}.html")
        sections = [ranges_section(gathered)]
        sections += [posterior_section(gathered, joint) for joint in gathered.posteriors]
        name = read_robot(options.robot).name if options.robot else "a type of servo"
        title = f"Randomization ranges of {name}"
        subtitle = f"{len(gathered.ranges.entries)} parameters, each from data"
        write_page(page, title, subtitle, sections, gathered.ranges.provenance)
        print(f"\npage: {page}")
    return 0


def completion(options: argparse.Namespace) -> int:
    """Print the completion script of a shell, with file names for options that take files."""
    from sim2real.cli import parser

    shtab = library("shtab", "completion")
    root = parser()
    several = [a for a in root._actions if isinstance(a, argparse._SubParsersAction)]
    for command in (command for action in several for command in action.choices.values()):
        for action in command._actions:
            if action.type is Path:
                action.complete = shtab.FILE
    print(shtab.complete(root, shell=options.shell))
    return 0
