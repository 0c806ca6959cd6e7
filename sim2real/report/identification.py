"""Identification section of a report: parameters, their intervals, the response to a step."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.display import Drawing
from sim2real.model import JointModel, Model
from sim2real.recording import Recording
from sim2real.report.drawing import ACCENT, INK, new_figure
from sim2real.report.page import Block, Note, Section, Table, Text, printable
from sim2real.report.quantity import effect_text, milliradians, quantities, quantity_table
from sim2real.report.series import fit_panels, series_block
from sim2real.units import readable_name

Fit = tuple[Recording, str, Array, Mask | None]
_SHADED = (
    " The shaded samples were held out for the stated error; the model that is drawn was then "
    "fitted to them as well."
)

_LEAD = (
    "Each servo is a PD controller with latency: torque = "
    "kp\u00a0(command\u00a0− position) − kd\u00a0velocity, where the command is "
    "delayed by the latency."
)
_WHITE = 0.1
"""Lag-1 autocorrelation below which a residual counts as white."""
_CORRELATED, _MOST_PAIRS = 0.3, 4
_SETTLED = 0.005
"""Overshoot of a step, as a share of it, below which there is hardly one."""


def identification_section(model: Model, fits: Sequence[Fit]) -> Section:
    """Text, tables and plots of ``fits``: recording, joint, predicted rad, held-out mask (T,)."""
    blocks = model_blocks(model)
    for name, joint in model.joints.items():
        figures = model.fit.get(f"{name}.position_rad", {})
        text, noise = describe_response(name, joint), figures.get("noise")
        if joint.effects:
            text += " This does not include the effects of the model."
        error = figures.get("train") if (held := figures.get("heldout")) is None else held
        if error is not None and noise:
            text += f" The error is {error / noise:.1f} times the noise."
        blocks.append(Text(text, heading=name))
        for recording, _, predicted, heldout in (fit for fit in fits if fit[1] == name):
            panels, close_up = fit_panels(recording, name, predicted, heldout, noise)
            label = f"{name} in {recording.name}"
            caption = f"{label}, and the residual below.{_SHADED if panels[0].shaded_s else ''}"
            blocks.append(series_block(panels, label, caption, close_up=close_up))
    return Section("Identification", _LEAD, blocks)


def model_blocks(model: Model) -> list[Block]:
    """Parameters, errors, correlations and effects of a model, and its notes."""
    rows = [(name, q) for name, joint in model.joints.items() for q in quantities(joint)]
    blocks: list[Block] = [quantity_table(rows, level=model.interval_level)] if rows else []
    errors = []
    for signal, figures in model.fit.items():
        shown = milliradians if signal.endswith("position_rad") else _number
        cells = (shown(figures.get(key)) for key in ("train", "heldout", "noise"))
        errors.append((signal.removesuffix(".position_rad"), *cells, _residual(figures)))
    if errors:
        blocks.append(Table(("RMSE", "train", "held out", "noise", "residual"), errors))
    remarks = {name: _remarks(joint) for name, joint in model.joints.items()}
    remarks |= {"supply and link": [effect_text(effect) for effect in model.effects]}
    blocks += [Note("info", f"{name}: {'; '.join(some)}") for name, some in remarks.items() if some]
    notes = [f"{name}: {note}" for name, joint in model.joints.items() for note in joint.notes]
    return [*blocks, *(Note("warn", note) for note in (*notes, *model.notes))]


def joint_blocks(joint: JointModel) -> list[Block]:
    """Parameters, correlations and effects of one servo, which has no name, and its notes."""
    table = quantity_table([("", quantity) for quantity in quantities(joint)])
    header = (*table.header[1:4], "interval", "")
    notes = [Note("info", remark) for remark in _remarks(joint)]
    notes += [Note("warn", note) for note in joint.notes]
    return [Table(header, [row[1:] for row in table.rows]), *notes]


def _number(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.4g}"


def _residual(figures: Mapping[str, float | None]) -> str:
    """Whether the residual is white, the share of outliers, the error without effects."""
    names = ("correlation_time_s", "whiteness", "robust_outliers", "heldout_without_effects")
    time, lag, outliers, plain = map(figures.get, names)
    texts = []
    if lag is not None and abs(lag) < _WHITE:
        texts.append("white")
    elif time is not None:
        texts.append(f"correlated over {1e3 * time:.0f} ms")
    if outliers:
        texts.append(f"{100 * outliers:.2g} % outliers")
    if plain is not None:
        texts.append(f"plain PD: {milliradians(plain)} held out")
    return ", ".join(texts)


def _remarks(joint: JointModel) -> list[str]:
    """The strongest correlations of estimates, and effects."""
    strong = sorted(joint.correlation.items(), key=lambda pair: -abs(pair[1]))[:_MOST_PAIRS]
    pairs = [
        f"{' and '.join(map(readable_name, pair.split(', ')))} {r:+.2f}"
        for pair, r in strong
        if abs(r) > _CORRELATED
    ]
    correlated = [f"correlated {', '.join(pairs)}"] if pairs else []
    return [*correlated, *(effect_text(effect, joint.interval) for effect in joint.effects)]


def parameter_figure(model: Model) -> Drawing:
    """Plot kp, kd and latency: a panel each, a row per joint, intervals up to twice the value."""
    rows = [quantities(joint)[:3] for joint in model.joints.values()]
    with new_figure(62 + 34 * max(1, len(rows)), "kp, kd and latency of each joint") as figure:
        panels = figure.subplots(1, 3, sharey=True)
        for number, axes in enumerate(panels):
            for row, quantity in enumerate(each[number] for each in rows):
                low, high = (quantity.value + side * abs(quantity.value) for side in (-2, 2))
                shown = np.clip(quantity.interval or [quantity.value] * 2, low, high)
                axes.plot(shown, [row, row], color=INK, linewidth=1.2)
                axes.plot(quantity.value, row, "o", color=ACCENT, markersize=5)
                axes.set_title(f"{quantity.name}, {quantity.unit}")
            axes.margins(x=0.1)
        panels[0].set_yticks(range(len(rows)), [printable(name)[:14] for name in model.joints])
        panels[0].set_ylim(len(rows) - 0.4, -0.6)
    return figure


def step_response(joint: JointModel) -> Mapping[str, float]:
    """Response of the PD servo, without further effects, to a small step; empty without stiffness.

    With inertia I and the torque m g l of a horizontal pendulum, w^2 = (kp + m g l) / I, zeta = kd
    / (2 I w) and overshoot exp(-pi zeta / sqrt(1 - zeta^2)) of the step, for small angles (K.
    Ogata, Modern Control Engineering, section 5-3); ``half_time_s`` includes the latency.
    """
    gravity = joint.load.gravity_Nm if joint.load and not joint.per_inertia else 0.0
    stiffness = joint.kp_Nm_per_rad + gravity
    if stiffness <= 0:
        return {}
    from scipy.signal import step  # slow to load; tables of fits do not need it

    frequency = math.sqrt(stiffness / joint.inertia_kgm2)
    damping = joint.kd_Nms_per_rad / (2 * joint.inertia_kgm2 * frequency)
    swing = math.sqrt(max(1 - damping**2, 0.0))
    time = np.linspace(0.0, 4 + 4 * damping, 4001)  # in units of one over the frequency
    _, rise = step(([1.0], [1.0, 2 * damping, 1.0]), T=time)
    first = int(np.argmax(rise >= 0.5))
    half = np.interp(0.5, rise[first - 1 : first + 1], time[first - 1 : first + 1])
    return {
        "natural_frequency_rad_s": frequency,
        "damping_ratio": damping,
        "half_time_s": joint.latency_s + float(half) / frequency,
        "overshoot": math.exp(-math.pi * damping / swing) if swing else 0.0,
    }


def describe_response(name: str, joint: JointModel) -> str:
    """One or two sentences on the response time and settling of ``name``."""
    response = step_response(joint)
    if not response:
        return f"With kp at 0, {name} does not follow its command."
    frequency, damping, half, overshoot = response.values()
    settling = f"it overshoots a step by {100 * overshoot:.0f} %"
    if damping == 0:
        settling = "it oscillates and does not settle"
    elif overshoot < _SETTLED:
        settling = "it hardly overshoots" if overshoot else "it does not overshoot"
    return (
        f"{name} reaches half of a small step {1e3 * half:.0f} ms after it is sent, of which "
        f"{1e3 * joint.latency_s:.0f} ms is latency. Its natural frequency is {frequency:.3g} "
        f"rad/s ({frequency / (2 * math.pi):.2g} Hz) and its damping ratio {damping:.2f}: "
        f"{settling}."
    )
