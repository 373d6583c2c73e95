"""Arms with branches and chains beyond serial arms: what they hold, and what is refused with what to try."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ModelError
from holdfast.io.model_data import model_data
from holdfast.model.fingerprint import fingerprint
from tests.systems.branched import arm_with_gripper, link, two_arms_with_grippers
from tests.systems.problems import random_problem

JOINTS = [hf.Joint(name=f"j{k}") for k in range(4)]
LINKS = [link(f"l{k}") for k in range(4)]
BOX = hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)


def arm(**given) -> hf.Arm:
    """Return an arm that forks at its second link."""
    return hf.Arm(JOINTS, LINKS, **{"parents": [None, 0, "l1", 1]} | given)


def chain(**given) -> hf.ClosedChain:
    """Return a chain of one such arm."""
    return hf.ClosedChain({"a": arm()}, **given)


BALL = hf.Grasp("ball")
REFUSED = {
    "too few parents": (lambda: arm(parents=[None, 0]), "parents: expected one per joint, got 2 for 4 joints"),
    "a later parent": (lambda: arm(parents=[None, 2, 1, 1]), r"parents\[1\]: expected an earlier link, 0 .. 0, got 2"),
    "an unknown parent": (lambda: arm(parents=[None, 0, "l7", 1]), r"parents\[2\]: no links 'l7'. Did you mean"),
    "a tip": (lambda: arm(tip=hf.Pose.translation(0, 0, 1)), "tip: expected none for an arm with branches"),
    "no frame": (lambda: arm(frames={"pad": "l1"}), r"frame 'pad': expected \(link, pose\)"),
    "a frame's link": (lambda: arm(frames={"pad": ("l9", hf.Pose.identity())}), "frame 'pad': no links 'l9'"),
    "a coupled joint": (
        lambda: arm(couplings=[hf.Coupling({"j9": 1.0})]),
        "coupling: no joint 'j9'. Did you mean 'j3'",
    ),
    "no coupling": (lambda: arm(couplings=[{"j1": 1.0}]), "couplings: expected a list of Coupling"),
    "a loop's end": (
        lambda: arm(loops={"x": hf.Closure("l1", "l8", BALL)}),
        "loop 'x': no link or frame 'l8'",
    ),
    "a coefficient": (lambda: hf.Coupling({"a/j1": 0.0}), "coefficient of 'a/j1': expected another number than 0"),
    "no joints": (lambda: hf.Coupling({}), "expected coefficients by joint"),
    "a closure's end": (lambda: hf.Closure(1.5, "b", BALL), "closure: a: expected int"),
    "spherical limits": (
        lambda: hf.Joint("spherical", effort_limit=1.0),
        "effort_limit: expected none for a spherical",
    ),
    "spherical spring": (lambda: hf.Joint("spherical", stiffness=1.0), "stiffness: expected none for a spherical"),
    "spherical friction": (lambda: hf.Joint("spherical", friction=1.0), "friction: expected none for a spherical"),
    "a screw": (lambda: hf.Joint("screw"), "a screw joint needs a pitch"),
    "a pitch": (lambda: hf.Joint(pitch=0.1), "a revolute joint has no pitch"),
    "no object": (lambda: chain(grasps={("a", "l3"): BALL}), "object: expected a HeldObject, got NoneType"),
    "an arm's own grasp": (lambda: chain(held_object=BOX, grasps={"a": BALL}), r"as \('a', frame\). Known: l0, l1"),
    "a grasp's arm": (lambda: chain(held_object=BOX, grasps={("b", "l3"): BALL}), "grasp 'b': no such arm"),
    "a grasp's frame": (
        lambda: chain(held_object=BOX, grasps={("a", "l33"): BALL}),
        "no link or frame 'l33' in arm 'a'. Did you",
    ),
    "which object": (
        lambda: chain(objects={"pot": BOX, "lid": BOX}, grasps={("a", "l3"): BALL}),
        "of: expected the name of an object, got None. Known: pot, lid",
    ),
    "an unknown object": (
        lambda: chain(objects={"pot": BOX}, grasps={("a", "l3"): replace(BALL, of="pott")}),
        "got 'pott'. Did you mean 'pot'",
    ),
    "a name twice": (
        lambda: chain(objects={"a": BOX}),
        "'a': expected names of objects and loops that nothing else has",
    ),
    "two named object": (lambda: chain(held_object=BOX, objects={"object": BOX}), "object 'object': expected another"),
    "a chain's loop": (
        lambda: chain(loops={"x": hf.Closure("a/l1", "a/k1", BALL)}),
        "loop 'x': b: no link or frame 'k1' in arm 'a'",
    ),
    "no such place": (lambda: chain(loops={"x": hf.Closure("a/l1", "lid", BALL)}), "loop 'x': b: no 'lid'"),
    "a loop to the world": (lambda: chain(loops={"x": hf.Closure("a/l1", None, BALL)}), "closure: b: expected int"),
    "a loop on one link": (
        lambda: chain(loops={"x": hf.Closure("a/l1", "a/l1", BALL)}),
        "loop 'x': expected two bodies",
    ),
    "a chain's coupling": (lambda: chain(couplings=[hf.Coupling({"a/j8": 1.0})]), "coupling: no joint 'a/j8'. Did you"),
    "springs": (
        lambda: chain(held_object=BOX, springs=[hf.Spring(("world", [0, 0, 0]), ("object", [0, 0, 0]), 1.0)]),
        "springs: expected none in a chain with branches in arm 'a'",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_refused(what):
    """The message names the part, what was expected, and the nearest name."""
    make, message = REFUSED[what]
    with pytest.raises(ModelError, match=message):
        make()


def test_parents_of_a_serial_arm():
    """Parents that say what is so anyhow make no branches."""
    made = hf.Arm(JOINTS, LINKS, hf.Pose.translation(0, 0, 1), parents=[None, "l0", 1, 2])
    assert made.parents == () and made.is_serial and made.parent_of == (None, 0, 1, 2)
    assert arm().parents == (None, 0, 1, 1) and not arm().is_serial


def test_parts_of_joints():
    """Where a joint is taken apart, what stands on its link stands on the last of its parts."""
    joints = [hf.Joint("planar", name="base"), *JOINTS[1:]]
    made = hf.Arm(joints, LINKS, parents=[None, 0, 0, "l0"], frames={"plate": ("l0", hf.Pose.identity())})
    assert made.joint_count == 6 and made.parents == (None, 0, 1, 2, 2, 2)
    assert made.frames["plate"][0] == 2 and [joint.name for joint in made.joints][:3] == ["base.1", "base.2", "base.3"]


def keys(data: Any) -> Iterator[str]:
    """Yield all keys in plain data."""
    for part in data.values() if isinstance(data, dict) else data if isinstance(data, list) else ():
        yield from keys(part)
    yield from data if isinstance(data, dict) else ()


def test_serial_chains_are_as_before():
    """The new fields are no part of fingerprints or files of chains that do not use them, and are of others."""
    serial = random_problem(3).chain
    assert not {"parents", "frames", "couplings", "loops", "objects", "actuated"} & {*keys(model_data(serial))}
    assert not serial.beyond_serial
    named = two_arms_with_grippers().chain
    coupled = replace(named, couplings=[hf.Coupling({"arm1/joint1": 1.0})])
    assert fingerprint(named) != fingerprint(coupled)


def test_what_it_says_of_itself():
    """Branches, grasps by frames, couplings and objects are in its words, and in its table for notebooks."""
    p = two_arms_with_grippers()
    assert "link6: rigid grasp; pad1: ball grasp" in repr(p.chain) and "couplings: 2" in repr(p.chain)
    assert p.chain.beyond_serial[0] == "branches in arm 'arm1'"
    assert "<table>" in p.chain._repr_html_()
    assert arm_with_gripper().frame("pad1", "test")[0] == 6
    none = hf.ClosedChain({"a": arm()})
    assert none.beyond_serial == ("branches in arm 'a'", "no held object") and none.forest.position_count == 4
    state = hf.State(np.zeros(4), np.zeros(4))
    assert repr(state) == "<State: 4 joints, at rest>"
    with pytest.raises(hf.errors.StateError, match="expected one object, got 0"):
        _ = state.object_frame
