"""Own servo: superposed step responses at exact times, so that nothing is shared with what is
tested."""

import numpy as np
import pytest

from sim2real.diagnose.arrival_jitter import halfwidth
from sim2real.diagnose.arrivals import Residual, arrivals

KP, KD, LATENCY, INERTIA = 3.0, 0.12, 0.05, 0.003
LAGS, LEAST_GAIN = 25, 0.02
T = 1500


def command(t):
    """A slow triangle, a rest and a chirp."""
    u = 0.4 * np.abs((t / 2) % 2 - 1)
    u[(t > 8) & (t < 12)] = 0.2
    fast = t >= 12
    x = t[fast] - 12
    u[fast] = 0.2 + 0.3 * np.sin(2 * np.pi * (0.2 * x + 0.06 * x**2))
    return u


def angle(t, u, arrival, kp=KP):
    """Angle after steps that arrive when they do, or never where infinite, in order."""
    there = np.isfinite(arrival)
    there[0] = True
    change = np.diff(u[there], prepend=u[0])
    half, root = KD / (2 * INERTIA), np.emath.sqrt((KD / (2 * INERTIA)) ** 2 - kp / INERTIA)
    p, r = -half - root, -half + root
    q = np.full(t.size, u[0])
    for when, du in zip(np.maximum.accumulate(arrival[there]), change, strict=True):
        first = np.searchsorted(t, when)
        x = t[first : first + 100] - when
        q[first : first + 100] += (
            du * (1 + ((r * np.exp(p * x) - p * np.exp(r * x)) / (p - r))).real
        )
        q[first + 100 :] += du
    return q


def measured(q, rng, sd=0.001, step=0.0015):
    wander = np.zeros(q.size)
    for k in range(1, q.size):
        wander[k] = 0.99 * wander[k - 1] + 1.4e-4 * rng.normal()
    return np.round((q + wander + sd * rng.normal(size=q.size)) / step) * step


def recording(seed, jitter=0.0, loss=0.0, t=None, lost=None, kp=KP, scale=1.0):
    """What a fit with the true parameters leaves, and which set-points are lost."""
    rng = np.random.default_rng(seed)
    t = np.arange(T) / 50 if t is None else t
    u = scale * command(t)
    arrival = t + LATENCY + jitter * rng.uniform(-1, 1, size=t.size)
    if lost is None:
        lost = np.flatnonzero(rng.uniform(size=t.size) < loss)
    lost = lost[lost > 0]
    arrival[lost] = np.inf
    residual = angle(t, u, t + LATENCY) - measured(angle(t, u, arrival, kp), rng)
    used = np.ones(t.size, dtype=bool)
    return Residual(t, u, used, residual, KP, KD, LATENCY, INERTIA), lost


def listen(*joints, broadcast=False):
    return arrivals(joints, lags=LAGS, least_gain=LEAST_GAIN, broadcast=broadcast)


@pytest.mark.parametrize("seed", range(6))
def test_finds_nothing_in_noise(seed):
    found = listen([recording(seed)[0]])
    assert found.jitter.gain < 4
    assert found.jitter.halfwidth_s < 0.001
    assert found.loss.gain == 0
    assert found.loss.probability == 0
    assert found.loss.sd < 0.01  # hundreds of set-points were seen to arrive
    assert found.loss.lost[0][0].size == 0
    assert not found.loss.explained[0][0].any()


@pytest.mark.parametrize("size", [0.002, 0.008, 0.02])
def test_recovers_jitter(size):
    given = recording(1, jitter=size)[0]
    jitter = listen([given]).jitter
    assert jitter.gain > 25
    assert jitter.halfwidth_s == pytest.approx(size, rel=0.15)
    assert 0 < jitter.sd_s < 0.15 * size
    left = given.residual - jitter.explained[0][0]
    assert left.std() < 0.9 * given.residual.std()


@pytest.mark.parametrize("share", [0.01, 0.05, 0.15])
def test_recovers_lost_set_points(share):
    given, lost = recording(2, loss=share)
    loss = listen([given]).loss
    assert loss.gain > 50
    assert loss.probability == pytest.approx(share, abs=3 * loss.sd + 0.2 * share)
    change = np.abs(np.diff(given.command, prepend=given.command[0]))
    assert np.isin(loss.lost[0][0], lost).mean() > 0.8
    assert np.isin(lost[change[lost] > 0.03], loss.lost[0][0]).mean() > 0.8
    left = given.residual - loss.explained[0][0]
    assert left.std() < 0.8 * given.residual.std()


