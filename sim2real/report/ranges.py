"""Ranges and posteriors: tables, figures and sections of a report."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sim2real.arrays import Array
from sim2real.display import Drawing
from sim2real.posterior.chain import LEAST_TIMES
from sim2real.posterior.servo import LEVELS, ServoPosterior
from sim2real.ranges.entry import Ranges
from sim2real.ranges.gather import Gathered
from sim2real.ranges.latency import Cause, Latencies, LatencySplit
from sim2real.ranges.population import TypeParameter
from sim2real.report.drawing import ACCENT, FAINT, INK, PAPER, RULE, new_figure, svg
from sim2real.report.page import Block, Figure, Note, Section, Table, Text, printable
from sim2real.report.quantity import Quantity, milliradians, quantity_table
from sim2real.report.series import Panel, in_mrad, series_block
from sim2real.robot import Density
from sim2real.units import readable_name
from sim2real.viewers.scenes import MEASURED, SignalGroup

_LEAD = (
    "Ranges of each parameter in which the real robot may differ from its simulator. For a policy "
    "trained over these ranges the real robot is one sample of many. The last column states the "
    "data that each range is derived from."
)
_TABLE = (
    "Distribution of each parameter: low to high of a uniform distribution, or mean ± standard "
    "deviation of a normal one; drawn once per episode or at every step. Fixed: the model "
    "has a value but no interval."
)
_SAMPLES = (
    "Ranges do not represent correlations between parameters. The samples in {file} do: each row "
    "is one consistent set of servo parameters."
)
_LATENCY = (
    "Latency of the commands in each {what}, over all joints, with two standard errors. The band "
    "is the range: the maximum-likelihood uniform distribution."
)
_POPULATION = (
    "Mean over units, and standard deviations between units and between runs of a unit, with "
    "{level:g} % intervals; the ranges above are intervals of a new unit."
)
_BY_UNIT = (
    "Each parameter by unit, with the interval of each model. The line is the mean, the band the "
    "range: a run of a new unit."
)
_DENSITY = (
    "Mass per length of each link over that of the whole robot{whiskers}. The area of a bar is "
    "the link's share of the mass."
)
_CORNER = (
    "Posterior of {joint}. On the diagonal each parameter with its median and its 5 % and 95 % "
    "quantiles; below it regions that contain 50, 80 and 95 %."
)
_PREDICTIVE = (
    "{joint} in {recording}, which was not used by the fit: measured minus median predicted angle, "
    "and the band that should contain 95 % of the samples, including noise."
)
_DRAWN, _BINS, _GRID = 20000, 40, 36
_SHARES = (0.95, 0.8, 0.5)
_INSIDE = ("#e9d9d4", "#d99a89", ACCENT)


def range_blocks(ranges: Ranges) -> list[Block]:
    """Notes, and every range with its source."""
    rows = []
    for x in ranges.entries:
        numbers = f"{x.numbers(3 if x.distribution == 'normal' else 5)} {x.unit}".rstrip()
        drawn = "fixed" if x.constant else f"{x.distribution} per {x.period}"
        rows.append((x.parameter, numbers, drawn, x.source))
    notes = [Note("warn", note) for note in ranges.notes]
    return [Table(("parameter", "range", "drawn", "from"), rows, _TABLE), *notes]


def gathered_blocks(gathered: Gathered) -> list[Block]:
    """Every range with its source and, of a type of servo, mean and spreads of each parameter."""
    blocks = range_blocks(gathered.ranges)
    if gathered.population:
        header = ("parameter", "unit", "mean", "between units", "between runs")
        caption = _POPULATION.format(level=100 * gathered.ranges.interval_level)
        blocks.insert(1, Table(header, [*map(_spreads, gathered.population)], caption))
    return blocks


def _spreads(one: TypeParameter) -> tuple[str, ...]:
    """The row of one parameter: standard deviations in percent of the mean, or in its unit."""
    found, cells = one.components, []
    percent = 100.0 if one.log else 1.0
    for ends, scale in ((found.mean, 1.0), (found.between, percent), (found.within, percent)):
        low, middle, high = (scale * x for x in ends or (0.0, 0.0, 0.0))
        value, low_text, high_text = Quantity("", "", middle, (low, high)).texts
        sign = " %" if one.log and scale > 1 else ""
        cells.append(f"{value}{sign} ({low_text} to {high_text})" if ends else "-")
    joint, _, name = one.name.partition(".")
    return (f"{joint} {readable_name(name)}", one.unit, *cells)


def population_figure(parameters: Sequence[TypeParameter]) -> Drawing:
    """Plot each parameter by unit, with the mean and the range of a new unit as a band."""
    units = list(dict.fromkeys(unit for one in parameters for unit in one.units))
    rows = -(-len(parameters) // 2)
    with new_figure(60 + 150 * rows, "parameters by unit; band: the range of a new unit") as figure:
        panels = figure.subplots(rows, 2, sharex=True, squeeze=False).ravel()
        for axes, one in zip(panels, parameters, strict=False):
            scale, unit = (1e3, "ms") if one.unit == "s" else (1.0, one.unit)
            place = np.array([units.index(unit_name) for unit_name in one.units], dtype=float)
            runs = [one.units[:k].count(unit_name) for k, unit_name in enumerate(one.units)]
            place += 0.12 * np.array(runs)
            low, _, high = one.components.new
            axes.axhspan(scale * low, scale * high, color=ACCENT, alpha=0.16, linewidth=0)
            axes.axhline(scale * one.components.mean[1], color=ACCENT, linewidth=1.0)
            reach = scale * np.abs(one.ends - one.values[:, None]).T
            look: Any = {"fmt": "o", "color": INK, "markersize": 4, "elinewidth": 1.0}
            axes.errorbar(place, scale * one.values, reach, **look)
            name = readable_name(one.name.partition(".")[2])
            axes.set_title(printable(f"{name}, {unit}".rstrip(", ")))
            axes.set_xticks(range(len(units)), [printable(name)[:14] for name in units])
            axes.set_xlim(-0.4, len(units) - 0.4)
        for axes in panels[len(parameters) :]:
            axes.set_visible(False)
    return figure


def ranges_section(gathered: Gathered) -> Section:
    """Every range with its source, and the figures of latency and density."""
    blocks, latencies, density = gathered_blocks(gathered), gathered.latencies, gathered.density
    if gathered.population:
        blocks.append(Figure(svg(population_figure(gathered.population)), _BY_UNIT))
    if gathered.ranges.posterior:
        blocks.append(Text(_SAMPLES.format(file=gathered.ranges.posterior)))
    if latencies is not None:
        caption = _LATENCY.format(what="window" if latencies.windows else "recording")
        blocks.append(Figure(svg(latency_figure(latencies)), caption))
    if density is not None:
        whiskers = "" if density.sd is None else "; whiskers are 90 % intervals"
        blocks.append(Figure(svg(density_figure(density)), _DENSITY.format(whiskers=whiskers)))
    return Section("Ranges", _LEAD, blocks)


def posterior_table(joint: str, posterior: ServoPosterior) -> Table:
    """Median and interval of each parameter."""
    rows = []
    quantiles = posterior.quantiles(*posterior.shares).T
    for prior, (low, middle, high) in zip(posterior.parameters, quantiles, strict=True):
        rows.append((joint, Quantity(readable_name(prior.name), prior.unit, middle, (low, high))))
    caption = f"Medians and {100 * posterior.level:g} % intervals."
    return quantity_table(rows, caption=caption)


def posterior_section(gathered: Gathered, joint: str) -> Section:
    """Chain, corner plot and predictive check of a joint with a posterior."""
    posterior = gathered.posteriors[joint]
    mixing = posterior.chain
    lead = (
        f"{mixing.accepted.size} walkers made {mixing.steps} steps each, "
        f"{mixing.spans:.0f} of the longest autocorrelation time; {LEAST_TIMES} are required. "
        f"{100 * mixing.acceptance:.0f} % of the moves were accepted."
    )
    rows = [
        (readable_name(prior.name), str(prior), f"{time:.1f}")
        for prior, time in zip(posterior.parameters, mixing.times, strict=True)
    ]
    blocks: list[Block] = [
        posterior_table(joint, posterior),
        Table(("parameter", "prior", "autocorrelation\nsteps"), rows),
        Figure(svg(corner_figure(posterior, joint)), _CORNER.format(joint=joint)),
    ]
    if joint not in gathered.checks:
        return Section(f"Posterior of {joint}", lead, blocks)
    check = gathered.checks[joint]
    shares = ", ".join(f"{100 * check.covered[x]:.0f} %" for x in LEVELS)
    bands = ", ".join(f"{100 * x:.0f}" for x in LEVELS)
    text = (
        f"Predictive check: of {check.recording}, {shares} lies within the bands that "
        f"should contain {bands} %; the error of the median is {milliradians(check.rmse)} (RMSE)."
    )
    signals = {
        "2.5 %": check.band[0] - check.median,
        "97.5 %": check.band[1] - check.median,
        MEASURED: check.measured - check.median,
    }
    group = SignalGroup((check.recording, joint, "residual"), "rad", check.t, signals)
    panel = Panel(in_mrad(group), "measured − predicted, mrad")
    caption = _PREDICTIVE.format(joint=joint, recording=check.recording)
    label = f"{joint} in {check.recording}: residual"
    blocks += [
        Note("good" if check.holds else "warn", text),
        series_block([panel], label, caption),
    ]
    return Section(f"Posterior of {joint}", lead, blocks)


def density_section(density: Density) -> Section:
    """Mass, length and normalised density of each link."""
    ends, rows = density.interval, []
    for k, name in enumerate(density.links):
        numbers = (f"{x[k]:.3f}" for x in (density.mass_kg, density.length_m, density.value))
        between = "–" if ends is None else f"{ends[0, k]:.3f} to {ends[1, k]:.3f}"
        rows.append((name, *numbers, between))
    header = ("link", "mass\nkg", "length\nm", "density", "90 % interval")
    unknown = Note("warn", "mass_sd_kg and length_sd_m of the links would give intervals")
    blocks: list[Block] = [Table(header, rows), *([unknown] if ends is None else [])]
    return Section("Normalised density", "", blocks)


def density_figure(density: Density) -> Drawing:
    """Plot each link as a bar, as wide as it is long, whose area is its share of the mass."""
    start = np.cumsum(density.length_m) - density.length_m
    middle = start + density.length_m / 2
    with new_figure(260, "normalised density of each link along the body") as figure:
        axes = figure.subplots()
        axes.bar(start, density.value, density.length_m, align="edge", color=RULE, edgecolor=PAPER)
        axes.axhline(1.0, color=FAINT, linewidth=0.9, linestyle=(0, (4, 3)))
        margin = None if density.interval is None else density.interval[1] - density.value
        look: Any = {"fmt": "o", "color": ACCENT, "markersize": 5, "capsize": 4}
        axes.errorbar(middle, density.value, margin, **look)
        for x, y, name in zip(middle, density.value, density.links, strict=True):
            label = f"{printable(name)}\n{y:.3f}"
            axes.text(x, y / 2, label, ha="center", va="center", color=INK)
        axes.set_title("normalised density; dashed: whole robot")
        axes.set_xlabel("from the nose, m")
        axes.set_ylim(0, 1.15 * float(density.value.max()))
    return figure


_BIASED = 3.0
"""Error of a fit over the noise above which its latency may be biased."""


def latency_split_section(split: LatencySplit) -> Section:
    """A row for each cause, and the latency of each servo."""
    rows = []
    for cause in split.causes:
        low, median, high = (f"{1e3 * x:.1f}" for x in (cause.low_s, cause.median_s, cause.high_s))
        seen = np.isfinite(cause.median_s)
        between = f"{low} to {high}" if seen else "–"
        rows.append((cause.name, median if seen else "–", between, cause.source))
    table = Table(("cause", "median\nms", "90 % interval\nms", "from"), rows)
    joints = split.by_joint_s.items()
    servos = ", ".join(f"{name} {1e3 * x:.1f} ms" for name, x in joints)
    notes = []
    for name, _ in joints:
        fit = split.model.fit.get(f"{name}.position_rad", {})
        error, noise = fit.get("heldout") or fit.get("train") or 0.0, fit.get("noise") or np.inf
        if error > _BIASED * noise:
            text = f"{name}: the fit is {1e3 * error:.1f} mrad off, {error / noise:.0f} times the "
            text += "noise: its latency may be biased (a robot with data sheets adds limits)"
            notes.append(Note("warn", text))
    return Section("Latency", "", [table, Note("info", f"command by joint: {servos}"), *notes])


def latency_split_figure(causes: Sequence[Cause]) -> Drawing:
    """Plot the median and interval of each cause that is seen."""
    with new_figure(180, "latency by cause") as figure:
        axes, seen = figure.subplots(), [one for one in causes if np.isfinite(one.median_s)]
        for number, one in enumerate(seen):
            axes.plot([1e3 * one.low_s, 1e3 * one.high_s], [number] * 2, color=ACCENT, linewidth=6)
            axes.plot(1e3 * one.median_s, number, "o", color=INK, markersize=4)
        axes.set_yticks(range(len(seen)), [one.name for one in seen])
        axes.set_ylim(len(seen) - 0.5, -0.5)
        axes.set_xlim(0.0, 1.05e3 * max(one.high_s for one in seen))
        axes.set_title("latency, ms: median and 90 % interval")
    return figure


def latency_figure(latencies: Latencies) -> Drawing:
    """Plot the latency of each episode with two standard errors, and the range."""
    with new_figure(230, "latency of the commands by episode") as figure:
        axes, drawn = figure.subplots(), latencies.spread
        low, high = (1e3 * (drawn.centre + s * drawn.half_width) for s in (-1, 1))
        axes.axhspan(low, high, color=ACCENT, alpha=0.16, linewidth=0)
        number = np.arange(1, latencies.seconds.size + 1)
        look: Any = {"fmt": "o", "color": INK, "markersize": 4, "elinewidth": 1.0}
        axes.errorbar(number, 1e3 * latencies.seconds, 2e3 * latencies.sd, **look)
        axes.set_title("latency, ms; band: the range")
        axes.set_xlabel("window" if latencies.windows else "recording")
        axes.locator_params(axis="x", integer=True)
        axes.margins(x=0.03)
    return figure


def corner_figure(posterior: ServoPosterior, joint: str) -> Drawing:
    """Plot histograms on the diagonal and, below it, regions that contain 50, 80 and 95 %."""
    F = len(posterior.names)
    units = [prior.unit for prior in posterior.parameters]
    scale = np.array([1e3 if unit == "s" else 1.0 for unit in units])
    values = posterior.values[:: max(1, posterior.values.shape[0] // _DRAWN)] * scale
    ends = np.quantile(values, [0.001, 0.999], axis=0)
    with new_figure(140 + 120 * F, printable(f"posterior of {joint}")) as figure:
        for (row, column), axes in np.ndenumerate(figure.subplots(F, F, squeeze=False)):
            axes.set_visible(column <= row)
            axes.grid(visible=False)
            axes.set_xlim(*ends[:, column])
            if row == column:
                axes.hist(values[:, row], bins=_BINS, range=tuple(ends[:, row]), color=RULE)
                for quantile in np.quantile(values[:, row], [0.05, 0.5, 0.95]):
                    axes.axvline(quantile, color=ACCENT, linewidth=1.0)
                unit = "ms" if units[row] == "s" else units[row]
                label = f"{printable(readable_name(posterior.names[row]))}\n{unit}"
                axes.set_title(label.strip(), color=INK, size=10)
            elif column < row:
                _regions(axes, values[:, [column, row]], ends[:, [column, row]])
            axes.locator_params(nbins=3)
            axes.ticklabel_format(useOffset=False, style="plain")
            axes.tick_params(labelbottom=row == F - 1, labelleft=0 == column < row, labelsize=9)
            axes.tick_params(axis="x", labelrotation=35)
    return figure


def _regions(axes: Any, values: Array, ends: Array) -> None:  # noqa: ANN401 - a panel
    """Fill the smallest regions that contain each share of the draws."""
    from scipy.ndimage import gaussian_filter

    counts, x, y = np.histogram2d(values[:, 0], values[:, 1], bins=_GRID, range=ends.T)
    smooth = gaussian_filter(counts, 1.0)
    order = np.sort(smooth.ravel())[::-1]
    cumulative = np.cumsum(order) / order.sum()
    levels = np.unique([order[np.searchsorted(cumulative, share)] for share in _SHARES])
    middles = [(edges[1:] + edges[:-1]) / 2 for edges in (x, y)]
    colours = _INSIDE[-levels.size :]
    axes.contourf(*middles, smooth.T, levels=[*levels, order[0] + 1], colors=colours)
    axes.set_ylim(*ends[:, 1])
