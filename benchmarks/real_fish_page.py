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

CLIPS = ("f0_75", "f1_25", "f1_75", "f2_25")
RIVAL_M_S = 0.019
_BY_HAND = ("<!-- by hand: begin -->", "<!-- by hand: end -->")
_HEAD = """# A real fish, filmed: what the fluid and the twin say of it

Four clips of a tendon-driven robot fish (0.56 m, filmed from above; M. Y. Michelis et al., arXiv
2602.23283). Its joint angles (three harmonics of the beat) move a simulated fish whose body is
free: in the lattice-Boltzmann pool (part 1), and in the reduced-order twin, which is fast enough to
be calibrated and diagnosed (part 2). In short, errors of clips that no fit has seen:

{short}

{kept}
## 1. Speed, in the fluid

`python benchmarks/real_fish.py`, on one H200. Speeds are m/s along the fish's own heading.

![Predicted against measured speed, and speed against the size of the cells](real_fish.png)
"""
_REST = """
### What explains the rest

- **The cells**, before anything else. With nothing fitted the predicted speed grows by 39 to 67 %
  from 1 to 0.67 cm and by a fifth more to 0.5 cm, and passes the measured one on the way: at 60
  frames a second the mean error is smallest at 0.67 cm. So an agreement at one size is no proof,
  and the finest is not the best. The tail is 3 mm thick, thinner than a cell at all of them.
- **The time base.** At 80 frames a second all measured speeds grow by 4/3; the predicted ones by
  1.30 to 1.34 in fine cells, that of `f0_75` by 1.5. The clips alone cannot say which is right.
- **The slope.** The fastest clip is 4.5 times as fast as the slowest; predicted at 1 cm it is 3 to
  4.1 times, whatever the drag and the scale of the angles. Five hinges are taken as one here, so
  that the tail's curvature is lost; whether that is the reason was not tested, nor were waves.
- **The fits** sit at the edge of what was tried in 4 of 12 cases at 1 cm and in all at 2 cm, and
  most want negative drag, which makes up for something else. Four clips and six splits are not the
  published eight clips and one split: 0.021 against 0.019 is no ranking.
- **The data**: angles are good to 5 to 10 %, speeds to 5 %.
- **The head's yaw** (rad), measured (predicted at 1 cm): {yaw}. The simulated head swings
  too far, the more so the faster the beat.
- **The shape.** The file has only the widest block under water; the head is made as wide as lets
  the fish float with its back at the surface ({width:.1f} cm), which is Archimedes' principle and
  no fit. Waves are not simulated.
- The predicted speeds still change by 0.002 to 0.010 m/s between the last two windows of four
  seconds, at 2 cm by up to 0.028: those are not steady.
"""


