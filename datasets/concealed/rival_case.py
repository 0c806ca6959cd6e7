"""A case as the rivals read it, and an answer as the grader reads it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim2real.identification.fit import Fit, first_guess, fit, gains
from sim2real.model import JointModel, Model, write_model
from sim2real.output import write_json
from sim2real.recording import Recording, read_commands, read_recording
from sim2real.servo.trace import Trace, traces

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """The recordings of each joint, the plain servos fitted to them, and what to predict.

    ``before`` are the recordings in which nothing is hidden, of cases that have them.
    """

    given: dict[str, list[Trace]]
    plain: dict[str, Fit]
    wanted: Recording
    before: Case | None = None

    @property
    def model(self) -> Model:
        """The plain servos."""
        joints = {}
        for joint, one in self.plain.items():
            kp, kd, latency = (float(x) for x in one.row[:3])
            joints[joint] = JointModel(kp, kd, latency, one.inertia)
        return Model(joints=joints)


@dataclass(frozen=True)
class Said:
    """An answer: entries of ``effects``, the enriched model, or angles where it's no model."""

    effects: tuple[dict[str, Any], ...]
    model: Model
    angles: dict[str, Array] | None = None


def read_case(folder: Path, wanted: Path) -> Case:
    """Read a case and fit gains and latency of every joint to all recordings."""
    before = _fitted(folder, "ref_*.csv", wanted) if any(folder.glob("ref_*.csv")) else None
    return replace(_fitted(folder, "[ab].csv", wanted), before=before)


def _fitted(folder: Path, pattern: str, wanted: Path) -> Case:
    recordings = [read_recording(path) for path in sorted(folder.glob(pattern))]
    rng = np.random.default_rng(0)
    given = {joint: traces(recordings, joint) for joint in recordings[0].joints}
    plain = {}
    for joint, some in given.items():
        start, _ = first_guess(some, rng)
        plain[joint] = fit(some, start, gains(start, some[0].load.inertia_kgm2))
    return Case(given, plain, read_commands(wanted))


def answer(case: Case, said: Said, folder: Path) -> None:
    """Write what the grader reads."""
    folder.mkdir(parents=True, exist_ok=True)
    verdict = "explained" if said.effects else "consistent"
    content = {"verdict": verdict, "effects": list(said.effects), "mismatch": [], "rivals": []}
    write_json(folder / "diagnosis.json", content)
    write_model(case.model, folder / "baseline.json")
    write_model(said.model, folder / "enriched.json")
    if said.angles is not None:
        np.savez(folder / "enriched_c.npz", **said.angles)  # type: ignore[arg-type]


def entry(effect: str, joint: str, probability: float, found: dict[str, float]) -> dict[str, Any]:
    """One effect that is claimed."""
    estimates = {n: {"mean": x, "sd": 0.0, "q05": x, "q95": x} for n, x in found.items()}
    said = {"effect": effect, "component": joint, "probability": probability}
    return {**said, "group": [effect], "parameters": estimates}


def surest_first(entries: list[dict[str, Any]]) -> tuple[dict[str, Any], ...]:
    """By probability, the highest first."""
    return tuple(sorted(entries, key=lambda entry: -entry["probability"]))
