"""The page of the real fish: what ``real_fish.py`` and ``real_fish_diagnosis.py`` found.

python benchmarks/real_fish_page.py [FOLDER]    # reads and writes reports/real_fish*
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import real_fish_twin_figure as twin_figure
import real_fish_twin_page as twin_page

Found = dict[str, Any]

CLIPS = ("f0_75", "f1_25", "f1_75", "f2_25")
RIVAL_M_S = 0.019
_HEAD = """# A real fish, filmed: what the fluid and the twin say of it

Four clips of a tendon-driven robot fish (0.56 m, filmed from above; M. Y. Michelis et al., arXiv
2602.23283). Its joint angles (three harmonics of the beat) move a simulated fish whose body is
free, with the boxes, bars and arms that its hull leaves out: in the lattice-Boltzmann pool and in
the reduced-order twin (part 1). The twin is fast enough to be calibrated and diagnosed (part 2).

{short}

## 1. Speed, with what the hull leaves out

`python benchmarks/real_fish.py FOLDER --device cuda:0 --cells 0.01 0.0067`. Speeds are m/s along
the fish's own heading; nothing is fitted except the one number where stated.

![Predicted and measured speed and yaw against the beat](real_fish.png)

### What the appendages resist

By shape and size alone (`sim2real/bluff_bodies.py`, rules in `benchmarks/fish_blocks.py`):

| | drag area along (cm2) | across (cm2) | added mass along (g) | across (g) |
|---|---:|---:|---:|---:|
{areas}

They move through undisturbed water; the water of the fluid does not receive their momentum.
"""
_REST = """
### What it says

- **The bars.** {bars}
- **The slope.** Measured speed grows by a factor of {grows:.1f} from the slowest clip to the
  fastest, predicted speed ({where}) by {predicted:.1f}: the tail beats three times as fast. A
  factor on the drag areas hardly changes that.
- **The head's yaw** is {yaw} the measured one ({where}; {yaw_without} without the appendages).
- **The tail is no surface.** Its five plates stand apart, 15 mm each every 30 mm, and the hull has
  them as one. With a tail no higher than their share (a bound, as water passes between them) the
  speeds are {ajar} m/s ({where}), and the yaw {ajar_yaw} the measured one.
- **The data**: angles are good to 5 to 10 %, speeds to 5 %; the time base is 1/60 or 1/80 s.
- **The float.** Hull and appendages displace 4 % less than the fish weighs; the head is {width:.1f}
  cm wide instead of 3.0, which lets the fish float with its box awash ({bare:.1f} cm without the
  appendages): Archimedes' principle, and no fit. Waves are not simulated.
"""


def main() -> None:
    """Read, write, draw."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "reports")
    found = json.loads((folder / "real_fish.json").read_text())
    twin = json.loads((folder / "real_fish_diagnosis.json").read_text())
    fluid_file = folder / "real_fish_fluid.json"
    fluid = json.loads(fluid_file.read_text()) if fluid_file.is_file() else None
    (folder / "real_fish.md").write_text(part(found, twin) + twin_page.section(twin, fluid))
    draw(found, folder / "real_fish.png")
    twin_figure.draw(twin, folder / "real_fish_diagnosis.png")


def short(found: Found, twin: Found) -> str:
    """The page in a few lines."""
    rows = ["| mean speed (m/s), errors at 60 frames a second | |", "|---|---:|"]
    for run in found["runs"]:
        one, where = run["at_60"], run["where"]
        before, after = np.mean(run["lacking"]["left_out"], axis=1)
        held = one["one_number"]["mean"]
        rows += [
            f"| {where}, nothing fitted | {one['error']:.3f} |",
            f"| {where}, one number fitted on two clips, held out | {held:.3f} |",
            f"| {where}, without the appendages, nothing fitted | {before:.3f} |",
            f"| ... with an area in their place, estimated from the other clips | {after:.3f} |",
        ]
    beat = twin["one_left_out"]["by the beat"]["mean"][3]
    rows += [
        f"| no simulator: speed in proportion to the beat | {beat:.3f} |",
        f"| a published simulator, five fitted on two of eight clips | {RIVAL_M_S} |",
    ]
    return "\n".join(rows)


