"""Export of randomization ranges as a function for Newton, as Python text.

Fields: ``newton.Model`` and ``newton.actuators``, release 1.8.
"""

from __future__ import annotations

from sim2real.exporters.actuator import Export, comment, head
from sim2real.exporters.ranges import Term, delays, noise_sds, split, table, terms
from sim2real.ranges.entry import Ranges

FIELDS = {
    "kp_Nm_per_rad": "kp",
    "kd_Nms_per_rad": "kd",
    "coulomb_friction.torque_Nm": "joint_friction",
    "unmodelled_inertia.inertia_kgm2": "joint_armature",
}
"""Array of a drive (kp, kd) or of a model that each quantity is written to."""

HEADER = "import newton\nimport numpy as np\n\n"
FUNCTION = '''

def randomize(model, solver, rng):
    """Draw anew for the joints of these names, one value for each world.

    model is a newton.Model with the exported actuators, rng a numpy.random.Generator.
    """
    dofs = {}
    for label, dof in zip(model.joint_label, model.joint_qd_start.numpy()):
        for name in {label, label.rsplit("/")[-1]}:
            dofs.setdefault(name, []).append(int(dof))
    arrays = {name: getattr(model, name) for name in ("joint_friction", "joint_armature")}
    for joint, field, draw, ends in DRAWN:
        values = np.maximum(getattr(rng, draw)(*ends, size=len(dofs[joint])), 0.0)
        if field in arrays:
            put(arrays[field], dofs[joint], values)
            continue
        for actuator in model.actuators:
            driven = actuator.indices.numpy().tolist()
            there = [(driven.index(d), x) for d, x in zip(dofs[joint], values) if d in driven]
            if there:
                put(getattr(actuator.drive, field), *zip(*there))
    solver.notify_model_changed(newton.ModelFlags.JOINT_DOF_PROPERTIES)


def put(array, where, values):
    """Assign some entries of a Warp array."""
    changed = array.numpy()
    changed[list(where)] = values
    array.assign(changed)
'''


def newton_ranges(ranges: Ranges) -> Export:
    """Python text with ``randomize(model, solver, rng)``, to be called at a reset.

    The gains are those of the exported drives, whose kd contains the back-EMF. Delays, which are
    set when the model is built, and the noise of joints are written as tables.

    Args:
        ranges: The ranges.
    """
    all_terms = terms(ranges)
    joint_delays, lines = delays(all_terms)
    mapped, others = split(all_terms, FIELDS)
    lines += [term.left_out("Newton") for term in others]
    text = comment(head(lines, "Randomization ranges")) + HEADER
    text += table("DELAY_S", "ends of the delay, s: draw one when building", joint_delays)
    text += table("JOINT_POS_NOISE_SD", "of each measured angle, rad", noise_sds(all_terms))
    rows = "".join(map(_row, mapped))
    text += f"DRAWN = [  # joint, field, distribution of NumPy, its two numbers\n{rows}]\n"
    return Export(text + FUNCTION, tuple(lines))


def _row(term: Term) -> str:
    origin = comment(term.range.source.splitlines(), "    # ")
    field, draw = FIELDS[term.quantity], term.range.distribution
    return f'{origin}    ({term.joint!r}, "{field}", "{draw}", {term.ends}),\n'
