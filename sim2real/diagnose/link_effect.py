"""Do set-points arrive at irregular times, or not at all? Tested against ``angle_noise``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.angle_noise import Noise, NoisyJoint, with_noise
from sim2real.diagnose.decision import DECISION
from sim2real.inference.correlated_noise import whitened
from sim2real.inference.normal import SD_PER_MEDIAN
from sim2real.servo.event_filter import Arrivals, EventFilter, Filtered
from sim2real.servo.linearised import Residual

MOST_LAGS = 6
"""Largest order of the autoregression of the noise."""
EFFECTS = ("latency_jitter", "packet_loss")


@dataclass(frozen=True)
class IrregularTiming:
    """Irregular timing that explains a part of a robot's residuals."""

    # of ``latency_jitter``, ``packet_loss`` or both, the one that explains more first: halfwidth in
    # s or probability, and its standard deviation
    sizes: Mapping[str, tuple[float, float]]
    gain: float = 0.0  # log-likelihood gained over noise alone, in nats
    shares: tuple[float, ...] = ()  # gain at each joint by itself
    common: bool = False  # whether a set-point is lost for all joints at once
    burst: float = 1.0  # mean number of set-points that are lost in succession
    correlation: float = 0.0  # of successive delays
    # for each joint, by recording, when set-points were lost that it would have shown
    lost_s: tuple[tuple[Array, ...], ...] = ()
    # for each joint, by recording, the residual in rad without what the irregular timing is
    # expected to do, shape (T,)
    unexplained: tuple[tuple[Array, ...], ...] = ()

    @property
    def effect(self) -> str:
        """The effect that explains more."""
        return next(iter(self.sizes))


def link_of(
    residuals: Sequence[Sequence[Residual]],
    lags: int,
    least_gain: float,
    noticed: float = 0.0,
    *,
    both: bool = True,
    law_error: float = 0.1,
) -> IrregularTiming:
    """The better of the two effects on one robot's link; ``gain`` 0 below what is ``noticed``.

    With ``both`` the other one is added where it gains as much as is ``noticed`` again, and more
    than the law of the first one may leave, a share ``law_error`` of its gain. ``residuals`` are
    those of each joint's recordings, ``lags`` and ``least_gain`` as of ``with_noise``.
    """
    joints = [with_noise(of_joint, min(lags, MOST_LAGS), least_gain) for of_joint in residuals]
    samples = sum(joint.count for joint in joints)
    least = max(noticed, DECISION.link.negligible_gain * samples) if noticed else 0.0
    fits = [fit for effect in EFFECTS for fit in fitted(joints, (effect,))]
    best = max(fits, key=lambda fit: fit.gain)
    if best.gain < least:
        return IrregularTiming({best.effects[0]: (0.0, np.inf)}, shares=(0.0,) * len(joints))
    if noticed and both:
        effects = (*best.effects, *(e for e in EFFECTS if e not in best.effects))
        pair = max(fitted(joints, effects, best), key=lambda fit: fit.gain)
        best = pair if pair.gain > best.gain + max(least, law_error * best.gain) else best
    return best.result()


def fitted(
    joints: Sequence[NoisyJoint], effects: tuple[str, ...], begun: LinkFit | None = None
) -> list[LinkFit]:
    """Fits with packets of each joint's own and, for losses of several joints, with common ones.

    ``begun`` as of ``LinkFit``, whose packets stay as they are.
    """
    times = {tuple(s.residual.size for s in joint.segments) for joint in joints}
    at_once = "packet_loss" in effects and len(joints) > 1 and len(times) == 1
    kinds = (False, True) if at_once else (False,)
    if begun is not None and begun.arrivals.loss:
        kinds = (begun.common,)
    return [LinkFit(joints, effects, common=common, begun=begun) for common in kinds]