def part(found: Found, twin: Found) -> str:
    """The first part of the report."""
    areas = [
        f"| {one['name']} | "
        + " | ".join(f"{v:.1f}" for v in 1e4 * np.array(one["area_m2"]))
        + " | "
        + " | ".join(f"{v:.0f}" for v in 998e3 * np.array(one["added_mass_m3"]))
        + " |"
        for one in found["appendages"]
    ]
    total = 1e4 * np.sum([one["area_m2"] for one in found["appendages"]], axis=0)
    areas.append(f"| **together** | **{total[0]:.0f}** | **{total[1]:.0f}** | | |")
    lines = [_HEAD.format(short=short(found, twin), areas="\n".join(areas))]
    for frames in ("60", "80"):
        lines += speeds(found["runs"], f"at_{frames}", frames)
    lines += lacking(found["runs"])
    finest = found["runs"][-1]
    one, ajar = finest["at_60"], finest["open_tail"]
    grows, predicted = (one[name][-1] / one[name][0] for name in ("measured", "plain"))
    lines.append(
        _REST.format(
            where=finest["where"], grows=grows, predicted=predicted, bars=bars(finest),
            yaw=_ratios(one["yaw_plain"], one["yaw_measured"]),
            yaw_without=_ratios(one["yaw_without"], one["yaw_measured"]),
            ajar=", ".join(f"{v:.3f}" for v in ajar["speed"]),
            ajar_yaw=_ratios(ajar["yaw"], one["yaw_measured"]),
            width=100 * found["head_width_m"][0], bare=100 * found["head_width_m"][1],
        )
    )  # fmt: skip
    return "\n".join(lines)


def bars(run: Found) -> str:
    """Which of the bars that were set before are met."""
    one, number = run["at_60"], run["at_60"]["one_number"]
    factors = [fit["factor"] for fit in number["fits"]]
    yaw = np.array(one["yaw_plain"]) / one["yaw_measured"]
    before, after = np.mean(run["lacking"]["left_out"], axis=1)
    fell = f"{100 * (1 - after / before):.0f} %"
    spread = f"{min(factors):.2f} to {max(factors):.2f}"
    checks = (
        ("nothing fitted, 0.030 m/s", f"{one['error']:.3f}", one["error"] <= 0.030),
        ("yaw within 20 %", f"up to {yaw.max():.2f} times", np.all(np.abs(yaw - 1) <= 0.2)),
        ("one number, held out, 0.012 m/s", f"{number['mean']:.3f}", number["mean"] <= 0.012),
        ("its factor from 0.7 to 1.4", spread, 0.7 <= min(factors) <= max(factors) <= 1.4),
        ("an area for what is missing, clips left out 40 % better", fell, after <= 0.6 * before),
    )
    lines = (f"{bar}: {value}, {'met' if met else '**missed**'}" for bar, value, met in checks)
    return f"In the {run['where']}: {'; '.join(lines)}."


def _ratios(values: Any, measured: Any) -> str:  # noqa: ANN401
    ratio = np.array(values) / np.array(measured)
    return f"{ratio.min():.2f} to {ratio.max():.2f} times"


def _row(name: str, values: Any, last: str = "") -> str:  # noqa: ANN401
    return f"| {name} | " + " | ".join(f"{v:.3f}" for v in values) + f" | {last} |"


