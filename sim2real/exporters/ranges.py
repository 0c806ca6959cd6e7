"""Export of randomization ranges: a table, and a Python function that draws from it.

Names: Isaac Lab 2.3 and 3.0 (``isaaclab.envs.mdp.events``), mjlab 1.5 and 1.6, Newton 1.8, MuJoCo
Playground (``randomization_fn`` of https://github.com/google-deepmind/mujoco_playground).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from sim2real.effects import CATALOGUE
from sim2real.exporters.actuator import MOTOR_TERMS, Export, LeftOut, comment, head
from sim2real.ranges.entry import Range, Ranges

SHARED = "robot"
"""Used instead of a joint for ranges of all joints, the supply or the link."""
DELAYS = ("command_latency_s", "latency_offset_s")
KP, KD = "kp_Nm_per_rad", "kd_Nms_per_rad"
FRICTION, ARMATURE = "coulomb_friction.torque_Nm", "unmodelled_inertia.inertia_kgm2"
TWO_SD = "drawn from a uniform distribution within two standard deviations"

REASONS = {
    "motor": "nothing there draws limits or losses of a motor; set them when the actuator is made",
    "torque_saturation": "nothing there draws the limit of an actuator; set it when it is made",
    "normalised_density": "relative to the robot's mean density: scale the masses of its links",
    "position_noise_m": "noise of a camera: add it to the observation of the body's position",
    "yaw_noise_rad": "noise of a camera: add it to the observation of the heading",
}


@dataclass(frozen=True)
class Term:
    """A range, with the joint (or ``body``, ``robot``) and the quantity that it names."""

    joint: str
    quantity: str
    range: Range

    def row(self, quantity: str, distribution: str, ends: tuple[object, object]) -> str:
        """The row of a table of what is drawn, with its source as a comment."""
        source = comment(self.range.source.splitlines(), "    # ")
        return f"{source}    ({self.joint!r}, {quantity!r}, {distribution!r}, {ends!r}),\n"

    def left_out(self, target: str) -> LeftOut:
        """The line of a quantity that a target lacks."""
        kind, drawn = self.quantity.partition(".")[0], self.range
        numbers = f"{drawn.distribution} {drawn.first:.6g}, {drawn.second:.6g}"
        what = f"{self.quantity} ({numbers} {drawn.unit})".rstrip()
        return LeftOut(self.joint, what, REASONS.get(kind, f"{target} has no such parameter"))


def terms(ranges: Ranges) -> list[Term]:
    """The entries of the ranges, each with its joint and quantity.

    Friction and rotor of a motor are those of the effects, unless the joint has these as well.
    """
    effects, found = {effect.name for effect in CATALOGUE}, []
    for entry in ranges.entries:
        first, _, tail = entry.parameter.partition(".")
        before, _, parameter = entry.parameter.rpartition(".")
        joint, _, effect = before.rpartition(".")
        if not before or first in effects:
            found.append(Term(SHARED, entry.parameter, entry))
        elif first == "body":
            found.append(Term(first, tail, entry))
        elif effect in {*effects, "motor"}:
            found.append(Term(joint, f"{effect}.{parameter}", entry))
        else:
            found.append(Term(before, parameter, entry))
    taken = {(term.joint, term.quantity) for term in found}
    names = {f"motor.{key}": f"{effect}.{name}" for key, effect, name in MOTOR_TERMS}
    renamed = [replace(term, quantity=names.get(term.quantity, term.quantity)) for term in found]
    pairs = zip(found, renamed, strict=True)
    return [old if (new.joint, new.quantity) in taken else new for old, new in pairs]


def _delays(all_terms: list[Term]) -> tuple[dict[str, tuple[float, float]], list[LeftOut]]:
    """Range of each joint's delay in s, and parts of it that are not drawn."""
    latency = next((term for term in all_terms if term.quantity == DELAYS[0]), None)
    names = dict.fromkeys(t.joint for t in all_terms if t.joint not in (SHARED, "body"))
    if latency is None:
        return {}, []
    if not names:
        return {}, [LeftOut(SHARED, latency.quantity, "the ranges name no joint to delay")]
    lines = []
    if latency.range.distribution == "normal":
        lines.append(LeftOut(SHARED, f"shape of {DELAYS[0]}", TWO_SD))
    low, high = _uniform(latency.range, -float("inf"))
    offsets = {t.joint: t.range for t in reversed(all_terms) if t.quantity == DELAYS[1]}
    ends = {}
    for joint in names:
        mean = 0.0
        if offset := offsets.get(joint):
            normal = offset.distribution == "normal"
            mean = offset.first if normal else (offset.first + offset.second) / 2
            why = "only its mean is added to the joint's delay"
            lines.append(LeftOut(joint, f"spread of {DELAYS[1]}", why))
        ends[joint] = max(low + mean, 0.0), max(high + mean, 0.0)
    return ends, lines


