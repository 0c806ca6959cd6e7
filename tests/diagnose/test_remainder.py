import numpy as np
import pytest

from sim2real.diagnose.remainder import remainder
from sim2real.recording import Load
from sim2real.servo.trace import Trace

T = 0.01 * np.arange(2000)
ANGLE = 0.8 * np.sin(0.9 * T) * np.cos(0.37 * T)
SPEED = np.gradient(ANGLE, T)
TURNS = T[1:][np.diff(np.sign(SPEED)) != 0]
SINCE = np.min(np.abs(T - TURNS[:, None]) + 1e3 * (TURNS[:, None] > T), axis=0)


@pytest.mark.parametrize(
    ("where", "told"),
    [
        (SINCE < 0.15, "reversals"),
        (np.abs(SPEED) > 0.6, "speeds above"),
        (SPEED > 0.05, "turning forwards"),
        (T < 0.8, "first second"),
        (T > -1.0, "spread over"),
    ],
)
def test_the_part_of_the_motion_with_the_error_is_told_with_its_share(where, told):
    trace = Trace("a", "a", T, ANGLE, ANGLE, Load(0.002), np.ones(T.size, dtype=bool))
    noise = np.random.default_rng(0).normal(0, 1e-3, T.size)
    text = remainder([trace], (noise * np.where(where, 5.0, 1.0))[None], 1e-3)
    assert told in text
    assert "%" not in text or int(text.split("%")[0].split()[-1]) > 60
