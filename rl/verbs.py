"""The verb that needs policies, ``forecast``; like ``sim2real.verbs`` it imports nothing heavy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from sim2real.errors import InputError, check_choice, check_whole, names_of
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
    task: Literal["point", "near", "mixed", "chain", "turn", "pentagram"] = "turn",
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
    film: File | None = None,
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
        film: Film to write (.gif, .mp4 or .avi): a good, a median and a bad draw side by side, of
            the policy that is ranked first.
        seed: Seed of everything random.

    Raises:
        InputError: If a policy is of another robot, the ranges are not the model's or have no
            posterior sample, or a file is not what it should be.
    """
    check_whole("forecast", "seed", seed)
    check_whole("forecast", "realities", realities, 20)
    check_whole("forecast", "repeats", repeats, 2)
    check_choice("forecast", "fidelity", fidelity, ("twin", "fluid"))
    from rl.experiments.episodes import FIGURES
    from rl.experiments.testbeds import SimulationSettings
    from rl.forecast.make import make_forecast
    from rl.task import TASKS

    check_choice("forecast", "task", task, TASKS)
    check_choice("forecast", "rank_by", rank_by, FIGURES)
    if seconds is not None and not 0.1 <= seconds <= 600:
        raise InputError("forecast", "seconds", f"{seconds:g}", "0.1 to 600")
    return make_forecast(
        names_of("forecast", "policies", policies),
        robot_of(robot),
        model_of(model),
        Path(ranges),
        diagnosis=None if diagnosis is None else Path(diagnosis),
        recordings=recordings_of(recordings) if recordings else [],
        task=TASKS[task],
        seconds=seconds,
        trials=None if trials is None else Path(trials),
        limits=names_of("forecast", "limit", limit),
        rank_by=rank_by,
        count=(realities, repeats),
        settings=SimulationSettings(fidelity, device, threads, cell_m),
        kept=None if kept is None else Path(kept),
        film=None if film is None else Path(film),
        seed=seed,
        inputs=(robot, model, ranges, diagnosis, trials),
    )