def _uniform(drawn: Range, least: float = 0.0) -> tuple[float, float]:
    """Ends of a range, of a normal distribution two standard deviations from its mean."""
    if drawn.distribution == "uniform":
        return drawn.first, drawn.second
    return max(drawn.first - 2 * drawn.second, least), drawn.first + 2 * drawn.second


@dataclass(frozen=True)
class RangesTarget:
    """A simulator that draws parameters of joints once per episode."""

    name: str
    # its name of each quantity that it draws; kp and kd of one name are drawn together, uniformly
    fields: Mapping[str, str]
    normal: str  # its name of a normal distribution
    imports: str
    functions: str
    delay: str  # remark on the table of delays
    noise: str  # remark on the table of the noise of joints
    # name of a function that returns delays in physics steps, and what they are
    steps: tuple[str, str] | None = None

    def write(self, ranges: Ranges) -> Export:
        """Python text that draws the ranges."""
        delays, lines = _delays(every := terms(ranges))
        noise, drawn, others = {}, [], []
        for term in every:
            one = term.range
            zero_mean = one.distribution == "normal" and one.first == 0 and one.period == "step"
            if term.quantity == "position_noise_rad" and zero_mean:
                noise[term.joint] = one.second
            elif term.quantity in self.fields and one.period == "episode":
                drawn.append(term)
            elif term.quantity not in DELAYS:
                others.append(term)
        rows, more = self._rows(drawn)
        lines += [*more, *(term.left_out(self.name) for term in others)]
        text = comment(head(lines, "Randomization ranges")) + self.imports
        for name, remark, values in (
            ("DELAY_S", self.delay, delays),
            ("JOINT_POS_NOISE_SD", self.noise, noise),
        ):
            entries = "".join(f"    {joint!r}: {value!r},\n" for joint, value in values.items())
            text += f"{name} = {{  # {remark}\n{entries}}}\n\n" if entries else ""
        text += f"DRAWN = [  # joint, quantity, distribution, its numbers\n{rows}]\n"
        if delays and self.steps:
            text += STEPS.format(*self.steps)
        return Export(text + self.functions, tuple(lines))

    def _rows(self, drawn: list[Term]) -> tuple[str, list[LeftOut]]:
        """Rows of what is drawn, and terms or shapes that are not."""
        rows, lines = "", []
        together = self.fields[KP] == self.fields[KD]
        gains: dict[str, dict[str, Term]] = {}
        for term in drawn:
            if together and term.quantity in (KP, KD):
                gains.setdefault(term.joint, {})[term.quantity] = term
            else:
                one = term.range
                shape = self.normal if one.distribution == "normal" else "uniform"
                rows += term.row(self.fields[term.quantity], shape, (one.first, one.second))
        for joint, both in gains.items():
            if len(both) < 2:
                lines += [term.left_out(self.name) for term in both.values()]
                continue
            kp, kd = both[KP], both[KD]
            rows += kp.row(self.fields[KP], "uniform", (_uniform(kp.range), _uniform(kd.range)))
            normal_ones = [term for term in (kp, kd) if term.range.distribution == "normal"]
            lines += [LeftOut(joint, f"shape of {term.quantity}", TWO_SD) for term in normal_ones]
        return rows, lines


