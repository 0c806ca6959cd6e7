"""The ranges part of a report: every range, and what it comes from."""

from __future__ import annotations

from sim2real.posterior.convergence import LEAST_TIMES
from sim2real.posterior.predictive_check import LEVELS
from sim2real.ranges.gather import Gathered
from sim2real.report.corner_plot import corner_figure
from sim2real.report.drawing import svg
from sim2real.report.page import Block, Figure, Note, Section, Table, Text
from sim2real.report.quantity import milliradians, printable
from sim2real.report.range_plots import density_figure, latency_figure, predictive_figure
from sim2real.report.style import NARROW
from sim2real.units import readable_name

_LEAD = (
    "How far the real robot may be from its simulator, parameter by parameter. A policy that is "
    "trained over these ranges meets the real robot as one of many. Each number comes from data; "
    "the last column says from which."
)
_TABLE = (
    "What each parameter is drawn from: low to high of a uniform distribution, or mean ± standard "
    "deviation of a normal one; once an episode, or anew at every step. Fixed: the model "
    "has a value but no interval."
)
_LATENCY = (
    "Latency of the commands in each {what}, with two standard errors, all joints together. The "
    "band is the range: the uniform distribution that most likely lies behind them."
)
_DENSITY = (
    "Mass per length of each link over that of the whole robot{whiskers}. The area of a block is "
    "its share of the mass."
)
_CHAIN = (
    "{walkers} walkers made {steps} steps each, {spans:.0f} of the longest autocorrelation time; "
    "{least} are required. {accepted:.0f} % of the moves were accepted. {how}"
)
_EXACT = "The servo was solved in closed form, without time steps."
_STEPS = "The servo was simulated in sub-steps, effects included."
_CORNER = (
    "Posterior of {joint}. On the diagonal each parameter with its median and its 5 % and 95 % "
    "quantiles; below it regions that hold 50, 80 and 95 %."
)
_PREDICTIVE = (
    "{joint} in {recording}, of which nothing here was fitted: how far it was measured from the "
    "median of the predictions, and the band that should hold 95 %, noise included."
)


def ranges_section(found: Gathered) -> Section:
    """Every range with its source, and the figures of latency and density."""
    rows = [
        (
            printable(entry.parameter),
            f"{entry.numbers(3 if entry.distribution == 'normal' else 5)}\n{entry.unit}",
            "fixed" if entry.constant else f"{entry.distribution}\nper {entry.period}",
            printable(entry.source),
        )
        for entry in found.ranges.entries
    ]
    blocks: list[Block] = [Note("warn", printable(note)) for note in found.ranges.notes]
    blocks.append(Table(("parameter", "range", "drawn", "from"), rows, _TABLE))
    if found.ranges.posterior:
        text = (
            f"Ranges forget how parameters go together. {found.ranges.posterior} keeps that: each "
            "row of its sample is one servo set that the recordings allow."
        )
        blocks.append(Text(text))
    if found.latencies is not None and found.spread is not None:
        drawn = latency_figure(found.latencies, found.spread)
        what = "window" if found.latencies.windows else "recording"
        caption = _LATENCY.format(what=what)
        blocks.append(Figure(svg(drawn), caption, svg(drawn, width=NARROW)))
    if found.density is not None:
        drawn = density_figure(found.density)
        whiskers = "" if found.density.sd is None else "; whiskers are 90 % intervals"
        caption = _DENSITY.format(whiskers=whiskers)
        blocks.append(Figure(svg(drawn), caption, svg(drawn, width=NARROW)))
    return Section("Ranges", _LEAD, blocks)


def posterior_sections(found: Gathered) -> list[Section]:
    """For each joint that was sampled: its chain, its corner plot, its predictive check."""
    return [_posterior_section(found, joint) for joint in found.posteriors]


def _posterior_section(found: Gathered, joint: str) -> Section:
    one = found.posteriors[joint]
    mixing = one.convergence
    lead = _CHAIN.format(
        walkers=one.chain.accepted.size,
        steps=mixing.steps,
        spans=mixing.spans,
        least=LEAST_TIMES,
        accepted=100 * mixing.accepted,
        how=_EXACT if one.exact else _STEPS,
    )
    low, middle, high = one.quantiles(0.05, 0.5, 0.95)
    rows = [
        (
            f"{printable(readable_name(prior.name))}\n{prior.unit}",
            f"{middle[k]:.5g}\n{low[k]:.5g} to {high[k]:.5g}",
            str(prior),
            f"{mixing.times[k]:.1f}",
        )
        for k, prior in enumerate(one.priors.each)
    ]
    header = ("parameter", "median\n5 % to 95 %", "prior", "autocorrelation\nsteps")
    blocks: list[Block] = [Table(header, rows)]
    drawn = corner_figure(one, joint)
    blocks.append(Figure(svg(drawn), _CORNER.format(joint=printable(joint))))
    if joint in found.checks:
        blocks += _predictive(found, joint)
    return Section(f"Posterior of {printable(joint)}", lead, blocks)


def _predictive(found: Gathered, joint: str) -> list[Block]:
    check = found.checks[joint]
    shares = ", ".join(f"{100 * check.covered[x]:.0f} %" for x in LEVELS)
    bands = ", ".join(f"{100 * x:.0f}" for x in LEVELS)
    text = (
        f"Predictive check: of {printable(check.recording)}, {shares} lies within the bands that "
        f"should hold {bands} %; the median is off by {milliradians(check.rmse)} (RMSE)."
    )
    drawn = predictive_figure(check, joint)
    caption = _PREDICTIVE.format(joint=printable(joint), recording=printable(check.recording))
    return [
        Note("good" if check.holds else "warn", text),
        Figure(svg(drawn), caption, svg(drawn, width=NARROW)),
    ]
