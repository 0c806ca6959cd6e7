"""Notes on a fit, one sentence each."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from sim2real.effects import named
from sim2real.identification.control_loop import undetected_loop
from sim2real.identification.joint_fit import refitted
from sim2real.identification.priors import MOTOR_SHEET, gains, of_effects
from sim2real.identification.problem import Fit, ServoProblem
from sim2real.identification.search import error_on, first_guess, fit
from sim2real.identification.uncertainty import Uncertainty, uncertainty
from sim2real.inference.least_squares import rms
from sim2real.inference.normal import Z90
from sim2real.inference.parameters import column
from sim2real.noise import ABOVE_NOISE
from sim2real.recording import PER_INERTIA, Load, Recording
from sim2real.robot import Servo
from sim2real.servo.linearised import fastest_visible_rad_s, ringing_rad_s
from sim2real.servo.parameters import INERTIA_LEFT_OUT, LINE, LINE_COLUMNS
from sim2real.servo.trace import Trace, firmware_gain, sensor_noise, traces
from sim2real.units import readable_name


def on_recordings(recordings: Sequence[Recording], still: Sequence[str]) -> tuple[str, ...]:
    """Notes on joints that do not move, recordings in water, and other gains of the firmware."""
    notes = [f"{joint} does not move in these recordings and is not identified" for joint in still]
    wet = [recording.name for recording in recordings if recording.medium == "water"]
    if wet:
        notes.append(f"recorded in water ({', '.join(wet)}): drag and added mass bias the gains")
    gains = {recording.name: firmware_gain(recording) for recording in recordings}
    known = list(dict.fromkeys(gain for gain in gains.values() if gain is not None))
    if len(known) > 1:
        others = ", ".join(f"{gain:g}" for gain in known[1:])
        notes.append(
            f"kp is that of the firmware gain {known[0]:g}; recordings with a gain of {others} "
            "were fitted with kp in proportion to it"
        )
    unknown = ", ".join(name for name, gain in gains.items() if gain is None)
    if known and unknown:
        notes.append(f"{unknown}: no firmware_p_gain is stated, and {known[0]:g} was assumed")
    return tuple(notes)


def on_fit(
    best: Fit,
    spread: Uncertainty,
    ends: Mapping[str, tuple[float, float]],
    without_influence: Sequence[str],
    figures: Mapping[str, float | None],
    warned: bool = False,
) -> list[str]:
    """Notes on parameters without influence, undetermined ones, bounds, convergence and misfit.

    ``ends`` are the intervals of the fitted parameters, by name, ``without_influence`` the columns
    that were not fitted, ``figures`` as of ``Model.fit``; ``warned``: whether there are warnings
    about the recordings, which may explain a misfit.
    """
    notes = [
        f"{readable_name(name)} has no influence on these recordings; "
        "its value is the starting value"
        for name in without_influence
    ]
    for direction in dict.fromkeys(spread.open_directions):
        *names, last = [readable_name(best.names[k]) for k in direction]
        listed = f"{', '.join(names)} and {last}" if names else last
        how = "be determined separately" if names else "be determined"
        notes.append(f"{listed} cannot {how} from these recordings")
    for k, name in enumerate(best.names):
        if k not in spread.undetermined and not np.isfinite(ends[name][1]):
            notes.append(
                f"{readable_name(name)} has no upper bound: these recordings do not constrain it"
            )
    for p, value in zip(best.parameters, best.values, strict=True):
        above, below = value - p.low, p.high - value
        absent = p.name.startswith("motor.") and p.low == 0  # a loss
        if min(above, below) < 1e-6 * (p.high - p.low) and not absent:
            end = p.low if above < below else p.high
            notes.append(f"{readable_name(p.name)} is at its bound of {end:g}")
    if not best.converged:
        notes.append(
            "the search did not converge in its number of evaluations; do not use these values "
            "(--effort multiplies that number)"
        )
    return notes + _misfit(figures, warned)


def _misfit(figures: Mapping[str, float | None], warned: bool) -> list[str]:
    """Notes on errors far above the noise, of the fit and on held-out data."""
    keys = ("train", "heldout", "noise", "whiteness", "correlation_time_s")
    train, held_out, noise, white, time = (figures[key] or 0.0 for key in keys)
    notes = []
    if train > 0 and train >= ABOVE_NOISE * noise:
        times = f"{train / noise:.0f} times the noise" if noise > 0 else "where no noise is visible"
        correlated = f", and is correlated over {1e3 * time:.0f} ms" if white >= 0.5 else ""
        why = "physics is missing from this model"
        if warned:
            why = "see the warnings about the recordings before physics that may be missing"
        elif not correlated:
            why = (
                "single readings or times of samples are wrong, or the noise varies with the speed"
            )
        notes.append(
            f"the residual of the model is {1e3 * train:.1f} mrad, {times}{correlated}: {why}"
        )
    least = max(train, noise)
    if held_out > 4 * least > 0:
        notes.append(
            f"the error on held-out data is {1e3 * held_out:.1f} mrad, {held_out / least:.0f} "
            "times that of the fit: these values do not hold for other motions"
        )
    return notes


def on_ringing(best: Fit, traces: Sequence[Trace]) -> list[str]:
    """A note on a servo that oscillates faster than the recordings can show."""
    found, visible = ringing_rad_s(traces, best.row), fastest_visible_rad_s(traces)
    if found <= visible:
        return []
    found_hz, visible_hz = found / (2 * np.pi), visible / (2 * np.pi)
    return [
        f"the fitted servo oscillates at {found_hz:.3g} Hz, above half the sampling rate of "
        f"{visible_hz:.3g} Hz: kp and kd are not determined by these recordings; sample faster"
    ]


def on_weight(plain: Fit) -> list[str]:
    """A note where the stated weight of a pendulum sets the scale, or the data contradict it.

    They do where the linear servo without the weight leaves less than half of the error; its gains
    are searched from those with it and from smaller ones.
    """
    traces = plain.problem.traces
    load = max((trace.load for trace in traces), key=lambda load: load.gravity_Nm)
    if load.gravity_Nm == 0 or traces[0].varying is not None:
        return []
    pendulum = f"({load.pendulum_mass_kg:g} kg at {load.pendulum_length_m:g} m)"
    starts = np.tile(plain.row, (4, 1))
    starts[:, :2] *= np.geomspace(1.0, 0.01, 4)[:, None]
    level = [replace(trace, load=Load(trace.load.inertia_kgm2)) for trace in traces]
    free = fit(replace(plain.problem, traces=level), starts, rounds=2)
    before, after = rms([plain.error]), rms([free.error])
    if after < 0.5 * before:
        return [
            f"the data contradict the weight of the stated pendulum {pendulum}: without it the "
            f"error of the linear servo is {1e3 * after:.1f} instead of {1e3 * before:.1f} mrad; "
            "check whether its shaft is horizontal and hangs down at 0"
        ]
    return [f"kp, kd and every torque are in proportion to the stated pendulum {pendulum}"]


def on_data_sheet(servo: Servo) -> list[str]:
    """A note where the data sheet does not state what the law of a motor needs."""
    missing = " and ".join(name for name in MOTOR_SHEET if not servo.states(name))
    return [
        f"the linear law pd was fitted, as servo {servo.name} states no {missing}; with "
        "these values of the data sheet, the model also limits torque and speed in faster motions"
    ]


def by_prior(motor: Fit, spread: Uncertainty) -> tuple[str, ...]:
    """Names of the parameters of a motor that have at least 0.7 of their prior's deviation."""
    problem = motor.problem
    prior_sd, nominal = (column(problem.parameters, name) for name in ("prior_sd", "nominal"))
    near = np.abs(motor.x * problem.unit - nominal) <= 2 * prior_sd
    return tuple(compress(motor.names, near & (spread.sd * problem.unit >= 0.7 * prior_sd)))


