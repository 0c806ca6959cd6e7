"""Tier T2: real recordings with known changes put into them.

The truth is exact for angles between the sensor's steps that round to the recorded ones (a moving
mean kept within half a step); the result is rounded again. ``a`` and ``c`` of the XL330 are never
``lift_and_drop``; half of its cases give the three other trajectories as references, so that ``c``
comes from one of these (``heldout_background`` is ``also a reference``), else ``c`` is ``unseen``.
Traps are nulls with gaps in the clock; a tenth of the other cases has them too.

``strength`` is the root mean square change of ``change_of`` (angle or set-point) over
``noise_rad``, what an autoregression (STS3215: the last value) leaves of the untouched ``a``.
That is the least noise there can be: a reference model misses 3 to 80 mrad on the XL330.
``real_oracle.py`` says what could be seen.

The stretches of the STS3215 log ``single`` are the library's bank of unchanged recordings and in no
case.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
from backgrounds import Log, Rng, noise_rad, rms
from real_effects import EFFECTS, SIZE_RAD, Change, Parameters
from real_outside import OUTSIDERS, Window, draw_window

COUNTS = {"null": 46, "single": 50, "double": 10, "outside": 24}
TRAP_SHARE = 0.2  # of the nulls
DISORDERED = 0.1  # of the others
BANK = ("single",)
"""Recordings that say how large changes look where there are none; beside ``lift_and_drop``."""


class Unseen(Exception):
    """No window of a log shows what was drawn."""


def injected(groups: dict[str, list[Log]], counts: dict[str, int], rng: Rng) -> list[Any]:
    """Cases of T2 in random order: recordings by name, and the answer."""
    plan: list[tuple[str, tuple[str, ...]]] = [("null", ())] * counts["null"]
    names, others = rng.permutation(list(EFFECTS)), rng.permutation(list(OUTSIDERS))
    plan += [("single", (str(names[k % names.size]),)) for k in range(counts["single"])]
    for _ in range(counts["double"]):
        pair = {str(n) for n in rng.choice(names[names != "latency_jitter"], 2, replace=False)}
        plan.append(("double", tuple(n for n in EFFECTS if n in pair)))
    plan += [("outside", (str(others[k % others.size]),)) for k in range(counts["outside"])]
    traps = int(np.ceil(TRAP_SHARE * counts["null"]))
    seen: set[Any] = set()
    cases: list[Any] = []
    for k, (kind, hidden) in enumerate(plan):
        trap = "clock" if k < traps else ""
        disorder = bool(trap) or (kind != "null" and rng.random() < DISORDERED)
        while len(cases) == k:
            with suppress(Unseen):
                name = "trap" if trap else kind
                cases.append(_case(groups, name, hidden, disorder, seen, rng))
    return [cases[i] for i in rng.permutation(len(cases))]


def _case(
    groups: dict[str, list[Log]],
    kind: str,
    hidden: tuple[str, ...],
    disorder: bool,
    seen: set[Any],
    rng: Rng,
) -> Any:
    changes = {name: (EFFECTS | OUTSIDERS)[name] for name in hidden}
    while True:
        takes, heldout = _takes(groups, rng)
        log = takes["a"]
        key = tuple(take.name for name, take in takes.items() if name != "c")
        if any(log.family not in change.families for change in changes.values()):
            continue
        jerky = not all(_starts_gently(takes[name]) for name in ("a", "c"))
        if "command_filter" in changes and jerky:
            continue
        if kind != "null" or key not in seen:  # no null twice
            break
    if kind == "null":
        seen.add(key)
    untouched = {name: take.name for name, take in takes.items()}
    j = int(rng.integers(len(log.joints)))
    noise = noise_rad(log, j)
    if changes:
        fine = {name: take.fine() for name, take in takes.items() if name[:3] != "ref"}
        takes |= fine
    effects: list[Any] = []
    windows: dict[str, list[Window]] = {}
    for name, change in changes.items():
        low, high = (10, 100) if kind == "outside" else (0.3, 60)
        size = SIZE_RAD[log.family] * low * (high / low) ** rng.uniform()
        p = change.draw(log, j, float(size), rng)
        least = 3 * noise if kind == "outside" else 0.0
        after = {}
        for each in takes:
            if not each.startswith("ref"):
                after[each], window = _put(change, takes[each], j, p, least, rng)
                if window:
                    windows[each] = [window]
        column = "command" if name in ("command_filter", "latency_jitter") else "position"
        moved = rms(getattr(after["a"], column)[:, j] - getattr(takes["a"], column)[:, j])
        takes |= after
        about = {"noise_rad": noise, "change_rms_rad": moved, "change_of": column}
        effects.append(
            {
                "effect": name,
                "component": change.component or log.joints[j],
                "parameters": p if kind != "outside" else {},
                "strength": moved / noise,
                "driver": change.driver,
                "detail": about | (p if kind == "outside" else {}),
            }
        )
    if changes:
        takes |= {name: takes[name].rounded() for name in fine}
    if disorder:
        takes["a"] = gaps(takes["a"], rng)
    about = {"trap": "clock" if kind == "trap" else "", "clock_disturbed": disorder}
    about |= {"windows_s": windows, "heldout_background": heldout}
    return takes, answer_of("T2", kind, effects, untouched, about)


def answer_of(
    tier: str, kind: str, effects: list[Any], background: dict[str, str], more: dict[str, Any]
) -> dict[str, Any]:
    """An answer about logs by name; ``more`` is what is not as in most answers."""
    driver = effects[0]["driver"] if effects else "none"
    told = {"tier": tier, "kind": kind, "trap": "", "clock_disturbed": False, "model_given": "none"}
    told |= {"effects": effects, "windows_s": {}, "driver": driver, "background": background}
    return told | more | {"oracle": {}}


def _starts_gently(log: Log) -> bool:
    steps = np.abs(np.diff(log.command[:, 0]))
    return bool(steps[0] < 0.1 * np.nanmax(steps))


def _put(
    change: Change, log: Log, j: int, p: Parameters, least: float, rng: Rng
) -> tuple[Log, Window | None]:
    """A log with a change; where it has a window, one in which it shows."""
    if change.lasts_s is None:
        return change.put(log, j, p, rng), None
    for _ in range(1000):
        window = draw_window(change, log, rng)
        after = change.put(log, j, p | {"window_s": window}, rng)
        moved = after.position[:, j] - log.position[:, j]
        inside = (log.t >= window[0]) & (log.t <= window[1])
        if rms(moved[inside]) >= least:
            return after, window
    raise Unseen


def _takes(groups: dict[str, list[Log]], rng: Rng) -> tuple[dict[str, Log], str]:
    """References, a, sometimes b, and c from one group; and whether c is also a reference."""
    weights = {"xl330_200": 0.35, "xl330_800": 0.35, "emps": 0.12}
    names = [name for name in groups if name not in BANK]
    shares = np.array([weights.get(name, 0.09) for name in names])
    logs = groups[str(rng.choice(names, p=shares / shares.sum()))]
    order = [logs[k] for k in rng.permutation(3 if logs[0].family == "xl330" else len(logs))]
    if logs[0].family == "xl330":
        a, c = order[:2]
        unseen = bool(rng.random() < 0.5)
        references, rest = [*([] if unseen else [c]), order[2], logs[3]], []
        heldout = "unseen" if unseen else "also a reference"
    else:
        a, c, *rest = order
        references, rest = rest[:2], rest[2:]
        heldout = "same command" if a.family == "emps" else "unseen"
    named = {f"ref_{k + 1}": log for k, log in enumerate(references)}
    return named | {"a": a} | dict(zip("b", rest, strict=False)) | {"c": c}, heldout


def gaps(log: Log, rng: Rng) -> Log:
    """With rows missing, single ones and some in a row; the first few and the last stay."""
    out = set(rng.integers(5, log.t.size - 1, size=int(rng.integers(3, 12))).tolist())
    for _ in range(int(rng.integers(1, 4)) if log.t.size > 500 else 0):
        start = int(rng.integers(20, log.t.size - 60))
        out |= set(range(start, start + int(rng.integers(5, 50))))
    return log.rows(np.array([k for k in range(log.t.size) if k not in out]))
