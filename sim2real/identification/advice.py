"""What a user must know about a fit, each in one sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim2real.effects import Effect
from sim2real.identification.control_loop import hidden
from sim2real.identification.fit import Fit, residuals
from sim2real.identification.motor_fit import MotorFit
from sim2real.identification.uncertainty import Uncertainty, uncertainty
from sim2real.inference.folds import rms
from sim2real.recording import PER_INERTIA, Load, Recording
from sim2real.robot import Robot, Servo
from sim2real.servo.parameters import INERTIA_LEFT_OUT
from sim2real.servo.trace import Trace

_SHORT = {
    "kp_Nm_per_rad": "kp",
    "kd_Nms_per_rad": "kd",
    "latency_s": "latency",
    "unmodelled_inertia.inertia_kgm2": "inertia left out",
}
ABOVE_NOISE = 2.0
"""Residuals above so many times the noise have something in them."""
_KEPT = 0.7
"""Share of what was believed of a parameter's spread above which nothing was learned of it."""
_MATERIAL = 0.05
"""Share of the stated inertia below which a difference is left to scales and rulers."""


def on_recordings(recordings: Sequence[Recording], still: Sequence[str]) -> tuple[str, ...]:
    """Notes on joints that do not move and on recordings made in water."""
    notes = [f"{joint} does not move in these recordings and is not identified" for joint in still]
    wet = [recording.name for recording in recordings if recording.medium == "water"]
    if wet:
        notes.append(f"recorded in water ({', '.join(wet)}): drag and added mass hide in the gains")
    return tuple(notes)


def on_fit(
    best: Fit,
    spread: Uncertainty,
    ends: Mapping[str, tuple[float, float]],
    unseen: Sequence[str],
    figures: Mapping[str, float | None],
) -> list[str]:
    """Notes on parameters without influence, open directions, bounds, convergence and misfit."""
    notes = [
        f"{_short(name)} has no influence on these recordings; its value is only a start"
        for name in unseen
    ]
    for direction in dict.fromkeys(spread.open_directions):
        notes.append(_open([_short(best.names[k]) for k in direction]))
    named = {k for direction in spread.open_directions for k in direction}
    for k, name in enumerate(best.names):
        if k not in named and not np.isfinite(ends[name][1]):
            notes.append(f"{_short(name)} cannot be told from above: these recordings set no bound")
    for p in best.at_bound:
        if p.name.startswith("motor.") and p.low == 0:
            continue  # a loss that is not there
        value = best.values[best.names.index(p.name)]
        end = p.low if value - p.low < p.high - value else p.high
        notes.append(f"{_short(p.name)} ended on its bound of {end:g}")
    if not best.converged:
        notes.append("the search did not converge; do not use these values")
    return notes + _on_misfit(figures)


def on_effects(effects: Sequence[Effect], *, shows_inertia: bool) -> list[str]:
    """A note where inertia is to be fitted that no recording can show."""
    if shows_inertia or all(effect.name != "unmodelled_inertia" for effect in effects):
        return []
    return ["unmodelled_inertia cannot show: it takes a pendulum or two known loads"]


def on_data_sheet(robot: Robot, joint: str, needed: Sequence[str]) -> list[str]:
    """A note where the data sheet does not state what the law of a motor needs."""
    known = robot.joint(joint)
    if known is None:
        return []
    missing = " and ".join(name for name in needed if not known.servo.states(name))
    return [
        f"the linear law pd was fitted, as servo {known.servo.name} states no {missing}: from its "
        "data sheet they would bound torque and speed in motions faster than the recorded ones"
    ]


