"""Export of randomization ranges as mjlab event terms, as Python text.

Terms: ``mjlab.envs.mdp.dr`` and ``mjlab.managers.event_manager``, releases 1.5 and 1.6.
"""

from __future__ import annotations

import re

from sim2real.exporters.actuator import Export, LeftOut, comment, head
from sim2real.exporters.ranges import Term, delays, noise_sds, split, table, terms
from sim2real.ranges.entry import Ranges

KP, KD = "kp_Nm_per_rad", "kd_Nms_per_rad"
JOINT = {
    "coulomb_friction.torque_Nm": "joint_friction",
    "unmodelled_inertia.inertia_kgm2": "joint_armature",
}
"""Function of ``mjlab.envs.mdp.dr`` for each quantity of a joint that has one of its own."""

HEADER = """from mjlab.envs.mdp import dr
from mjlab.managers.event_manager import EventTermCfg
from mjlab.managers.scene_entity_config import SceneEntityCfg

"""
DELAY_LAGS = '''
def delay_lags(joint, physics_dt):
    """delay_min_lag and delay_max_lag of a joint's actuator, in physics steps."""
    return tuple(round(delay / physics_dt) for delay in DELAY_S[joint])

'''
EVENTS = '''
def events(viscous_damping=None):
    """Event terms that draw anew at every reset.

    viscous_damping is that of each joint's exported actuator, which is part of its kd.
    """
    passive = viscous_damping or {}
    drawn = {}
    for joint, (kp, kd) in GAINS.items():
        kd = tuple(max(end - passive.get(joint, 0.0), 0.0) for end in kd)
        entity = SceneEntityCfg("robot", actuator_names=[joint])
        params = {"kp_range": kp, "kd_range": kd, "asset_cfg": entity, "operation": "abs"}
        drawn[f"gains of {joint}"] = EventTermCfg(func=dr.pd_gains, mode="reset", params=params)
    for function, joint, distribution, ends in JOINTS:
        entity = SceneEntityCfg("robot", joint_names=[joint])
        params = {"ranges": ends, "asset_cfg": entity, "distribution": distribution}
        drawn[f"{function.__name__} of {joint}"] = EventTermCfg(
            func=function, mode="reset", params=params | {"operation": "abs"}
        )
    return drawn
'''


def mjlab_ranges(ranges: Ranges) -> Export:
    """Python text with ``events()``, a dictionary of event terms for an environment.

    mjlab draws kp and kd together, uniformly: a normal distribution of one of them is replaced by a
    uniform one within two standard deviations. Delays and the noise of joints, which are no events
    there, are written as tables.

    Args:
        ranges: The ranges.
    """
    all_terms = terms(ranges)
    joint_delays, lines = delays(all_terms)
    mapped, others = split(all_terms, {KP, KD, *JOINT})
    gains, alone, changed = _gains(mapped)
    lines += [*changed, *(term.left_out("mjlab") for term in (*others, *alone))]
    of_joints = [term for term in mapped if term.quantity in JOINT]
    text = comment(head(lines, "Randomization ranges")) + HEADER
    text += table("DELAY_S", "ends of the delay, s", joint_delays)
    text += table("JOINT_POS_NOISE_SD", "of GaussianNoiseCfg on joint_pos", noise_sds(all_terms))
    text += DELAY_LAGS if joint_delays else ""
    rows = "".join(f"    {joint!r}: {ends},\n" for joint, ends in gains.items())
    text += f"GAINS = {{  # ends of kp and kd\n{rows}}}\n"
    rows = "".join(map(_joint_row, of_joints))
    text += f"JOINTS = [\n{rows}]\n" if rows else "JOINTS = []\n"
    return Export(text + EVENTS, tuple(lines))


def _gains(mapped: list[Term]) -> tuple[dict[str, str], list[Term], list[LeftOut]]:
    """Ends of kp and kd by joint, terms without the other gain, and distributions that change."""
    by_joint: dict[str, dict[str, Term]] = {}
    for term in mapped:
        if term.quantity in (KP, KD):
            by_joint.setdefault(term.joint, {})[term.quantity] = term
    gains: dict[str, str] = {}
    alone: list[Term] = []
    changed: list[LeftOut] = []
    for joint, both in by_joint.items():
        if len(both) < 2:
            alone += both.values()
            continue
        gains[re.escape(joint)] = f"({_ends(both[KP])}, {_ends(both[KD])})"
        why = "drawn from a uniform distribution within two standard deviations"
        normal = [name for name in (KP, KD) if both[name].range.distribution == "normal"]
        changed += [LeftOut(joint, f"shape of {name}", why) for name in normal]
    return gains, alone, changed


def _ends(term: Term) -> str:
    low, high = term.range.first, term.range.second
    if term.range.distribution == "normal":
        low, high = max(low - 2 * high, 0.0), low + 2 * high
    return f"({low!r}, {high!r})"


def _joint_row(term: Term) -> str:
    drawn = "uniform" if term.range.distribution == "uniform" else "gaussian"
    joint = re.escape(term.joint)
    return f'    (dr.{JOINT[term.quantity]}, {joint!r}, "{drawn}", {term.ends}),\n'
