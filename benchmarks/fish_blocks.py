"""The filmed fish with what its hull leaves out: appendages from the blocks of its makers.

Rules, the same for every block, none of them fitted to a clip:

- Blocks no wider and no higher than the hull of their link are within it. Those in one line act as
  one block of their largest face and whole length: the hull has their water and their resistance
  across, and lacks the drag of their blunt ends.
- What passes through that line counts outside it only, a stub on each side.
- An arm that stands behind another, no further than three of its heights, and reaches no further,
  is in its wake and has no drag along (two discs in line: Hoerner, Fluid-Dynamic Drag, 1965,
  ch. 8); across the link it resists.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import sim2real as s2r
from sim2real.appendages import Appendage
from sim2real.structured import read_toml

PLATES_AT_M = (0.377, 0.407, 0.439, 0.468, 0.489)
"""Middles of the tail's plates behind the front: markers 3 to 7 (the README of the clips)."""
WAKE = 3.0
"""Heights behind a plate in which another is in its wake."""


def with_blocks(robot: s2r.Robot, blocks: Path) -> s2r.Robot:
    """The robot with the blocks of ``blocks.toml`` on its head and its tail."""
    content = read_toml(blocks)
    head, tail, *rest = robot.links
    return replace(
        robot,
        links=(
            replace(head, appendages=tuple(head_blocks(content["head"], head))),
            replace(tail, appendages=tuple(arms(content["tail"], head.length_m))),
            *rest,
        ),
    )


def open_tail(robot: s2r.Robot, blocks: Path) -> s2r.Robot:
    """The robot with a tail as solid as its plates, which stand apart: the height is their share.

    The hull has them as one surface. Water passes between them; how much is not known, so this is a
    bound beside ``with_blocks`` and no part of it.
    """
    content = read_toml(blocks)["tail"]
    head, tail, *rest = robot.links
    share = len(content["plates_high_m"]) * content["plate_m"][0] / tail.length_m
    low = replace(tail, height_m=share * tail.height_m)
    return replace(robot, links=(head, low, *rest))


def head_blocks(blocks: Sequence[Mapping[str, Any]], head: Any) -> list[Appendage]:  # noqa: ANN401
    """The head's blocks: the line within the hull, then those outside."""
    boxes = [_box(block["name"], block["size_m"], block["at_m"]) for block in blocks]
    inside = [
        box
        for box in boxes
        if abs(box.at_m[1]) + box.size_m[1] / 2 <= head.width_m / 2
        and abs(box.at_m[2]) + box.size_m[2] / 2 <= head.height_m / 2
    ]
    line = _line(inside)
    outside = [part for box in boxes if box not in inside for part in _without(box, line)]
    return [line, *outside]


def arms(tail: Mapping[str, Any], hinge_m: float) -> list[Appendage]:
    """The tendon arms, one to each side of every plate."""
    along, high = tail["arm_m"]
    half = tail["plate_m"][1] / 2
    out: list[Appendage] = []
    before: tuple[float, float] | None = None
    for place, reach in zip(PLATES_AT_M, tail["arm_reach_m"], strict=True):
        wake = before is not None and place - before[0] <= WAKE * high and reach <= before[1]
        for side in (1, -1):
            at = (place - hinge_m, side * (half + reach / 2), 0.0)
            arm = _box(f"arm {len(out) + 1}", (along, reach, high), at)
            out.append(replace(arm, drag=(0.0, 0.0)) if wake else arm)
        before = place, reach
    return out


def _box(name: str, size: Sequence[float], at: Sequence[float]) -> Appendage:
    return Appendage(name, "box", (size[0], size[1], size[2]), (at[0], at[1], at[2]))


def _line(inside: Sequence[Appendage]) -> Appendage:
    front = min(box.at_m[0] - box.size_m[0] / 2 for box in inside)
    back = max(box.at_m[0] + box.size_m[0] / 2 for box in inside)
    widest = max(inside, key=lambda box: box.size_m[1] * box.size_m[2])
    return replace(
        widest,
        name=", ".join(box.name for box in inside),
        size_m=(back - front, *widest.size_m[1:]),
        at_m=((front + back) / 2, *widest.at_m[1:]),
        in_hull=True,
    )


def _without(box: Appendage, line: Appendage) -> list[Appendage]:
    """The parts of a box outside the line, if it passes through it."""
    half, through = line.size_m[1] / 2, box.size_m[1] / 2
    if abs(box.at_m[2]) > line.size_m[2] / 2 or abs(box.at_m[1]) + half >= through:
        return [box]
    parts = []
    for side, name in ((1, "left"), (-1, "right")):
        reach = through + side * box.at_m[1] - half
        size = (box.size_m[0], reach, box.size_m[2])
        at = (box.at_m[0], side * (half + reach / 2), box.at_m[2])
        parts.append(_box(f"{box.name}, {name}", size, at))
    return parts
