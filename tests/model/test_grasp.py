"""Grasps: four kinds, what each transmits, and one-sided contacts."""

import numpy as np
import pytest

from holdfast import Friction, Grasp, ModelError, Pose
from holdfast.model.grasp import WrenchLimits

KINDS = {"rigid": 0, "hinge": 1, "softfinger": 2, "ball": 3}
BALL, FINGER = Friction(0.5), Friction(0.5, torsion_radius=0.01)
EDGE = Friction(0.5, half_length=0.05)

REFUSED = {
    "kind": ({"kind": "rigit"}, r"grasp: kind: expected one of rigid, hinge, softfinger, ball, got 'rigit'.*'rigid'"),
    "no kind": ({"kind": None}, r"grasp: kind: expected one of .*, got None"),
    "frame": ({"kind": "ball", "frame": [0, 0, 1]}, r"grasp: frame"),
    "frame scale": (
        {"kind": "ball", "frame": Pose.unchecked(1.1 * np.eye(3), np.zeros(3))},
        r"grasp: frame: rotation: expected",
    ),
    "rigid contact": ({"kind": "rigid", "contact": BALL}, r"a rigid grasp is two-sided; expected contact=None"),
    "no friction": ({"kind": "ball", "contact": 0.5}, r"grasp: contact: expected None or Friction, got float"),
    "ball torsion": ({"kind": "ball", "contact": FINGER}, r"a ball contact has no torsion_radius"),
    "ball edge": ({"kind": "ball", "contact": EDGE}, r"a ball contact has no half_length"),
    "finger": ({"kind": "softfinger", "contact": BALL}, r"a softfinger contact needs torsion_radius"),
    "finger edge": ({"kind": "softfinger", "contact": EDGE}, r"a softfinger contact needs torsion_radius"),
    "hinge": ({"kind": "hinge", "contact": BALL}, r"a hinge contact needs half_length"),
    "limits": ({"kind": "rigid", "wrench_limits": 50.0}, r"wrench_limits: expected None or WrenchLimits, got float"),
    "hinge torsion": ({"kind": "hinge", "contact": FINGER}, r"a hinge contact has no torsion_radius"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_refused(what):
    """A grasp that cannot exist is refused by field."""
    given, message = REFUSED[what]
    with pytest.raises(ModelError, match=message):
        Grasp(**given)


@pytest.mark.parametrize("field", ["mu", "torsion_radius", "half_length"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, "rough"])
def test_friction_is_positive(field, value):
    """Friction coefficient, radius and length are numbers > 0."""
    with pytest.raises(ModelError, match=f"friction: {field}: expected"):
        Friction(**{"mu": 0.5, field: value})


@pytest.mark.parametrize("field", ["moment", "force"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, -np.inf, "strong", None])
def test_wrench_limits_are_positive(field, value):
    """Largest moment and force are numbers > 0, infinite if there is none."""
    with pytest.raises(ModelError, match=f"wrench_limits: {field}: expected"):
        WrenchLimits(**{field: value})


def test_lever():
    """A moment counts as a force at the ratio of the limits; with one limit only, at 1 m."""
    assert WrenchLimits(3.0, 60.0).lever == 0.05
    assert [WrenchLimits(**x).lever for x in ({}, {"moment": 3}, {"force": np.float64(60)})] == [1.0] * 3
    assert WrenchLimits(np.inf, 10**400 // 10**399).force == 10.0


@pytest.mark.parametrize("kind", KINDS)
def test_limits_on_every_kind(kind):
    """A largest wrench goes with any grasp, with or without friction."""
    limits = WrenchLimits(5.0, 100.0)
    assert Grasp(kind, wrench_limits=limits).wrench_limits is limits
    assert Grasp("ball", contact=BALL, wrench_limits=limits).contact is BALL


def test_contacts_that_fit():
    """Each kind takes its own friction, or none."""
    for kind, contact in (("ball", BALL), ("softfinger", FINGER), ("hinge", EDGE)):
        assert Grasp(kind, contact=contact).contact is contact
        assert Grasp(kind).contact is None


@pytest.mark.parametrize("kind", KINDS)
def test_freedom_and_transmission(kind):
    """Transmitted and free directions together are the six; K has orthonormal rows and K h = 0."""
    grasp = Grasp(kind)
    assert len(grasp.free) == KINDS[kind]
    assert sorted(grasp.transmitted + grasp.free) == list(range(6))
    K = grasp.transmission
    assert K.shape == (6 - KINDS[kind], 6)
    np.testing.assert_array_equal(K @ K.T, np.eye(len(K)))
    np.testing.assert_array_equal(K @ np.eye(6)[:, list(grasp.free)], 0)


def test_frozen():
    """The contact frame is a read-only copy."""
    p = np.array([0.1, 0.0, 0.0])
    grasp = Grasp("hinge", Pose(np.eye(3), p))
    p[0] = 9.0
    assert grasp.frame.p[0] == 0.1
    for array in (grasp.frame.R, grasp.frame.p, Grasp("ball", [1, 0, 0, 0, 0, 0, 0]).frame.p):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
