"""Exported ranges compile, and draw what the ranges say."""

import ast
import re
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from sim2real.exporters.ranges import TARGETS
from sim2real.ranges.entry import Range, Ranges, normal, read_ranges, uniform

each_target = pytest.mark.parametrize("target", TARGETS)
RANGES = Ranges(
    (
        uniform("command_latency_s", 0.04, 0.08, "s", "windows"),
        normal("j1.latency_offset_s", -0.01, 0.001, "s", "windows"),
        normal("j1.kp_Nm_per_rad", 2.1, 0.05, "N m/rad", "posterior,\nof j1"),
        uniform("j1.kd_Nms_per_rad", 0.05, 0.07, "N m s/rad", "posterior"),
        uniform("arm.j2.kp_Nm_per_rad", 1.8, 1.9, "N m/rad", "posterior"),
        normal("j1.coulomb_friction.torque_Nm", 0.03, 0.004, "N m", "posterior"),
        uniform("arm.j2.unmodelled_inertia.inertia_kgm2", 0.001, 0.002, "kg m2", "posterior"),
        normal("j1.backlash.gap_rad", 0.02, 0.001, "rad", "posterior"),
        normal("j1.position_noise_rad", 0.0, 0.002, "rad", "noise", "step"),
        uniform("arm.j2.position_noise_rad", -0.001, 0.001, "rad", "noise", "step"),
        normal("body.yaw_noise_rad", 0.0, 0.01, "rad", "noise", "step"),
        normal("body.normalised_density.tail", 1.0, 0.05, "", "scale"),
        uniform("packet_loss.probability", 0.0, 0.05, "", "posterior"),
    )
)
LACKED = {
    "spread of latency_offset_s",
    "backlash.gap_rad",
    "position_noise_rad",  # a uniform one
    "yaw_noise_rad",
    "normalised_density.tail",
    "packet_loss.probability",
}


@each_target
def test_what_a_target_lacks_is_listed_there_and_values_are_kept(target):
    made = TARGETS[target].write(RANGES)
    of_mjlab = {"shape of kp_Nm_per_rad", "kp_Nm_per_rad"} if target == "mjlab" else set()
    assert {line.what.partition(" (")[0] for line in made.left_out} == LACKED | of_mjlab
    head = [node for node in made.text.splitlines() if node.startswith("#")]
    assert all(f"#   {line}" in head for line in made.left_out)
    ranges = read_ranges("datasets/pool/ranges.json")
    tree = ast.parse(TARGETS[target].write(ranges).text)
    constants = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    numbers = {value for value in constants if isinstance(value, float)}
    gains = [entry for entry in ranges.entries if re.search(r"\.k[pd]_", entry.parameter)]
    assert len(gains) == 6
    for entry in gains:
        low, high = entry.first, entry.second
        if entry.distribution == "normal" and target == "mjlab":  # uniform, two deviations
            low, high = low - 2 * high, low + 2 * high
        assert {low, high} <= numbers


def test_isaaclab_terms(modules):
    mdp = {"randomize_actuator_gains": "gains", "randomize_joint_parameters": "joint"}
    managers = {
        "EventTermCfg": lambda **fields: SimpleNamespace(**fields),
        "SceneEntityCfg": lambda name, joint_names: (name, joint_names),
    }
    space = modules(
        TARGETS["isaaclab"].write(RANGES).text,
        isaaclab__envs__mdp=mdp,
        isaaclab__managers=managers,
        isaaclab__utils={"configclass": lambda cls: cls},
    )
    terms = vars(space["RandomizationCfg"]).items()
    found = [
        (one.func, *one.params["asset_cfg"][1], *list(one.params.items())[1])
        + (one.params["distribution"],)
        for name, one in terms
        if name.startswith("draw_")
    ]
    assert found == [
        ("gains", "j1", "stiffness_distribution_params", (2.1, 0.05), "gaussian"),
        ("gains", "j1", "damping_distribution_params", (0.05, 0.07), "uniform"),
        ("gains", r"arm\.j2", "stiffness_distribution_params", (1.8, 1.9), "uniform"),
        ("joint", "j1", "friction_distribution_params", (0.03, 0.004), "gaussian"),
        ("joint", r"arm\.j2", "armature_distribution_params", (0.001, 0.002), "uniform"),
    ]
    assert space["DELAY_S"]["j1"] == pytest.approx((0.03, 0.07))
    assert space["delay_steps"]("arm.j2", 0.005) == (8, 16)
    assert space["JOINT_POS_NOISE_SD"] == {"j1": 0.002}


