"""What a parameter says of itself."""

import pytest

from sim2real.inference.parameters import Parameter
from sim2real.units import unit_of


def test_a_parameter_says_its_prior_and_its_unit():
    assert (
        str(Parameter("kp_Nm_per_rad", 0.5, 8.0, 2.0, log=True)) == "log-uniform 0.5 to 8 N m/rad"
    )
    assert str(Parameter("latency_s", 0.0, 0.5, 0.05)) == "uniform 0 to 0.5 s"
    assert str(Parameter("u_m_s", -1, 1, 0.1, 0.02, 0.3)) == "normal 0.02 ± 0.3 m/s"
    assert Parameter("kp_Nm_per_rad", 1, 2, 1, unit="1/s²").unit == "1/s²"


@pytest.mark.parametrize(
    "name, unit",
    [("gap_rad", "rad"), ("limit_rad_s2", "rad/s²"), ("ki_Nm_per_rad_s", "N m/(rad s)"),
     ("coefficient_Nms2", "N m s²"), ("s_per_s", "s/s"), ("ratio", "")],
)  # fmt: skip
def test_units(name, unit):
    assert unit_of(name) == unit
