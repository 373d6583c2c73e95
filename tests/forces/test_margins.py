"""Margins of grasps and joints: the formulae and their signs."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast import ClosedChain, Friction, Grasp, Joint, State
from holdfast.errors import StateError
from holdfast.forces.margins import contact_margin, grasp_margins, joint_margins
from holdfast.model.grasp import WrenchLimits
from holdfast.questions.arrays import contact_of
from holdfast.spatial.spatial_vector import rotate
from tests.model.parts import BOX, arm
from tests.systems.problems import random_problem

MU, E, L, A, B = 0.6, 0.02, 0.05, 0.1, 0.04
ONE_SIDED = {
    "ball": Grasp("ball", contact=Friction(MU)),
    "softfinger": Grasp("softfinger", contact=Friction(MU, torsion_radius=E)),
    "hinge": Grasp("hinge", contact=Friction(MU, half_length=L)),
    "sole": Grasp("sole", contact=Friction(MU, half_lengths=(A, B))),
}


def margin_of(grasp: Grasp, f) -> float:
    """Return the margin of one grasp for a wrench in contact axes."""
    return float(contact_margin(grasp.kind, contact_of(grasp), f))


def formula(kind: str, f) -> float:
    """Return the margin as it is written down."""
    m_x, m_y, m_n, f_x, f_y, f_n = f
    slides = MU * f_n - np.hypot(f_x, f_y)
    if kind == "softfinger":
        slides = MU * f_n - np.sqrt(f_x**2 + f_y**2 + (m_n / E) ** 2)
    tips = (L * f_n - abs(m_y)) / L if kind == "hinge" else np.inf
    if kind == "sole":
        tips = min(f_n - abs(m_y) / A, f_n - abs(m_x) / B)
    return min(slides, tips, f_n)


@pytest.mark.parametrize("kind", ONE_SIDED)
@pytest.mark.parametrize("seed", range(8))
def test_one_sided(kind, seed):
    """The least of the conditions, whatever part of the wrench decides."""
    rng = np.random.default_rng(seed)
    f = 10.0 ** rng.uniform(-3, 3) * (rng.normal(size=6) * np.array([1, 0.1, 0.02, 1, 1, 1]) + 2 * np.eye(6)[5])
    assert margin_of(ONE_SIDED[kind], f) == pytest.approx(formula(kind, f), rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "wrench", "margin"),
    [
        ("ball", [0, 0, 0, 3, 4, 10], 1.0),
        ("ball", [0, 0, 0, 3, 4, 5], -2.0),
        ("ball", [0, 0, 0, 0, 0, -1], -1.0),  # pulls: by f_n, not by the smaller mu f_n
        ("softfinger", [0, 0, 0.06, 0, 4, 10], 1.0),
        ("hinge", [0, 0.4, 9, 0, 0, 10], 2.0),
        ("hinge", [0, -0.6, 0, 0, 0, 10], -2.0),
        ("sole", [0.2, 0.9, 50, 0, 0, 10], 1.0),  # over the front edge; no limit about the normal
        ("sole", [-0.48, 0.5, 0, 0, 0, 10], -2.0),  # over the side edge
        ("sole", [0.1, 0.1, 0, 3, 4, 10], 1.0),
    ],
)
def test_by_hand(kind, wrench, margin):
    """Slides, spins, tips over its edge, lifts off."""
    assert margin_of(ONE_SIDED[kind], np.array(wrench, dtype=float)) == pytest.approx(margin, rel=1e-14)


@pytest.mark.parametrize("kind", ONE_SIDED)
def test_scales_with_the_force(kind):
    """A friction cone: twice the wrench, twice the margin; nothing held, nothing to spare."""
    f = np.array([0.1, 0.02, 0.01, 0.5, -0.3, 3.0])
    assert margin_of(ONE_SIDED[kind], 2 * f) == pytest.approx(2 * margin_of(ONE_SIDED[kind], f), rel=1e-14)
    assert margin_of(ONE_SIDED[kind], np.zeros(6)) == 0.0


@pytest.mark.parametrize(
    ("limits", "margin"),
    [
        (WrenchLimits(), np.inf),
        (WrenchLimits(force=20.0), 7.0),
        (WrenchLimits(moment=8.0), 3.0),  # N m over 1 m
        (WrenchLimits(moment=8.0, force=20.0), 7.0),
        (WrenchLimits(moment=5.5, force=20.0), 0.5 * 20 / 5.5),
    ],
)
def test_wrench_limits(limits, margin):
    """Force limit less |f|, moment limit less |m| over the lever; a limit that is not given does not count."""
    f = np.array([0, 3, 4, 12, 3, 4], dtype=float)
    assert margin_of(Grasp("rigid", wrench_limits=limits), f) == pytest.approx(margin, rel=1e-14)
    pressing = replace(ONE_SIDED["ball"], wrench_limits=limits)
    assert margin_of(pressing, f) == pytest.approx(min(margin, formula("ball", f)), rel=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_of_a_chain(seed):
    """In the grasps' order, each wrench seen in its contact's axes; arms without a grasp have no margin."""
    p = random_problem(seed, grasps=("ball", None, "softfinger", "rigid", "hinge"), joints=(7, 6, 7, 8, 7))
    chain = replace(p.chain, grasps={n: replace(g, contact=contact(g.kind)) for n, g in p.chain.grasps.items()})
    f = np.random.default_rng(seed).normal(size=(5, 6))
    wrenches = np.zeros((5, 6))
    for i, grasp in zip((0, 2, 3, 4), chain.grasps.values(), strict=True):
        wrenches[i] = rotate(p.state.object_frame.R @ grasp.frame.R, f[i])
    expected = [formula("ball", f[0]), formula("softfinger", f[2]), np.inf, formula("hinge", f[4])]
    np.testing.assert_allclose(grasp_margins(chain, p.state, wrenches), expected, rtol=1e-12)
    assert grasp_margins(replace(chain, grasps={}), p.state, wrenches).shape == (0,)
    with pytest.raises(StateError, match=r"grasp_wrench: expected shape \(5, 6\)"):
        grasp_margins(chain, p.state, wrenches[1:])


def contact(kind: str) -> Friction | None:
    """Return a one-sided contact for every kind that can be one."""
    return ONE_SIDED[kind].contact if kind in ONE_SIDED else None


def test_joint_margins():
    """To the nearer end, to the rate limit, to the effort limit; infinite without one, negative beyond."""
    joints = [
        Joint(position_limits=(-1.0, 2.0), rate_limit=3.0, effort_limit=10.0),
        Joint(position_limits=(-np.inf, 0.5)),
    ]
    chain = ClosedChain({"left": replace(arm(2), joints=joints), "right": arm(3)}, BOX, {"left": Grasp("ball")})
    state = State([-0.8, 0.7, 9, 9, 9], [-3.5, 7, 0, 0, 0], [1, 0, 0, 0, 0, 0, 0])
    found = joint_margins(chain, state, np.array([-4.0, 1, 1, 1, 1]))
    np.testing.assert_allclose(found.position, [0.2, -0.2, np.inf, np.inf, np.inf], rtol=1e-14)
    np.testing.assert_allclose(found.rate, [-0.5, np.inf, np.inf, np.inf, np.inf], rtol=1e-14)
    np.testing.assert_allclose(found.effort, [6.0, np.inf, np.inf, np.inf, np.inf], rtol=1e-14)
    with pytest.raises(StateError, match=r"tau: expected shape \(5,\)"):
        joint_margins(chain, state, np.zeros(4))
    with pytest.raises(StateError, match="expected 5 joint positions"):
        joint_margins(chain, State(np.zeros(4), np.zeros(4), [1, 0, 0, 0, 0, 0, 0]), np.zeros(5))
