"""Real recordings of servos, and rigs in one condition: the backgrounds of the tiers T2 and T3.

``xl330_200`` and ``xl330_800`` (a pendulum at two firmware gains), the four swings of EMPS (metres
read as radians, every fourth sample, each from a turning point; all have the same command, and
repeat within 0.3 um), and each STS3215 log cut into segments of 6 s before the tested servo steps.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rng = np.random.Generator

XL330 = ("sin_sin", "sin_time_square", "up_and_down")
DROP = "lift_and_drop"
COUNT_RAD = 2 * np.pi / 4096
THIN = 4
EMPS_TURNS = (0, 6224, 12464, 18704, 24841)


@dataclass(frozen=True)
class Log:
    """A real recording: times (T,), set-points and angles (T, J) and stated loads."""

    name: str
    family: str
    t: Array
    command: Array
    position: Array
    load: dict[str, float]
    supply_V: Array
    duty: Array

    @property
    def joints(self) -> list[str]:
        """Names of the joints."""
        return [f"j{k + 1}" for k in range(self.position.shape[1])]

    @property
    def step(self) -> float:
        """Of the sensor, rad."""
        return 5e-8 if self.family == "emps" else COUNT_RAD

    def rows(self, keep: NDArray[Any]) -> Log:
        """Some samples of it."""
        names = ("t", "command", "position", "supply_V", "duty")
        return replace(self, **{name: getattr(self, name)[keep] for name in names})

    def reads(self, j: int, angle: Array) -> Log:
        """With other angles of a joint."""
        position = self.position.copy()
        position[:, j] = angle
        return replace(self, position=position)

    def fine(self) -> Log:
        """With angles between the steps of the sensor that round to the recorded ones."""
        if self.family == "emps":
            return self
        kernel, half = np.ones(9) / 9, 0.49 * self.step
        padded = np.pad(self.position, ((4, 4), (0, 0)), mode="edge")
        smooth = np.stack([np.convolve(x, kernel, "valid") for x in padded.T], axis=1)
        angles = np.clip(smooth, self.position - half, self.position + half)
        return replace(self, position=angles)

    def rounded(self) -> Log:
        """With angles rounded to the steps of the sensor."""
        return replace(self, position=np.round(self.position / self.step) * self.step)

    def sends(self, j: int, command: Array) -> Log:
        """With other set-points of a joint."""
        changed = self.command.copy()
        changed[:, j] = command
        return replace(self, command=changed)


def backgrounds(folder: Path) -> dict[str, list[Log]]:
    """Logs of one rig in one condition, by group; those of the XL330 end with lift_and_drop."""
    groups = {}
    for gain in (200, 800):
        paths = [folder / "bam_xl330" / f"xl330_kp{gain}_{n}.csv" for n in (*XL330, DROP)]
        groups[f"xl330_{gain}"] = [_read(path, "xl330") for path in paths]
    for name in ("single", "nocomp2", "pgain_zero_db"):
        whole = _read(folder / "sts3215_backlash" / f"{name}.csv", "sts")
        groups[name] = list(_segments(whole))
    data = pd.read_csv(folder / "emps" / "emps.csv")
    groups["emps"] = []
    for k, (start, stop) in enumerate(zip(EMPS_TURNS[:-1], EMPS_TURNS[1:], strict=True)):
        part = data.iloc[start:stop:THIN]
        t, command, angle = (part[c].to_numpy(float) for c in ("t_s", "reference_m", "position_m"))
        empty = np.full(t.size, np.nan)
        angles = command[:, None], angle[:, None]
        log = Log(f"emps_{k + 1}", "emps", np.round(t - t[0], 6), *angles, {}, empty, empty)
        groups["emps"].append(log)
    return groups


def _read(path: Path, family: str) -> Log:
    table = pd.read_csv(path)
    about = json.loads(path.with_suffix(".json").read_text())
    command, position = (
        np.stack([table[f"{j}.{q}"].to_numpy(float) for j in about["joints"]], axis=1)
        for q in ("command_rad", "position_rad")
    )
    t, duty = table["t_s"].to_numpy(float), table["j1.load"].to_numpy(float)
    supply = table["supply_V"].to_numpy(float) if "supply_V" in table else np.full(t.size, np.nan)
    load = about["loads"].get("j1", {})
    return Log(path.stem, family, t, command, position, load, supply, duty)


def _segments(log: Log) -> Iterator[Log]:
    """Cut three samples before the tested servo steps away from 0."""
    away = np.abs(log.command[:, 0]) > 0.1
    cuts = [0, *(np.flatnonzero(away[1:] & ~away[:-1]) - 2), log.t.size]
    for k, (start, stop) in enumerate(zip(cuts[:-1], cuts[1:], strict=True)):
        if stop - start > 40:
            part = log.rows(np.arange(start, stop))
            yield replace(part, name=f"{log.name}_{k + 1}", t=np.round(part.t - part.t[0], 6))


def noise_rad(log: Log, j: int) -> float:
    """What an autoregression of the angle leaves, rad, by its median, as steps are no noise.

    Not less than rounding.
    """
    angle, order = log.position[:, j], 12
    if log.family == "sts":  # few samples, between steps
        left = np.diff(angle)
    else:
        past = np.lib.stride_tricks.sliding_window_view(angle, order)[:-1]
        past = np.column_stack([past, np.ones(len(past))])
        left = angle[order:] - past @ np.linalg.lstsq(past, angle[order:], rcond=None)[0]
    return float(max(1.4826 * np.median(np.abs(left)), log.step / np.sqrt(12)))


def rms(x: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(x**2)))


def rate(x: Array, t: Array) -> Array:
    """Its derivative."""
    return np.asarray(np.gradient(x, t))
