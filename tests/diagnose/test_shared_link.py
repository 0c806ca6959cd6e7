"""A link that several joints share: where it shows, and how likely it is on each."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from sim2real.diagnose.link.link_effect import IrregularTiming
from sim2real.diagnose.missing.calibrated_odds import judged, judged_together
from sim2real.diagnose.missing.investigate import _on_all


def on_all(gain, *shares, mismatch=True):
    """Whether joints of which each but the last misses something else share this link."""
    link = IrregularTiming("packet_loss", gain, shares=shares)
    findings = [SimpleNamespace(mismatch=mismatch) for _ in shares[:-1]]
    return _on_all(link, link, [*findings, SimpleNamespace(mismatch=False)])


def test_what_one_joint_alone_shows_is_no_link_where_the_others_contradict_it():
    assert not on_all(150.0, 190.0, 0.0, 0.0)
    assert not on_all(0.0, 0.0, 0.0)


def test_a_joint_that_hardly_moves_contradicts_no_link():
    assert on_all(188.0, 190.0, 0.0)
    assert on_all(740.0, 90.0, 30.0, 625.0)


@pytest.fixture
def shared(explained_joint):
    """Findings of two joints on one link, the second with structure that stays."""
    _, (joint,) = explained_joint
    base = joint.finding.tried.plain
    link = IrregularTiming("packet_loss", 700.0, 0.02, 0.002, shares=(650.0, 50.0))
    without = replace(joint.finding.unmodelled, windows_evidence=300.0, excess=6.0)
    first = replace(joint.finding, best=base, groups=(), link=link, excess=1.0, unmodelled=without)
    return [first, replace(first, place=1, excess=2.2)], joint.unseen


def of_link(finding):
    return max(g.probability for g in finding.groups if g.members == ("packet_loss",))


def test_a_link_is_as_likely_on_all_joints_that_share_it(shared):
    findings, unseen = shared
    alone = judged(findings[1], unseen)
    together = judged_together(findings, [unseen, unseen])
    assert of_link(alone) < of_link(together[1])
    assert all(of_link(finding) >= 0.9 for finding in together)


def test_events_that_nobody_foretells_are_nothing_outside_the_catalogue(shared):
    findings, unseen = shared
    regular = judged(replace(findings[0], link=None), unseen)
    lossy = judged(findings[0], unseen)
    assert regular.unknown > lossy.unknown and lossy.unknown < 0.1
    assert not lossy.unexplained and lossy.mismatch
