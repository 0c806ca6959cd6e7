"""What is named on a robot, what is listed, and the verdict, by the probabilities of its joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.effect_probabilities import Group
from sim2real.diagnose.joint_result import JointFindings
from sim2real.diagnose.result import Rival, Verdict
from sim2real.effects import SET_ANEW, named


@dataclass(frozen=True)
class Named:
    """A named group on one joint, or on several that share it."""

    group: Group
    joints: tuple[str, ...]
    component: str


def named_groups(results: Mapping[str, JointFindings]) -> list[Named]:
    """Groups of all joints; an effect on the supply or the link of several joints counts once."""
    groups: list[Named] = []
    shared: dict[str, list[tuple[str, Group]]] = {}
    for joint, result in results.items():
        for group in result.finding.groups:
            if group.probability < DECISION.named:
                continue
            head = group.head
            if head in SET_ANEW or named(head).component == "joint":
                groups.append(Named(group, (joint,), joint))
            else:
                shared.setdefault(head, []).append((joint, group))
    mimicked: set[str] = set()
    for effect, where in shared.items():
        most_probable = max((group for _, group in where), key=lambda group: group.probability)
        joints = tuple(joint for joint, _ in where)
        links = (results[joint].finding.link for joint in joints)
        own = any(link is not None and len(link.shares) == 1 for link in links)
        place: str = joints[0] if own or len(results) == 1 else named(effect).component
        groups.append(Named(most_probable, joints, place))
        mimicked.update(named(effect).mimics if len(joints) > 1 else ())
    # What something of the supply or the link, seen on several joints, looks like on one.
    groups = [entry for entry in groups if entry.group.head not in mimicked]
    return sorted(groups, key=lambda entry: -entry.group.probability)


def split_by_size(
    results: Mapping[str, JointFindings], groups: Sequence[Named], negligible: float
) -> tuple[list[Named], list[Named]]:
    """The groups that matter, and those that change the held-out error by less than a share.

    The latter are not listed next to a mismatch without a name.
    """
    nameless = any(x.finding.mismatch and x.finding.unexplained for x in results.values())
    large: list[Named] = []
    small: list[Named] = []
    for entry in groups:
        of_joints = (results[name] for name in entry.joints)
        changes = [one.finding.changes(one.unseen, entry.group.head) for one in of_joints]
        if max(changes) >= negligible:
            large.append(entry)
        elif not nameless:
            small.append(entry)
    return large, small


def verdict(
    joints: Sequence[JointFindings],
    large: Sequence[Named],
    small: Sequence[Named],
    *,
    referred: bool,
) -> Verdict:
    """The verdict on a robot; ``referred``: whether it is compared with references."""
    differing = [joint for joint in joints if joint.finding.mismatch]
    uncatalogued = any(joint.finding.unknown > DECISION.named for joint in differing)
    unsolved = uncatalogued or any(joint.finding.unexplained for joint in differing)
    if referred and not large and not uncatalogued:
        return "unchanged"
    if not differing or (small and not large and not unsolved):
        return "consistent"
    if not large:
        return "unexplained"
    if unsolved or any(joint.leaves_structure for joint in differing):
        return "partly_explained"
    return "ambiguous" if any(len(e.group.members) > 1 for e in large) else "explained"


def rivals(results: Mapping[str, JointFindings], groups: Sequence[Named]) -> tuple[Rival, ...]:
    """What was considered and not named, most probable first."""
    taken = {(joint, e) for entry in groups for joint in entry.joints for e in entry.group.members}
    found = []
    for joint, result in results.items():
        finding = result.finding
        effects = {e for s in finding.posterior.sets for e in s - finding.tried.base}
        for effect in effects if finding.mismatch else ():
            p = finding.posterior.inclusion(effect) * (1 - finding.unknown)
            if (joint, effect) not in taken and p > DECISION.report.rival_min_probability:
                found.append(Rival(effect, joint, p))
    return tuple(sorted(found, key=lambda r: -r.probability)[: DECISION.report.most_rivals])
