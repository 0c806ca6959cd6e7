"""The first section of the demo's page: verdicts, key numbers and the film."""

from __future__ import annotations

from collections.abc import Iterator

from sim2real.diagnose.result import Diagnosis, percent
from sim2real.model import Model
from sim2real.report.page import Section, Table, Text
from sim2real.report.quantity import milliradians, quantities


def summary_section(
    model: Model, servos: Diagnosis, body: Diagnosis, ablation: str, swim: Section
) -> Section:
    """Results of the run: the first section of the page.

    Args:
        model: The identified servos.
        servos: Their diagnosis.
        body: The diagnosis of the swim.
        ablation: Result of the ablation in a sentence.
        swim: The film of a swim and what it shows.
    """
    rows = [
        ("diagnosis of the servos", _verdict(servos)),
        ("diagnosis of the body", _verdict(body)),
        *_servos(model),
        ("ablation", ablation),
    ]
    lead = (
        "The recordings give the parameters of the servos and of the body, the physics that both "
        "models leave out, and ranges for training. The section on the ablation says how the "
        "policy that swims below was trained."
    )
    film = [Text(swim.lead, "A swim of the trained policy"), *swim.blocks]
    return Section("Results", lead, [Table(("what", "result"), rows), *film])


def _servos(model: Model) -> Iterator[tuple[str, str]]:
    """Name and main parameters of each servo, with its error on held-out data."""
    for name, joint in model.joints.items():
        shown = [q for q in quantities(joint) if q.name in ("kp", "kd", "latency")]
        values = ", ".join(f"{q.name} {q.texts[0]} {q.unit}" for q in shown)
        figures = model.fit[f"{name}.position_rad"]
        error, noise = milliradians(figures.get("heldout")), milliradians(figures.get("noise"))
        yield f"servo {name}", f"{values}\nheld-out error {error}, sensor noise {noise}"


def _verdict(diagnosis: Diagnosis) -> str:
    """The verdict, and below it each effect with its probability."""
    effects = [f"{percent(e.probability)}: {e.statement}" for e in diagnosis.effects]
    return "\n".join([diagnosis.verdict.replace("_", " "), *effects])