def test_tells_them_apart():
    for seed in (3, 4):
        late = listen([recording(seed, jitter=0.008)[0]])
        assert late.jitter.gain > 2 * late.loss.gain
        lossy = listen([recording(seed, loss=0.05)[0]])
        assert lossy.loss.gain > 1.3 * lossy.jitter.gain


def test_pools_recordings_and_joints():
    one, two = (recording(seed, jitter=0.003)[0] for seed in (5, 6))
    alone = [listen([given]).jitter for given in (one, two)]
    together, link = listen([one, two]).jitter, listen([one], [two]).jitter
    for pooled in (together, link):
        assert pooled.gain > 0.8 * sum(jitter.gain for jitter in alone)
        assert pooled.sd_s < min(jitter.sd_s for jitter in alone)
        assert pooled.halfwidth_s == pytest.approx(0.003, rel=0.15)
    assert [len(parts) for parts in together.explained] == [2]
    assert [len(parts) for parts in link.explained] == [1, 1]


def test_a_broadcast_is_lost_for_all():
    first, lost = recording(7, loss=0.05)
    second = recording(8, lost=lost, scale=0.5)[0]
    apart = listen([first], [second]).loss
    shared = listen([first], [second], broadcast=True).loss
    assert shared.gain > apart.gain + 20
    np.testing.assert_array_equal(shared.lost[0][0], shared.lost[1][0])
    correct = [np.isin(lost, x.lost[1][0]).sum() for x in (apart, shared)]
    assert correct[1] > correct[0]


def test_a_broadcast_has_one_length():
    short = recording(9, t=np.arange(1200) / 50)[0]
    with pytest.raises(ValueError, match="expected the same"):
        listen([recording(9)[0]], [short], broadcast=True)


def test_gains_that_are_wrong_are_neither():
    found = listen([recording(10, kp=1.1 * KP)[0]])
    assert found.jitter.gain < 5
    assert found.loss.gain < 5


def test_times_may_be_uneven():
    rng = np.random.default_rng(0)
    t = np.cumsum(0.02 + rng.uniform(-0.004, 0.004, size=T))
    t[700:] += 0.5  # samples are missing
    jitter = listen([recording(11, jitter=0.006, t=t)[0]]).jitter
    assert jitter.halfwidth_s == pytest.approx(0.006, rel=0.15)
    given, lost = recording(11, loss=0.05, t=t)
    found = listen([given]).loss
    assert np.isin(found.lost[0][0], lost).mean() > 0.8


def test_does_not_look_at_what_it_may_not_use():
    given = recording(12, jitter=0.006)[0]
    given.used[400:700] = False
    given.residual[400:700] = np.nan
    found = listen([given])
    assert found.jitter.halfwidth_s == pytest.approx(0.006, rel=0.2)
    assert np.isfinite(found.jitter.explained[0][0]).all()
    changed = given.residual.copy()
    changed[400:700] = 7.0
    again = listen([Residual(**{**vars(given), "residual": changed})])
    assert again.jitter.gain == pytest.approx(found.jitter.gain, abs=1e-6)


def test_needs_samples():
    given = recording(13)[0]
    given.used[20:] = False
    with pytest.raises(ValueError, match="0 samples count"):
        listen([given])


def test_short_recordings():
    given = recording(14, t=np.arange(60) / 50)[0]
    found = listen([given])
    assert found.jitter.gain < 10
    assert found.loss.gain < 10


@pytest.mark.parametrize("width", [0.3, 1.0, 2.5])
def test_halfwidth_where_none_overtakes(width):
    rng = np.random.default_rng(0)
    sent = np.arange(400_000)
    late = np.maximum.accumulate(sent + rng.uniform(-width, width, size=sent.size)) - sent
    blocks = late.reshape(-1, 200).mean(axis=1)
    assert halfwidth(blocks.std() * np.sqrt(200), 1.0) == pytest.approx(width, rel=0.05)
