"""Which physics of the body or the camera do swims in a pool show that the twin leaves out?

The search is that of ``sim2real.inference.selection`` on swims as ``twin_search`` has them: every
effect of the catalogue beside servos and law, in which the twin's error is a part of the noise.
What is named has to predict the end of each swim better when fitted to its beginning; what others
can imitate is a group; and where a shape without a name (``unlisted``) does better than all, the
diagnosis abstains. Thresholds are in ``law_error.json``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from sim.inference.coordinates import Swum
from sim.inference.law_error import LAW_ERROR, LawError
from sim.inference.searched import learned, searched
from sim.inference.swim_findings import diagnosis_of
from sim.inference.swims import Swim
from sim.inference.twin_search import Belief
from sim2real.diagnose.result import Diagnosis
from sim2real.model import Model
from sim2real.robot import Robot


def diagnose_swims(
    swims: Sequence[Swim],
    model: Model,
    robot: Robot,
    simulate: Swum,
    *,
    references: Sequence[Swim] = (),
    belief: Belief | None = None,
    known: LawError = LAW_ERROR,
    progress: Callable[[float], None] = lambda share: None,
) -> Diagnosis:
    """Find what the body's simulator leaves out.

    Args:
        swims: Pool recordings of one robot in one pool.
        model: The servos.
        robot: The robot.
        simulate: The twin (``sim.twin.followed.by_followed_twin``).
        references: Swims of the same robot in which nothing is thought to be missing.
        belief: What ``learned`` says of them, where it is known already.
        known: The twin's error and the thresholds.
        progress: Called with the share that is done.

    Returns:
        The diagnosis; its errors are those of the speed over ground, in m/s, on what was held out.
    """
    before = belief or learned(references, model, robot, simulate, known)
    found = searched(swims, model, robot, simulate, before, progress)
    return diagnosis_of(found, robot, known, referred=bool(references) or belief is not None)
