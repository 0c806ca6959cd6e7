"""Check of a recording before a fit: clock, joints, findings and identifiable parameters."""

from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.clock import Timing, timing
from sim2real.display import NotebookDisplay
from sim2real.errors import RecordingFinding
from sim2real.findings import joint_findings, measured_joint, merged, moves, recording_findings
from sim2real.identification.advice import expected_precision
from sim2real.plausible import validate_recording
from sim2real.recording import Recording
from sim2real.robot import Robot


@dataclass(frozen=True)
class JointCheck:
    """One joint of a recording."""

    joint: str
    range_rad: float  # largest minus smallest position; 0 if there is none
    command_range_rad: float  # of the commands before the torque is off, likewise
    moves: int  # movements of the command, separated by pauses or reversals
    noise_rad: float  # standard deviation of the measurement noise, including quantization
    step_rad: float  # quantization step; 0 if none is visible
    missing: int  # number of missing positions
    load: str
    findings: tuple[RecordingFinding, ...]
    identifiable: tuple[str, ...] = ()  # what can and cannot be identified, one sentence each


@dataclass(frozen=True)
class Check(NotebookDisplay):
    """Result of a check; ``findings`` concern the whole recording, each joint has its own."""

    recording: str
    kind: str
    duration_s: float
    timing: Timing
    joints: tuple[JointCheck, ...]
    findings: tuple[RecordingFinding, ...]

    @property
    def all_findings(self) -> list[RecordingFinding]:
        """All findings; one that several joints share is listed once."""
        rows = ((row.joint, finding) for row in self.joints for finding in row.findings)
        return [*self.findings, *merged(rows)]


class Checks(tuple[Check, ...]):
    """The checks of several recordings, which print one below the other."""

    def __str__(self) -> str:
        return "\n\n\n".join(map(str, self))

    def _repr_html_(self) -> str:
        """The checks as HTML for IPython."""
        return "\n".join(check._repr_html_() or f"<pre>{check}</pre>" for check in self)

    @property
    def all_findings(self) -> list[RecordingFinding]:
        """The findings of all recordings."""
        return [finding for check in self for finding in check.all_findings]


def check(recording: Recording, robot: Robot | None = None, *, seed: int = 0) -> Check:
    """Check a recording, as ``verbs.check`` does those of a list."""
    validate_recording(recording, robot)
    clock, found = timing(recording.t, recording.position), tuple(recording_findings(recording))
    joints = tuple(_check_joint(recording, j, robot, seed) for j in range(len(recording.joints)))
    return Check(recording.name, recording.kind, recording.duration_s, clock, joints, found)


def _check_joint(recording: Recording, j: int, robot: Robot | None, seed: int) -> JointCheck:
    data = measured_joint(recording, j)
    name, powered = data.joint, data.t.size
    findings = tuple(joint_findings(recording, data, robot))
    identifiable: tuple[str, ...] = ()
    if powered > 1:
        # Excitation alone says nothing about readings that do not belong to it.
        identifiable = ("what can be identified is not stated while the warnings hold",)
        if all(finding.severity == "note" for finding in findings):
            identifiable = expected_precision(recording, name, seed=seed)
    load, stated = recording.loads.get(name), "not given"
    if load is not None:
        stated = f"{load.inertia_kgm2:.3g} kg m2"
        if load.gravity_Nm:
            stated += f", {load.pendulum_mass_kg:.3g} kg at {load.pendulum_length_m:.3g} m"
    return JointCheck(
        joint=name,
        range_rad=_range(recording.position[:, j]),
        command_range_rad=_range(data.command),
        moves=moves(data.t, data.command) if powered > 1 else 0,
        noise_rad=data.noise_rad,
        step_rad=data.step_rad,
        missing=recording.missing(j),
        load=stated if recording.kind == "servo" else recording.medium,
        findings=findings,
        identifiable=identifiable,
    )


def _range(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.ptp(finite)) if finite.size else 0.0
