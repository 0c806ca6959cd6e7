"""Own servo: superposed step responses at exact times, so that nothing is shared with what is
tested."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from sim2real.diagnose.angle_noise import with_noise
from sim2real.diagnose.link_effect import EFFECTS, MOST_LAGS, fitted, link_of
from sim2real.recording import Load
from sim2real.servo.event_filter import Arrivals, Channel, EventFilter
from sim2real.servo.linearised import Residual, gain_derivatives, servo_modes
from sim2real.servo.trace import Trace

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
        swing = (r * np.exp(p * x) - p * np.exp(r * x)) / (p - r)
        q[first : first + 100] += du * (1 + swing).real
        q[first + 100 :] += du
    return q


def measured(q, rng, sd=0.001, step=0.0015):
    wander = np.zeros(q.size)
    for k in range(1, q.size):
        wander[k] = 0.99 * wander[k - 1] + 1.4e-4 * rng.normal()
    return np.round((q + wander + sd * rng.normal(size=q.size)) / step) * step


def recording(
    seed, jitter=0.0, loss=0.0, t=None, lost=None, kp=KP, scale=1.0, drift=0.0, step=0.0015
):
    """What a fit with the true parameters leaves, and which set-points are lost."""
    rng = np.random.default_rng(seed)
    t = np.arange(T) / 50 if t is None else t
    u = scale * command(t)
    regular = t + LATENCY + drift * t
    arrival = regular + jitter * rng.uniform(-1, 1, size=t.size)
    if lost is None:
        lost = np.flatnonzero(rng.uniform(size=t.size) < loss)
    lost = lost[lost > 0]
    arrival[lost] = np.inf
    residual = angle(t, u, regular) - measured(angle(t, u, arrival, kp), rng, step=step)
    return replace(fitted_servo(t, u, residual, LATENCY), drift_s_per_s=drift), lost


def fitted_servo(t, command, residual, latency):
    used = np.ones(t.size, dtype=bool)
    trace = Trace("r", "r.csv", t, command, command, Load(INERTIA, 0.0), used)
    return Residual(trace, residual, KP, KD, latency)


def test_set_points_may_act_before_they_are_stamped():
    t, sample = np.arange(200) / 50, np.arange(200)
    plain = fitted_servo(t, np.where(sample < 99, 0.0, 0.3), np.zeros(200), 0.0)
    late = fitted_servo(t, np.where(sample < 100, 0.0, 0.3), np.zeros(200), 0.0)
    ahead = replace(late, trace=replace(late.trace, sample_delay_s=0.02))
    np.testing.assert_allclose(gain_derivatives(ahead), gain_derivatives(plain), atol=1e-9)


def fit(effect, *joints):
    """The likelier fit of an effect, with packets in common or not."""
    noisy = [with_noise(joint, MOST_LAGS, LEAST_GAIN) for joint in joints]
    return max(fitted(noisy, (effect,)), key=lambda each: each.gain)


def uneven(*joints):
    """Jitter and loss, each on its own."""
    return [fit(effect, *joints).result() for effect in EFFECTS]


def size_of(link):
    """The size of the first effect, and its standard deviation."""
    return link.sizes[link.effect]


@pytest.mark.parametrize("seed", range(6))
def test_finds_nothing_in_noise(seed):
    jitter, loss = uneven([recording(seed)[0]])
    assert jitter.gain < 4
    assert size_of(jitter)[0] < 0.001
    assert loss.gain == 0


@pytest.mark.parametrize("size", [0.002, 0.008, 0.02])
def test_recovers_jitter(size):
    jitter = uneven([recording(1, jitter=size)[0]])[0]
    assert jitter.gain > 25
    assert size_of(jitter)[0] == pytest.approx(size, rel=0.15)
    assert 0 < size_of(jitter)[1] < 0.15 * size


def test_recovers_jitter_whose_delays_are_alike():
    rng = np.random.default_rng(3)
    late = lfilter([0.003 * np.sqrt(1 - 0.7**2)], [1.0, -0.7], rng.normal(size=T))
    t = np.arange(T) / 50
    u = command(t)
    on_time, moved = angle(t, u, t + LATENCY), angle(t, u, t + LATENCY + late)
    residual = on_time - measured(moved, rng)
    jitter = uneven([fitted_servo(t, u, residual, LATENCY)])[0]
    assert size_of(jitter)[0] == pytest.approx(0.003 * np.sqrt(3), rel=0.2)
    assert jitter.correlation == pytest.approx(0.7, abs=0.2)


@pytest.mark.parametrize("share", [0.01, 0.05, 0.15])
def test_recovers_lost_set_points(share):
    loss = uneven([recording(2, loss=share)[0]])[1]
    assert loss.gain > 50
    assert size_of(loss)[0] == pytest.approx(share, abs=3 * size_of(loss)[1] + 0.2 * share)


@pytest.mark.parametrize("seed", [1, 2])
def test_finds_both_at_once_and_no_other_beside_one(seed):
    def found(**of):
        return link_of([[recording(seed, **of)[0]]], LAGS, LEAST_GAIN, 10.0)

    both = found(jitter=0.008, loss=0.06)
    assert set(both.sizes) == set(EFFECTS)
    late, lost = (both.sizes[effect] for effect in EFFECTS)
    assert late[0] == pytest.approx(0.008, rel=0.25)
    assert lost[0] == pytest.approx(0.06, rel=0.6)  # delays explain some of the losses
    assert set(found(jitter=0.008).sizes) == {"latency_jitter"}
    assert set(found(loss=0.06).sizes) == {"packet_loss"}


def test_set_points_are_lost_on_clocks_that_drift():
    drifted = recording(1, loss=0.05, drift=0.001)[0]
    pair = drifted, replace(drifted, drift_s_per_s=0.0)
    on_time, unaware = (fit("packet_loss", [x]) for x in pair)
    assert on_time.gain > 1.5 * unaware.gain


def test_a_link_says_which_and_on_which_joints():
    quiet = recording(20, scale=0.0)[0]
    jitter = link_of([[recording(5, jitter=0.008)[0]], [quiet]], LAGS, LEAST_GAIN, 10.0)
    assert jitter.effect == "latency_jitter"
    assert jitter.shares[0] > 25
    assert jitter.shares[1] < 4
    nothing = link_of([[quiet]], LAGS, LEAST_GAIN, 10.0)
    assert nothing.gain == 0


def test_gains_that_are_wrong_are_neither():
    jitter, loss = uneven([recording(10, kp=1.1 * KP)[0]])
    assert jitter.gain < 5
    assert loss.gain < 5


def test_times_may_be_uneven():
    rng = np.random.default_rng(0)
    t = np.cumsum(0.02 + rng.uniform(-0.004, 0.004, size=T))
    t[700:] += 0.5  # samples are missing
    jitter = uneven([recording(11, jitter=0.006, t=t)[0]])[0]
    assert size_of(jitter)[0] == pytest.approx(0.006, rel=0.15)
    loss = uneven([recording(11, loss=0.05, t=t)[0]])[1]
    assert size_of(loss)[0] == pytest.approx(0.05, abs=0.02)


def test_does_not_look_at_what_it_may_not_use():
    given = recording(12, jitter=0.006)[0]
    given.trace.used[400:700] = False
    given.residual[400:700] = np.nan
    found = uneven([given])[0]
    assert size_of(found)[0] == pytest.approx(0.006, rel=0.2)
    changed = given.residual.copy()
    changed[400:700] = 7.0
    again = uneven([Residual(**{**vars(given), "residual": changed})])[0]
    assert again.gain == pytest.approx(found.gain, abs=1e-6)


def test_needs_samples():
    given = recording(13)[0]
    given.trace.used[MOST_LAGS:] = False
    with pytest.raises(ValueError, match="0 samples count"):
        uneven([given])


def packets(seed, *, burst=1.0, loss=0.05, n=T):
    """Indices of set-points lost in bursts of this mean length, by a two-state chain."""
    rng, lost, out = np.random.default_rng(seed), False, []
    for k in range(1, n):
        begins = loss / (burst * (1 - loss))
        lost = rng.uniform() < (1 - 1 / burst if lost else begins)
        if lost:
            out.append(k)
    return np.array(out)


def test_recovers_the_length_of_bursts():
    loss = uneven([recording(21, lost=packets(22, burst=4.0))[0]])[1]
    assert loss.burst == pytest.approx(4.0, rel=0.4)
    single = uneven([recording(21, lost=packets(23))[0]])[1]
    assert single.burst < 1.3


def test_says_when_set_points_were_lost():
    given, lost = recording(7, loss=0.03)
    (of_joint,) = uneven([given])[1].lost_s
    seen = lost[np.abs(np.diff(given.trace.command)[lost - 1]) > 0.005]
    assert np.isin(given.trace.t[seen], of_joint[0]).mean() > 0.8


def test_finds_whether_one_packet_carries_all_joints():
    first, lost = recording(7, loss=0.05)
    assert fit("packet_loss", [first], [recording(8, lost=lost, scale=0.5)[0]]).common
    assert not fit("packet_loss", [first], [recording(9, loss=0.05, scale=0.5)[0]]).common


def exact(track, timing):
    """Log-likelihood of one track by all its histories, each by dense Gaussian algebra."""
    t, u, K = track.t, track.command, track.t.size
    begins = t + track.latency_s
    slots = int(np.searchsorted(begins, t[-1], side="right"))
    p, r, gain = track.modes.fast, track.modes.slow, track.modes.gain

    def step(x):
        x = np.maximum(x, 0.0)
        return (gain * (1 + (r * np.exp(p * x) - p * np.exp(r * x)) / (p - r)) / (p * r)).real

    def impulse(x):
        y = np.maximum(x, 0.0)
        return np.where(x > 0, (gain * (np.exp(p * y) - np.exp(r * y)) / (p - r)).real, 0.0)

    total = []
    for code in range(2 ** (slots - 1)):
        lost = [False, *(bool(code >> k & 1) for k in range(slots - 1))]
        active = np.maximum.accumulate(np.where(lost, 0, np.arange(slots)))
        chance, deviation, covariance = 0.0, np.zeros(K), np.diag(track.variance * track.scale**2)
        delays = np.zeros((K, slots))
        for k in range(1, slots):
            q = timing.repeated_loss if active[k - 1] < k - 1 else timing.loss
            chance += np.log(q if lost[k] else 1 - q)
            delays[:, k] = impulse(t - begins[k]) * (u[active[k]] - u[active[k - 1]])
        lag = np.abs(np.subtract.outer(np.arange(slots), np.arange(slots)))
        covariance += timing.delay_sd_s**2 * delays @ timing.correlation**lag @ delays.T
        for k in range(slots):
            end = begins[k + 1] if k + 1 < K else np.inf
            held = step(t - (t[0] if k == 0 else begins[k])) - step(t - end)
            deviation += (u[k] - u[active[k]]) * held
        error = track.residual - deviation
        _, logdet = np.linalg.slogdet(covariance)
        total.append(chance - 0.5 * (logdet + error @ np.linalg.solve(covariance, error)))
    return np.logaddexp.reduce(total)


def short_track():
    rng = np.random.default_rng(5)
    t = np.arange(12) / 50
    source = fitted_servo(t, rng.normal(size=12), 0.02 * rng.normal(size=12), 0.043)
    return Channel(
        t, source.trace.command, source.latency_s, servo_modes(source), source.residual,
        rng.uniform(0.5, 2.0, size=12), np.zeros(12, dtype=bool), np.zeros(1), 1e-4,
    )  # fmt: skip


@pytest.mark.parametrize(
    "timing", [Arrivals(0.2, 0.4), Arrivals(0.1, 0.1, 0.004), Arrivals(1e-12, 1e-12, 0.006, 0.7)]
)
def test_the_filter_sums_over_all_histories(timing):
    track = short_track()
    ((found,),) = EventFilter([[track]], alike=0.0).run([timing], width=2000)
    assert found.loglikelihood == pytest.approx(exact(track, timing), abs=1e-6)
