"""The held-out score of a link: the likelihood of recordings that its fit did not use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.diagnose.link.angle_noise import Noise, NoisyJoint, with_noise
from sim2real.diagnose.link.link_effect import (
    MOST_LAGS,
    IrregularTiming,
    LinkData,
    LinkFit,
    LinkScore,
    channel_of,
)
from sim2real.inference.correlated_noise import whitened
from sim2real.servo.event_filter import Arrivals, Channel, EventFilter, sampled


@dataclass(frozen=True)
class ScoreJob:
    """A link to score.

    Attributes:
        folds: For each recording the residuals of all recordings, of servos fitted to the others.
        fit: The link as fitted to all recordings, from which the fits to the others start.
    """

    folds: tuple[LinkData, ...]
    fit: IrregularTiming


def link_score(job: ScoreJob) -> LinkScore:
    """Score each recording by the link that was fitted to the others.

    Raises:
        ValueError: If the joints do not have as many recordings as there are folds, at least two.
    """
    counts = {len(residuals) for fold in job.folds for residuals in fold.joints}
    if counts != {len(job.folds)} or len(job.folds) < 2:
        found = f"{sorted(counts)} recordings of the joints, {len(job.folds)} folds"
        raise ValueError(f"{found}; expected the same number, above 1")
    rng = np.random.default_rng(0)
    parts = [_score_fold(job, k, rng) for k in range(len(job.folds))]
    return LinkScore(
        loglikelihood=sum(part.loglikelihood for part in parts),
        expected=sum(part.expected for part in parts),
        sd=float(np.sqrt(sum(part.sd**2 for part in parts))),
        without=sum(part.without for part in parts),
        samples=sum(part.samples for part in parts),
    )


def _score_fold(job: ScoreJob, k: int, rng: np.random.Generator, *, draws: int = 8) -> LinkScore:
    """The score of recording ``k``."""
    fold = job.folds[k]
    joints = [with_noise(x, min(fold.lags, MOST_LAGS), fold.least_gain) for x in fold.joints]
    others = [
        replace(joint, segments=(*joint.segments[:k], *joint.segments[k + 1 :])) for joint in joints
    ]
    fit = LinkFit(others, job.fit.effect, common=job.fit.common, start=job.fit)
    segments = [joint.segments[k] for joint in joints]
    channels = [channel_of(*pair) for pair in zip(segments, fit.noise_models, strict=True)]
    groups = [channels] if job.fit.common else [[channel] for channel in channels]
    drawn = [_drawn(group, fit.arrivals, rng, draws) for group in groups]
    (results,) = EventFilter([*groups, *(x for some in drawn for x in some)]).run([fit.arrivals])
    values = np.array([x.loglikelihood for x in results])
    expected = values[len(groups) :].reshape(len(groups), draws).sum(axis=0)
    samples = sum(int(segment.counts.sum()) for segment in segments)
    regular = [_settled(joint) for joint in others]
    alone = [channel_of(*pair) for pair in zip(segments, regular, strict=True)]
    return LinkScore(
        loglikelihood=float(values[: len(groups)].sum()),
        expected=float(expected.mean()),
        # a few draws tell little of the spread, which is no smaller than that of normal noise
        sd=float(max(expected.std(ddof=1), np.sqrt(samples / 2))),
        without=sum(_of_noise(channel) for channel in alone),
        samples=samples,
    )


def _drawn(
    group: Sequence[Channel], arrivals: Arrivals, rng: np.random.Generator, draws: int
) -> list[list[Channel]]:
    """Channels like those of a group, with residuals drawn from the model."""
    residuals = sampled(group, arrivals, rng, draws)
    return [
        [replace(channel, residual=x[s]) for channel, x in zip(group, residuals, strict=True)]
        for s in range(draws)
    ]


def _settled(joint: NoisyJoint) -> Noise:
    """The noise of a joint, refitted to its recordings, set-points arriving at the latency."""
    noise, _ = joint.settled(joint.remodelled(joint.noise))
    return noise


def _of_noise(channel: Channel) -> float:
    """Log-likelihood of a channel whose set-points arrive at the latency."""
    used = channel.scale > 0
    sd = channel.scale[used] * np.sqrt(channel.variance)
    innovation = whitened(channel.residual, channel.autoregression)[used]
    return float(-0.5 * np.sum(2 * np.log(sd) + (innovation / sd) ** 2))
