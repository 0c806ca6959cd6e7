"""How often findings about angles are raised without a fault, and found with one.

    python -m benchmarks.recording_findings RECORDING.csv...

Every joint that moves is judged as recorded and with a fault that is put into it: command and
position swapped (``readings.lead_s``), and the faults of ``sim2real.readings``. Prints for each
finding how many joints raise it, which sets the limits of ``sim2real.readings`` and
``readings.UNEXPLAINED_RATIO``. The shipped recordings, those of ``shared/realdata`` and
development seeds of ``datasets/concealed`` and ``datasets/foreign``, with their nuisances, are the
recordings to judge.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks.harness import command_line
from sim2real import readings
from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.noise import noise_floor, quantization_step
from sim2real.readings import lead_s
from sim2real.recording import read_recording


@dataclass(frozen=True)
class Joint:
    """A joint that moves: times (T,), set-points (T,), angles (T,), and whether a weight pulls."""

    name: str
    t: Array
    command: Array
    angle: Array
    gravity: bool


def joints(path: Path) -> Iterator[Joint]:
    """The joints of a recording that move."""
    recording = read_recording(path)
    for j, joint in enumerate(recording.joints):
        powered = recording.powered(j)
        t, command = recording.t[:powered], recording.command[:powered, j]
        angle = recording.position[:powered, j]
        seen = np.isfinite(angle)
        if powered > 100 and seen.sum() > 100 and np.ptp(command) > 0.1 and np.ptp(angle[seen]) > 0:
            load = recording.loads.get(joint)
            heavy = load is None or load.gravity_Nm > 0
            yield Joint(f"{path} {joint}", t[seen], command[seen], angle[seen], heavy)


def stale(joint: Joint, rng: np.random.Generator, share: float = 0.08) -> Array:
    """Angles of which this share repeats the previous one."""
    angle = joint.angle.copy()
    for k in np.flatnonzero(rng.random(angle.size - 1) < share) + 1:
        angle[k] = angle[k - 1]
    return angle


def wrong(joint: Joint, rng: np.random.Generator, size_rad: float = 1.0) -> Array:
    """Angles of which three are wrong by ``size_rad``."""
    angle = joint.angle.copy()
    angle[rng.choice(np.arange(20, angle.size - 20, 20), 3, replace=False)] += size_rad
    return angle


def constant(joint: Joint, _: np.random.Generator) -> Array:
    """Angles of which every fifth is another source's."""
    angle = joint.angle.copy()
    angle[::5] = float(joint.angle.max()) + 0.3
    return angle


def wrapped(joint: Joint, _: np.random.Generator) -> Array:
    """Angles modulo one turn that cross its ends."""
    return np.mod(joint.angle - float(np.median(joint.angle)) - 0.02, 2 * np.pi)


def stopped(joint: Joint, rng: np.random.Generator) -> Array:
    """Angles that end in the middle of the range, with noise of 0.5 mrad."""
    middle = 0.5 * (float(joint.angle.max()) + float(joint.angle.min()))
    return np.minimum(joint.angle, middle) + rng.normal(0, 5e-4, joint.angle.size)


def repeats(joint: Joint, angle: Array) -> bool:
    """Whether stale readings are reported."""
    noise = noise_floor(joint.t, joint.command, angle)
    return readings.stale_share(angle, quantization_step(angle), noise) > 0


FINDINGS: dict[str, tuple[Callable[[Joint, Array], bool], Callable[..., Array]]] = {
    "wrong readings": (lambda _, angle: bool(readings.wrong_readings(angle).any()), wrong),
    "wraps": (lambda _, angle: readings.wraps(angle)[0].size > 0, wrapped),
    "constant": (lambda _, angle: readings.interleaved_constant(angle) is not None, constant),
    "stale readings": (repeats, stale),
    "departure": (
        lambda joint, angle: (
            readings.departure(joint.t, joint.command, angle, joint.gravity) is not None
        ),
        stopped,
    ),
}


def main() -> None:
    """Print the table."""
    parser = command_line(__doc__, seed=0)
    parser.add_argument("recordings", nargs="+", type=Path)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    raised: dict[str, list[str]] = {name: [] for name in ("precedes its command", *FINDINGS)}
    found, count = dict.fromkeys(raised, 0), 0
    for path in tqdm(options.recordings, disable=None):
        try:
            moving = list(joints(path))
        except InputError as error:
            print(f"left out: {error}")
            continue
        for joint in moving:
            count += 1
            fair = np.where(readings.wrong_readings(joint.angle), np.nan, joint.angle)
            if lead_s(joint.t, joint.command, fair) is not None:
                raised["precedes its command"].append(joint.name)
            found["precedes its command"] += lead_s(joint.t, joint.angle, joint.command) is not None
            for name, (raises, put) in FINDINGS.items():
                if raises(joint, joint.angle):
                    raised[name].append(joint.name)
                found[name] += raises(joint, put(joint, rng))
    print(f"{count} joints\n{'':22} {'as recorded':>12} {'with fault':>12}")
    for name, names in raised.items():
        print(f"{name:22} {len(names):12d} {found[name]:12d}  {', '.join(names[:4])}")


if __name__ == "__main__":
    main()
