"""The page of a forecast."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rl.experiments.ablation_report import picture
from rl.experiments.episodes import FIGURES
from rl.forecast.forecast import Forecast
from sim2real.report.notebook import result_section
from sim2real.report.page import Block, Note, Section, Table, Text, write_page
from sim2real.structured import read_json

_PATHS = (
    "The first trial in twenty realities, with the start at the right and the target at the left; "
    "grey where it is not reached."
)


SEALED = Path(__file__).with_name("sealed.json")
"""Results of 90 % intervals on sets of realities, by ``benchmarks/forecast_realities.py``."""


def worth(sealed: Mapping[str, Any]) -> str:
    """What intervals of forecasts have been worth on sets of simulated realities."""
    parts = []
    for entry in sealed["sets"]:
        names = ("mean time_s", "mean energy", "next time_s", "next energy")
        held = [100 * entry["held"][name] for name in names]
        parts.append(
            "of {} {} they contained the mean time in {:.0f} %, the mean energy in {:.0f} %, the "
            "next trial's in {:.0f} and {:.0f} %".format(entry["realities"], entry["of"], *held)
        )
    return f"What 90 % intervals have been worth: {'; '.join(parts)}. No real robot is among them."


@result_section.register
def _forecast(forecast: Forecast) -> Section:
    """All sections in one, for a terminal or a notebook."""
    first, *others = sections(forecast, plots=False)
    parts = ((Text(one.lead, one.title), *one.blocks) for one in others)
    return Section(first.title, first.lead, [*first.blocks, *(x for part in parts for x in part)])


def write_forecast_page(forecast: Forecast, path: str | os.PathLike[str]) -> None:
    """Write the page: intervals, paths, ranking, what to do next."""
    N = len(forecast.parameters)
    title = f"Forecast of {forecast.robot}"
    subtitle = f"The task “{forecast.task}” in {N} realities that agree with what is known"
    write_page(path, title, subtitle, sections(forecast), forecast.provenance)


def sections(forecast: Forecast, *, plots: bool = True) -> list[Section]:
    """Sections of the page, or those without plots."""
    rows = [(x.policy, FIGURES[x.figure].label, *x.texts) for x in forecast.rows()]
    header = ("policy", "figure", "expected", "mean, 90 % interval", "next trial, 90 %")
    caption = (
        "The interval of the mean is that of many trials of the real robot; that of the next trial "
        "contains the chance of a single one. Trials without arrival count with the full time."
    )
    blocks: list[Block] = [Table(header, rows, caption)]
    blocks += [
        Note("info", f"{policy}: P({limit}) = {forecast.probability(policy, limit):.2f}")
        for policy in forecast.policies
        for limit in forecast.limits
    ]
    blocks.append(Note("info", worth(read_json(SEALED))))
    blocks += [Note("warn", note) for note in forecast.notes]
    if forecast.update is not None:
        kind: Any = "warn" if forecast.update.contradicted else "good"
        blocks.insert(0, Note(kind, forecast.verdict))
    lead = f"{forecast.task} of {forecast.robot} in {len(forecast.parameters)} realities."
    out = [Section("What to expect", lead, blocks)]
    if plots:
        out.append(Section("Paths", _PATHS, [picture(forecast.plot())]))
    if len(forecast.policies) > 1:
        order = [(policy, f"{chance:.2f}") for policy, chance in forecast.ranking()]
        lead = f"By {FIGURES[forecast.rank_by].label}, best first."
        table = Table(("policy", "probability to be the best"), order)
        out.append(Section("Which policy", lead, [table]))
    following = forecast.next_measurements()
    if following:
        narrower = [
            (x.what, x.how, *(f"{100 * y:.0f} %" for y in (x.mean, *x.shrinks.values())))
            for x in following
        ]
        figures = [FIGURES[name].label for name in following[0].shrinks]
        lead = "By how much narrower the intervals of the means are expected to be after it."
        table = Table(("what", "measurement", "mean", *figures), narrower)
        out.append(Section("What to measure next", lead, [table]))
    if ranges := forecast.next_ranges():
        best = forecast.ranking()[0][0]
        lead = (
            f"Parameters by the share of the variance of the {FIGURES[forecast.rank_by].label} of "
            f"{best} between realities that each explains alone. To train over all that the robot "
            "may be, and no more, give the range of the realities to sim2real train --ranges."
        )
        table = Table(("parameter", "share", "realities, 90 %", "training, 90 %", "next training"),
            [(x.parameter, f"{100 * x.share:.0f} %", _range(x.drawn), _range(x.trained), x.advice)
             for x in ranges])  # fmt: skip
        out.append(Section("What to randomize next", lead, [table]))
    return out


def _range(ends: tuple[float, float] | None) -> str:
    if ends is None:
        return "not stated"
    low, high = (f"{x:.3g}" for x in ends)
    return low if low == high else f"{low} to {high}"