def main() -> None:
    """Read, write, draw."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "reports")
    found = json.loads((folder / "real_fish.json").read_text())
    twin = json.loads((folder / "real_fish_diagnosis.json").read_text())
    fluid_file = folder / "real_fish_fluid.json"
    fluid = json.loads(fluid_file.read_text()) if fluid_file.is_file() else None
    page = folder / "real_fish.md"
    kept = by_hand(page.read_text() if page.is_file() else "")
    page.write_text(table(found, short(found, twin), kept) + twin_page.section(twin, fluid))
    draw(found, folder / "real_fish.png")
    twin_figure.draw(twin, folder / "real_fish_diagnosis.png")


def by_hand(page: str) -> str:
    """What was written by hand into a page that is made anew: all between two marks, with them."""
    begin, end = (page.find(mark) for mark in _BY_HAND)
    return page[begin : end + len(_BY_HAND[1])] + "\n" if 0 <= begin < end else ""


def short(found: dict[str, Any], twin: dict[str, Any]) -> str:
    """The page in a few lines."""
    fluid = np.mean(found["cells"][-1]["at_60"]["held_out"])
    now, before, beat = (
        twin["one_left_out"][k]["mean"] for k in ("calibrated", "uncalibrated", "by the beat")
    )
    named = sum(split["effects"][0]["gain"] >= twin["enough"] for split in twin["splits"])
    return "\n".join(
        [
            "| mean speed (m/s) | |",
            "|---|---:|",
            f"| fluid in cells of 1 cm, two numbers fitted on two clips | {fluid:.3f} |",
            f"| twin, uncalibrated | {before[3]:.3f} |",
            f"| twin, calibrated on three clips | {now[3]:.3f} |",
            f"| no simulator: speed in proportion to the beat | {beat[3]:.3f} |",
            f"| a published simulator, five fitted on two of eight clips | {RIVAL_M_S} |",
            "",
            f"Calibration takes the yaw rate's error from {before[2]:.2f} to {now[2]:.3f} rad/s and"
            f" leaves the sway's at {now[1]:.3f} m/s. The diagnosis names"
            f" {f'an effect in {named} of 4 fits' if named else 'nothing'}: what is missing"
            f" {'may be' if named else 'is not'} in its catalogue.",
        ]
    )


def table(found: dict[str, Any], said: str, kept: str) -> str:
    """The first part of the report."""
    lines = [_HEAD.format(short=said, kept=kept)]
    for frames in ("60", "80"):
        best = found["cells"][-1][f"at_{frames}"]
        base = "as published" if frames == "60" else "as the motor's label would have it"
        lines += [
            f"\n### {frames} frames a second, {base}\n",
            "| | " + " | ".join(CLIPS) + " | mean error |",
            "|---|" + "---:|" * (len(CLIPS) + 1),
            "| measured | " + " | ".join(f"{v:.3f}" for v in best["measured"]) + " | |",
        ]
        measured = np.array(best["measured"])
        k = 0 if frames == "60" else 1
        rows = [(row["cell_m"], row[f"at_{frames}"]["plain"]) for row in found["cells"]]
        rows += [(row["cell_m"], np.array(row["speed"])[:, k]) for row in found["fine"]]
        for cell, plain in rows:
            error = np.abs(np.array(plain) - measured).mean()
            shown = " | ".join(f"{v:.3f}" for v in plain)
            lines.append(f"| nothing fitted, {100 * cell:g} cm | {shown} | {error:.3f} |")
        for row in found["cells"]:
            held = row[f"at_{frames}"]["held_out"]
            shown = " | ".join(f"{v:.3f}" for v in held)
            lines.append(
                f"| two fitted on two clips, mean error when held out, {100 * row['cell_m']:g} cm"
                f" | {shown} | {np.mean(held):.3f} |"
            )
        lines.append(
            f"| a published simulator, five fitted on two of eight | | | | | {RIVAL_M_S} |"
        )
        fits = ", ".join(f"{f['drag']:+.2f} and {f['angles']:.2f}" for f in best["fits"])
        lines.append(f"\nForm drag and scale of the angles that were fitted at 1 cm: {fits}.")
    one = found["cells"][-1]["at_60"]
    yaw = ", ".join(
        f"{m:.3f} ({p:.3f})" for m, p in zip(one["yaw_measured"], one["yaw_plain"], strict=True)
    )
    lines.append(_REST.format(yaw=yaw, width=100 * found["head_width_m"]))
    return "\n".join(lines) + "\n"


def draw(found: dict[str, Any], target: Path) -> None:
    """Predicted against measured, and predicted against the cell."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
    row = found["cells"][-1]
    for frames, colour in (("60", "#19528c"), ("80", "#b8381d")):
        one = row[f"at_{frames}"]
        measured = np.array(one["measured"])
        spread = np.array(one["held_out"])
        left.plot(measured, one["plain"], "o", color=colour, label=f"{frames} frames/s")
        fitted = measured + np.array(one["held_out_signed"])
        left.errorbar(
            measured, fitted, spread, fmt="s", mfc="none", color=colour, capsize=3,
            label=f"{frames} frames/s, two fitted, held out",
        )  # fmt: skip
    left.plot([0, 0.32], [0, 0.32], color="0.6", linewidth=1)
    left.set(xlabel="measured (m/s)", ylabel="predicted, 1 cm cells (m/s)", xlim=(0, 0.32))
    left.legend(frameon=False, fontsize=8)
    sizes = [r["cell_m"] for r in found["cells"]] + [r["cell_m"] for r in found["fine"]]
    for k, clip in enumerate(CLIPS):
        speeds = [r["at_60"]["plain"][k] for r in found["cells"]]
        speeds += [r["speed"][k][0] for r in found["fine"]]
        (drawn,) = right.plot(100 * np.array(sizes), speeds, "o-", label=clip)
        right.axhline(row["at_60"]["measured"][k], color=drawn.get_color(), linestyle=":")
    right.invert_xaxis()
    right.set(
        xlabel="side of a cell (cm)",
        ylabel="speed (m/s), 60 frames/s",
        title="nothing fitted; dotted: measured",
    )
    right.legend(frameon=False, fontsize=8)
    figure.savefig(target, dpi=120)


if __name__ == "__main__":
    main()
