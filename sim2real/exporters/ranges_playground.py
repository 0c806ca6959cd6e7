"""Export of randomization ranges as a function for MuJoCo Playground, as Python text.

Form: ``randomization_fn`` of https://github.com/google-deepmind/mujoco_playground.
"""

from __future__ import annotations

from sim2real.exporters.actuator import Export, comment, head
from sim2real.exporters.ranges import Term, delays, noise_sds, split, table, terms
from sim2real.ranges.entry import Ranges

FIELDS = {
    "kp_Nm_per_rad": ("actuator_gainprm", "actuator_biasprm"),
    "kd_Nms_per_rad": ("actuator_biasprm",),
    "coulomb_friction.torque_Nm": ("dof_frictionloss",),
    "unmodelled_inertia.inertia_kgm2": ("dof_armature",),
}
"""Fields of ``mjx.Model`` that each quantity is written to."""

KD = "kd_Nms_per_rad"

PASSIVE = '''    def passive(joint):
        """Damping outside the drive, of the joint and its back-EMF: part of its kd."""
        tendons = {mj_model.tendon(k).name: k for k in range(mj_model.ntendon)}
        back_emf = tendons.get(joint + "_back_emf")
        tendon = 0.0 if back_emf is None else mj_model.tendon_damping[back_emf]
        return mj_model.dof_damping[dof(joint)] + tendon

'''

SET = {
    "kp_Nm_per_rad": (
        "actuator_gainprm = actuator_gainprm.at[actuator({joint!r}), 0].set(value)",
        "actuator_biasprm = actuator_biasprm.at[actuator({joint!r}), 1].set(-value)",
    ),
    "kd_Nms_per_rad": (
        "damping = value - passive({joint!r})",
        "actuator_biasprm = actuator_biasprm.at[actuator({joint!r}), 2].set(-damping)",
    ),
    "coulomb_friction.torque_Nm": (
        "dof_frictionloss = dof_frictionloss.at[dof({joint!r})].set(jp.maximum(value, 0))",
    ),
    "unmodelled_inertia.inertia_kgm2": (
        "dof_armature = dof_armature.at[dof({joint!r})].set(jp.maximum(value, 0))",
    ),
}


def playground_ranges(ranges: Ranges) -> Export:
    """Python text with ``randomizer(mj_model)``, which makes a Playground ``domain_randomize``.

    Actuators and joints have the names of the ranges' joints, as `mujoco.mujoco` writes them.
    Delays and the noise of joints, which are not part of an ``mjx.Model``, are written as tables.

    Args:
        ranges: The ranges.
    """
    all_terms = terms(ranges)
    joint_delays, lines = delays(all_terms)
    mapped, others = split(all_terms, SET)
    lines += [term.left_out("an mjx.Model") for term in others]
    fields = sorted({field for term in mapped for field in FIELDS[term.quantity]})
    text = comment(head(lines, "Randomization ranges")) + "import jax\nimport jax.numpy as jp\n\n"
    text += table("DELAY_S", "ends of the delay, s: draw one per episode", joint_delays)
    text += table("JOINT_POS_NOISE_SD", "of each measured angle, rad", noise_sds(all_terms))
    text += "\ndef randomizer(mj_model):\n"
    text += '    """For a model whose actuators are named after their joints."""\n\n'
    text += "    def actuator(joint):\n        return mj_model.actuator(joint).id\n\n"
    text += "    def dof(joint):\n        return mj_model.joint(joint).dofadr[0]\n\n"
    text += PASSIVE if any(term.quantity == KD for term in mapped) else ""
    text += "    def domain_randomize(model, rng):\n"
    text += "        @jax.vmap\n        def draw(rng):\n"
    text += "".join(f"            {field} = model.{field}\n" for field in fields)
    text += "".join(_drawn(term) for term in mapped)
    text += "            return {" + ", ".join(f'"{name}": {name}' for name in fields) + "}\n\n"
    text += "        drawn = draw(rng)\n"
    text += "        in_axes = jax.tree_util.tree_map(lambda x: None, model)\n"
    text += "        in_axes = in_axes.tree_replace({name: 0 for name in drawn})\n"
    text += "        return model.tree_replace(drawn), in_axes\n\n"
    return Export(text + "    return domain_randomize\n", tuple(lines))


def _drawn(term: Term) -> str:
    first, second = term.range.first, term.range.second
    if term.range.distribution == "uniform":
        value = f"jax.random.uniform(key, minval={first!r}, maxval={second!r})"
    else:
        value = f"{first!r} + {second!r} * jax.random.normal(key)"
    text = comment(term.range.source.splitlines(), "            # ")
    text += f"            rng, key = jax.random.split(rng)\n            value = {value}\n"
    return text + "".join(
        f"            {line.format(joint=term.joint)}\n" for line in SET[term.quantity]
    )
