"""Results as sections, from which notebooks make HTML and ``print`` makes text.

``result_section`` dispatches on the type of the result; other packages register theirs with it.
"""

from functools import singledispatch

from sim2real.check import Check
from sim2real.design.plan import Design
from sim2real.design.rivals import RivalDesign
from sim2real.diagnose.result import Diagnosis
from sim2real.model import JointModel, Model
from sim2real.posterior.posteriors import Posteriors
from sim2real.ranges.entry import Ranges
from sim2real.ranges.gather import Gathered
from sim2real.ranges.latency import LatencySplit
from sim2real.recording import Recording
from sim2real.report.design_plot import design_section, rivals_section
from sim2real.report.diagnosis import effect_tables
from sim2real.report.identification import joint_blocks, model_blocks
from sim2real.report.page import Note, Section, Table, render_fragment, section_text
from sim2real.report.quantity import milliradians
from sim2real.report.ranges import (
    density_section,
    gathered_blocks,
    latency_split_section,
    posterior_table,
    range_blocks,
)
from sim2real.report.recordings import check_section, recording_section
from sim2real.report.servo_table import servos_section
from sim2real.robot import Density, Robot
from sim2real.servo.prediction import Prediction
from sim2real.servo_library.catalogue import ServoEntry, ServoLibrary

_RANGES = "Randomization ranges"


def result_html(result: object) -> str:
    """A result as an HTML fragment for a notebook; it needs Jinja."""
    return render_fragment([result_section(result)])


def result_text(result: object) -> str:
    """A result as text of at most 100 columns."""
    return section_text(result_section(result))


@singledispatch
def result_section(result: object) -> Section:
    """Tables and notes of a result of a type for which a function is registered."""
    raise TypeError(f"no section for a {type(result).__name__}")


result_section.register(Check)(check_section)
result_section.register(Density)(density_section)
result_section.register(Design)(lambda design: design_section(design, plots=False))
result_section.register(LatencySplit)(latency_split_section)
result_section.register(Recording)(recording_section)
result_section.register(RivalDesign)(rivals_section)
result_section.register(ServoLibrary)(lambda library: servos_section(list(library)))
result_section.register(Model)(lambda model: Section("Model", "", model_blocks(model)))
result_section.register(JointModel)(lambda joint: Section("Servo", "", joint_blocks(joint)))
result_section.register(Ranges)(lambda ranges: Section(_RANGES, "", range_blocks(ranges)))
result_section.register(Gathered)(lambda found: Section(_RANGES, "", gathered_blocks(found)))


@result_section.register
def _servo(entry: ServoEntry) -> Section:
    origin = f"licence {entry.licence}, source {entry.source}"
    scored = f"; held out: {entry.scored_on}" if entry.scored_on else ""
    blocks = [*servos_section([entry]).blocks, *model_blocks(entry.model)]
    return Section("Servo", "", [*blocks, Note("info", origin + scored)])


@result_section.register
def _diagnosis(diagnosis: Diagnosis) -> Section:
    verdict, *lines = map(str.strip, str(diagnosis).splitlines())
    notes = [Note("info", line) for line in lines]
    return Section("Diagnosis", verdict.capitalize(), [*effect_tables(diagnosis), *notes])


@result_section.register
def _posterior(posterior: Posteriors) -> Section:
    tables = [posterior_table(joint, servo) for joint, servo in posterior.joints.items()]
    return Section("Posterior", "" if tables else "no joint moved on the bench", tables)


@result_section.register
def _prediction(prediction: Prediction) -> Section:
    rows = [(*place, milliradians(error)) for place, error in prediction.rmse.items()]
    return Section("Prediction", "", [Table(("recording", "joint", "RMSE"), rows)])


@result_section.register
def _robot(robot: Robot) -> Section:
    def cell(*numbers: float | None) -> str:
        return " to ".join("–" if x is None else f"{x:.4g}" for x in numbers)

    sheets = ((x.name, vars(x)) for x in robot.links)
    links = [(name, cell(sheet["mass_kg"]), cell(sheet["length_m"])) for name, sheet in sheets]
    moved = ((x, vars(x)["limits_rad"] or [None]) for x in robot.joints)
    joints = [(x.name, x.servo.name, cell(*limits)) for x, limits in moved]
    tables = [
        Table(("link", "mass\nkg", "length\nm"), links),
        Table(("joint", "servo", "limits\nrad"), joints),
    ]
    return Section(f"Robot {robot.name}", "", tables)