def on_motor(motor: MotorFit, spread: Uncertainty, servo: Servo) -> list[str]:
    """What of the motor the recordings do not tell, and where they contradict the data sheet."""
    values, log = motor.fit.values, motor.log
    sd = np.where(log, spread.sd / np.maximum(values, 1e-300), spread.sd)
    names = [_words(name) for name in motor.fit.names]
    told = motor.moved | (sd < _KEPT * motor.believed_sd)
    kept = [name for name, known in zip(names, told, strict=True) if not known]
    notes = []
    if kept:
        notes.append(f"these recordings do not tell {', '.join(kept)}: they stay as believed")
    unseen = hidden(motor)
    if unseen is not None:
        kp, kd = (float(x) for x in motor.fit.row[:2])
        notes.append(
            "these recordings do not tell a controller that looks in step with their samples from "
            "one that looks all the time, as is believed: looking at "
            f"{1 / unseen.period_s:.0f} Hz it would have kp {unseen.kp:.3g} and not {kp:.3g}, "
            f"kd {unseen.kd:.3g} and not {kd:.3g}; set-points sent at odd times would tell"
        )
    if motor.problem.traces[0].load is PER_INERTIA:
        return notes
    for name, stated in (
        ("motor.stall_torque_Nm", servo.max_torque_Nm),
        ("motor.no_load_speed_rad_s", servo.no_load_speed_rad_s),
    ):
        k = motor.fit.names.index(name)
        away = abs(np.log(values[k] / stated))
        if away > 2 * motor.believed_sd[k] and sd[k] < 0.5 * away:
            notes.append(
                f"{names[k]} is {values[k]:.3g} where the data sheet says {stated:.3g}: is it that "
                "servo, and at that voltage?"
            )
    return notes


def _words(name: str) -> str:
    for unit in ("_Nms_per_rad", "_Nm_per_rad", "_rad_s", "_kgm2", "_Nm", "_s"):
        name = name.removesuffix(unit)
    return name.removeprefix("motor.").replace("_", " ")


def on_inertia(held: Fit, freed: Fit, scored: Sequence[Trace], stated: Load) -> list[str]:
    """A note where the data contradict the stated inertia, as a rotor behind gears makes them.

    It takes an inertia that is clearly not the stated one, and a better fit of held-out data too.
    """
    unit = np.array([*freed.row[:2], 0.05, freed.inertia])
    spread = uncertainty(freed, np.maximum(unit, 1e-9))
    extra, sd = float(freed.row[INERTIA_LEFT_OUT]), float(spread.sd[3])
    before, after = (rms(f.residuals) for f in (held, freed))
    unseen = [rms(residuals(f.row, scored)) for f in (held, freed)]
    clear = abs(extra) > max(3 * sd, _MATERIAL * stated.inertia_kgm2)
    if not clear or after > 0.95 * before or (scored and unseen[1] > unseen[0]):
        return []
    moved = 1e3 * (freed.row[2] - held.row[2])
    return [
        f"the data contradict the stated inertia of {stated.inertia_kgm2:.4g} kg m2: "
        f"{stated.inertia_kgm2 + extra:.4g} fits better (error {1e3 * before:.1f} -> "
        f"{1e3 * after:.1f} mrad) and changes the latency by {moved:+.1f} ms; is a rotor or arm "
        "left out? --effects unmodelled_inertia fits it"
    ]


def _short(name: str) -> str:
    return _SHORT.get(name, name)


def _open(names: list[str]) -> str:
    if len(names) == 1:
        return f"{names[0]} cannot be told from these recordings"
    return f"{' and '.join(names)} cannot be told apart by these recordings"


def _on_misfit(figures: Mapping[str, float | None]) -> list[str]:
    train, noise = figures.get("train"), figures.get("noise")
    white, time = figures.get("whiteness"), figures.get("correlation_time_s")
    if not train or noise is None or white is None or time is None:
        return []
    if train < ABOVE_NOISE * noise or white < 0.5:
        return []
    times = f"{train / noise:.0f} times the noise" if noise > 0 else "where no noise shows"
    return [
        f"the model leaves {1e3 * train:.1f} mrad, {times}, and "
        f"what it leaves is correlated over {1e3 * time:.0f} ms: physics is missing from this model"
    ]
