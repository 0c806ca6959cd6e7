"""Display of results in notebooks as sections of a report, with tables and notes.

``result_section`` dispatches on the type of the result; other packages register theirs with it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import singledispatch

from sim2real.check import Check
from sim2real.design.plan import Design
from sim2real.design.tell_apart import RivalDesign
from sim2real.diagnose.result import Diagnosis, percent
from sim2real.model import JointModel, Model
from sim2real.posterior.posteriors import Posteriors
from sim2real.ranges.entry import Range, Ranges
from sim2real.ranges.gather import Gathered
from sim2real.recording import Recording
from sim2real.report.design_plot import design_section
from sim2real.report.page import Block, Note, Section, Table, render_fragment
from sim2real.report.quantity import effect_text, milliradians, printable, quantities
from sim2real.report.rival_plots import rivals_section
from sim2real.report.servo_table import COLUMNS, cells
from sim2real.report.table import span
from sim2real.robot import Density, Robot
from sim2real.servo.prediction import Prediction
from sim2real.servo_library.catalogue import ServoLibrary
from sim2real.servo_library.entry import ServoEntry

NONE = "–"


def result_html(result: object) -> str:
    """A result as an HTML fragment for a notebook.

    Raises:
        ModuleNotFoundError: If Jinja is not installed.
    """
    return render_fragment([result_section(result)])


@singledispatch
def result_section(result: object) -> Section:
    """Tables and notes of a result.

    Raises:
        TypeError: If no function is registered for the type of the result.
    """
    raise TypeError(f"no notebook section for a {type(result).__name__}")


@result_section.register
def _model(model: Model) -> Section:
    rows = [row for name, joint in model.joints.items() for row in _parameters(name, joint)]
    blocks: list[Block] = []
    if rows:
        blocks.append(Table(("joint", "parameter", "value", "unit", "90 % interval"), rows))
    errors = [
        (printable(signal), _number(figures.get("train")), _number(figures.get("heldout")))
        for signal, figures in model.fit.items()
    ]
    if errors:
        blocks.append(Table(("signal", "RMSE, train", "RMSE, held out"), errors))
    notes = [f"{name}: {note}" for name, joint in model.joints.items() for note in joint.notes]
    return Section("Model", "", [*blocks, *_notes([*model.notes, *notes])])


@result_section.register
def _servos(library: ServoLibrary) -> Section:
    rows = [tuple(map(printable, cells(entry))) for entry in library]
    return Section("Servos", "", [Table(COLUMNS, rows)])


@result_section.register
def _servo(entry: ServoEntry) -> Section:
    rows = [tuple(map(printable, cells(entry)))]
    blocks = [Table(COLUMNS, rows), *_model(entry.model).blocks]
    return Section("Servo", "", [*blocks, Note("info", printable(entry.source))])


def _parameters(name: str, joint: JointModel) -> Iterable[tuple[str, ...]]:
    for quantity in quantities(joint):
        value, low, high = quantity.texts
        interval = f"{low} to {high}" if quantity.interval else quantity.origin
        yield printable(name), quantity.name, value, quantity.unit, interval
    for effect in joint.effects:
        yield printable(name), "effect", effect_text(effect, joint.interval), "", ""


@result_section.register
def _design(design: Design) -> Section:
    sections = [design_section(design, joint) for joint in design.joints]
    return Section("Design", "", [block for section in sections for block in section.blocks])


@result_section.register
def _rival_design(design: RivalDesign) -> Section:
    return rivals_section(design)


@result_section.register
def _diagnosis(diagnosis: Diagnosis) -> Section:
    blocks: list[Block] = []
    named = [(effect, "") for effect in diagnosis.effects]
    named += [(effect, " (negligible)") for effect in diagnosis.negligible]
    if named:
        rows = [
            (
                percent(effect.probability),
                printable(effect.effect),
                printable(effect.component),
                printable(effect.statement) + remark,
            )
            for effect, remark in named
        ]
        blocks.append(Table(("probability", "effect", "component", "finding"), rows))
    blocks += [Note("info", printable(str(mismatch))) for mismatch in diagnosis.mismatch]
    if diagnosis.next_experiment is not None:
        blocks.append(Note("info", f"Next: {printable(diagnosis.next_experiment.statement)}"))
    return Section("Diagnosis", f"Verdict: {diagnosis.verdict.replace('_', ' ')}.", blocks)


@result_section.register
def _density(density: Density) -> Section:
    ends = density.interval
    rows = [
        (
            printable(name),
            f"{density.mass_kg[k]:.3f}",
            f"{density.length_m[k]:.3f}",
            f"{density.value[k]:.3f}",
            NONE if ends is None else f"{ends[0, k]:.3f} to {ends[1, k]:.3f}",
        )
        for k, name in enumerate(density.links)
    ]
    header = ("link", "mass\nkg", "length\nm", "normalised density", "90 % interval")
    return Section("Normalised density", "", [Table(header, rows)])


@result_section.register
def _posterior(posterior: Posteriors) -> Section:
    rows = [
        (printable(joint), prior.name, f"{middle:.4g}", prior.unit, f"{low:.4g} to {high:.4g}")
        for joint, servo in posterior.joints.items()
        for prior, (low, middle, high) in zip(
            servo.parameters, servo.quantiles(0.05, 0.5, 0.95).T, strict=True
        )
    ]
    header = ("joint", "parameter", "median", "unit", "90 % interval")
    lead = "" if rows else "No joint moves in a bench recording."
    return Section("Posterior", lead, [Table(header, rows)] if rows else [])


@result_section.register
def _ranges(ranges: Ranges) -> Section:
    rows = [_range_row(entry) for entry in ranges.entries]
    header = ("parameter", "distribution", "drawn per", "range", "unit", "source")
    return Section("Randomization ranges", "", [Table(header, rows), *_notes(ranges.notes)])


def _range_row(entry: Range) -> tuple[str, ...]:
    between = " to " if entry.distribution == "uniform" else " ± "
    numbers = f"{entry.first:.4g}{between}{entry.second:.4g}"
    name, source = printable(entry.parameter), printable(entry.source)
    return name, entry.distribution, entry.period, numbers, entry.unit, source


@result_section.register
def _gathered(gathered: Gathered) -> Section:
    return result_section(gathered.ranges)


@result_section.register
def _prediction(prediction: Prediction) -> Section:
    rows = [
        (printable(name), printable(joint), milliradians(error))
        for (name, joint), error in prediction.rmse.items()
    ]
    return Section("Prediction", "", [Table(("recording", "joint", "RMSE"), rows)])


@result_section.register
def _recording(recording: Recording) -> Section:
    rows = [
        (
            printable(joint),
            span(recording.command[:, j]),
            span(recording.position[:, j]),
            str(recording.missing(j)),
        )
        for j, joint in enumerate(recording.joints)
    ]
    header = ("joint", "command", "position", "missing samples")
    blocks: list[Block] = [Table(header, rows)]
    if recording.columns:
        blocks.append(Note("info", f"Further columns: {printable(', '.join(recording.columns))}"))
    return Section(f"Recording {printable(recording.name)}", recording.summary, blocks)


@result_section.register
def _robot(robot: Robot) -> Section:
    links = [
        (printable(link.name), *(_number(vars(link)[key]) for key in ("mass_kg", "length_m")))
        for link in robot.links
    ]
    joints = []
    for joint in robot.joints:
        limits = vars(joint)["limits_rad"]
        between = NONE if limits is None else f"{limits[0]:.4g} to {limits[1]:.4g}"
        joints.append((printable(joint.name), printable(joint.servo.name), between))
    blocks = (
        Table(("link", "mass\nkg", "length\nm"), links),
        Table(("joint", "servo", "limits\nrad"), joints),
    )
    return Section(f"Robot {printable(robot.name)}", "", blocks)


@result_section.register
def _check(check: Check) -> Section:
    clock = check.timing
    gaps = f"{sum(length for _, length in clock.gaps):.3g} s in gaps" if clock.gaps else "no gap"
    lead = (
        f"{check.kind}, {check.duration_s:.2f} s at {clock.rate_hz:.4g} Hz, jitter "
        f"{1e3 * clock.jitter_s:.2g} ms, {gaps}, {clock.missing_cells} positions missing"
    )
    rows = [
        (
            printable(joint.joint),
            str(joint.moves),
            f"{joint.command_range_rad:.3f}",
            f"{joint.range_rad:.3f}",
            f"{1e3 * joint.noise_rad:.2f}",
            str(joint.missing),
            printable("; ".join(joint.identifiable)) or NONE,
        )
        for joint in check.joints
    ]
    header = (
        "joint", "moves", "command\nrad", "position\nrad", "noise\nmrad", "missing", "identifiable",
    )  # fmt: skip
    blocks = [Table(header, rows), *_notes([finding.text for finding in check.all_findings])]
    return Section(f"Check of {printable(check.recording)}", lead, blocks)


def _notes(sentences: Iterable[str]) -> list[Block]:
    return [Note("warn", printable(sentence)) for sentence in sentences]


def _number(value: float | None) -> str:
    return NONE if value is None or not math.isfinite(value) else f"{value:.4g}"
