"""Isaac Lab, Genesis, URDF and JSON: each text parses, holds the numbers, lists what it lacks."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest

from sim2real.effects import CATALOGUE
from sim2real.exporters.actuator import Actuator
from sim2real.exporters.genesis import genesis
from sim2real.exporters.isaaclab import _entry, isaaclab
from sim2real.exporters.mujoco import mujoco
from sim2real.exporters.plain import plain
from sim2real.exporters.urdf import urdf
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.recording import Load
from sim2real.robot import Robot, read_robot

TYPICAL = {e.name: {p.name: p.typical for p in e.parameters} for e in CATALOGUE}
TYPICAL["torque_saturation"]["free_damping"] = 0.0
TEXTS = (isaaclab, genesis, urdf, plain, mujoco)


def servo(name: str = "j1", *effects: str) -> Model:
    fitted = tuple(FittedEffect(effect, TYPICAL[effect]) for effect in effects)
    joint = JointModel(2.2, 0.06, 0.05, 0.002, load=Load(0.003), effects=fitted)
    return Model({name: joint, "j2": JointModel(1.1, 0.03, 0.02, 0.002)})


@pytest.fixture
def robot() -> Robot:
    return read_robot("datasets/servo_steps/robot.toml")


class Recorded:
    """Stands in for a configuration class: keeps its fields."""

    def __init__(self, **fields: Any) -> None:
        self.fields = fields


def configurations(text: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, dict[str, Any]]:
    """Fields of the configurations that an exported text makes at 5 ms a step."""
    package, module = ModuleType("isaaclab"), ModuleType("isaaclab.actuators")
    module.DelayedPDActuatorCfg = type("DelayedPDActuatorCfg", (Recorded,), {})  # type: ignore[attr-defined]
    module.DCMotorCfg = type("DCMotorCfg", (Recorded,), {})  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "isaaclab", package)
    monkeypatch.setitem(sys.modules, "isaaclab.actuators", module)
    space: dict[str, Any] = {}
    exec(compile(text, "exported.py", "exec"), space)
    made = space["actuators"](physics_dt=0.005)
    return {name: one.fields | {"class": type(one).__name__} for name, one in made.items()}


def test_isaaclab(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    found = configurations(
        isaaclab(servo("j1", "coulomb_friction", "torque_saturation"), robot).text, monkeypatch
    )
    assert found["j1"] == {
        "class": "DelayedPDActuatorCfg",
        "joint_names_expr": ["j1"],
        "stiffness": 2.2,
        "damping": 0.06,
        "effort_limit": 0.5,  # identified; not the data sheet's 1.67
        "velocity_limit": 5.24,
        "min_delay": 10,
        "max_delay": 10,
        "friction": 0.05,
        "dynamic_friction": 0.05,
    }
    assert found["j2"]["effort_limit"] == 1.67
    assert (found["j2"]["min_delay"], found["j2"]["max_delay"]) == (4, 4)


def test_isaaclab_jitter_is_drawn_between_two_delays(monkeypatch: pytest.MonkeyPatch) -> None:
    export = isaaclab(servo("j1", "latency_jitter"))
    fields = configurations(export.text, monkeypatch)["j1"]
    assert (fields["min_delay"], fields["max_delay"]) == (8, 12)
    assert any("part of latency_jitter" in str(line) for line in export.left_out)
    assert "effort_limit" not in fields


def test_a_drive_that_clips_before_the_back_emf_is_a_dc_motor() -> None:
    motor = Actuator("j1", kp=2.0, kd=0.0, latency=0.02, inertia=0.002, back_emf=0.1, limit=0.8)
    text = _entry(motor)
    fields = ("damping=0.1", "saturation_effort=0.8", "effort_limit=1.6", "velocity_limit=8")
    for field in ("DCMotorCfg", *fields):
        assert field in text
    assert "delay" not in text


def test_genesis() -> None:
    model = servo("j1", "coulomb_friction", "unmodelled_inertia", "torque_saturation")
    space: dict[str, Any] = {}
    exec(compile(genesis(model).text, "exported.py", "exec"), space)
    calls: dict[str, Any] = {}

    class Entity:
        def get_joint(self, name: str) -> SimpleNamespace:
            return SimpleNamespace(dofs_idx_local=[{"j1": 4, "j2": 2}[name]])

        def __getattr__(self, call: str) -> Any:
            return lambda *given: calls.update({call: given})

    assert space["set_actuators"](Entity()) == [4, 2]
    infinite = float("inf")
    assert calls == {
        "set_dofs_kp": ([2.2, 1.1], [4, 2]),
        "set_dofs_kv": ([0.06, 0.03], [4, 2]),
        "set_dofs_damping": ([0, 0], [4, 2]),
        "set_dofs_armature": ([0.001, 0], [4, 2]),
        "set_dofs_frictionloss": ([0.05, 0], [4, 2]),
        "set_dofs_force_range": ([-0.5, -infinite], [0.5, infinite], [4, 2]),
    }


def test_urdf(robot: Robot) -> None:
    root = ElementTree.fromstring(urdf(servo("j1", "coulomb_friction"), robot).text)
    joint = root.find("joint")
    assert joint is not None
    assert (joint.get("name"), joint.get("type")) == ("j1", "revolute")
    dynamics, limit = joint.find("dynamics"), joint.find("limit")
    assert dynamics is not None
    assert limit is not None
    assert dynamics.get("friction") == "0.05"
    sheet = {"lower": "-0.8", "upper": "0.8", "effort": "1.67", "velocity": "5.24"}
    assert limit.attrib == sheet
    bare = ElementTree.fromstring(urdf(servo()).text).findall("joint")
    assert [one.get("type") for one in bare] == ["continuous", "continuous"]


def test_urdf_runs_in_mujoco(robot: Robot) -> None:
    mj = pytest.importorskip("mujoco")
    model = mj.MjModel.from_xml_string(urdf(servo("j1", "coulomb_friction"), robot).text)
    assert model.joint("j1").range == pytest.approx([-0.8, 0.8])
    assert model.dof_frictionloss[model.joint("j1").dofadr[0]] == pytest.approx(0.05)


def test_json_has_every_number(robot: Robot) -> None:
    content = json.loads(plain(servo("j1", "backlash"), robot).text)
    joint = content["joints"]["j1"]
    assert joint["kp_Nm_per_rad"] == 2.2
    assert joint["inertia_kgm2"] == 0.003
    play = {"gap_rad": 0.03, "rotor_inertia_kgm2": 4e-4, "output_friction_Nm": 0.02}
    assert joint["effects"] == [{"effect": "backlash", "parameters": play}]
    assert joint["data_sheet"]["max_torque_Nm"] == 1.67
    assert content["joints"]["j2"]["limit_Nm"] is None


@pytest.mark.parametrize("export", [isaaclab, genesis, urdf], ids=lambda f: f.__name__)
@pytest.mark.parametrize("effect", [effect.name for effect in CATALOGUE])
def test_an_effect_is_in_the_text_or_in_the_list(export: Any, effect: str) -> None:
    without, with_it = export(servo()), export(servo("j1", effect))
    listed = {str(line) for line in with_it.left_out} - {str(line) for line in without.left_out}
    assert with_it.text != without.text
    for line in listed:
        assert line in with_it.text
    expressed = {
        line for line in with_it.text.splitlines() if not line.lstrip().startswith(("#", "j"))
    } != {line for line in without.text.splitlines() if not line.lstrip().startswith(("#", "j"))}
    assert expressed or any(effect in line or "torque limit" in line for line in listed)


@pytest.mark.parametrize("export", TEXTS, ids=lambda f: f.__name__)
def test_a_name_stays_a_name(export: Any, tmp_path: Path) -> None:
    """A joint's name cannot end a comment or a string of the text it stands in."""
    name = "j'\"\n1 --> <x/>\nraise SystemExit"
    text = export(servo(name, "backlash")).text
    if export in (isaaclab, genesis):
        space: dict[str, Any] = {}
        code = text.replace("from isaaclab.actuators import DelayedPDActuatorCfg", "")
        exec(compile(code, "exported.py", "exec"), space)
    elif export is plain:
        assert name in json.loads(text)["joints"]
    else:
        assert len(list(ElementTree.fromstring(text).iter("joint"))) >= 2


def test_the_readme_says_what_each_target_expresses() -> None:
    from sim2real.exporters import genesis as g
    from sim2real.exporters import isaaclab as i
    from sim2real.exporters import mjlab as j
    from sim2real.exporters import mujoco as m
    from sim2real.exporters import newton as n
    from sim2real.exporters import urdf as u

    text = Path("sim2real/exporters/README.md").read_text()
    rows = [line.strip("| ").split("|") for line in text.splitlines() if line.startswith("| `")]
    said = [
        {row[0].strip().strip("`") for row in rows if len(row) > k and row[k].strip()}
        for k in range(1, 7)
    ]
    assert said == [set(target.HAS) for target in (m, j, i, n, g, u)]
