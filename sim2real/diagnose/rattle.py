"""A rattle: a narrow peak in the spectrum of a residual, above the frequencies of the motion.

An output that is free in its gap bounces between the flanks of its gears, also at rest. The limit
cycle is chaotic, so no trajectory fit can follow it; what remains is a peak at its frequency or an
alias of it. A vibration from outside has such a peak too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import periodogram

from sim2real.arrays import Array
from sim2real.diagnose.decision import DECISION
from sim2real.servo.trace import Trace
from sim2real.units import readable

BAND_HZ, LOWEST_HZ = 1.0, 4.0
"""Width of a band of the spectrum, and where bands begin."""
GAP_SHARES = 0.035, 0.2
"""Standard deviation of a rattle over the gap, of 16 simulated gear trains at rest.

With friction or a weight that holds the output, or with well damped flanks, none rattles."""


@dataclass(frozen=True)
class Rattle:
    """A rattle of a joint."""

    frequency_Hz: float  # of the peak, or an alias
    sd_rad: float  # its standard deviation
    ratio: float  # power in the peak's band over the median band

    def __str__(self) -> str:
        """The rattle in words, with the gaps that would make it."""
        gaps = (self.sd_rad / share for share in GAP_SHARES)
        size, most, least = (readable("gap_rad", x) for x in (self.sd_rad, *gaps))
        return (
            f"also at rest: a rattle of {size} near {self.frequency_Hz:.0f} Hz or an alias, as of "
            f"gears with a gap of {least} to {most}, or a vibration from outside"
        )


def rattles(joints: Sequence[Sequence[Trace]], residuals: Array) -> list[Rattle | None]:
    """The rattle of each of N joints, None without one, from residuals in rad, shape (N, R, T).

    What several joints have at one frequency is a vibration of the bench.
    """
    found = []
    for traces, of_joint in zip(joints, residuals, strict=True):
        pairs = zip(traces, of_joint, strict=False)
        found.append(rattle([t.t for t in traces], [r[: t.t.size] for t, r in pairs]))
    at = np.array([one.frequency_Hz if one else np.nan for one in found])
    alone = (np.abs(at[:, None] - at) <= BAND_HZ).sum(axis=1) == 1
    return [one if single else None for one, single in zip(found, alone, strict=True)]


def rattle(
    times: Sequence[Array], residuals: Sequence[Array], least: float = DECISION.report.rattle_ratio
) -> Rattle | None:
    """The peak in the spectra of a joint's residuals in rad at times in s, None without one.

    The peak's band has ``least`` times the power of the median band, and twice that of every band
    from the lowest to two below it: the residual of a motion that is modelled badly falls with
    frequency instead.
    """
    spectra = [_bands(t, e) for t, e in zip(times, residuals, strict=True)]
    count = min((s.size for s in spectra), default=0)
    if count < 6:
        return None
    power = np.mean([s[:count] for s in spectra], axis=0)
    floor, top = float(np.median(power)), int(power.argmax())
    ratio = float(power[top]) / max(floor, 1e-300)
    moving = top < 2 or (2 * power[: top - 1] > power[top]).any()
    if moving or ratio < least:
        return None
    around = power[top - 2 : top + 3]
    sd = float(np.sqrt(np.sum(np.maximum(around - floor, 0.0))))
    return Rattle(LOWEST_HZ + BAND_HZ * (top + 0.5), sd, ratio)


def _bands(t: Array, residual: Array) -> Array:
    """Power in rad2 in each band, of a residual without gaps."""
    known = np.isfinite(residual)
    step = float(np.median(np.diff(t)))
    grid = np.arange(t[0], t[-1], step)
    even = np.interp(grid, t[known], residual[known])
    frequency, density = periodogram(even, 1 / step, "hann")
    edges = np.arange(LOWEST_HZ, frequency[-1], BAND_HZ)
    return np.histogram(frequency, edges, weights=density * frequency[1])[0]
