"""A forecast from files: what is known is read and checked, then policies swim."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from rl.controllers import Controller
from rl.deploy.policy import PolicyController
from rl.experiments.episodes import FIGURES
from rl.experiments.named import controller_of, shown, with_price
from rl.experiments.testbeds import SimulationSettings
from rl.forecast.diagnosed import read_diagnosed
from rl.forecast.forecast import Forecast, limit_of
from rl.forecast.realities import Realities, check_ranges, draw_realities, residuals_of, sample_of
from rl.forecast.swims import Forecaster
from rl.forecast.trials import read_trials
from rl.sac.plan import RECIPES
from rl.task import CONTROL_S, Task
from sim.view.video import check_video
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.output import provenance
from sim2real.progress import progress_bar
from sim2real.ranges.entry import read_ranges
from sim2real.recording import Recording
from sim2real.robot import Robot


def make_forecast(
    policies: Sequence[str],
    robot: Robot,
    model: Model,
    ranges_file: Path,
    *,
    diagnosis: Path | None,
    recordings: Sequence[Recording],
    task: Task,
    seconds: float | None,
    trials: Path | None,
    limits: Sequence[str],
    rank_by: str,
    count: tuple[int, int],
    settings: SimulationSettings,
    kept: Path | None,
    film: Path | None,
    seed: int,
    inputs: Sequence[object],
) -> Forecast:
    """The forecast; arguments as for ``rl.verbs.forecast``, ``count`` realities and repeats."""
    if film is not None:
        check_video(film)
    ranges = read_ranges(ranges_file)
    sample = sample_of(ranges, ranges_file)
    check_ranges(ranges, model, ranges_file)
    stated = tuple(limit_of(text) for text in limits)
    controllers = named_controllers(policies, robot)
    weight = RECIPES["default"].energy
    steps = task.steps if seconds is None else round(seconds / CONTROL_S)
    task = replace(task, steps=steps, energy=weight)
    observed = [] if trials is None else read_trials(trials, list(controllers), CONTROL_S * steps)
    diagnosed = None if diagnosis is None else read_diagnosed(diagnosis)
    residuals = residuals_of(recordings, model, robot)
    rng = np.random.default_rng(seed)
    drawn = draw_realities(robot, model, ranges, sample, count[0], rng, diagnosed=diagnosed)
    origin = provenance([*inputs, *recordings, *_files(policies)], seed)
    swimmers = [origin["inputs"][str(path)] for path in _files(policies)]
    key = repr((drawn.digest(residuals), swimmers, robot, task.name, steps, settings))
    forecaster = Forecaster(robot, task, drawn, count[1], seed, settings, residuals)
    with progress_bar("forecast") as progress:
        swum = forecaster.swim(controllers, file=kept, key=key, progress=progress)
    joints = tuple(joint.name for joint in robot.joints)
    made = Forecast(
        robot.name, task.name, tuple(controllers), joints, {name: swum[name] for name in FIGURES},
        drawn.names, drawn.values, swum["paths"], swum["targets"], rank_by, _trained(controllers),
        stated, notes=_notes(model, drawn, bool(residuals)), provenance=origin,
    )  # fmt: skip
    made = made.after(observed) if observed else made
    if film is not None:
        best = made.ranking()[0][0]
        names = three_draws(made, best, settings.at_once)
        forecaster.film(film, names, controllers[best])
    return made


def three_draws(made: Forecast, policy: str, first: int) -> dict[int, str]:
    """A good, a median and a bad one of the ``first`` realities, with what to call them in a film.

    Their first trial is at the 95 %, 50 % and 5 % quantile of the figure that ranks policies.
    """
    measure = FIGURES[made.rank_by]
    values = made.figures[made.rank_by][made.policies.index(policy), :first, 0]
    order = np.argsort(measure.better * values, kind="stable")
    mass = np.cumsum(made.weights[order])
    places = np.searchsorted(mass, mass[-1] * np.array([0.95, 0.5, 0.05]))
    kinds = zip(order[places], ("good", "median", "bad"), strict=True)
    return {int(d): f"{kind}: {measure.label} {values[d]:{measure.digits}}" for d, kind in kinds}


def named_controllers(
    policies: Sequence[str], robot: Robot
) -> dict[str, Callable[[int], Controller]]:
    """Functions from a number of robots to controllers, by the names that are shown.

    Raises:
        InputError: If there is none, two have one name, or a policy is of another robot.
    """
    limits = [joint.limits_rad for joint in robot.joints]
    joints = tuple(joint.name for joint in robot.joints)
    out: dict[str, Callable[[int], Controller]] = {}
    for name in dict.fromkeys(policies):
        controller = controller_of(name, limits, 1)
        if isinstance(controller, PolicyController):
            policy = controller.policy
            if tuple(policy.joints) != joints:
                found = f"a policy of {', '.join(policy.joints)}"
                raise InputError(name, "joints", found, f"{', '.join(joints)} of {robot.name}")
            if not np.allclose(np.array([policy.low, policy.high]).T, limits, atol=1e-3):
                ends = zip(policy.low, policy.high, strict=True)
                found = ", ".join(f"{low:.3g} to {high:.3g}" for low, high in ends)
                raise InputError(name, "limits", f"{found} rad", f"the limits of {robot.name}")
        label = shown(name)
        label = name if label in out else label
        out[label] = partial(controller_of, name, limits)
    if not out:
        raise InputError("forecast", "policies", "none", "at least one policy")
    return out


def _trained(
    controllers: Mapping[str, Callable[[int], Controller]],
) -> dict[str, dict[str, list[float]]]:
    """What learned policies state of the robots that they were trained with."""
    made = {name: make(1) for name, make in controllers.items()}
    return {
        name: controller.policy.provenance.get("trained_over", {})
        for name, controller in made.items()
        if isinstance(controller, PolicyController)
    }


def _files(policies: Sequence[str]) -> list[Path]:
    """The policies that are files."""
    return [path for name in policies if (path := Path(with_price(name)[0])).exists()]


def _notes(model: Model, drawn: Realities, recorded: bool) -> tuple[str, ...]:
    notes = []
    if "twin" not in model.body:
        notes.append("the body is not calibrated: its law is as uncertain as that of any robot")
    elif not {"posterior", "interval"} & model.body.keys():
        notes.append("the body's calibration states no uncertainty: it counts as exact")
    if not recorded and not drawn.unexplained.any():
        notes.append("the model states no error of its fit: trials are not disturbed")
    return tuple(notes)
