"""The report of ``benchmarks/peers.py``: table, figures as JSON, and the picture of the XL330."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers import BAM_OWN, METHODS, REPORT, SIMULATED, Fold, answer_path
from sim2real.output import write_json
from sim2real.recording import read_recording
from sim2real.report.style import ACCENT, INK, MUTED, house_style, new_figure

TITLES = {
    "sim2real": "**sim2real**",
    "hand": "by hand",
    "position": "mujoco.sysid, position actuator",
    "dcmotor": "mujoco.sysid, DC motor",
    "bam_published_m6": "BAM, published M6",
} | {f"bam_m{n}": f"BAM, M{n}" for n in range(1, 7)}
TEMPLATE = Path(__file__).with_suffix(".md")
DRAWN = "kp800_sin_sin"
HEIGHT_POINTS, DPI, MARGIN_INCHES = 400, 120, 0.1
Answers = Mapping[tuple[str, str], dict[str, Any]]
"""Answers by names of fold and method."""


def write_report(work: Path, folds: Sequence[Fold]) -> None:
    """Write ``peers.json``, ``README.md`` and, where the real recordings are, ``xl330.png``."""
    answers = {
        (fold.name, method): json.loads(path.read_text())
        for fold in folds
        for method in METHODS
        if (path := answer_path(work, fold, method)).is_file()
    }
    if not answers:
        raise SystemExit(f"no answers in {work}")
    REPORT.mkdir(parents=True, exist_ok=True)
    kept = {
        f"{fold} {method}": {k: v for k, v in answer.items() if k != "predictions"}
        for (fold, method), answer in answers.items()
    }
    write_json(REPORT / "peers.json", kept)
    by_protocol = {
        p: [f for f in folds if f.protocol == p] for p in ("within", "across", "simulated")
    }
    text = TEMPLATE.read_text().format(
        within=errors_table(answers, by_protocol["within"]),
        across=errors_table(answers, by_protocol["across"]),
        simulated=errors_table(answers, by_protocol["simulated"]),
        gains=recovery_table(answers, by_protocol["simulated"]),
        trials=_trials(answers),
    )
    (REPORT / "README.md").write_text(text)
    drawn = [fold for fold in folds if fold.name == DRAWN]
    if drawn and all((DRAWN, m) in answers for m in ("sim2real", "hand")):
        draw(drawn[0], answers)


def errors_table(answers: Answers, folds: Sequence[Fold]) -> str:
    """Mean errors in mrad and mean seconds of one fit, by method; then each fold's mean error.

    A method that has not answered all folds is averaged over those that it has, beside
    ``sim2real`` on the same ones.
    """
    columns = [fold for fold in folds if (fold.name, "sim2real") in answers]
    head = ["method", "folds", "mean absolute error", "sim2real, same folds", "RMSE", "CPU s a fit"]
    rows = [[*head, *(fold.name.replace("_", " ") for fold in columns)]]
    for method in METHODS:
        done = [fold.name for fold in columns if (fold.name, method) in answers]
        if not done:
            continue
        seconds = np.mean([answers[name, method]["cpu_s"] for name in done])
        elsewhere = any("machine" in answers[name, method] for name in done)
        spent = "" if method == BAM_OWN else f"{seconds:.0f}" + ("\\*" if elsewhere else "")
        means = [
            f"{np.mean([_mrad(answers[name, who], which) for name in done]):.1f}"
            for who, which in ((method, "mae"), ("sim2real", "mae"), (method, "rmse"))
        ]
        found = [
            f"{_mrad(answers[f.name, method], 'mae'):.1f}" if f.name in done else ""
            for f in columns
        ]
        rows.append([TITLES[method], f"{len(done)} of {len(columns)}", *means, spent, *found])
    return _table(rows)


def _mrad(answer: Mapping[str, Any], which: str) -> float:
    """An answer's mean error over its recordings and joints."""
    return 1e3 * float(np.mean(list(answer[f"{which}_rad"].values())))


def recovery_table(answers: Answers, folds: Sequence[Fold]) -> str:
    """How far gains and latencies are from the truth, and how many intervals hold it."""
    truth = json.loads((SIMULATED / "truth.json").read_text())["joints"]
    rows = [["method", "kp", "kd", "latency (ms)", "90 % intervals that hold the truth"]]
    for method in ("sim2real", "hand", "position", "dcmotor"):
        off: dict[str, list[float]] = {"kp": [], "kd": [], "latency": []}
        held, count = 0, 0
        for fold in folds:
            for joint, values in answers.get((fold.name, method), {}).get("parameters", {}).items():
                found, intervals = _gains(method, joint, values, answers[fold.name, method])
                true = {k: truth[joint][f"{k}{unit}"] for k, unit in UNITS.items()}
                off["kp"].append(abs(found["kp"] / true["kp"] - 1))
                off["kd"].append(abs(found["kd"] / true["kd"] - 1))
                off["latency"].append(abs(found["latency"] - true["latency"]))
                held += sum(low <= true[k] <= high for k, (low, high) in intervals.items())
                count += len(intervals)
        if off["kp"]:
            errors = [f"{100 * np.mean(off[k]):.1f} %" for k in ("kp", "kd")]
            share = f"{held} of {count}" if count else "none given"
            rows.append([TITLES[method], *errors, f"{1e3 * np.mean(off['latency']):.2f}", share])
    return _table(rows)


