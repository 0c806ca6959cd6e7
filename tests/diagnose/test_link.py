"""Own servo: superposed step responses at exact times, so that nothing is shared with what is
tested."""

import numpy as np
import pytest

from sim2real.diagnose.link.angle_noise import with_noise
from sim2real.diagnose.link.jitter import halfwidth, latency_jitter
from sim2real.diagnose.link.link_effect import LinkData, link
from sim2real.diagnose.link.lost_packets import packet_loss
from sim2real.servo.linearised import Residual

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


def uneven(*joints):
    """Jitter and loss, each on its own."""
    given = [with_noise(joint, LAGS, LEAST_GAIN) for joint in joints]
    return latency_jitter(given), packet_loss(given)


@pytest.mark.parametrize("seed", range(6))
def test_finds_nothing_in_noise(seed):
    jitter, loss = uneven([recording(seed)[0]])
    assert jitter.gain < 4
    assert jitter.value < 0.001
    assert loss.gain == 0
    assert loss.value == 0


@pytest.mark.parametrize("size", [0.002, 0.008, 0.02])
def test_recovers_jitter(size):
    jitter = uneven([recording(1, jitter=size)[0]])[0]
    assert jitter.gain > 25
    assert jitter.value == pytest.approx(size, rel=0.15)
    assert 0 < jitter.sd < 0.15 * size


@pytest.mark.parametrize("share", [0.01, 0.05, 0.15])
def test_recovers_lost_set_points(share):
    loss = uneven([recording(2, loss=share)[0]])[1]
    assert loss.gain > 50
    assert loss.value == pytest.approx(share, abs=3 * loss.sd + 0.2 * share)


def test_tells_them_apart():
    for seed in (3, 4):
        late = uneven([recording(seed, jitter=0.008)[0]])
        assert late[0].gain > 2 * late[1].gain
        lossy = uneven([recording(seed, loss=0.05)[0]])
        assert lossy[1].gain > 1.3 * lossy[0].gain


def test_a_link_says_which_and_on_which_joints():
    quiet = recording(20, scale=0.0)[0]
    jitter = link(LinkData(((recording(5, jitter=0.008)[0],), (quiet,)), LAGS, LEAST_GAIN, 10.0))
    assert jitter.effect == "latency_jitter"
    assert jitter.shares[0] > 25
    assert jitter.shares[1] < 4
    nothing = link(LinkData(((quiet,),), LAGS, LEAST_GAIN, 10.0))
    assert nothing.gain == 0


def test_pools_recordings_and_joints():
    one, two = (recording(seed, jitter=0.003)[0] for seed in (5, 6))
    alone = [uneven([given])[0] for given in (one, two)]
    for pooled in (uneven([one, two])[0], uneven([one], [two])[0]):
        assert pooled.gain > 0.8 * sum(jitter.gain for jitter in alone)
        assert pooled.sd < min(jitter.sd for jitter in alone)
        assert pooled.value == pytest.approx(0.003, rel=0.15)


def test_what_is_lost_is_lost_for_all():
    first, lost = recording(7, loss=0.05)
    second = recording(8, lost=lost, scale=0.5)[0]
    other = recording(8, loss=0.05, scale=0.5)[0]
    alone = sum(uneven([given])[1].gain for given in (first, second))
    assert uneven([first], [second])[1].gain > alone + 20
    assert uneven([first], [other])[1].gain < alone


def test_joints_of_different_recordings_lose_each_its_own():
    short = recording(9, loss=0.05, t=np.arange(1200) / 50)[0]
    both = [recording(9, loss=0.05)[0], short]
    alone = [uneven([given])[1].gain for given in both]
    assert uneven(*([given] for given in both))[1].gain == pytest.approx(sum(alone))


def test_gains_that_are_wrong_are_neither():
    jitter, loss = uneven([recording(10, kp=1.1 * KP)[0]])
    assert jitter.gain < 5
    assert loss.gain < 5


def test_times_may_be_uneven():
    rng = np.random.default_rng(0)
    t = np.cumsum(0.02 + rng.uniform(-0.004, 0.004, size=T))
    t[700:] += 0.5  # samples are missing
    jitter = uneven([recording(11, jitter=0.006, t=t)[0]])[0]
    assert jitter.value == pytest.approx(0.006, rel=0.15)
    assert uneven([recording(11, loss=0.05, t=t)[0]])[1].value == pytest.approx(0.05, abs=0.02)


def test_does_not_look_at_what_it_may_not_use():
    given = recording(12, jitter=0.006)[0]
    given.used[400:700] = False
    given.residual[400:700] = np.nan
    found = uneven([given])[0]
    assert found.value == pytest.approx(0.006, rel=0.2)
    changed = given.residual.copy()
    changed[400:700] = 7.0
    again = uneven([Residual(**{**vars(given), "residual": changed})])[0]
    assert again.gain == pytest.approx(found.gain, abs=1e-6)


def test_needs_samples():
    given = recording(13)[0]
    given.used[20:] = False
    with pytest.raises(ValueError, match="0 samples count"):
        uneven([given])


def test_short_recordings():
    jitter, loss = uneven([recording(14, t=np.arange(60) / 50)[0]])
    assert jitter.gain < 10
    assert loss.gain < 10


@pytest.mark.parametrize("width", [0.3, 1.0, 2.5])
def test_halfwidth_where_none_overtakes(width):
    rng = np.random.default_rng(1)
    sent = np.arange(400_000)
    late = np.maximum.accumulate(sent + rng.uniform(-width, width, size=sent.size)) - sent
    blocks = late.reshape(-1, 200).mean(axis=1)
    assert halfwidth(blocks.std() * np.sqrt(200), 1.0) == pytest.approx(width, rel=0.05)
