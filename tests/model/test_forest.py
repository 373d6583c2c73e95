"""Forests as data: the table of joints, refusals, and the forest of a chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ModelError
from holdfast.model.closure import Closure
from holdfast.model.forest import GROUND, BodyJoint, Forest, ForestBody, JointCoupling
from holdfast.model.joint_kinds import JOINT_KINDS
from holdfast.spatial import rotation
from tests.systems.bushed import random_bushed
from tests.systems.problems import random_problem
from tests.systems.trunk_problems import random_on_trunk

LINK = hf.Link(1.0, [0.1, 0.0, 0.0], np.eye(3) * 0.01)
NEEDS = {"screw": {"pitch": 0.3}, "planar": {"across": [1.0, 0.0, 0.0]}}


def joint(kind: str, **given) -> BodyJoint:
    """Return a joint of a kind with what it needs."""
    return BodyJoint(kind, **NEEDS.get(kind, {}) | given)


def body(kind: str = "revolute", parent: int | None = None) -> ForestBody:
    """Return a body on a joint."""
    return ForestBody(LINK, joint(kind), parent)


@pytest.mark.parametrize("kind", JOINT_KINDS)
def test_rate_maps_are_derivatives(kind):
    """The displacement along qd grows by (A qd, B qd), where a rotation grows by exp(u) on its left."""
    random, one = np.random.default_rng(3), joint(kind)
    table, h = one.of_kind, 1e-6
    assert one.rate_map.shape == (6, table.freedoms)
    qd = random.normal(size=table.freedoms)
    q = random.normal(size=table.position_count)
    if table.pose:
        q[:4] /= np.linalg.norm(q[:4])

    def at(step: float) -> tuple[np.ndarray, np.ndarray]:
        moved = (
            q + step * qd
            if not table.pose
            else np.concatenate(
                [rotation.quaternion_product(rotation.quaternion_exp(step * qd[:3]), q[:4]), q[4:] + step * qd[3:]]
            )
        )
        return one.displacement(moved)

    (before, p), (after, r), (now, _) = at(-h), at(h), at(0.0)
    spin = (after - before) / (2 * h) @ now.T
    found = np.concatenate([[spin[2, 1], spin[0, 2], spin[1, 0]], (r - p) / (2 * h)])
    np.testing.assert_allclose(found, one.rate_map @ qd, atol=1e-8)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BodyJoint("hinge"), "joint: kind"),
        (lambda: BodyJoint("screw"), "a screw joint needs pitch"),
        (lambda: BodyJoint("revolute", pitch=0.1), "a revolute joint has no pitch"),
        (lambda: BodyJoint("planar", across=[0.0, 0.0, 1.0]), "perpendicular"),
        (lambda: BodyJoint("free", hf.Pose.translation(0.1, 0.0, 0.0)), "expected the identity for a free body"),
        (lambda: BodyJoint("free", damping=1.0), "nothing drives or damps a free body"),
        (lambda: BodyJoint("spherical", stiffness=1.0), "expected 0 for a spherical joint"),
        (lambda: ForestBody(LINK, BodyJoint("free"), 0), "expected None for a free body"),
        (lambda: ForestBody(hf.Link(0.0), BodyJoint("free")), "mass of a free body"),
        (lambda: Closure(None, 0, hf.Grasp("bushing", stiffness=np.ones(6))), "a bushing is no constraint"),
        (lambda: JointCoupling([]), "at least one"),
        (lambda: JointCoupling([(0, 0, 0.0)]), "coefficient"),
        (lambda: JointCoupling([(0, 0, 1.0), (0, 0, 2.0)]), "each component once"),
        (lambda: Forest([]), "at least one, got none"),
        (lambda: Forest([body(parent=0)]), "body 0: parent: expected the index of a body before it"),
        (lambda: Forest([body()], [Closure(0, 1, hf.Grasp("ball"))]), "closure 0: b"),
        (lambda: Forest([body()], [Closure(0, 0, hf.Grasp("ball"))]), "expected two bodies"),
        (lambda: Forest([body()], couplings=[JointCoupling([(0, 1, 1.0)])]), "coupling 0: component"),
        (lambda: Forest([body("free")], couplings=[JointCoupling([(0, 1, 1.0)])]), "body 0 is free"),
        (lambda: Forest([body(), "link"]), "expected a list of ForestBody"),
    ],
)
def test_refusals(make, message):
    """What cannot be is refused with its place."""
    with pytest.raises(ModelError, match=message):
        make()


def test_slices():
    """A spherical and a free joint have one position more than rates."""
    forest = Forest([body("free"), body("spherical", 0), body("planar", 1), body("screw", 1)])
    assert [part.stop for part in forest.positions] == [7, 11, 14, 15]
    assert [part.stop for part in forest.velocities] == [6, 9, 12, 13]
    assert repr(forest) == "<Forest: 4 bodies (1 free), 0 closures, 0 couplings>"


def test_forest_of_a_chain():
    """Arms in order, each from its base, and the object last; the closures are the grasps."""
    chain = random_problem(3, arms=3).chain
    forest = chain.forest
    assert len(forest.bodies) == chain.joint_count + 1 and forest.bodies[-1].joint.kind == "free"
    assert [end for end, _ in forest.topology.ends] == [chain.joints[name].stop - 1 for name in chain.grasps]
    starts = [k for k, parent in enumerate(forest.topology.parents) if parent == GROUND]
    assert starts == [*(chain.joints[name].start for name in chain.arms), chain.joint_count]
    assert [c.grasp for c in forest.closures] == [*chain.grasps.values()]
    assert chain.forest is forest


def test_forest_of_a_trunk():
    """A floating base is the first body, and mounted arms hang on their links."""
    given = random_on_trunk(3, 2, floating=True).chain
    chain = replace(given, springs=())
    assert chain.mounts
    forest = chain.forest
    assert forest.bodies[0].link is chain.trunk.floating
    for name, on in chain.mounted_on.items():
        if chain.arms[name].joints:
            assert forest.topology.parents[1 + chain.joints[name].start] == on


def test_force_elements_are_no_part_of_a_forest():
    """A chain with bushings or springs has no forest of its own yet, and says what to try."""
    chain = random_bushed(0).chain
    with pytest.raises(ModelError, match="no part of a forest; try the chain itself"):
        _ = chain.forest
    sprung = replace(random_problem(3).chain, springs=[hf.Spring(("world", np.zeros(3)), ("object", np.zeros(3)), 1.0)])
    with pytest.raises(ModelError, match="springs between bodies"):
        _ = sprung.forest