STEPS = '''

def {0}(joint, physics_dt):
    """{1}, in physics steps."""
    return tuple(round(delay / physics_dt) for delay in DELAY_S[joint])
'''
ISAACLAB_IMPORTS = """import re

import isaaclab.envs.mdp as mdp
from isaaclab.managers import EventTermCfg, SceneEntityCfg
from isaaclab.utils import configclass

"""
ISAACLAB = '''

class RandomizationCfg:
    """Drawn anew at every reset."""


for number, (joint, quantity, distribution, ends) in enumerate(DRAWN):
    gains = quantity in ("stiffness", "damping")
    term = EventTermCfg(
        func=mdp.randomize_actuator_gains if gains else mdp.randomize_joint_parameters,
        mode="reset",
        params={
            "asset_cfg": SceneEntityCfg("robot", joint_names=[re.escape(joint)]),
            f"{quantity}_distribution_params": ends,
            "operation": "abs",
            "distribution": distribution,
        },
    )
    setattr(RandomizationCfg, f"draw_{number}_{quantity}", term)
RandomizationCfg = configclass(RandomizationCfg)
'''
MJLAB_IMPORTS = """import re

from mjlab.envs.mdp import dr
from mjlab.managers.event_manager import EventTermCfg
from mjlab.managers.scene_entity_config import SceneEntityCfg

"""
MJLAB = '''

def events(viscous_damping=None):
    """Event terms that draw anew at every reset.

    viscous_damping is that of each joint's exported actuator, which is part of its kd.
    """
    passive = viscous_damping or {}
    drawn = {}
    for joint, quantity, distribution, ends in DRAWN:
        name = [re.escape(joint)]
        if quantity == "pd_gains":
            kp, kd = ends
            kd = tuple(max(end - passive.get(joint, 0.0), 0.0) for end in kd)
            entity = SceneEntityCfg("robot", actuator_names=name)
            params = {"kp_range": kp, "kd_range": kd, "asset_cfg": entity}
        else:
            entity = SceneEntityCfg("robot", joint_names=name)
            params = {"ranges": ends, "asset_cfg": entity, "distribution": distribution}
        drawn[f"{quantity} of {joint}"] = EventTermCfg(
            func=getattr(dr, quantity), mode="reset", params=params | {"operation": "abs"}
        )
    return drawn
'''
NEWTON = '''

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
PLAYGROUND = '''

def randomizer(mj_model):
    """domain_randomize for a model whose actuators are named after their joints."""
    tendons = {mj_model.tendon(k).name: k for k in range(mj_model.ntendon)}

    def passive(joint, dof):
        """Damping outside the drive, of the joint and its back-EMF: part of its kd."""
        back_emf = tendons.get(joint + "_back_emf")
        tendon = 0.0 if back_emf is None else mj_model.tendon_damping[back_emf]
        return mj_model.dof_damping[dof] + tendon

    def domain_randomize(model, rng):
        @jax.vmap
        def draw(rng):
            fields = {}

            def put(field, place, value):
                fields[field] = fields.get(field, getattr(model, field)).at[place].set(value)

            for joint, field, distribution, (first, second) in DRAWN:
                rng, key = jax.random.split(rng)
                if distribution == "uniform":
                    value = jax.random.uniform(key, minval=first, maxval=second)
                else:
                    value = first + second * jax.random.normal(key)
                actuator, dof = mj_model.actuator(joint).id, mj_model.joint(joint).dofadr[0]
                if field == "kp":
                    put("actuator_gainprm", (actuator, 0), value)
                    put("actuator_biasprm", (actuator, 1), -value)
                elif field == "kd":
                    put("actuator_biasprm", (actuator, 2), passive(joint, dof) - value)
                else:
                    put(field, dof, jp.maximum(value, 0))
            return fields

        drawn = draw(rng)
        in_axes = jax.tree_util.tree_map(lambda x: None, model)
        in_axes = in_axes.tree_replace({name: 0 for name in drawn})
        return model.tree_replace(drawn), in_axes

    return domain_randomize
'''


def _fields(*names: str) -> Mapping[str, str]:
    return dict(zip((KP, KD, FRICTION, ARMATURE), names, strict=True))


TARGETS: Mapping[str, RangesTarget] = {
    "isaaclab": RangesTarget(
        "Isaac Lab",
        _fields("stiffness", "damping", "friction", "armature"),
        "gaussian",
        ISAACLAB_IMPORTS,
        ISAACLAB,
        "ends of the delay, s: drawn at reset",
        "of GaussianNoiseCfg on joint_pos, rad",
        ("delay_steps", "min_delay and max_delay of the joint's exported actuator"),
    ),
    "mjlab": RangesTarget(
        "mjlab",
        _fields("pd_gains", "pd_gains", "joint_friction", "joint_armature"),
        "gaussian",
        MJLAB_IMPORTS,
        MJLAB,
        "ends of the delay, s",
        "of GaussianNoiseCfg on joint_pos",
        ("delay_lags", "delay_min_lag and delay_max_lag of a joint's actuator"),
    ),
    "newton": RangesTarget(
        "Newton",
        _fields("kp", "kd", "joint_friction", "joint_armature"),
        "normal",
        "import newton\nimport numpy as np\n\n",
        NEWTON,
        "ends of the delay, s: draw one when building",
        "of each measured angle, rad",
    ),
    "mujoco-playground": RangesTarget(
        "an mjx.Model",
        _fields("kp", "kd", "dof_frictionloss", "dof_armature"),
        "normal",
        "import jax\nimport jax.numpy as jp\n\n",
        PLAYGROUND,
        "ends of the delay, s: draw one per episode",
        "of each measured angle, rad",
    ),
}
"""By the name that ``export-ranges --to`` takes."""