def speeds(runs: list[Found], key: str, frames: str) -> list[str]:
    """The table of one time base."""
    base = "as published" if frames == "60" else "as the motor's label would have it"
    one = runs[-1][key]
    lines = [
        f"\n### {frames} frames a second, {base}\n",
        "| | " + " | ".join(CLIPS) + " | mean error |",
        "|---|" + "---:|" * (len(CLIPS) + 1),
        _row("beats a second", one["beat_hz"]),
        _row("measured", one["measured"]),
        _row("measured, body lengths a beat", one["lengths_a_beat"][0]),
    ]
    for run in runs:
        one, where = run[key], run["where"]
        number = one["one_number"]
        off = np.abs(np.array(one["without"]) - one["measured"]).mean()
        held = f"{where}, one number fitted on two clips, errors held out"
        lines += [
            _row(f"{where}, nothing fitted", one["plain"], f"{one['error']:.3f}"),
            _row(f"{where}, body lengths a beat", one["lengths_a_beat"][1]),
            _row(f"{where}, without the appendages", one["without"], f"{off:.3f}"),
            _row(held, number["held_out"], f"{number['mean']:.3f}"),
        ]
    for run in runs:
        factors = ", ".join(f"{fit['factor']:.2f}" for fit in run[key]["one_number"]["fits"])
        lines.append(
            f"\nFactors on the drag areas that two clips want ({run['where']}): {factors}."
        )
    return lines


def lacking(runs: list[Found]) -> list[str]:
    """What the file without the appendages seems to lack."""
    lines = [
        "\n### Without the appendages in the file: does anything resist?\n",
        "| | drag area (cm2) | 90 % | behind the front (cm) | evidence (nats) | errors of clips"
        " left out, before and after (m/s) |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for run in runs:
        one = run["lacking"]
        area = 1e4 * np.array([one["area_m2"][name] for name in ("mean", "q05", "q95")])
        before, after = np.mean(one["left_out"], axis=1)
        lines.append(
            f"| {run['where']} | {area[0]:.0f} | {area[1]:.0f} to {area[2]:.0f}"
            f" | {100 * one['x_m']['mean']:.0f} | {one['log_odds']:.0f} | {before:.3f}, {after:.3f}"
            f" ({100 * (after / before - 1):+.0f} %) |"
        )
    return lines


def draw(found: Found, target: Path) -> None:
    """Speed and yaw against the beat, and predicted against measured speed."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 4.2), layout="constrained")
    one = found["runs"][-1]["at_60"]
    left.plot(one["beat_hz"], one["measured"], "ko-", label="filmed")
    right.plot(one["beat_hz"], one["yaw_measured"], "ko-", label="filmed")
    colours = ("#19528c", "#b8381d", "#2f8f6b", "#7a5195")
    for run, colour in zip(found["runs"], colours, strict=False):
        one, where = run["at_60"], run["where"]
        left.plot(one["beat_hz"], one["plain"], "o-", color=colour, label=where)
        left.plot(one["beat_hz"], one["without"], "v:", color=colour, label=f"{where}, hull alone")
        middle.plot(one["measured"], one["plain"], "o", color=colour, label=where)
        middle.errorbar(
            one["measured"], one["measured"], np.array(one["one_number"]["held_out"]), fmt="none",
            color=colour, capsize=3,
        )  # fmt: skip
        right.plot(one["beat_hz"], one["yaw_plain"], "o-", color=colour, label=where)
        right.plot(one["beat_hz"], one["yaw_without"], "v:", color=colour)
    middle.plot([0, 0.4], [0, 0.4], color="0.7", linewidth=1, zorder=0)
    middle.set_title("bars: errors held out, one number fitted", fontsize=9)
    left.set(xlabel="beats a second", ylabel="speed (m/s)", ylim=(0, None))
    middle.set(xlabel="measured (m/s)", ylabel="predicted (m/s)", xlim=(0, 0.4), ylim=(0, 0.4))
    right.set(xlabel="beats a second", ylabel="amplitude of the head's yaw (rad)", ylim=(0, None))
    for axes in (left, middle, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=7, loc="lower right" if axes is middle else "best")
    figure.savefig(target, dpi=120)
    plt.close(figure)


if __name__ == "__main__":
    main()
