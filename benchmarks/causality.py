"""How surely position and command that are swapped are told from ones that are not.

    python benchmarks/causality.py RECORDING.csv...

For every joint that moves, as recorded and with its two columns swapped: how much more every later
shift of the position leaves unexplained than the best earlier one (``sim2real.plausible``). Prints
quantiles and the shares on the wrong side of ``UNEXPLAINED_RATIO``; the shipped
recordings, those of ``shared/realdata`` and inputs of ``datasets/concealed`` and
``datasets/foreign`` set that number.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.plausible import UNEXPLAINED_RATIO, lead_s, matches
from sim2real.recording import read_recording


def joints(path: Path) -> list[tuple[str, Array, Array, Array]]:
    """Name, times, commands and filled positions of the joints of a recording that move."""
    recording = read_recording(path)
    found = []
    for j, joint in enumerate(recording.joints):
        powered = recording.powered(j)
        t, command = recording.t[:powered], recording.command[:powered, j]
        position = recording.position[:powered, j]
        seen = np.isfinite(position)
        if powered > 1 and seen.any() and np.ptp(command) > 0 and np.ptp(position[seen]) > 0:
            found.append((joint, t, command, np.interp(t, t[seen], position[seen])))
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recordings", nargs="+", type=Path)
    ratios: dict[str, list[float]] = {"as recorded": [], "swapped": []}
    refused = dict.fromkeys(ratios, 0)
    worst = ("", 0.0)
    for path in parser.parse_args().recordings:
        try:
            moving = joints(path)
        except InputError as error:
            print(f"left out: {error}")
            continue
        for joint, t, command, position in moving:
            for way, pair in (
                ("as recorded", (command, position)),
                ("swapped", (position, command)),
            ):
                found = matches(t, *pair)
                if found is None:
                    continue
                ratio = found[1].unexplained / max(found[0].unexplained, 1e-12)
                ratios[way].append(ratio)
                refused[way] += lead_s(t, *pair) is not None
                if way == "as recorded" and ratio > worst[1]:
                    worst = (f"{path}, {joint}", ratio)
    print(
        f"{'':12} {'joints':>6} {'5 %':>8} {'median':>8} {'95 %':>8} {'largest':>8} {'refused':>8}"
    )
    for way, values in ratios.items():
        quantiles = " ".join(f"{x:8.3f}" for x in np.quantile(values, [0.05, 0.5, 0.95, 1.0]))
        print(f"{way:12} {len(values):6d} {quantiles} {refused[way]:8d}")
    print(f"threshold {UNEXPLAINED_RATIO:g}; largest as recorded: {worst[0]}")


if __name__ == "__main__":
    main()