UNITS = {"kp": "_Nm_per_rad", "kd": "_Nms_per_rad", "latency": "_s"}


def _gains(
    method: str, joint: str, values: Mapping[str, Any], answer: Mapping[str, Any]
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """kp, kd and latency of a joint, and their intervals."""
    names = {k: f"{k}{unit}" for k, unit in UNITS.items()}
    if method == "sim2real":
        found = {k: values[name] for k, name in names.items()}
        return found, {k: values["interval"][name] for k, name in names.items()}
    own = {"kp": "kp", "kd": "kd", "latency": "delay"}
    intervals = answer["intervals"][joint]
    found = {k: values[name] for k, name in own.items()}
    return found, {k: intervals[name] for k, name in own.items() if name in intervals}


def _trials(answers: Answers) -> str:
    """What BAM's searches were given."""
    rows = []
    for method in (m for m in METHODS if m.startswith("bam_m")):
        fits = [a for (_, m), a in answers.items() if m == method]
        if fits:
            given = sorted(a["trials"]["j1"] for a in fits)
            many = f"{given[0]:,}" + (f" to {given[-1]:,}" if given[-1] > given[0] else "")
            rows.append(f"{TITLES[method]}: {many} trials a fit")
    timed = [answer for answer in answers.values() if "own_cpu_s_a_trial" in answer]
    own = [answer["own_cpu_s_a_trial"]["j1"] for answer in timed]
    far = [answer["compiled_minus_own_rad"]["j1"] for answer in timed]
    if not rows or not own:
        return "It was not run."
    return (
        f"{'; '.join(rows)} (its default: 100,000). One trial takes its own code "
        f"{1e3 * np.mean(own):.0f} ms of CPU, so its default takes "
        f"{100_000 * np.mean(own) / 3600:.1f} hours; the CPU seconds here are those of the "
        f"compiled loop, which agrees with its own to {max(far):.0e} rad."
    )


def draw(fold: Fold, answers: Answers) -> None:
    """Measured and predicted angles of a trajectory that no fit has seen, and both errors."""
    (recording,) = map(read_recording, fold.score)
    powered = recording.powered(0)
    t, measured = recording.t[:powered], np.degrees(recording.position[:powered, 0])
    lines = {
        method: np.degrees(answers[fold.name, method]["predictions"]["j1"][recording.name])
        for method in ("hand", "sim2real")
    }
    mean = {m: np.mean(np.abs(angle - measured)) for m, angle in lines.items()}
    words = {
        "hand": f"simulator tuned by hand: off by {mean['hand']:.1f}° on average",
        "sim2real": f"simulator identified by sim2real: {mean['sim2real']:.1f}°",
    }
    look: dict[str, dict[str, Any]] = {
        "hand": {"color": MUTED, "linewidth": 1.4},
        "sim2real": {"color": ACCENT, "linewidth": 1.8},
    }
    with house_style():
        figure = new_figure(
            HEIGHT_POINTS, "A real servo's angle, two simulations of it and their errors"
        )
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        above.plot(t, measured, color=INK, linewidth=2.6, label="real servo")
        for method, angle in lines.items():
            above.plot(t, angle, label=words[method], **look[method])
            below.plot(t, angle - measured, **look[method])
        below.axhline(0, color=INK, linewidth=0.8)
        above.set_title("A real Dynamixel XL330 turns a pendulum: a motion that neither has seen")
        above.set_ylabel("angle (°)")
        below.set_ylabel("error (°)")
        below.set_xlabel("time (s)", color=MUTED)
        above.legend(loc="upper center", ncols=3, bbox_to_anchor=(0.5, 1.04))
        above.set_ymargin(0.12)
        figure.set_layout_engine("constrained", w_pad=MARGIN_INCHES, h_pad=MARGIN_INCHES)
        figure.savefig(REPORT / "xl330.png", dpi=DPI, metadata={"Software": None})


def _table(rows: Sequence[Sequence[str]]) -> str:
    head, *body = rows
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
