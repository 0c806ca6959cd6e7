"""Two short recordings each of a servo that misses nothing and of some that miss one effect."""

import pytest
from searching import Searched, searched
from simulated import FRICTION, robot, two
from strange import position_damping, strange

from sim2real.diagnose.diagnose import Case, diagnose, diagnose_all, examined
from sim2real.diagnose.joint_result import JointFindings
from sim2real.diagnose.result import Diagnosis
from sim2real.recording import Recording


@pytest.fixture(scope="session")
def nothing() -> Searched:
    return searched()


@pytest.fixture(scope="session")
def rubbing() -> Searched:
    return searched(coulomb_friction={"torque_Nm": 0.05})


@pytest.fixture(scope="session")
def filtered() -> Searched:
    return searched(command_filter={"time_constant_s": 0.06})


@pytest.fixture(scope="session")
def explained() -> Diagnosis:
    """Of a servo with dry friction."""
    return diagnose(two(**FRICTION), robot("j1"))


@pytest.fixture(scope="session")
def explained_joint() -> tuple[Case, list[JointFindings]]:
    """What is known of its joint, before it is put into words."""
    return examined(Case(two(**FRICTION), robot("j1")))


@pytest.fixture(scope="session")
def puzzling() -> tuple[list[Recording], Diagnosis]:
    """Of a servo that does what is in no catalogue, with its recordings."""
    given = [strange(k, name, position_damping, seconds=8.0) for k, name in ((1, "a"), (2, "b"))]
    return given, diagnose_all([Case(given, robot("j1"))], thorough=True)[0]
