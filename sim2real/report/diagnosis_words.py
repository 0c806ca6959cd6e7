"""A diagnosis in plain words: effects, probabilities, sizes with their units."""

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
    """An effect in plain words, to stand in a sentence; its identifier's own if it is new."""
    from sim2real.effects import plain as known  # it starts Warp

    return printable(known(effect))


def sure(share: float) -> str:
    """A probability in percent; never 0 or 100, as nothing is that sure."""
    words = {"<": "less than ", ">": "more than "}
    text = percent(share).replace(" ", "\u00a0")
    return words.get(text[0], "") + text.lstrip("<>")


def how_sure(share: float, *, of: str = "") -> str:
    """A probability as a sentence, in words and in percent: ``"Almost certain: 98 % sure."``.

    Args:
        share: The probability.
        of: What is that sure, ``"that it is one of them"``; nothing where it was just said.
    """
    words = next((words for least, words in _SURE if share >= least), "very unlikely")
    return f"{words.capitalize()}: {' '.join(filter(None, (sure(share), 'sure', of)))}."


def listed(names: Sequence[str], last: str = "and") -> str:
    """``"a, b and c"``."""
    return f" {last} ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def per_inertia(diagnosis: Diagnosis, component: str) -> bool:
    """Whether the torques of a component are per unit of inertia."""
    joints = diagnosis.model.joints
    some = [joints[component]] if component in joints else list(joints.values())
    return any(joint.per_inertia for joint in some)
