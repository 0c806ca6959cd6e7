"""Texts of a diagnosis: effects and probabilities in words."""

from __future__ import annotations

from collections.abc import Sequence

from sim2real.diagnose.result import Diagnosis, percent
from sim2real.report.quantity import printable

_SURE = (
    (0.99, "practically certain"),
    (0.95, "almost certain"),
    (0.8, "very likely"),
    (0.65, "likely"),
    (0.5, "more likely than not"),
    (0.2, "possible"),
    (0.05, "unlikely"),
)


def plain(effect: str) -> str:
    """Phrase for an effect within a sentence; its identifier with spaces if it is unknown."""
    from sim2real.effects import plain as phrase  # it starts Warp

    return printable(phrase(effect))


def sure(share: float) -> str:
    """A probability in percent, never rounded to 0 or 100."""
    words = {"<": "less than ", ">": "more than "}
    text = percent(share).replace(" ", "\u00a0")
    return words.get(text[0], "") + text.lstrip("<>")


def how_sure(share: float, *, of: str = "") -> str:
    """A probability as a sentence, in words and in percent: ``"Almost certain: 98 % sure."``.

    Args:
        share: The probability.
        of: Statement that is meant, as ``"that it is one of them"``; empty if clear from before.
    """
    words = next((words for threshold, words in _SURE if share >= threshold), "very unlikely")
    return f"{words.capitalize()}: {' '.join(filter(None, (sure(share), 'sure', of)))}."


def listed(names: Sequence[str], last: str = "and") -> str:
    """``"a, b and c"``."""
    return f" {last} ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def per_inertia(diagnosis: Diagnosis, component: str) -> bool:
    """Whether the torques of a component are per unit of inertia."""
    joints = diagnosis.model.joints
    selected = [joints[component]] if component in joints else list(joints.values())
    return any(joint.per_inertia for joint in selected)
