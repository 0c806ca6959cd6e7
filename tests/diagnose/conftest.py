"""Two short recordings each of a servo that misses nothing and of some that miss one effect."""

import sys

import pytest
from searching import Searched, searched
from simulated import FRICTION, robot, two

from sim2real.diagnose.diagnose import Case, diagnose, examined
from sim2real.diagnose.joint_result import JointFindings
from sim2real.diagnose.result import Diagnosis


@pytest.fixture(scope="session")
def nothing() -> Searched:
    return searched(seconds=12.0)


@pytest.fixture(scope="session")
def rubbing() -> Searched:
    return searched(coulomb_friction={"torque_Nm": 0.05})


@pytest.fixture(scope="session")
def filtered() -> Searched:
    return searched(command_filter={"time_constant_s": 0.06})


@pytest.fixture(scope="session")
def both() -> tuple[Diagnosis, tuple[Case, list[JointFindings]]]:
    """The diagnosis of a servo with dry friction, and what it puts into words."""
    seen = []
    with pytest.MonkeyPatch.context() as patch:
        module = sys.modules["sim2real.diagnose.diagnose"]
        patch.setattr(module, "examined", lambda *a, **k: seen.append(examined(*a, **k)) or seen[0])
        return diagnose(two(**FRICTION), robot("j1")), seen[0]


@pytest.fixture(scope="session")
def explained(both) -> Diagnosis:
    return both[0]


@pytest.fixture(scope="session")
def explained_joint(both) -> tuple[Case, list[JointFindings]]:
    """What is known of the joint, before it is put into words."""
    return both[1]
