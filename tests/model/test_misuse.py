"""What is no number, name or truth value is refused at every public constructor, and always by our errors."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf

EYE, ZERO, REST = np.eye(3), np.zeros(3), [1, 0, 0, 0, 0, 0, 0]
LINK, JOINT = hf.Link(1.0, ZERO, EYE), hf.Joint()
ARM, OBJECT = hf.Arm([JOINT], [LINK]), hf.HeldObject(1.0, EYE)
CHAIN, STATE = hf.ClosedChain({"a": ARM}, OBJECT, {"a": hf.Grasp("rigid")}), hf.State([0.0], [0.0], REST)
PATH = hf.RestToRest(REST)

# Nothing takes any of these: no number, no vector, no name, no part.
NEVER = {
    "complex": 1j,
    "bytes": b"1",
    "nan": np.nan,
    "huge": 10**400,
    "masked entry": np.ma.masked,
    "masked": np.ma.masked_array([1.0, 2.0, 3.0], [False, True, False]),
    "truths": np.array([True, False, True]),
    "texts": np.array(["1", "2", "3"], dtype=object),
    "nans": np.full((3, 3), np.nan),
    "object": object(),
    "ragged": [[1.0], [1.0, 2.0]],
}
NOT_A_NUMBER = NEVER | {"truth": True, "text": "1", "vector": [1.0, 2.0], "nothing": None, "minus": -1.0}
PLACES = {
    "Link.mass": (lambda x: hf.Link(x), NOT_A_NUMBER),
    "Link.com": (lambda x: hf.Link(1.0, x), NEVER),
    "Link.inertia": (lambda x: hf.Link(1.0, ZERO, x), NOT_A_NUMBER),
    "Link.name": (lambda x: hf.Link(1.0, name=x), NEVER),
    "Link.physical": (lambda x: hf.Link(1.0, physical=x), NEVER | {"text": "no", "zero": 0}),
    "Joint.axis": (lambda x: hf.Joint(axis=x), NEVER),
    "Joint.kind": (lambda x: hf.Joint(x), NEVER),
    "Joint.name": (lambda x: hf.Joint(name=x), NEVER),
    "Joint.placement": (lambda x: hf.Joint(placement=x), NEVER),
    "Joint.position_limits": (lambda x: hf.Joint(position_limits=x), NEVER),
    "Joint.rate_limit": (lambda x: hf.Joint(rate_limit=x), NOT_A_NUMBER),
    "Joint.effort_limit": (lambda x: hf.Joint(effort_limit=x), NOT_A_NUMBER),
    "Joint.armature": (lambda x: hf.Joint(armature=x), NOT_A_NUMBER),
    "Arm.joints": (lambda x: hf.Arm(x, [LINK]), NEVER),
    "Arm.tip": (lambda x: hf.Arm([JOINT], [LINK], x), NEVER),
    "Arm.at": (ARM.at, NEVER),
    "Arm.name": (lambda x: hf.Arm([JOINT], [LINK], name=x), NEVER),
    "HeldObject.mass": (lambda x: hf.HeldObject(x, EYE), NOT_A_NUMBER | {"zero": 0.0}),
    "HeldObject.com": (lambda x: hf.HeldObject(1.0, EYE, x), NEVER),
    "HeldObject.physical": (lambda x: hf.HeldObject(1.0, EYE, physical=x), NEVER),
    "box mass": (lambda x: hf.HeldObject.box(x, 1.0, 1.0, 1.0), NOT_A_NUMBER | {"zero": 0.0}),
    "box x": (lambda x: hf.HeldObject.box(1.0, x, 1.0, 1.0), NOT_A_NUMBER | {"zero": 0.0}),
    "box y": (lambda x: hf.HeldObject.box(1.0, 1.0, x, 1.0), NOT_A_NUMBER | {"zero": 0.0}),
    "box z": (lambda x: hf.HeldObject.box(1.0, 1.0, 1.0, x), NOT_A_NUMBER | {"zero": 0.0}),
    "Grasp.kind": (lambda x: hf.Grasp(x), NEVER),
    "Grasp.frame": (lambda x: hf.Grasp("rigid", x), NEVER),
    "Grasp.contact": (lambda x: hf.Grasp("ball", contact=x), NEVER),
    "Friction.mu": (lambda x: hf.Friction(x), NOT_A_NUMBER | {"zero": 0.0}),
    "WrenchLimits.force": (lambda x: hf.WrenchLimits(force=x), NOT_A_NUMBER | {"zero": 0.0}),
    "ClosedChain.arms": (lambda x: hf.ClosedChain(x, OBJECT, {}), NEVER),
    "ClosedChain names": (lambda x: hf.ClosedChain({x: ARM}, OBJECT, {}), {"number": 1, "none": None, "tuple": (1,)}),
    "ClosedChain.gravity": (lambda x: hf.ClosedChain({"a": ARM}, OBJECT, {}, x), NOT_A_NUMBER),
    "with_bases": (CHAIN.with_bases, NEVER),
    "without_grasp": (CHAIN.without_grasp, NEVER),
    "with_grasp": (lambda x: CHAIN.with_grasp(x, hf.Grasp("rigid")), NEVER),
    "Pose.R": (lambda x: hf.Pose(x, ZERO), NOT_A_NUMBER),
    "Pose.p": (lambda x: hf.Pose(EYE, x), NOT_A_NUMBER),
    "Pose.from_wxyz_xyz": (hf.Pose.from_wxyz_xyz, NEVER | {"six": [1, 0, 0, 0, 0, 0], "twice": [2, 0, 0, 0, 0, 0, 0]}),
    "State.q": (lambda x: hf.State(x, [0.0], REST), NEVER),
    "State.object_pose": (lambda x: hf.State([0.0], [0.0], x), NEVER | {"far from unit": [1e200] * 7}),
    "Inputs": (lambda x: hf.Inputs(x).shaped(CHAIN), NEVER),
    "GravityCompensation.chain": (hf.GravityCompensation, NOT_A_NUMBER),
    "GravityCompensation.squeeze": (lambda x: hf.GravityCompensation(CHAIN, x), NEVER | {"text": "1", "truth": True}),
    "ObjectTracking.path": (lambda x: hf.ObjectTracking(CHAIN, x), NEVER | {"path": PATH}),
    "ObjectTracking.damping": (lambda x: hf.ObjectTracking(CHAIN, PATH.at, damping=x), NEVER),
    "TorqueSchedule.coefficients": (lambda x: hf.TorqueSchedule([0.0], x), NEVER | {"masked table": [NEVER["masked"]]}),
    "forward_dynamics chain": (lambda x: hf.forward_dynamics(x, STATE, [0.0]), NEVER),
    "forward_dynamics state": (lambda x: hf.forward_dynamics(CHAIN, x, [0.0]), NEVER),
    "forward_dynamics tau": (lambda x: hf.forward_dynamics(CHAIN, STATE, x), NOT_A_NUMBER),
    "compile chain": (hf.compile, NEVER),
    "compile parameters": (lambda x: hf.compile(CHAIN, parameters=x), NEVER | {"text": "link_inertia"}),
    "compile rank": (lambda x: hf.compile(CHAIN, generic_rank=x), NEVER | {"truth": True, "text": "1"}),
}


@pytest.mark.parametrize("place", PLACES)
def test_refused(place):
    """On one line; no warning, no bare error of Python's or NumPy's, and never in silence."""
    make, never = PLACES[place]
    for kind, x in never.items():
        if kind == "minus" and place in ("Pose.p", "ClosedChain.gravity"):
            continue
        with pytest.raises(hf.HoldfastError) as caught:
            make(x)
        assert "\n" not in str(caught.value), kind


@pytest.mark.parametrize(
    "R",
    [2.0 * EYE, np.diag([1.0, 1.0, -1.0]), EYE + 0.01 * np.eye(3, k=1), np.zeros((3, 3)), np.full((3, 3), 1e200)],
    ids=["scaled", "mirrored", "sheared", "nothing", "huge"],
)
def test_poses_are_rigid(R):
    """Scaled, sheared and mirrored matrices are no poses, alone or in a state; rounding is mended."""
    with pytest.raises(hf.ModelError, match="pose: R: expected a rotation matrix"):
        hf.State([0.0], [0.0], hf.Pose(R, ZERO))
    off = hf.Pose(EYE + 3e-7 * np.ones((3, 3)), ZERO)
    np.testing.assert_allclose(off.R.T @ off.R, EYE, rtol=0, atol=1e-14)
    seven = hf.Pose.from_wxyz_xyz([1.0 + 4e-7, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(seven.R, EYE)