def on_motor(motor: Fit, spread: Uncertainty, servo: Servo) -> list[str]:
    """Notes on motor parameters that are undetermined or contradict the data sheet."""
    problem, values = motor.problem, motor.values
    prior_sd, sd = column(problem.parameters, "prior_sd"), spread.sd * problem.unit
    names = [readable_name(name) for name in motor.names]
    notes = []
    if undetermined := [readable_name(name) for name in by_prior(motor, spread)]:
        notes.append(f"these recordings do not determine {', '.join(undetermined)}: the prior does")
    loop = undetected_loop(motor)
    if loop is not None:
        period_s, loop_kp, loop_kd = loop
        kp, kd = (float(x) for x in motor.row[:2])
        notes.append(
            "these recordings do not distinguish a control loop that is synchronous with their "
            "samples from a continuous one, which is assumed: at "
            f"{1 / period_s:.0f} Hz kp would be {loop_kp:.3g} instead of {kp:.3g} and "
            f"kd {loop_kd:.3g} instead of {kd:.3g}; set-points sent at irregular times "
            "distinguish them"
        )
    if motor.law == "current_limited":
        stall = float(motor.row[LINE_COLUMNS[0]])
        notes.append(
            f"the torque is limited to {stall:.3g} N m at any speed, as "
            "by the drive's current: the no-load speed of the data sheet is no limit"
        )
    if problem.traces[0].load is PER_INERTIA:
        return notes
    for name, stated in zip(LINE, (servo.max_torque_Nm, servo.no_load_speed_rad_s), strict=True):
        k = motor.names.index(name)
        deviation = abs(np.log(values[k] / stated))
        if deviation > 2 * prior_sd[k] and sd[k] < 0.5 * deviation:
            notes.append(
                f"{names[k]} is {values[k]:.3g}, but the data sheet states {stated:.3g}: check the "
                "type of the servo and the supply voltage"
            )
    return notes


