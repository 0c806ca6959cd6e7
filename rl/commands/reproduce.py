"""``sim2real reproduce``: what the paper shows, each with its figure, on one page."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch

from rl.commands.ablate import make_testbeds, reality_of
from rl.commands.policies import table_line, trajectories
from rl.experiments.episodes import FIGURES, Episodes, measured, summary
from rl.experiments.film import Film, Reel
from rl.experiments.named import controller_of, shown, with_price
from rl.experiments.testbeds import DrawnTrials, SimulationSettings, trials_of
from rl.make import draws_of
from rl.sac.plan import Arm, plan_of
from rl.task import CONTROL_S, TASKS, Task
from sim.view.picture import GRID_M
from sim.view.video import Video, check_video
from sim2real.arrays import Array
from sim2real.errors import InputError, check_whole
from sim2real.model import Model, read_model
from sim2real.output import check_writable, provenance, write_json
from sim2real.ranges.entry import Ranges, read_ranges
from sim2real.recording import read_recording
from sim2real.report.drawing import save_png, svg
from sim2real.report.page import Block, Section, Table, write_page
from sim2real.report.page import Figure as Picture
from sim2real.report.page import Film as Shown
from sim2real.robot import Robot, read_robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Fish(NamedTuple):
    """The robot of the results: its files, and where it swims."""

    robot: Robot
    model: Model
    ranges: Ranges
    settings: SimulationSettings


def run(options: argparse.Namespace) -> int:
    """Make each result in turn; write figures, ``results.json`` and ``index.html``."""
    page = check_writable(options.out / "index.html")
    if options.episodes is not None:
        check_whole("reproduce", "--episodes", options.episodes, 1)
    torch.set_num_threads(1)
    settings = SimulationSettings(options.fidelity, options.device, options.threads, options.cell_m)
    files = read_robot(options.robot), read_model(options.model), read_ranges(options.ranges)
    fish, sections, content = Fish(*files, settings), [], {}
    for name in dict.fromkeys(options.results):
        section, content[name] = RESULTS[name](options, fish)
        sections.append(section)
        print(f"{name}: {section.lead}")
    options.result = content
    inputs = [options.robot, options.model, options.ranges]
    inputs += options.swims if "calibration" in content else []
    inputs += [options.reality] if {"turn", "pentagram"} & content.keys() else []
    if content.keys() - {"calibration", "learning-curves"}:
        usual = [str(_GAITS)] if "pentagram" in content else []
        chosen = [Path(with_price(name)[0]) for name in options.policies or usual]
        inputs += [path for path in chosen if path.exists()]
        inputs += sorted(_best(options.run).glob("policy*.*"))
    note = provenance(inputs, options.seed)
    write_json(options.out / "results.json", {**content, "provenance": note})
    where = f"{fish.robot.name}, in the {options.fidelity}"
    write_page(page, "What the paper shows", where, sections, note)
    print(f"report: {page}")
    return 0


def learning_curves(options: argparse.Namespace, _: Fish) -> tuple[Section, Any]:
    """Return and success against steps, over the seeds of a training (Fig. 4 a)."""
    from rl.sac.checkpoint import curves_figure, read_progress

    folders = _agents(options.run)
    figure = _figure(options, "learning-curves", curves_figure({"policy": folders}))
    last = {folder.name: float(read_progress(folder)["mean_return"][-1]) for folder in folders}
    lead = (
        f"Agents of {options.run}: {len(folders)}. Mean of the last 64 episodes that ended in "
        "training, and its standard deviation over the agents, shaded."
    )
    return Section("Learning curves", lead, [figure]), last


def stages(options: argparse.Namespace, fish: Fish) -> tuple[Section, Any]:
    """Policies kept in a training, between the start zone and the target zone (Fig. 4 b)."""
    from rl.experiments.figures import zones_figure
    from rl.sac.checkpoint import read_progress

    last = int(read_progress(_agents(options.run)[0])["steps"][-1])
    agent = _best(options.run)
    kept = sorted(agent.glob("policy-*.*"), key=_steps)
    trials = DrawnTrials(fish.robot, fish.model, None, options.episodes or 10, fish.settings)
    files = dict(zip("ABCDEFGH", [*kept, _policy(agent)], strict=False))
    controllers = {letter: controller_of(str(file), fish.robot) for letter, file in files.items()}
    swims = trials.run(TASKS["zones"], controllers, options.seed)
    ways = {name: _paths(one) for name, one in swims.items()}
    rows = {name: summary(one, TASKS["zones"]) for name, one in swims.items()}
    notes = {name: f"{_steps(file) or last:,} steps" for name, file in files.items()}
    caption = "Paths of the head; a dot is where a swim ended. Targets are not drawn."
    figure = _figure(options, "stages", zones_figure(ways, notes), caption)
    arrive = ", ".join(f"{100 * row['success']:.0f} % ({name})" for name, row in rows.items())
    lead = (
        f"{trials.episodes} swims of each policy that {agent} kept, from a start in the red zone "
        f"to a target in the green one; there arrive {arrive}."
    )
    table = _table({f"{name}\n{notes[name]}": one for name, one in swims.items()}, "zones")
    return Section("Stages of training", lead, [figure, table]), rows


def calibration(options: argparse.Namespace, fish: Fish) -> tuple[Section, Any]:
    """Recorded swims and their simulation, as functions of time (Fig. 3)."""
    from rl.experiments.figures import compared_figure, compared_signals
    from sim.inference.swims import by_fluid, by_twin, seen, swim_of
    from sim2real.body import values

    swims = [swim_of(read_recording(path), fish.robot) for path in options.swims]
    fluid = {"cell_m": options.cell_m, "device": options.device}
    simulator = by_twin(fish.robot) if options.fidelity == "twin" else by_fluid(fish.robot, **fluid)
    shown, errors = [], {}
    for swim in swims:
        track = simulator([fish.model], swim)
        signals = seen(swim.t, track, [values(fish.model)])[0]
        rows = compared_signals(swim, signals, np.unwrap(track[0, :, 2]))
        shown.append((swim, rows))
        errors[swim.name] = {
            label: float(np.sqrt(np.nanmean(np.square(measured - simulated))))
            for label, (measured, simulated) in rows.items()
        }
    figure = _figure(options, "calibration", compared_figure(shown), "Joint 1 is the foremost.")
    lines = [(name, *(f"{x:#.3g}" for x in row.values())) for name, row in errors.items()]
    table = Table(("swim", *next(iter(errors.values()))), lines, "Root mean square errors.")
    lead = "Measured (red) and simulated (blue, dashed) from the recorded commands."
    return Section("Calibration", lead, [figure, table]), errors


def turn(options: argparse.Namespace, fish: Fish) -> tuple[Section, Any]:
    """The turn by 180 degrees, simulated and in reality, as stills and as a film (Fig. 5)."""
    from rl.experiments.figures import in_step, stills_figure

    check_video(options.out / "turn.mp4")
    policy = (options.policies or [str(_policy(_best(options.run)))])[0]
    task, repeats = TASKS["turn"], options.episodes or 3
    reels = {"simulation": Reel(), "reality": Reel()}
    trials: dict[str, Episodes] = {}
    for name, reel in reels.items():
        (trials[name],) = _swims(options, fish, name, task, [policy], repeats, reel).values()
    ways = [_paths(one)[0] for one in trials.values()]
    rows = {name: summary(one, task) for name, one in trials.items()}
    caption = f"The grid is of {GRID_M:g} m. A swim that has arrived keeps its last picture."
    stills = stills_figure(reels, ways, trials["reality"].targets[0, 0])
    figure = _figure(options, "turn", stills, caption)
    beside = list(in_step(list(reels.values())))
    for file in ("turn.mp4", "turn.gif"):
        with Video(options.out / file) as video:
            for picture in beside:
                video.add(picture)
    shared = min(np.isfinite(way[:, 0]).sum() for way in ways)
    first, second = (way[:shared] for way in ways)
    apart = float(np.sqrt(np.square(first - second).sum(axis=1).mean()))
    lead = (
        f"{shown(policy)} in its simulator and in {options.reality.name}, from the same start: the "
        f"target is 1.5 m behind. In the first trial heads are {100 * apart:.0f} cm apart (RMS)."
    )
    film = Shown((options.out / "turn.gif").read_bytes(), "Film: simulation left, reality right")
    blocks = [figure, film, _table(trials, "turn")]
    return Section("The turn", lead, blocks), {**rows, "apart_m": apart}


def pentagram(options: argparse.Namespace, fish: Fish) -> tuple[Section, Any]:
    """Four controllers at 21 waypoints: paths, time and energy (Fig. 6 and 7)."""
    from rl.experiments.figures import bars_figure

    chosen = options.policies or [str(_policy(_best(options.run))), "pnl", "adrc", str(_GAITS)]
    task, repeats = TASKS["pentagram"], options.episodes or 3
    swims = _swims(options, fish, "reality", task, chosen, repeats)
    caption = "Red: the first trial, with its time; grey: the others, up to four."
    paths = _figure(options, "pentagram", trajectories(swims), caption)
    figures = {name: measured(one, task) for name, one in swims.items()}
    bars = _figure(options, "pentagram-bars", bars_figure(figures))
    rows = {name: summary(one, task) for name, one in swims.items()}
    for name, row in rows.items():
        print(table_line(name, row))
    lead = (
        f"{repeats} trials of each controller in {options.reality.name}, the same starts for all; "
        "the bars are means, the lines standard deviations."
    )
    return Section("The pentagram", lead, [paths, bars, _table(swims, "pentagram")]), rows


RESULTS: dict[str, Callable[[argparse.Namespace, Fish], tuple[Section, Any]]] = {
    "learning-curves": learning_curves, "stages": stages, "calibration": calibration,
    "turn": turn, "pentagram": pentagram,
}  # fmt: skip
"""Results by name, in the paper's order."""
_GAITS = Path("datasets/pool/agents/discrete-cpg/policy.zip")