def test_mjlab_terms(modules):
    """Terms as `mjlab.envs.mdp.dr` (1.6) takes them: gains together, back-EMF apart."""
    dr = SimpleNamespace(pd_gains="gains", joint_friction="friction", joint_armature="armature")
    space = modules(
        TARGETS["mjlab"].write(RANGES).text,
        mjlab__envs__mdp={"dr": dr},
        mjlab__managers__event_manager={"EventTermCfg": lambda **given: SimpleNamespace(**given)},
        mjlab__managers__scene_entity_config={
            "SceneEntityCfg": lambda name, **which: (name, which)
        },
    )
    found = space["events"](viscous_damping={"j1": 0.055})
    gains = found["pd_gains of j1"]
    assert (gains.func, gains.mode) == ("gains", "reset")
    assert gains.params["kp_range"] == pytest.approx((2.0, 2.2))  # two standard deviations
    assert gains.params["kd_range"] == pytest.approx((0.0, 0.015))
    assert gains.params["asset_cfg"] == ("robot", {"actuator_names": ["j1"]})
    friction = found["joint_friction of j1"].params
    assert (friction["ranges"], friction["distribution"]) == ((0.03, 0.004), "gaussian")
    armature = found["joint_armature of arm.j2"].params
    assert armature["asset_cfg"] == ("robot", {"joint_names": [r"arm\.j2"]})
    assert armature["operation"] == "abs"
    assert len(found) == 3  # arm.j2 has no range of kd, which mjlab draws together with kp
    assert space["delay_lags"]("arm.j2", 0.005) == (8, 16)


def warp_array(values):
    return wp.array(np.array(values), device="cpu")


def test_newton_draws_into_the_right_places(modules):
    """Two worlds of two joints, their actuators in two groups, as ``newton.Model`` has them."""
    flags = SimpleNamespace(JOINT_DOF_PROPERTIES=2)
    space = modules(TARGETS["newton"].write(RANGES).text, newton={"ModelFlags": flags})

    def group(*dofs):
        drive = SimpleNamespace(kp=warp_array([9.0] * len(dofs)), kd=warp_array([9.0] * len(dofs)))
        return SimpleNamespace(indices=warp_array(dofs), drive=drive)

    model = SimpleNamespace(
        joint_label=["a/j1", "a/arm.j2", "b/j1", "b/arm.j2"],
        joint_qd_start=warp_array([0, 1, 2, 3, 4]),
        joint_friction=warp_array([9.0] * 4),
        joint_armature=warp_array([9.0] * 4),
        actuators=[group(2, 0), group(1, 3)],
    )
    told: list[int] = []
    solver = SimpleNamespace(notify_model_changed=told.append)
    drawn = []
    for seed in range(200):
        space["randomize"](model, solver, np.random.default_rng(seed))
        drawn.append(model.actuators[0].drive.kp.numpy().copy())
    assert np.mean(drawn) == pytest.approx(2.1, abs=0.01)
    assert np.std(drawn) == pytest.approx(0.05, rel=0.2)
    assert np.corrcoef(np.array(drawn).T)[0, 1] < 0.5  # each world has its own
    second = model.actuators[1].drive
    assert ((second.kp.numpy() > 1.8) & (second.kp.numpy() < 1.9)).all()
    assert (second.kd.numpy() == 9.0).all()  # no range of arm.j2
    assert (model.joint_friction.numpy()[[1, 3]] == 9.0).all()
    assert (model.joint_friction.numpy()[[0, 2]] < 0.1).all()
    assert (model.joint_armature.numpy()[[1, 3]] < 0.0021).all()
    assert set(told) == {2}


class At:
    """Sets values of an array as JAX does."""

    def __init__(self, whole, where=None):
        self.whole, self.where = whole, where

    def __getitem__(self, where):
        return At(self.whole, where)

    def set(self, value):
        changed = self.whole.copy()
        changed[self.where] = value
        return changed


class Values(np.ndarray):
    """An array with JAX's way of setting values."""

    at = property(At)


