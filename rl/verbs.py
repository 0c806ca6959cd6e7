"""The verb that needs policies, ``forecast``; like ``sim2real.verbs`` it imports nothing heavy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from sim2real.errors import InputError, check_choice, check_whole, names_of
from sim2real.output import provenance
from sim2real.progress import progress_bar
from sim2real.verbs import model_of, recordings_of, robot_of

if TYPE_CHECKING:
    from rl.forecast.forecast import Forecast
    from sim2real.model import Model
    from sim2real.robot import Robot
    from sim2real.verbs import File, Recorded


def forecast(
    policies: Sequence[str],
    robot: Robot | File,
    model: Model | File,
    ranges: File,
    *,
    diagnosis: File | None = None,
    recordings: Recorded = (),
    task: Literal["point", "near", "mixed", "chain", "turn", "zones", "pentagram"] = "turn",
    seconds: float | None = None,
    trials: File | None = None,
    limit: Sequence[str] = (),
    rank_by: Literal["success", "time_s", "energy", "reward", "path_m"] = "reward",
    realities: int = 200,
    repeats: int = 2,
    fidelity: Literal["twin", "fluid"] = "twin",
    device: str = "cpu",
    cell_m: float = 0.02,
    threads: int = 2,
    kept: File | None = None,
    seed: int = 0,
) -> Forecast:
    """Predict what policies will do on the real robot, with intervals.

    Args:
        policies: Policies: policy.zip, policy.zip@0.5 at another price of energy, policy.npz, pnl
            or adrc.
        robot: The robot (robot.toml).
        model: Its servos and body (MODEL.json).
        ranges: Its ranges, with the posterior sample next to them (ranges.json).
        diagnosis: Effects to draw, with their probabilities (diagnosis.json).
        recordings: Swims that the model was calibrated with; what it leaves unexplained of them
            disturbs the forecast's trials. Without them, random signals of that size do.
        task: The task.
        seconds: Longest time of a trial, s; by default that of the task.
        trials: Trials of the real robot (trials.csv: policy, success, and of time_s, energy and
            reward some), which sharpen the forecast or contradict it.
        limit: Limits whose probability is to be stated: time_s<=6 for the next trial,
            time_s<=6@0.95 for 95 % of all.
        rank_by: Figure that several policies are ranked by.
        realities: Number of realities that are drawn.
        repeats: Trials in each.
        fidelity: Simulate in the reduced-order twin or in the fluid.
        device: Device of the simulation, cpu or cuda:0.
        cell_m: Side of a cell of the fluid, in m.
        threads: CPU threads of the simulator.
        kept: File of the trials so far (.npz), so that an interrupted call continues.
        seed: Seed of everything random.

    Raises:
        InputError: If a policy is of another robot, the ranges are not the model's or have no
            posterior sample, or a file is not what it should be.
    """
    check_whole("forecast", "seed", seed)
    check_whole("forecast", "realities", realities, 20)
    check_whole("forecast", "repeats", repeats, 2)
    check_choice("forecast", "fidelity", fidelity, ("twin", "fluid"))
    from rl.deploy.policy import PolicyController
    from rl.experiments.episodes import FIGURES
    from rl.experiments.named import named_controllers, with_price
    from rl.experiments.testbeds import SimulationSettings
    from rl.forecast.forecast import Forecast, limit_of
    from rl.forecast.realities import read_diagnosed, read_realities, residuals_of
    from rl.forecast.swims import Forecaster
    from rl.forecast.trials import read_trials
    from rl.sac.plan import RECIPES
    from rl.task import CONTROL_S, TASKS
    from sim.twin.law import is_calibrated
    from sim2real.ranges.entry import read_ranges

    check_choice("forecast", "task", task, TASKS)
    check_choice("forecast", "rank_by", rank_by, FIGURES)
    if seconds is not None and not 0.1 <= seconds <= 600:
        raise InputError("forecast", "seconds", f"{seconds:g}", "0.1 to 600")
    names = names_of("forecast", "policies", policies)
    fish, known = robot_of(robot), model_of(model)
    stated = tuple(limit_of(text) for text in names_of("forecast", "limit", limit))
    controllers = named_controllers(names, fish)
    steps = TASKS[task].steps if seconds is None else round(seconds / CONTROL_S)
    chosen = replace(TASKS[task], steps=steps, energy=RECIPES["default"].task.energy)
    found = read_trials(Path(trials), list(controllers), CONTROL_S * steps) if trials else []
    diagnosed = None if diagnosis is None else read_diagnosed(diagnosis)
    swims = recordings_of(recordings) if recordings else []
    residuals = residuals_of(swims, known, fish)
    drawn = read_realities(fish, known, Path(ranges), realities, seed, diagnosed)
    files = [path for name in names if (path := Path(with_price(name)[0])).exists()]
    sampled = Path(ranges).with_name(read_ranges(ranges).posterior)
    inputs = [robot, model, ranges, sampled, diagnosis, trials, *swims, *files]
    origin = provenance(inputs, seed)
    learned = [origin["inputs"][str(path)] for path in files]
    settings = SimulationSettings(fidelity, device, threads, cell_m)
    key = repr((drawn.digest(residuals), learned, fish, task, steps, settings))
    forecaster = Forecaster(fish, chosen, drawn, repeats, seed, settings, residuals)
    with progress_bar("forecast") as progress:
        file = None if kept is None else Path(kept)
        swum = forecaster.swim(controllers, file=file, key=key, progress=progress)
    trained = {
        name: one.policy.provenance.get("trained_over", {})
        for name, one in controllers.items()
        if isinstance(one, PolicyController)
    }
    notes = []
    if not is_calibrated(known.body):
        notes.append("the body is not calibrated: its law is as uncertain as that of any robot")
    elif not {"posterior", "interval"} & known.body.keys():
        notes.append("the body's calibration states no uncertainty: it counts as exact")
    if not residuals and not drawn.unexplained.any():
        notes.append("the model states no error of its fit: trials are not disturbed")
    figures = {name: swum[name] for name in FIGURES}
    out = Forecast(
        fish.name, task, tuple(controllers), tuple(joint.name for joint in fish.joints), figures,
        drawn.names, drawn.values, swum["paths"], swum["targets"], rank_by, trained, stated,
        notes=tuple(notes), provenance=origin,
    )  # fmt: skip
    return out.after(found) if found else out