def _swims(
    options: argparse.Namespace, fish: Fish, where: str, task: Task, policies: Sequence[str],
    repeats: int, reel: Reel | None = None,
) -> dict[str, Episodes]:  # fmt: skip
    """Trials in ``simulation`` or ``reality``, by names shown; a ``reel`` films the first."""
    plan = plan_of(
        {}, seeds=(0,), fidelity=options.fidelity, device=options.device, cell_m=options.cell_m,
        threads=options.threads,
    )  # fmt: skip
    arms = [Arm("policy", draws_of(fish.model, None, fish.robot, options.seed))]
    reality = reality_of(options)
    cell = options.reality_cell_m
    testbeds = make_testbeds(fish.robot, arms, plan, fish.ranges, reality, cell)
    testbed = next(one for one in testbeds if one.name == where)
    steering = [controller_of(name, fish.robot) for name in policies]
    watched = {} if reel is None else {"watcher": partial(Film, reel, name=where)}
    swims = trials_of(testbed.swim, steering, fish.robot, task, repeats, options.seed, **watched)
    return dict(zip(map(shown, policies), swims, strict=True))


def _agents(folder: Path, file: str = "progress.csv") -> list[Path]:
    """Folders of the agents of a training, which have a ``file``."""
    found = sorted({path.parent for path in folder.rglob(file)})
    if not found:
        raise InputError(folder, "", f"no {file}", "a folder of sim2real train")
    return found


