"""Export of randomization ranges as Isaac Lab event terms, as Python text.

Terms: https://isaac-sim.github.io/IsaacLab, ``isaaclab.envs.mdp.events``, releases 2.3 and 3.0.
"""

from __future__ import annotations

import re

from sim2real.exporters.actuator import Export, comment, head
from sim2real.exporters.ranges import Term, delays, noise_sds, split, table, terms
from sim2real.ranges.entry import Ranges

GAINS, JOINT = "randomize_actuator_gains", "randomize_joint_parameters"

TERMS = {
    "kp_Nm_per_rad": (GAINS, "stiffness_distribution_params"),
    "kd_Nms_per_rad": (GAINS, "damping_distribution_params"),
    "coulomb_friction.torque_Nm": (JOINT, "friction_distribution_params"),
    "unmodelled_inertia.inertia_kgm2": (JOINT, "armature_distribution_params"),
}
"""Event function and argument of each quantity that has one."""

HEADER = """import isaaclab.envs.mdp as mdp
from isaaclab.managers import EventTermCfg, SceneEntityCfg
from isaaclab.utils import configclass

"""
DELAY_STEPS = '''
def delay_steps(joint, physics_dt):
    """min_delay and max_delay of the joint's exported actuator, in physics steps."""
    return tuple(round(delay / physics_dt) for delay in DELAY_S[joint])

'''


def isaaclab_ranges(ranges: Ranges) -> Export:
    """Python text with a class ``RandomizationCfg`` of event terms, drawn at every reset.

    Delays and the noise of joints, which are not events there, are written as tables.

    Args:
        ranges: The ranges.
    """
    all_terms = terms(ranges)
    joint_delays, lines = delays(all_terms)
    mapped, others = split(all_terms, TERMS)
    lines += [term.left_out("Isaac Lab") for term in others]
    text = comment(head(lines, "Randomization ranges")) + HEADER
    text += table("DELAY_S", "ends of the delay, s: drawn at reset", joint_delays)
    text += table(
        "JOINT_POS_NOISE_SD", "of GaussianNoiseCfg on joint_pos, rad", noise_sds(all_terms)
    )
    text += DELAY_STEPS if joint_delays else ""
    text += '\n@configclass\nclass RandomizationCfg:\n    """Drawn anew at every reset."""\n\n'
    text += "\n".join(_event(k, term) for k, term in enumerate(mapped)) or "    pass\n"
    return Export(text, tuple(lines))


def _event(number: int, term: Term) -> str:
    function, argument = TERMS[term.quantity]
    name = re.sub(r"[^A-Za-z0-9]", "_", f"draw_{number}_{term.joint}_{term.quantity}")
    drawn = "uniform" if term.range.distribution == "uniform" else "gaussian"
    joint = repr([re.escape(term.joint)])
    return (
        comment(term.range.source.splitlines(), "    # ") + f"    {name} = EventTermCfg(\n"
        f"        func=mdp.{function},\n"
        '        mode="reset",\n'
        "        params={\n"
        f'            "asset_cfg": SceneEntityCfg("robot", joint_names={joint}),\n'
        f'            "{argument}": {term.ends},\n'
        '            "operation": "abs",\n'
        f'            "distribution": "{drawn}",\n'
        "        },\n"
        "    )\n"
    )