class Tree(SimpleNamespace):
    def tree_replace(self, fields):
        return Tree(**(vars(self) | fields))


@pytest.mark.parametrize("passive", [0.0, 0.02], ids=["all in the drive", "partly in the joint"])
def test_playground_draws_into_the_right_places(passive, modules):
    """With the mean of each distribution in place of a draw; kd is the damping of all parts."""
    jax = {
        "vmap": lambda f: (
            lambda keys: {name: np.stack([f(key)[name] for key in keys]) for name in f(keys[0])}
        ),
        "random": SimpleNamespace(
            split=lambda rng: (rng, rng),
            uniform=lambda key, minval, maxval: (minval + maxval) / 2,
            normal=lambda key: 0.0,
        ),
        "tree_util": SimpleNamespace(
            tree_map=lambda f, tree: Tree(**{name: f(x) for name, x in vars(tree).items()})
        ),
    }
    text = TARGETS["mujoco-playground"].write(RANGES).text
    space = modules(text, jax=jax, jax__numpy={"maximum": np.maximum})
    number = {"j1": 1, "arm.j2": 0}
    mj_model = SimpleNamespace(
        actuator=lambda name: SimpleNamespace(id=number[name]),
        joint=lambda name: SimpleNamespace(dofadr=[number[name]]),
        tendon=lambda k: SimpleNamespace(name="j1_back_emf"),
        dof_damping=np.array([0.0, passive]),
        tendon_damping=np.array([passive]),
        ntendon=1,
    )
    model = Tree(
        actuator_gainprm=np.zeros((2, 3)).view(Values),
        actuator_biasprm=np.zeros((2, 3)).view(Values),
        dof_frictionloss=np.zeros(2).view(Values),
        dof_armature=np.zeros(2).view(Values),
        opt=0,
    )
    drawn, axes = space["randomizer"](mj_model)(model, [0, 1, 2])
    assert drawn.actuator_gainprm.shape == (3, 2, 3)
    assert drawn.actuator_gainprm[0, :, 0] == pytest.approx([1.85, 2.1])
    assert drawn.actuator_biasprm[0, 1] == pytest.approx([0, -2.1, -0.06 + 2 * passive])
    assert drawn.dof_frictionloss[0] == pytest.approx([0, 0.03])
    assert drawn.dof_armature[0] == pytest.approx([0.0015, 0])
    assert (axes.actuator_gainprm, axes.opt) == (0, None)


@each_target
def test_ranges_of_a_motor_are_drawn_or_listed(target):
    entries = (
        uniform("command_latency_s", 0.04, 0.08, "s", "windows"),
        uniform("j1.motor.coulomb_Nm", 0.025, 0.035, "N m", "model"),
        uniform("j1.motor.rotor_inertia_kgm2", 0.0011, 0.0012, "kg m2", "model"),
        uniform("j1.motor.stall_torque_Nm", 1.3, 1.7, "N m", "model"),
    )
    made = TARGETS[target].write(Ranges(entries))
    (line,) = made.left_out
    assert line.component == "j1"
    assert "motor.stall_torque_Nm (uniform 1.3, 1.7 N m)" in str(line)
    assert str(line) in made.text
    for number in ("0.025", "0.035", "0.0011", "0.0012"):
        assert number in made.text
    assert "j1.motor" not in made.text  # as the name of a joint
    both = (*entries, uniform("j1.coulomb_friction.torque_Nm", 0.01, 0.02, "N m", "posterior"))
    assert any(
        "motor.coulomb_Nm" in line.what for line in TARGETS[target].write(Ranges(both)).left_out
    )


def test_latencies_that_are_not_drawn_as_stated_are_listed():
    write = TARGETS["newton"].write
    made = write(Ranges((uniform("command_latency_s", 0.04, 0.08, "s", "windows"),)))
    assert "name no joint" in str([*map(str, made.left_out)])
    ast.parse(made.text)
    latency = Range("command_latency_s", "normal", 0.06, 0.01, "s", "episode", "windows")
    made = write(Ranges((latency, uniform("j1.kp_Nm_per_rad", 1, 2, "N m/rad", "model"))))
    assert "(0.039999999999999994, 0.08)" in made.text or "(0.04, 0.08)" in made.text
    assert "two standard deviations" in str([*map(str, made.left_out)])
