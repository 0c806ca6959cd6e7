"""Figure of measured and predicted position of a joint, the residual and one movement."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sim2real.arrays import Array, Mask
from sim2real.recording import Recording
from sim2real.report.live_plot import Live, Panel, in_mrad
from sim2real.report.quantity import printable
from sim2real.report.series import drawable, isolated_samples, largest_move, segments
from sim2real.report.style import ACCENT, FAINT, INK, MUTED, RULE, house_style, new_figure
from sim2real.viewers.scenes import fit_groups

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def fit_figure(
    recording: Recording,
    joint: str,
    predicted: Array,
    *,
    heldout: Mask | None = None,
    noise_rad: float | None = None,
) -> Figure:
    """Plot the prediction of one joint of a recording.

    Args:
        recording: The recording.
        joint: Name of the joint.
        predicted: Predicted position in rad, shape (T,).
        heldout: Mask of held-out samples, shape (T,).
        noise_rad: Standard deviation of the measurement noise, shown with the residual.

    Returns:
        Three panels: command, measured and predicted position over the whole recording; the
        residual; and 1.5 s around the largest movement. Lines are interrupted at gaps.

    Raises:
        ValueError: If the joint was not recorded or a series has another shape.
    """
    if joint not in recording.joints:
        raise ValueError(f"{recording.name}: no joint {joint!r}")
    for name, series in (("predicted", predicted), ("heldout", heldout)):
        if series is not None and series.shape != recording.t.shape:
            raise ValueError(f"{name}: shape {series.shape}, expected {recording.t.shape}")
    column = recording.joints.index(joint)
    t, command = recording.t, recording.command[:, column]
    measured = recording.position[:, column]
    start, stop = largest_move(t, command, measured)
    zoomed = (t >= start) & (t <= stop)
    with house_style():
        figure = new_figure(540, printable(f"{joint} in {recording.name}: measured and predicted"))
        grid = figure.add_gridspec(3, 1, height_ratios=(2.1, 1.1, 2.1), hspace=0.0)
        overview = figure.add_subplot(grid[0])
        residual = figure.add_subplot(grid[1], sharex=overview)
        close = figure.add_subplot(grid[2])
        _draw_position(overview, t, command, measured, predicted)
        overview.legend(loc="lower right", bbox_to_anchor=(1, 1.02), ncols=3)
        overview.set_title("rad")
        overview.margins(y=0.14)
        overview.tick_params(labelbottom=False)
        _draw_residual(residual, t, measured - predicted, noise_rad)
        _draw_position(
            close, t[zoomed], command[zoomed], measured[zoomed], predicted[zoomed], dots=True
        )
        close.set_title(f"{start:.1f} s to {stop:.1f} s, rad")
        close.set_xlabel("time, s")
        overview.plot(
            [start, stop],
            [0, 0],
            color=INK,
            linewidth=3,
            solid_capstyle="butt",
            clip_on=False,
            zorder=4,
            transform=overview.get_xaxis_transform(),
        )
        if heldout is not None:
            _shade(overview, residual, t, heldout)
    return figure


def fit_live(
    recording: Recording,
    joint: str,
    predicted: Array,
    *,
    heldout: Mask | None = None,
    noise_rad: float | None = None,
) -> Live:
    """The content of ``fit_figure`` to zoom into; arguments as there."""
    position, *residual = fit_groups(recording, joint, predicted)
    runs = [] if heldout is None else segments(heldout)
    shaded = [(float(recording.t[a]), float(recording.t[b])) for a, b in runs]
    band = None if noise_rad is None else 2e3 * noise_rad
    panels = [Panel(position, "rad", shaded)]
    panels += [Panel(in_mrad(x), _residual_title(noise_rad), shaded, band) for x in residual]
    held_out = ", held-out samples shaded" if shaded else ""
    return Live(panels, f"{joint} in {recording.name}{held_out}, and the residual below.")


def _residual_title(noise_rad: float | None) -> str:
    return "measured − predicted, mrad" + ("; band: ± 2 × noise" if noise_rad is not None else "")


def _draw_position(
    axes: Axes, t: Array, command: Array, measured: Array, predicted: Array, *, dots: bool = False
) -> None:
    axes.plot(
        *drawable(t, command), color=FAINT, linewidth=1.0, drawstyle="steps-post", label="command"
    )
    times, values = drawable(t, measured)
    look = {"marker": "o", "markersize": 3.6, "linestyle": "none"} if dots else {"linewidth": 2.1}
    axes.plot(times, values, color=INK, markeredgewidth=0, label="measured", **look)
    if not dots:
        isolated = isolated_samples(values)
        axes.plot(
            times[isolated], values[isolated], "o", color=INK, markersize=1.6, markeredgewidth=0
        )
    axes.plot(*drawable(t, predicted), color=ACCENT, linewidth=1.1, label="predicted")


def _draw_residual(axes: Axes, t: Array, residual: Array, noise_rad: float | None) -> None:
    if noise_rad is not None:
        axes.axhspan(-2e3 * noise_rad, 2e3 * noise_rad, color=ACCENT, alpha=0.16, linewidth=0)
    times, values = drawable(t, 1e3 * residual)
    axes.plot(times, values, color=INK, linewidth=0.8)
    isolated = isolated_samples(values)
    axes.plot(times[isolated], values[isolated], "o", color=INK, markersize=1.4, markeredgewidth=0)
    axes.set_title(_residual_title(noise_rad))


def _shade(top: Axes, bottom: Axes, t: Array, heldout: Mask) -> None:
    for number, (first, last) in enumerate(segments(heldout)):
        for axes in (top, bottom):
            axes.axvspan(t[first], t[last], color=RULE, alpha=0.45, linewidth=0, zorder=0)
        if number == 0:
            top.annotate(
                "held out",
                (t[first], 1),
                xycoords=top.get_xaxis_transform(),
                xytext=(5, -4),
                textcoords="offset points",
                va="top",
                color=MUTED,
            )
