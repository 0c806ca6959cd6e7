"""Ranges section of a report: every range with its source."""

from __future__ import annotations

from sim2real.posterior.chain import LEAST_TIMES
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
    "Ranges of each parameter in which the real robot may differ from its simulator. For a policy "
    "trained over these ranges the real robot is one sample of many. The last column states the "
    "data that each range is derived from."
)
_TABLE = (
    "Distribution of each parameter: low to high of a uniform distribution, or mean ± standard "
    "deviation of a normal one; drawn once per episode or at every step. Fixed: the model "
    "has a value but no interval."
)
_LATENCY = (
    "Latency of the commands in each {what}, over all joints, with two standard errors. The band "
    "is the range: the maximum-likelihood uniform distribution."
)
_DENSITY = (
    "Mass per length of each link over that of the whole robot{whiskers}. The area of a bar is "
    "the link's share of the mass."
)
_CHAIN = (
    "{walkers} walkers made {steps} steps each, {spans:.0f} of the longest autocorrelation time; "
    "{least} are required. {accepted:.0f} % of the moves were accepted. {how}"
)
_EXACT = "The servo was solved in closed form, without time steps."
_STEPS = "The servo was simulated in sub-steps, effects included."
_CORNER = (
    "Posterior of {joint}. On the diagonal each parameter with its median and its 5 % and 95 % "
    "quantiles; below it regions that contain 50, 80 and 95 %."
)
_PREDICTIVE = (
    "{joint} in {recording}, which was not used by the fit: measured minus median predicted angle, "
    "and the band that should contain 95 % of the samples, including noise."
)


def ranges_section(gathered: Gathered) -> Section:
    """Every range with its source, and the figures of latency and density."""
    rows = [
        (
            printable(entry.parameter),
            f"{entry.numbers(3 if entry.distribution == 'normal' else 5)}\n{entry.unit}",
            "fixed" if entry.constant else f"{entry.distribution}\nper {entry.period}",
            printable(entry.source),
        )
        for entry in gathered.ranges.entries
    ]
    blocks: list[Block] = [Note("warn", printable(note)) for note in gathered.ranges.notes]
    blocks.append(Table(("parameter", "range", "drawn", "from"), rows, _TABLE))
    if gathered.ranges.posterior:
        text = (
            "Ranges do not represent correlations between parameters. The samples in "
            f"{gathered.ranges.posterior} do: each row is one consistent set of servo parameters."
        )
        blocks.append(Text(text))
    if gathered.latencies is not None and gathered.spread is not None:
        drawn = latency_figure(gathered.latencies, gathered.spread)
        unit_name = "window" if gathered.latencies.windows else "recording"
        caption = _LATENCY.format(what=unit_name)
        blocks.append(Figure(svg(drawn), caption, svg(drawn, width=NARROW)))
    if gathered.density is not None:
        drawn = density_figure(gathered.density)
        whiskers = "" if gathered.density.sd is None else "; whiskers are 90 % intervals"
        caption = _DENSITY.format(whiskers=whiskers)
        blocks.append(Figure(svg(drawn), caption, svg(drawn, width=NARROW)))
    return Section("Ranges", _LEAD, blocks)


def posterior_sections(gathered: Gathered) -> list[Section]:
    """Chain, corner plot and predictive check of each joint with a posterior."""
    return [_posterior_section(gathered, joint) for joint in gathered.posteriors]


def _posterior_section(gathered: Gathered, joint: str) -> Section:
    posterior = gathered.posteriors[joint]
    mixing = posterior.convergence
    lead = _CHAIN.format(
        walkers=posterior.chain.accepted.size,
        steps=mixing.steps,
        spans=mixing.spans,
        least=LEAST_TIMES,
        accepted=100 * mixing.accepted,
        how=_EXACT if posterior.problem.exact else _STEPS,
    )
    low, middle, high = posterior.quantiles(0.05, 0.5, 0.95)
    rows = [
        (
            f"{printable(readable_name(prior.name))}\n{prior.unit}",
            f"{middle[k]:.5g}\n{low[k]:.5g} to {high[k]:.5g}",
            str(prior),
            f"{mixing.times[k]:.1f}",
        )
        for k, prior in enumerate(posterior.parameters)
    ]
    header = ("parameter", "median\n5 % to 95 %", "prior", "autocorrelation\nsteps")
    blocks: list[Block] = [Table(header, rows)]
    drawn = corner_figure(posterior, joint)
    blocks.append(Figure(svg(drawn), _CORNER.format(joint=printable(joint))))
    if joint in gathered.checks:
        blocks += _predictive(gathered, joint)
    return Section(f"Posterior of {printable(joint)}", lead, blocks)


def _predictive(gathered: Gathered, joint: str) -> list[Block]:
    check = gathered.checks[joint]
    shares = ", ".join(f"{100 * check.covered[x]:.0f} %" for x in LEVELS)
    bands = ", ".join(f"{100 * x:.0f}" for x in LEVELS)
    text = (
        f"Predictive check: of {printable(check.recording)}, {shares} lies within the bands that "
        f"should contain {bands} %; the error of the median is {milliradians(check.rmse)} (RMSE)."
    )
    drawn = predictive_figure(check, joint)
    caption = _PREDICTIVE.format(joint=printable(joint), recording=printable(check.recording))
    return [
        Note("good" if check.holds else "warn", text),
        Figure(svg(drawn), caption, svg(drawn, width=NARROW)),
    ]
