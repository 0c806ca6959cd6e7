"""Every number that decides a verdict or a name, as ``decision.json`` has it.

The file is written by ``benchmarks/calibrate_decisions.py`` from cases of the generators'
development seeds; beside each value it says what it was read from.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

from sim2real.structured import Fields, read_json

FILE = Path(__file__).with_name("decision.json")
SCHEMA = "sim2real.decision/1"


@dataclass(frozen=True)
class Decision:
    """The numbers; gains and costs are in log-likelihood, excesses in variances of the noise.

    Attributes:
        false_alarms: Share of robots with nothing missing that may be called mismatched.
        named: Probability from which an effect is named.
        negligible: Share of the held-out error below whose change an effect does not matter.
        group_share: A rival this probable, relative to the likeliest, cannot be told from it.
        missing_share: Share of joints that are expected to miss something; the prior.
        prior_sd: Prior standard deviation of an effect's parameter, in typical values.
        surely: Gain that is never left to chance, however uneven the noise.
        law_error: How far the law of an effect may be from what a servo does, relative to it.
        most_certain: No effect is more probable.
        certain: Probability of an effect from which something is missing, whatever is left.
        shared: How much of an effect of the supply or the link the other joints must show.
        structured: Excess from which a residual is more than noise and slow wander.
        clean: Excess below which nothing is left, and nothing without a name is looked for.
        explained: Share of the excess that named effects must explain, or the cause is not in the
            catalogue.
        nameless_cost: Evidence by which a smooth function must be ahead of the catalogue.
        nameless_softness: Evidence over which that comparison changes its mind.
        few: Effects that one joint may well miss together.
        beyond_few: Highest probability of effects beyond these, or where structure stays.
        of_many: Highest probability of the greatest of more than these.
        ripple: What every servo has a little of is a finding from so many noises on.
        coarser: Step of a sensor, relative to the stated one, from which it is a finding.
        link_gain: Gain from which an uneven link is a finding.
        link_shows: Gain from which it shows on a joint.
        link_tie: Gain by which a joint's own effects must beat it to be kept.
        link_masked: Excess of a joint from which nothing can be seen of single set-points.
        mimic: Probability that is left to an effect that one of the supply or the link mimics.
        window_cost: Gain that a segment of something else must earn.
        window_second_cost: Gain that each second of it must earn.
        window_share: Share of the time from which it is no segment.
        change_borrowed: References that what all effects gain together counts for.
        change_other_motion: Further log odds against a change where the case moves otherwise.
        change_retuned: Log odds that a plain parameter was set anew, not that an effect came.
        change_farthest: Prior standard deviation of a change, in multiples of its start.
        nameless: Probability that what is missing has no name, where effects leave most of it.
        change_law_error: How far a straight line to a change may be from what it does.
        change_worth: Evidence below which no change will be named, however well it fits.
        detection_gain: Gain at which an effect is noticed.
        predictor: Share of the error below which another model is worth having.
        formula_share: Share of the unseen error's square that a term must take away.
        separation: In noises, from which rivals are told apart at first sight.
        line_clear: A motor's torque-speed line is the baseline where it leaves at most this share
            of the linear servo's error.
        line_room: How many times the data sheet's the line may be, either way; beyond that it is a
            finding.
    """

    false_alarms: float
    named: float
    negligible: float
    group_share: float
    missing_share: float
    prior_sd: float
    surely: float
    law_error: float
    most_certain: float
    certain: float
    shared: float
    structured: float
    clean: float
    explained: float
    nameless_cost: float
    nameless_softness: float
    few: float
    beyond_few: float
    of_many: float
    ripple: float
    coarser: float
    link_gain: float
    link_shows: float
    link_tie: float
    link_masked: float
    mimic: float
    window_cost: float
    window_second_cost: float
    window_share: float
    change_borrowed: float
    change_other_motion: float
    change_retuned: float
    change_farthest: float
    nameless: float
    change_law_error: float
    change_worth: float
    detection_gain: float
    predictor: float
    formula_share: float
    separation: float
    line_clear: float
    line_room: float


def read_decision(path: Path = FILE) -> Decision:
    """The decisions of a file.

    Raises:
        InputError: If one is missing or no number.
    """
    values = Fields(path, "", read_json(path, SCHEMA)).table("values")
    return Decision(
        **{field.name: values.table(field.name).number("value") for field in fields(Decision)}
    )


DECISION = read_decision()
"""Those that ship."""
