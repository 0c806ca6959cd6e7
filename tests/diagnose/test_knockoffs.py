"""Knockoffs: as large and smooth as the effects that they imitate, and unlike them."""

import numpy as np

from sim2real.diagnose.page.servo_knockoffs import changes, meaningless
from sim2real.inference.folds import rms

T = 0.02 * np.arange(1500)


def test_stronger_effects_change_the_angle_more(rubbing):
    servo = rubbing.tried.plain.fit.servos
    given = [c for c in rubbing.seen[1] if c.effect.name in ("coulomb_friction", "backlash")]
    own, by_effects = changes(rubbing.traces, servo, given)
    assert [x.shape for x in own] == [(t.t.size, servo.columns.shape[1]) for t in rubbing.traces]
    starts = np.concatenate([c.starts[:, 0] for c in given])
    for change in by_effects:
        assert change.shape[1] == starts.size
        first = change[:, : given[0].starts.shape[0]]
        assert np.all(np.diff([rms([column]) for column in first.T]) > 0), "stronger changes more"


def test_knockoffs_keep_size_and_smoothness_and_lose_the_rest():
    rng = np.random.default_rng(0)
    wave = np.sin(2 * np.pi * T / 2.0)[:, None]
    drawn = [meaningless(wave, T, rng)[:, 0] for _ in range(60)]
    sizes = [np.std(x) / np.std(wave) for x in drawn]
    assert 0.85 < np.mean(sizes) < 1.0
    assert max(np.abs(np.diff(x)).max() for x in drawn) < 0.2, "no jumps"
    alike = [np.corrcoef(x, wave[:, 0])[0, 1] for x in drawn]
    assert np.abs(np.mean(alike)) < 0.15
    assert np.quantile(np.abs(alike), 0.9) < 0.6, "even where the command repeats itself"