def _best(folder: Path) -> Path:
    """The agent that the held-out trials of a training chose, or its first."""
    from sim2real.structured import read_json

    agents, trials = _agents(folder, "policy.*"), folder / "trials.json"
    best = read_json(trials).get("best") if trials.exists() else None
    return next((agent for agent in agents if agent.name == best), agents[0])


def _policy(agent: Path) -> Path:
    """The last policy of an agent."""
    return sorted(agent.glob("policy.*"))[-1]


def _steps(policy: Path) -> int:
    """Steps of training after which a policy was kept, in its name."""
    number = re.fullmatch(r"policy-(\d+)", policy.stem)
    return int(number[1]) if number else 0


def _paths(swims: Episodes) -> list[Array]:
    return [swims.pose[:, e, :2] for e in range(len(swims.steps))]


def _figure(options: argparse.Namespace, name: str, figure: Figure, caption: str = "") -> Block:
    """The figure for the page, also as ``NAME.png``."""
    save_png(figure, options.out / f"{name}.png")
    return Picture(svg(figure), caption)


def _table(swims: Mapping[str, Episodes], task: str) -> Table:
    """Figures of controllers; only the turn has a time at which the target is faced."""
    names = ("time_s", "energy", "reward")
    header = ["controller", "arrives", *(FIGURES[x].label for x in names), "faces the target (s)"]
    cells, columns = [], len(header) - (task != "turn")
    for name, one in swims.items():
        figures = measured(one, TASKS[task])
        row = [name, f"{one.success.sum()} of {len(one.steps)}"]
        row += [_spread(figures[x], FIGURES[x].digits) for x in names]
        cells.append([*row, _spread(one.faced_s(), ".2f")][:columns])
    limit = f"{CONTROL_S * TASKS[task].steps:.0f} s, with the mean power until then"
    caption = f"Means and standard errors. A trial that does not arrive counts with {limit}."
    return Table(header[:columns], cells, caption)


def _spread(values: Array, digits: str) -> str:
    """Mean and standard error of the finite values."""
    if not (known := values[np.isfinite(values)]).size:
        return "-"
    return f"{known.mean():{digits}} ± {known.std() / np.sqrt(known.size):{digits}}"