def on_optima(best: Fit, spread: Uncertainty) -> list[str]:
    """A note on the other optimum that differs most, if one fits the recordings as well."""
    half_width = spread.half_width * best.problem.unit
    half_width = np.where(best.problem.log, best.values * np.expm1(half_width), half_width)
    limit = 2.0 if best.problem.ties is not None else spread.least_loss
    apart = best.problem.values(best.as_good(limit)) - best.values
    differs = np.abs(apart) > half_width
    if not differs.any():
        return []
    most = int(differs.sum(axis=1).argmax())
    differences = ", ".join(
        f"{readable_name(best.names[k])} {best.values[k] + apart[most, k]:.3g} "
        f"instead of {best.values[k]:.3g}"
        for k in np.flatnonzero(differs[most])
    )
    return [
        f"another optimum fits these recordings as well, with {differences}; recordings of other "
        "motions, loads or gains distinguish them"
    ]


def on_inertia(fixed: Fit, scored: Sequence[Trace], stated: Load) -> list[str]:
    """A note where the data contradict the stated inertia, for instance because of a geared rotor.

    It requires an inertia that differs significantly and by more than 5 %, as measured ones do, and
    a better fit of held-out data as well.
    """
    free = refitted(fixed.problem.traces, fixed.row, [named("unmodelled_inertia")])
    spread = uncertainty(free, repeating=False)
    extra, sd = float(free.row[INERTIA_LEFT_OUT]), float(spread.sd[3] * free.problem.unit[3])
    before, after = (rms([f.error]) for f in (fixed, free))
    heldout = [error_on(f.row, scored) or 0.0 for f in (fixed, free)]
    significant = abs(extra) > max(3 * sd, 0.05 * stated.inertia_kgm2)
    if not significant or after > 0.95 * before or heldout[1] > heldout[0]:
        return []
    shift = 1e3 * (free.row[2] - fixed.row[2])
    return [
        f"the data contradict the stated inertia of {stated.inertia_kgm2:.4g} kg m2: "
        f"{stated.inertia_kgm2 + extra:.4g} fits better (error {1e3 * before:.1f} -> "
        f"{1e3 * after:.1f} mrad) and changes the latency by {shift:+.1f} ms; a rotor or arm may "
        "be missing from it, --effects unmodelled_inertia fits it"
    ]


def expected_precision(recording: Recording, joint: str, *, seed: int = 0) -> tuple[str, ...]:
    """Parameters of one joint that the recording can and cannot identify, one sentence each.

    From the Fisher information of an approximate PD servo: half-widths of 90 % intervals if the
    joint is a PD servo and the noise is independent.
    """
    moving = traces([recording], joint)
    if not moving:
        return ("nothing can be identified: the joint does not move under command",)
    trace = moving[0]
    start = first_guess(moving, np.random.default_rng(seed))[0]
    inertia, kp = trace.load.inertia_kgm2, float(start[0])
    names, parameters = ["kp", "kd", "latency", "inertia left out"], list(gains(inertia))
    if trace.load is not PER_INERTIA and trace.load.gravity_Nm > 0:  # a pendulum
        parameters += of_effects([named("unmodelled_inertia")], start, inertia)
    problem = ServoProblem(moving, start, tuple(parameters))
    x = problem.searched(start[None])
    _, (slopes,) = problem.slopes(x, rough=False)
    size = problem.unit * np.where(problem.log, problem.values(x)[0], 1.0)
    unit = np.array([kp, max(start[1], 0.4 * np.sqrt(kp * inertia)), 0.05, inertia])[: size.size]
    scaled = slopes / size * unit / sensor_noise([trace])
    level, directions = np.linalg.eigh(scaled.T @ scaled)
    sd = np.sqrt((directions**2) @ (1 / np.maximum(level, 1e-12)))
    precise, units = [], ("N m/rad", "N m s/rad", "ms", "kg m2")
    for k in np.flatnonzero(sd < 1).tolist():
        half = Z90 * sd[k] * unit[k] * (1e3 if k == 2 else 1.0)
        share = 100 * half / start[k] if k < 2 and start[k] > 0 else np.inf
        how = f"{share:.2g} %" if share < 100 else f"{half:.2g} {units[k]}"
        precise.append(f"{names[k]} to {how}")
    per = " per unit of inertia" if trace.load is PER_INERTIA else ""
    sentences = [f"can identify{per}: {', '.join(precise)}"] if precise else []
    open_ones = [names[k] for k in np.flatnonzero(sd >= 1)]
    return (*sentences, f"cannot identify: {', '.join(open_ones)}") if open_ones else (*sentences,)
