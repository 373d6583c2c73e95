"""Branches of arms in a robot's file: joints that hang on an arm and move, and joints that mimic others."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from holdfast.model.coupling import Coupling
from holdfast.robots.urdf.bodies import FoldedChain, WeldedBody, fold, weld_branches
from holdfast.robots.urdf.chain_checks import held_argument, refuse_unsupported
from holdfast.robots.urdf.document import hint, listed, quoted
from holdfast.robots.urdf.path import Locks, PassedJoint
from holdfast.robots.urdf.robot import UrdfJoint, UrdfRobot
from holdfast.spatial.pose import Pose


def leaving_free(locks: Locks, arms: Collection[tuple[str, list[PassedJoint]]] | None) -> Locks:
    """Return locks of which `others` does not lock what hangs on an arm by further joints.

    Args:
        locks: the locks.
        arms: base and path of every arm; None for all joints of the robot.
    """
    robot = locks.robot
    if arms is None:
        return replace(locks, on_path=frozenset(robot.joints))
    free, alone = set(locks.on_path), replace(locks, others=False)
    for start, path in arms:
        free.update(joint.name for joint in with_branches(fold(start, path, alone), alone, on_base=False).joints)
    return replace(locks, on_path=frozenset(free))


def folded_arm(start: str, path: list[PassedJoint], locks: Locks, *, branches: bool) -> FoldedChain:
    """Return the bodies of an arm, with its branches if they move; without a path they are all that is on the base."""
    folded = fold(start, path, locks)
    if branches:
        folded = with_branches(folded, locks, on_base=not path)
        refuse_unsupported(locks, [body.step for body in folded.bodies], coupled=True)
    return folded


def with_branches(folded: FoldedChain, locks: Locks, *, on_base: bool) -> FoldedChain:
    """Return a chain with the bodies that hang on it by further joints. O(links).

    Args:
        folded: the chain.
        locks: the joints that are locked.
        on_base: whether those on the base belong to it, too.
    """
    passed = {joint.name for joint, _ in folded.path}
    bodies, parents = list(folded.bodies), list(folded.parents)
    waiting: list[int | None] = [*([None] if on_base else []), *range(len(bodies))]
    for k in waiting:  # the loop appends to this list
        links = folded.on_base if k is None else bodies[k].links
        for link, at in list(links.items()):
            for joint in locks.robot.joints_at(link):
                if joint.name in passed or joint.other(link) in links or locks.pose(joint) is not None:
                    continue
                step = PassedJoint(joint, link == joint.parent)
                passed.add(joint.name)
                own = {step.beyond: Pose.identity() if step.down else joint.origin.inverse()}
                weld_branches(own, passed, locks)
                waiting.append(len(bodies))
                bodies.append(WeldedBody(step, at @ joint.origin if step.down else at, own))
                parents.append(k)
    return replace(folded, bodies=tuple(bodies), parents=tuple(parents))


def mimicry(robot: UrdfRobot, joints: Sequence[UrdfJoint]) -> list[Coupling]:
    """Return the couplings of joints that mimic others.

    Raises:
        SceneError: some follow joints that are not among them; the message names all of these.
    """
    names = {joint.name for joint in joints}
    following = [(joint, joint.mimic) for joint in joints if joint.mimic is not None]
    if lost := [(joint, mimic) for joint, mimic in following if mimic.joint not in names]:
        (first, mimic), *_ = lost
        known = "" if mimic.joint in robot.joints else hint(mimic.joint, robot.joints)
        others = f"; {listed(joint.name for joint, _ in lost[1:])} likewise" if lost[1:] else ""
        raise first.element.refuse(
            f"mimic: expected to follow a joint of the same arm that moves, got {quoted(mimic.joint)}.{known}{others};"
            f" try {held_argument([joint for joint, _ in lost])}"
        )
    found = []
    for joint, mimic in following:
        terms = {joint.name: 1.0} | ({mimic.joint: -mimic.multiplier} if mimic.multiplier else {})
        found.append(Coupling(terms, mimic.offset))
    return found