class LinkFit:
    """Effects fitted to the joints of a robot by expectation maximisation.

    The noise of each joint is refitted to what the expected deviations leave: Shumway and Stoffer,
    Journal of Time Series Analysis 3 (1982) 253-264. It begins from two guesses of the noise,
    since an autoregression can take any deviation for noise, or from another fit, ``begun``, to
    which an effect is added.

    Attributes:
        gain: Log-likelihood gained over noise alone, in nats; 0 where there is none.
        arrivals: How set-points arrive.
        noise_models: Of the residual of each joint.
    """

    def __init__(
        self,
        joints: Sequence[NoisyJoint],
        effects: tuple[str, ...],
        *,
        common: bool,
        begun: LinkFit | None = None,
    ) -> None:
        self.joints, self.effects, self.common = joints, effects, common
        self.gain = 0.0
        self.arrivals: Arrivals = Arrivals() if begun is None else begun.arrivals
        if "packet_loss" in effects and not self.arrivals.loss:
            self.arrivals = replace(self.arrivals, loss=0.02, repeated_loss=0.1)
        self.noise_models: Sequence[Noise] = [joint.noise for joint in joints]
        # The filter's log-likelihood counts the squares, that of the noise alone does not.
        alone = sum(joint.refitted(joint.noise)[1] - 0.5 * joint.count for joint in joints)
        starts: list[Sequence[Noise]] = list(zip(*map(_guesses, joints), strict=True))
        if begun is not None:
            starts = [begun.noise_models]
        # Noise that is guessed from most samples is too small until it is fitted again.
        guesses = [self._climb(models, self.arrivals, steps=2) for models in starts]
        total, arrivals, models = max(guesses, key=lambda guess: guess[0])
        if total < alone:
            return
        total, arrivals, models = self._climb(models, arrivals, steps=6)
        if total > alone:
            self.gain, self.arrivals, self.noise_models = total - alone, arrivals, models

    def _climb(
        self, models: Sequence[Noise], arrivals: Arrivals, *, steps: int
    ) -> tuple[float, Arrivals, Sequence[Noise]]:
        """The best log-likelihood, arrivals and noise models of a few alternations."""
        best: tuple[float, Arrivals, Sequence[Noise]] = (-np.inf, arrivals, models)
        for step in range(steps):
            events, results = self._filter(models), list[Filtered]()
            if "packet_loss" in self.effects:
                arrivals, results = self._losses(events, arrivals)
            if "latency_jitter" in self.effects:
                arrivals, results = self._delays(events, arrivals)
            gained = _total(results) - best[0]
            if gained > 0:
                best = (_total(results), arrivals, models)
            if gained < DECISION.link.min_gain or step + 1 == steps:
                break
            models = self._renewed(models, events, arrivals, results)
        return best

    def _filter(self, noise_models: Sequence[Noise]) -> EventFilter:
        pairs = zip(self.joints, noise_models, strict=True)
        channels = [[x.channel(noise) for x in joint.segments] for joint, noise in pairs]
        if self.common:
            return EventFilter(list(zip(*channels, strict=True)))
        return EventFilter([[channel] for of_joint in channels for channel in of_joint])

    def _losses(
        self, events: EventFilter, arrivals: Arrivals, iterations: int = 2
    ) -> tuple[Arrivals, list[Filtered]]:
        """Probabilities of losses by expectation maximisation."""
        for _ in range(iterations):
            before, (results,) = arrivals, events.run([arrivals])
            chances, lost, after, again = np.sum([x.counts for x in results], axis=0)
            first = float(np.clip((lost + 0.5) / (chances + 1), 1e-4, 0.5))
            repeated = float(np.clip((again + 0.5) / (after + 5), 1e-3, 0.9))
            arrivals = replace(arrivals, loss=first, repeated_loss=repeated)
        return before, results

    def _delays(self, events: EventFilter, arrivals: Arrivals) -> tuple[Arrivals, list[Filtered]]:
        """The best size and correlation of the delays, of a grid that is finer once known."""

        def best_of(sizes: Array, correlations: Array) -> tuple[Arrivals, list[Filtered]]:
            pairs = product(sizes.tolist(), correlations.tolist())
            options = [replace(arrivals, delay_sd_s=sd, correlation=r) for sd, r in pairs]
            width = 8 if arrivals.loss else 1  # histories that are kept
            results = zip(options, events.run(options, width=width), strict=True)
            return max(results, key=lambda result: _total(result[1]))

        sizes = np.geomspace(2.5e-4, 0.1, 10) / np.sqrt(3)  # from halfwidths
        if arrivals.loss:  # coarser, as many histories of losses take long
            near = arrivals.delay_sd_s * np.geomspace(0.7, 1.4, 3)
            return best_of(near if near.any() else sizes[3:9:2], np.array([arrivals.correlation]))
        if arrivals.delay_sd_s:
            correlations = arrivals.correlation + np.array([-0.2, -0.1, 0.0, 0.1, 0.2])
            near = np.unique(np.clip(correlations, 0.0, 0.95))
            return best_of(arrivals.delay_sd_s * np.geomspace(0.6, 1.7, 7), near)
        middle = best_of(sizes, np.array([0.5]))
        others = best_of(np.array([middle[0].delay_sd_s]), np.array([0.0, 0.8]))
        return max(middle, others, key=lambda pair: _total(pair[1]))

    def _explained(
        self, events: EventFilter, arrivals: Arrivals, results: Sequence[Filtered]
    ) -> list[tuple[NoisyJoint, Array, tuple[Array, ...]]]:
        """The joints without the expected deviations, their covariances, times of losses in s."""
        deviations = events.expected([x.active for x in results], arrivals)
        J, out = len(self.joints), []
        of_channels = [x for x in results for _ in range(J)] if self.common else results
        channels = list(zip(deviations, of_channels, strict=True))
        taken = iter(channels)
        for j, joint in enumerate(self.joints):
            some = channels[j::J] if self.common else list(islice(taken, len(joint.segments)))
            segments, lost_s = [], []
            for s, (deviation, x) in zip(joint.segments, some, strict=True):
                left = np.where(s.source.trace.used, s.residual - deviation.mean, 0.0)
                segments.append(replace(s, residual=left))
                lost_s.append(s.source.trace.t[np.setdiff1d(np.arange(x.active.size), x.active)])
            covariance = np.sum([deviation.covariance for deviation, _ in some], axis=0)
            out.append((replace(joint, segments=tuple(segments)), covariance, tuple(lost_s)))
        return out

    def _renewed(
        self,
        noise_models: Sequence[Noise],
        events: EventFilter,
        arrivals: Arrivals,
        results: Sequence[Filtered],
    ) -> list[Noise]:
        """The noise of each joint, refitted to what the expected deviations leave."""
        out = []
        explained = self._explained(events, arrivals, results)
        for (joint, covariance, _), old in zip(explained, noise_models, strict=True):
            noise, _ = joint.settled(old)
            noise, _ = joint.settled(joint.remodelled(noise, covariance))
            taps = np.append(1.0, -noise.model)
            extra = taps @ (covariance[0] + covariance[1] / noise.ratio**2) @ taps
            out.append(replace(noise, variance=noise.variance + float(extra) / joint.count))
        return out

    def result(self) -> IrregularTiming:
        """The sizes of the effects, the gain at each joint, and what they explain."""
        arrivals, events = self.arrivals, self._filter(self.noise_models)
        (results,) = events.run([arrivals])
        explained = self._explained(events, arrivals, results)
        shares = [self]
        if len(self.joints) > 1:
            shares = [LinkFit([x], self.effects[:1], common=False) for x in self.joints]
        return IrregularTiming(
            {effect: self._size(events, effect, results) for effect in self.effects},
            self.gain,
            tuple(share.gain for share in shares),
            self.common,
            1 / (1 - arrivals.repeated_loss),
            arrivals.correlation,
            tuple(lost_s for _, _, lost_s in explained),
            tuple(
                tuple(s.corrected(noise.refit) for s in joint.segments)
                for (joint, _, _), noise in zip(explained, self.noise_models, strict=True)
            ),
        )

    def _size(
        self, events: EventFilter, effect: str, results: Sequence[Filtered], *, step: float = 0.1
    ) -> tuple[float, float]:
        """An effect's parameter, and its standard deviation from relative steps of this size."""
        arrivals = self.arrivals
        jitter = effect == "latency_jitter"
        name = "delay_sd_s" if jitter else "loss"
        factors = np.exp(step * np.array([-1.0, 0.0, 1.0]))
        options = [replace(arrivals, **{name: float(getattr(arrivals, name) * x)}) for x in factors]
        below, here, above = map(_total, events.run(options))
        curvature = (2 * here - below - above) / step**2
        if curvature <= 0 and not jitter:  # as if it were known which set-points were lost
            curvature = sum(float(x.counts[1] + x.counts[3]) for x in results)
        value = float(arrivals.delay_sd_s * np.sqrt(3) if jitter else arrivals.long_run_loss)
        # What is not known of the length of bursts adds to the standard deviation of a loss.
        widened = value if jitter else value * np.sqrt(1 + arrivals.repeated_loss)
        return value, float(widened / np.sqrt(curvature)) if curvature > 0 else np.inf


def _total(results: Sequence[Filtered]) -> float:
    return sum(x.loglikelihood for x in results)


def _guesses(joint: NoisyJoint) -> tuple[Noise, Noise]:
    """Noise of the size of most samples, undisturbed by events, and white of third differences."""
    noise = joint.noise
    sizes = [
        np.abs(whitened(s.corrected(noise.refit), noise.model) * s.weight(noise.ratio))[s.counts]
        for s in joint.segments
    ]
    third = [np.abs(np.diff(s.residual, 3)[s.counts[3:]]) for s in joint.segments]
    sd, rough = (SD_PER_MEDIAN * float(np.median(np.concatenate(x))) for x in (sizes, third))
    usual = joint.variance(joint.count * sd**2)
    white = joint.variance(joint.count * (rough / np.sqrt(20)) ** 2)  # 1 + 9 + 9 + 1
    plain = Noise(np.zeros_like(noise.model), 1.0, white, np.zeros(3))
    return replace(noise, variance=usual), plain
