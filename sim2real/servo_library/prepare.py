"""Preparation of an entry of the library from a model, for a pull request."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from sim2real.errors import InputError
from sim2real.model import JointModel, Model
from sim2real.servo_library.entry import JOINT, ServoEntry, entry_of


def prepared(
    model: Model,
    about: Mapping[str, Any],
    *,
    joint: str | None = None,
    file: str | os.PathLike[str] = "model",
) -> ServoEntry:
    """An entry from one joint of a model: with what is known of it, without paths of this machine.

    Args:
        model: The model.
        about: Fields of ``provenance.servo`` (see ``entry``) that replace or complete those of the
            model; None stands for a field that is not given.
        joint: Name of the joint; not needed where the model has one.
        file: The model's file, for messages.

    Raises:
        InputError: If the model lacks what an entry needs, or has several joints and none is named.
    """
    name = _joint(model, joint, file)
    known: dict[str, Any] = dict(model.provenance.get("servo", {}))
    known |= {key: value for key, value in about.items() if value is not None}
    known.setdefault("origin", "identified")
    held_out = model.provenance.get("held_out", {})
    if not known.get("scored_on") and isinstance(held_out, Mapping) and held_out.get(name):
        known["scored_on"] = f"{held_out[name]}, which was not fitted"
    figures = model.fit.get(f"{name}.position_rad", {})
    entry = replace(
        model,
        joints={JOINT: _rounded(model.joints[name])},
        body={},
        fit={f"{JOINT}.position_rad": {k: _round(x) for k, x in figures.items()}},
        provenance=_without_paths(model.provenance) | {"servo": known},
    )
    return entry_of(entry, file)


def _joint(model: Model, joint: str | None, file: str | os.PathLike[str]) -> str:
    names = list(model.joints)
    if joint is None and len(names) == 1:
        return names[0]
    if joint is not None and joint in model.joints:
        return joint
    expected = f"--joint with one of {', '.join(names)}" if names else "a model with a servo"
    raise InputError(file, "joints", joint or f"{len(names)} joints", expected)


def _without_paths(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Seed, versions, and hashes of the inputs by file name."""
    kept = {key: provenance[key] for key in ("seed", "versions") if key in provenance}
    inputs = provenance.get("inputs", {})
    if isinstance(inputs, Mapping) and inputs:
        kept["inputs"] = {Path(str(path)).name: digest for path, digest in inputs.items()}
    return kept


def _rounded(joint: JointModel) -> JointModel:
    """The joint with six digits, and without the correlations, to be read in a review."""
    return replace(
        joint,
        kp_Nm_per_rad=_round(joint.kp_Nm_per_rad),
        kd_Nms_per_rad=_round(joint.kd_Nms_per_rad),
        latency_s=_round(joint.latency_s),
        motor={name: _round(value) for name, value in joint.motor.items()},
        interval={name: (_round(a), _round(b)) for name, (a, b) in joint.interval.items()},
        correlation={},
        effects=tuple(
            replace(effect, parameters={k: _round(x) for k, x in effect.parameters.items()})
            for effect in joint.effects
        ),
    )


def _round(value: Any) -> Any:  # noqa: ANN401 - a number or None
    if value is None or not math.isfinite(value):
        return value
    return float(f"{value:.6g}")
