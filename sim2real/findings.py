"""Findings about a recording and its joints, one sentence each."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.clock import missing_samples, recording_clock_findings
from sim2real.errors import RecordingFinding
from sim2real.noise import noise_floor, quantization_step
from sim2real.readings import departure, interleaved_constant, stale_share, wraps, wrong_readings
from sim2real.recording import Recording
from sim2real.robot import Joint, Robot

LONGEST_LATENCY_S = 0.15
_LARGEST_DEPARTURE = 1 / 3
"""Share of a recording away from its command above which nothing is fitted: drives and sensors that
fail for a time were away for at most 0.23 (``benchmarks/recording_findings.py``)."""


@dataclass(frozen=True)
class MeasuredJoint:
    """One joint of a recording while its torque is on; no command is missing."""

    joint: str
    t: Array
    command: Array
    position: Array
    noise_rad: float  # standard deviation of the noise of all positions
    step_rad: float  # their quantization step; 0 if there is none

    def finding(self, text: str) -> RecordingFinding:
        """A note about the joint; ``text`` continues its name."""
        return RecordingFinding(self.joint + text)

    def warning(self, text: str) -> RecordingFinding:
        """A warning about the joint; ``text`` continues its name."""
        return RecordingFinding(self.joint + text, "warning")

    def error(self, does: str, why: str, expected: str) -> RecordingFinding:
        """An angle of the joint that does what it should not; sentence: what it does, and why."""
        where, found = f"{self.joint}.position_rad", f"an angle that {does}"
        return RecordingFinding(f"{self.joint} {does}{why}", "error", where, found, expected)


def measured_joint(recording: Recording, j: int) -> MeasuredJoint:
    """Joint number ``j`` of a recording."""
    t, command, position = recording.t, recording.command[:, j], recording.position[:, j]
    on = slice(recording.powered(j))
    noise, step = noise_floor(t, command, position), quantization_step(position)
    return MeasuredJoint(recording.joints[j], t[on], command[on], position[on], noise, step)


def moves(t: Array, command: Array) -> int:
    """Number of movements of ``command`` (T,): reversals, and starts after 0.1 s or more."""
    changed = np.flatnonzero(np.diff(command)) + 1
    if not changed.size:
        return 0
    turned = np.diff(np.sign(command[changed] - command[changed - 1])) != 0
    pause = np.diff(t[changed]) > max(0.1, 2.5 * np.median(np.diff(t)))
    return 1 + int(np.sum(turned | pause))


def recording_findings(recording: Recording) -> list[RecordingFinding]:
    """Findings about a recording as a whole: its clock, and columns that it lacks."""
    imported = recording.metadata.get("import_warnings")
    sentences = [str(sentence) for sentence in imported] if isinstance(imported, list) else []
    if np.isnan(recording.command).all():
        sentences.append("No command was recorded: servos cannot be identified.")
    if recording.kind == "pool" and not recording.has_poses:
        sentences.append("The body was not tracked: body and fluid cannot be calibrated.")
    clock = recording_clock_findings(recording.joints, recording.t, recording.position)
    return [*clock, *map(RecordingFinding, sentences)]


def all_findings(recording: Recording, robot: Robot | None = None) -> list[RecordingFinding]:
    """All findings about a recording, with its robot those about its data sheets as well."""
    return [*recording_findings(recording), *merged(joint_rows(recording, robot))]


def joint_rows(
    recording: Recording, robot: Robot | None = None
) -> Iterator[tuple[str, RecordingFinding]]:
    """The name of each joint of a recording with each finding about it."""
    for data in (measured_joint(recording, j) for j in range(len(recording.joints))):
        yield from ((data.joint, found) for found in joint_findings(recording, data, robot))


def merged(rows: Iterable[tuple[str, RecordingFinding]]) -> list[RecordingFinding]:
    """Findings, each with its joint, of which one that several joints share is listed once."""
    joints: dict[str, list[str]] = {}
    findings: dict[str, RecordingFinding] = {}
    for joint, finding in rows:
        about = finding.text.removeprefix(joint).removeprefix("'s").lstrip()
        joints.setdefault(about, []).append(joint)
        findings[about] = finding
    for about, some in joints.items():
        if len(some) > 1:
            findings[about] = replace(findings[about], text=f"{', '.join(some)}: {about}")
    return list(findings.values())


def joint_findings(
    recording: Recording, data: MeasuredJoint, robot: Robot | None
) -> Iterator[RecordingFinding]:
    """Findings about a joint, including what its load does not allow to identify."""
    t, command, position = data.t, data.command, data.position
    if t.size < 2:
        return
    sheet = robot.joint(data.joint) if robot else None
    load = recording.loads.get(data.joint)
    finite = np.isfinite(position)
    if not finite.any():
        yield data.finding(" has no measured positions.")
        return
    lost = missing_samples(t, position)
    missing = lost / (lost + int(finite.sum()))
    if missing > 0.01:
        yield data.finding(f" lacks {100 * missing:.2g} % of its positions.")
    readings = list(_readings(data))
    yield from readings
    if any(finding.severity == "error" for finding in readings):
        return  # nothing else is known of its motion
    span, least = float(np.ptp(command)), max(2 * data.step_rad, 9 * data.noise_rad)
    if span <= max(2 * data.step_rad, 1e-4):
        yield data.finding(" is never commanded to move: nothing can be fitted to it.")
    elif float(np.ptp(position[finite])) <= min(least, 0.5 * span):
        yield data.warning(f" does not move, although its command spans {span:.3g} rad.")
    elif recording.kind == "servo":
        yield from _motion(data, finite, load is None or load.gravity_Nm > 0)
    yield from _start(data, finite)
    yield from _excitation(data)
    if sheet is not None:
        yield from _data_sheet(data, sheet)
    if t.size < recording.t.size:
        yield data.finding(f"'s torque is off from {recording.t[t.size]:.4g} s on.")
    if recording.kind != "servo":
        return
    if load is None:
        yield data.finding(" has no stated load: its gains are identified per unit of inertia.")
    elif not load.gravity_Nm:
        yield data.finding(
            "'s load has no pendulum: only kp/inertia and kd/inertia are "
            "identifiable, so the stated inertia cannot be checked."
        )


def _readings(data: MeasuredJoint) -> Iterator[RecordingFinding]:
    """Readings that are wrong in themselves, whatever the joint does."""
    after, jumps = wraps(data.position)
    if after.size:
        size, turn = float(np.median(np.abs(jumps))), 2 * np.pi
        whole = " (one turn)" if abs(size - turn) < 0.1 * turn else ""
        yield data.error(
            f"jumps by {size:.3g} rad{whole} between two samples, {_times(after.size)}, "
            f"first at {data.t[after[0]]:.4g} s",
            ": its angle wraps around and must be unwrapped.",
            "one without jumps (does it wrap around? numpy.unwrap continues it)",
        )
        return
    constant = interleaved_constant(data.position)
    if constant is not None:
        measured = int(np.isfinite(data.position).sum())
        yield data.error(
            f"reads exactly {constant[0]:.4g} rad between other angles, {_times(constant[1])} in "
            f"{measured} samples",
            ": another source writes into the column.",
            "one series of angles (does another source write into the column?)",
        )
        return
    fresh = np.append(True, np.diff(data.position) != 0)
    wrong = np.flatnonzero(wrong_readings(data.position) & fresh)
    if wrong.size:
        seconds = ", ".join(f"{data.t[k]:.4g}" for k in wrong[:3])
        more = ", ..." if wrong.size > 3 else ""
        count = "one reading" if wrong.size == 1 else f"{wrong.size} readings"
        place = f"far from those before and after (at {seconds}{more} s)"
        yield data.warning(f" has {count} {place}: wrong readings of the sensor or the bus.")
    stale = stale_share(data.position, data.step_rad, data.noise_rad)
    if stale:
        yield data.warning(
            f" has stale readings: {100 * stale:.0f} % of the samples in "
            "which it turns steadily repeat the previous one. They look like missing physics."
        )


def _times(count: int) -> str:
    return {1: "once", 2: "twice"}.get(count, f"{count} times")


def _motion(data: MeasuredJoint, finite: Mask, gravity: bool) -> Iterator[RecordingFinding]:
    t, command, position = data.t[finite], data.command[finite], data.position[finite]
    match = _correlations(t, command, position, LONGEST_LATENCY_S)
    if match.size and match.max() < 0 and match.min() < -0.5:
        # Half a period of a periodic command looks like a reversed sign.
        late = _correlations(t, command, position, 1.0).max() > -0.8 * match.min()
        against = data.error(
            f"moves against its command (correlation {match.min():.2f})",
            ": the sign of one of them is reversed"
            + (f", or its latency exceeds {LONGEST_LATENCY_S:g} s." if late else "."),
            "one with the sign of its command (is one of them reversed?)",
        )
        yield replace(against, severity="warning") if late else against
        return
    edges = np.flatnonzero(np.r_[True, np.diff(position) != 0, True])
    for a, b in zip(edges[:-1], edges[1:] - 1, strict=True):
        # Commands at the end of the interval have not taken effect yet.
        due = command[a : b + 1][t[a : b + 1] < t[b] - 2 * LONGEST_LATENCY_S]
        moved = float(np.ptp(due)) if due.size else 0.0
        if t[b] - t[a] > 0.5 and moved > max(0.1, 10 * data.step_rad):
            yield data.warning(
                f" reads exactly {position[a]:.4g} rad from {t[a]:.4g} to {t[b]:.4g} s "
                f"while its command moves by {moved:.2g} rad: friction, gears or sensor may be "
                "stuck."
            )
            return
    apart = departure(data.t, data.command, data.position, gravity)
    if apart is not None:
        first, last = apart.windows_s[0]
        total = sum(end - start for start, end in apart.windows_s)
        where = "" if apart.held_rad is None else f", and stays near {apart.held_rad:.3g} rad"
        why = "stopped or pulled, its torque may be off, or commands may be increments"
        away = data.error(
            f"does not follow its command: for {total:.3g} s in all, first from {first:.4g} to "
            f"{last:.4g} s, it is up to {apart.largest_rad:.2g} rad away{where}",
            f". It may be {why}.",
            f"one that does (it may be {why})",
        )
        short = total <= _LARGEST_DEPARTURE * np.ptp(data.t)
        yield replace(away, severity="warning") if short else away


def _correlations(t: Array, command: Array, position: Array, longest_s: float) -> Array:
    """Correlations of the command with the position at lags of up to ``longest_s``, shape (L,)."""
    largest = max(1, int(longest_s / np.median(np.diff(t)))) if t.size > 2 else 0
    found = np.zeros(max(min(largest, t.size - 3) + 1, 0))
    for k in range(found.size):
        a, b = (x - x.mean() for x in (command[: t.size - k], position[k:]))
        size = np.sqrt(np.sum(a**2) * np.sum(b**2))
        found[k] = np.sum(a * b) / size if size > 0 else 0.0
    return found


def _start(data: MeasuredJoint, finite: Mask) -> Iterator[RecordingFinding]:
    changed = np.flatnonzero(data.command != data.command[0])
    still = int(changed[0]) + 1 if changed.size else data.t.size  # the change itself comes later
    early = np.flatnonzero(finite[:still] & (data.t[:still] <= data.t[0] + 0.5))
    if not early.size:
        return
    offset = float(np.median(data.position[early] - data.command[0]))
    if float(np.ptp(data.position[early])) > max(5 * data.step_rad, 9 * data.noise_rad, 0.01):
        yield data.warning(" is moving at the start of the recording: it should be at rest.")
    elif abs(offset) > 0.1:
        yield data.warning(f" starts {abs(offset):.2g} rad away from its first command.")
    elif abs(offset) > max(3 * data.step_rad, 4 * data.noise_rad, 0.005):
        side = "above" if offset > 0 else "below"
        yield data.finding(
            f" starts at rest {abs(offset):.2g} rad {side} its command: there may "
            "be an offset, a load or a dead band."
        )


def _excitation(data: MeasuredJoint) -> Iterator[RecordingFinding]:
    count = moves(data.t, data.command)
    if not count:
        return
    if count < 4:
        times = ("once", "twice", "three times")[count - 1]
        yield data.finding(
            f" is commanded to move only {times}: too little to hold out for validation."
        )
    step = np.diff(data.t)
    spread = float(np.average((data.command[1:] - data.command.mean()) ** 2, weights=step))
    speed = float(np.average((np.diff(data.command) / step) ** 2, weights=step))
    frequency = float(np.sqrt(speed / spread)) / (2 * np.pi)  # exact for a sine
    if frequency < 0.2:
        slow = f" is moved very slowly (about {frequency:.2g} Hz)"
        yield data.finding(f"{slow}: damping, latency and inertia are hardly identifiable.")


def _data_sheet(data: MeasuredJoint, sheet: Joint) -> Iterator[RecordingFinding]:
    beyond_rad = 0.1
    if sheet.states("limits_rad"):
        low, high = sheet.limits_rad
        extremes = (float(data.command.min()), float(data.command.max()))
        if extremes[0] < low - 1e-6 or extremes[1] > high + 1e-6:
            beyond = extremes[1] if extremes[1] > high + 1e-6 else extremes[0]
            limits = f"its limits of {low:.3g} to {high:.3g} rad"
            yield data.finding(f" is commanded to {beyond:.3g} rad, beyond {limits}.")
        angle = np.where(wrong_readings(data.position), np.nan, data.position)
        excess = np.maximum(low - angle, angle - high)
        reached = np.maximum(low - data.command, data.command - high) > beyond_rad
        if (excess > beyond_rad).any() and not reached.any():
            row = int(np.nanargmax(excess))
            yield data.warning(
                f" reads {angle[row]:.3g} rad at {data.t[row]:.4g} s, outside its limits of "
                f"{low:.3g} to {high:.3g} rad, {_times(int((excess > beyond_rad).sum()))}."
            )
    changed = np.flatnonzero(np.diff(data.command)) + 1
    slope = np.abs(np.diff(data.command[changed]) / np.diff(data.t[changed]))
    # Two slopes in a row: one alone may be a step, which no servo follows.
    fastest = float(np.minimum(slope[1:], slope[:-1]).max()) if slope.size > 1 else 0.0
    servo = sheet.servo
    if servo.states("no_load_speed_rad_s") and fastest > servo.no_load_speed_rad_s:
        yield data.finding(
            f" is commanded at up to {fastest:.3g} rad/s, above its servo's no-load "
            f"speed of {servo.no_load_speed_rad_s:.3g} rad/s: the response will be limited by it."
        )
    stated = servo.position_step_rad if servo.states("position_step_rad") else 0.0
    counts = data.step_rad / stated if stated > 0 else 0.0
    if counts and abs(counts - round(counts)) > 0.05:
        measured = f" is measured in steps of {data.step_rad:.3g} rad"
        yield data.finding(f"{measured}, but the data sheet states {stated:.3g} rad.")
