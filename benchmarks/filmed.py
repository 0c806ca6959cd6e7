"""Filmed swims as fits see them: clips, their errors, their noise, rivals without physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from real_fish import read_clip

import sim2real as s2r
from sim.inference.swims import Swim, swim_of
from sim.robot.swimmer import CONTROL_S
from sim.twin.prescribed import RUN_UP_S
from sim2real.arrays import Array
from sim2real.recording import Recording

MEASURES = ("surge", "sway", "yaw rate", "mean speed")
_HARMONICS, _NOISY = 3, 20
_POSE = ("body.x_m", "body.y_m", "body.yaw_rad")


@dataclass(frozen=True)
class Film:
    """A clip as a swim whose commands are its joints' angles, and its beats a second."""

    swim: Swim
    beat_hz: float

    @property
    def angle(self) -> Array:
        """The joints' angles while the film runs, shape (T, J)."""
        return self.swim.command[-self.swim.t.size :]

    @property
    def speeds(self) -> Array:
        """Surge, sway, yaw rate as filmed, shape (T, 3)."""
        return self.swim.signals[:, :3]


def film(folder: Path, name: str, robot: s2r.Robot, frames: float) -> Film:
    """A clip at so many frames a second.

    Its joints follow three harmonics of the beat, before the clip as in it; its point is moved from
    the front to the head's centre of mass.
    """
    clip, recording = read_clip(folder, name), s2r.read_recording(folder / f"{name}.csv")
    swim = _swim(recording, robot, frames)
    t: Array = CONTROL_S * np.arange(-round(RUN_UP_S / CONTROL_S), swim.t.size, dtype=np.float64)
    return Film(replace(swim, command=clip.angles(t, frames)), clip.beat * frames)


def _swim(recording: Recording, robot: s2r.Robot, frames: float) -> Swim:
    columns, back = dict(recording.columns), robot.links[0].com_m or 0.0
    yaw = np.unwrap(columns["body.yaw_rad"])
    columns["body.x_m"] = columns["body.x_m"] - back * np.cos(yaw)
    columns["body.y_m"] = columns["body.y_m"] - back * np.sin(yaw)
    t = recording.t * float(recording.metadata["frame_rate_hz"]) / frames
    return swim_of(replace(recording, t=t, columns=columns, command=recording.position), robot)


def errors(predicted: Array, held: Film) -> Array:
    """Root mean square errors of surge, sway, yaw rate; error of the mean surge, shape (4,)."""
    return _four(predicted[:, :3] - held.speeds)


def _four(off: Array) -> Array:
    return np.append(np.sqrt(np.mean(off**2, axis=0)), abs(off[:, 0].mean()))


def by_beat(train: Sequence[Film], held: Film) -> Array:
    """The trivial rival: speed in proportion to the beat, no sway, no turn, shape (T, 3)."""
    beat = np.array([one.beat_hz for one in train])
    speed = np.array([one.speeds[:, 0].mean() for one in train])
    out = np.zeros((held.swim.t.size, 3))
    out[:, 0] = held.beat_hz * (beat @ speed) / (beat @ beat)
    return out


def by_regression(train: Sequence[Film], held: Film) -> Array:
    """Speed by the beat; sway and yaw rate linear in the joints' angles (times the beat) and rates.

    Four numbers a signal and no water: what films tell without physics, shape (T, 3).
    """
    seen = np.concatenate([one.speeds[:, 1:] for one in train])
    weights = np.linalg.lstsq(np.concatenate([_motion(one) for one in train]), seen, rcond=None)[0]
    out = by_beat(train, held)
    out[:, 1:] = _motion(held) @ weights
    return out


def _motion(one: Film) -> Array:
    rate = np.gradient(one.angle, CONTROL_S, axis=0)
    return np.concatenate([2 * np.pi * one.beat_hz * one.angle, rate], axis=1)


def jitter(folder: Path, name: str, robot: s2r.Robot, frames: float) -> Array:
    """What the tracker's stated jitter makes of the four errors, by the same estimator."""
    rng = np.random.default_rng(0)
    recording = s2r.read_recording(folder / f"{name}.csv")
    sd = recording.metadata["noise_sd"]
    still = _swim(recording, robot, frames).signals[:, :3]

    def shaken() -> Array:
        moved = {
            column: recording.columns[column] + sd[column] * rng.standard_normal(recording.t.size)
            for column in _POSE
        }
        noisy = replace(recording, columns={**recording.columns, **moved})
        return _four(_swim(noisy, robot, frames).signals[:, :3] - still)

    return np.asarray(np.mean([shaken() for _ in range(_NOISY)], axis=0))


def beat(one: Film, speeds: Array) -> Array:
    """First harmonics of speeds (T, 3) and of the first joint's angle; complex, shape (4,)."""
    phase = 2 * np.pi * one.beat_hz * one.swim.t
    terms = np.stack([np.ones_like(phase), one.swim.t, np.cos(phase), np.sin(phase)], axis=1)
    known = np.column_stack([speeds[:, :3], one.angle[:, 0]])
    found = np.linalg.lstsq(terms, known, rcond=None)[0]
    return np.asarray(found[2] - 1j * found[3])


def irregular(one: Film) -> Array:
    """What three harmonics of the beat, fitted to the clip itself, leave of its speeds."""
    k = 2 * np.pi * one.beat_hz * one.swim.t[:, None] * np.arange(1, _HARMONICS + 1)
    terms = np.concatenate([np.ones_like(k[:, :1]), np.cos(k), np.sin(k)], axis=1)
    weights = np.linalg.lstsq(terms, one.speeds, rcond=None)[0]
    return _four(one.speeds - terms @ weights)
