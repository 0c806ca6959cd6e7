"""``sim2real diagnose``."""

from __future__ import annotations

import argparse
from pathlib import Path

from tqdm import tqdm

from sim2real.diagnose.diagnose import diagnose
from sim2real.diagnose.next_experiment import write_commands
from sim2real.diagnose.result import Diagnosis, write_diagnosis
from sim2real.model import read_model, write_model
from sim2real.output import check_writable
from sim2real.recording import read_recording
from sim2real.report.diagnosis import diagnosis_section
from sim2real.report.page import write_page
from sim2real.robot import read_robot


def run(options: argparse.Namespace) -> int:
    """Diagnose, print what was found, write it, the enriched model and a page to look at."""
    out = check_writable(options.out)
    robot = read_robot(options.robot)
    recordings = [read_recording(path) for path in options.recordings]
    references = [read_recording(path) for path in options.references or ()]
    model = read_model(options.model) if options.model else None
    with tqdm(total=100, desc="diagnose", unit="%", disable=None) as bar:
        found = diagnose(
            recordings,
            robot,
            model=model,
            references=references,
            negligible=options.negligible,
            seed=options.seed,
            progress=lambda share: bar.update(round(100 * share) - bar.n),
        )
    print(spoken(found))
    write(found, out)
    if not options.no_page:
        title = f"Diagnosis of {robot.name}"
        page = out.with_suffix(".html")
        subtitle = f"{len(recordings)} recordings, verdict: {found.verdict.replace('_', ' ')}"
        write_page(page, title, subtitle, [diagnosis_section(found)], found.provenance)
        print(f"\npage: {page}")
    return 0


def write(found: Diagnosis, out: Path) -> None:
    """Write the diagnosis, the enriched model and the command of the next experiment beside it."""
    enriched = out.with_name(f"{out.stem}.enriched.json")
    write_model(found.model, enriched)
    if found.next_experiment is not None:
        found = write_commands(found, out)
    write_diagnosis(found, out, enriched.name)


def spoken(found: Diagnosis) -> str:
    """The diagnosis in a few lines for a terminal."""
    lines = [f"verdict: {found.verdict.replace('_', ' ')}"]
    for effect in found.effects:
        lines.append(f"  {100 * effect.probability:3.0f} %  {effect.statement}")
    for effect in found.negligible:
        lines.append(f"  {100 * effect.probability:3.0f} %  {effect.statement} (negligible)")
    for entry in found.mismatch:
        lines.append(
            f"  {entry.component}: {1e3 * entry.rmse:.2f} mrad against "
            f"{1e3 * entry.noise:.2f} mrad of noise; {entry.where}"
        )
    for joint, formula in found.hypothesis.items():
        lines.append(f"  {joint}, a guess: {formula}")
    if found.next_experiment is not None:
        lines.append(f"next: {found.next_experiment.statement}")
    return "\n".join(lines)
