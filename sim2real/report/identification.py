"""Identification section of a report: parameters, their intervals and errors of the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sim2real.arrays import Array, Mask
from sim2real.model import JointModel, Model
from sim2real.recording import Recording
from sim2real.report.drawing import svg
from sim2real.report.fit_plot import fit_figure, fit_live
from sim2real.report.page import Block, Figure, Note, Section, Table, Text
from sim2real.report.parameter_plot import parameter_figure
from sim2real.report.quantity import Quantity, effect_text, milliradians, quantities
from sim2real.report.response import describe_response
from sim2real.report.style import NARROW

Fit = tuple[Recording, str, Array, Mask | None]

_LEAD = (
    "Each servo is a PD controller with latency: torque = "
    "kp\u00a0(command\u00a0− position) − kd\u00a0velocity, where the command is "
    "delayed by the latency."
)
_TABLE = (
    "Estimates with 90 % intervals below. RMSE is the root mean square error on held-out samples."
)
_MOTOR = "The motor of each servo: estimates with 90 % intervals below."
_GAINS = 4
"""The first quantities of a joint are kp, kd, latency and inertia; those of its motor follow."""
_PARAMETERS = "Estimates and 90 % intervals. Arrow: the interval exceeds the axis or is unbounded."
_FIT = (
    "{joint} in {recording}. Top: the whole recording{shaded}. Middle: residual. Bottom: the "
    "largest movement, marked by the bar at the top."
)


def identification_section(model: Model, fits: Sequence[Fit]) -> Section:
    """Text, tables and figures of an identification.

    Args:
        model: The fitted simulator.
        fits: For each figure the recording, the joint, its predicted position in rad, shape (T,),
            and a mask of held-out samples, shape (T,).
    """
    blocks: list[Block] = [_parameter_table(model)]
    if any(joint.motor for joint in model.joints.values()):
        blocks.append(_motor_table(model))
    blocks += [Note("warn", note) for note in model.notes]
    drawing = parameter_figure(model)
    blocks.append(Figure(svg(drawing), _PARAMETERS, svg(drawing, width=NARROW)))
    for name, joint in model.joints.items():
        blocks += _joint_blocks(model, name, joint)
        blocks += [_fit_block(model, fit) for fit in fits if fit[1] == name]
    return Section("Identification", _LEAD, blocks)


def _parameter_table(model: Model) -> Table:
    table = {name: quantities(joint)[:_GAINS] for name, joint in model.joints.items()}
    columns = list(zip(*table.values(), strict=True))
    # A unit that all joints share is put into the header, to save width.
    shared = [len({quantity.unit for quantity in column}) == 1 for column in columns]
    header = ["joint"]
    for column, one_unit in zip(columns, shared, strict=True):
        header.append(column[0].name + (f"\n{column[0].unit}" if one_unit else ""))
    rows = [
        (
            name,
            *(_cell(q, with_unit=not same) for q, same in zip(row, shared, strict=True)),
            _error_cell(model.fit.get(f"{name}.position_rad", {})),
        )
        for name, row in table.items()
    ]
    return Table((*header, "RMSE\nmrad"), rows, _TABLE)


def _motor_table(model: Model) -> Table:
    """One row per parameter and one column per joint."""
    motors = [
        {quantity.name: quantity for quantity in quantities(joint)[_GAINS:]}
        for joint in model.joints.values()
    ]
    units = {name: quantity.unit for motor in motors for name, quantity in motor.items()}
    rows = [
        (
            f"{name}\n{unit}" if unit else name,
            *(_cell(motor[name], with_unit=False) if name in motor else "–" for motor in motors),
        )
        for name, unit in units.items()
    ]
    return Table(("motor", *model.joints), rows, _MOTOR)


def _cell(quantity: Quantity, *, with_unit: bool) -> str:
    value, low, high = quantity.texts
    if quantity.interval is None:
        below = quantity.origin
    elif quantity.unbounded == "unbounded":
        below = "no bound"
    elif quantity.unbounded:
        below = f"above {low}" if quantity.unbounded == "unbounded above" else f"below {high}"
    else:
        below = f"{low} – {high}"
    return f"{value} {quantity.unit}\n{below}" if with_unit else f"{value}\n{below}"


def _error_cell(figures: Mapping[str, float | None]) -> str:
    train, heldout = figures.get("train"), figures.get("heldout")
    number = milliradians(train if heldout is None else heldout).removesuffix(" mrad")
    return number + ("\ntrain" if heldout is None and train is not None else "")


def _joint_blocks(model: Model, name: str, joint: JointModel) -> list[Block]:
    figures = model.fit.get(f"{name}.position_rad", {})
    sentences = [describe_response(name, joint)]
    sentences += [
        f"The recordings do not bound {quantity.name} ({quantity.unbounded})."
        for quantity in quantities(joint)
        if quantity.unbounded
    ]
    if joint.effects:
        effects = ", ".join(effect_text(effect, joint.interval) for effect in joint.effects)
        sentences.append(f"This does not include the effects of the model: {effects}.")
    sentences.append(_error_sentence(figures))
    notes = [Note("warn", note) for note in joint.notes]
    return [Text(" ".join(filter(None, sentences)), heading=name), *notes]


def _error_sentence(figures: Mapping[str, float | None]) -> str:
    train, heldout, noise = (figures.get(name) for name in ("train", "heldout", "noise"))
    error, which = (train, "the fitted") if heldout is None else (heldout, "held-out")
    if error is None:
        return ""
    sentence = f"The error on {which} samples is {milliradians(error)} (root mean square)"
    if noise:
        sentence += f", {error / noise:.1f} times the noise of {milliradians(noise)}"
    if heldout is not None and train and heldout > 1.5 * train:
        sentence += f" and {heldout / train:.1f} times the error on the samples of the fit"
    return sentence + "."


def _fit_block(model: Model, fit: Fit) -> Figure:
    recording, joint, predicted, heldout = fit
    noise = model.fit.get(f"{joint}.position_rad", {}).get("noise")
    figure = fit_figure(recording, joint, predicted, heldout=heldout, noise_rad=noise)
    live = fit_live(recording, joint, predicted, heldout=heldout, noise_rad=noise)
    shaded = ", held-out samples shaded" if heldout is not None and heldout.any() else ""
    caption = _FIT.format(joint=joint, recording=recording.name, shaded=shaded)
    return Figure(svg(figure), caption, svg(figure, width=NARROW), live)
