"""The filter across the arms against the dense equations it replaces."""

import numpy as np
import pytest

from holdfast.dynamics.closed.measurement import measurement
from holdfast.dynamics.closed.object_filter import initial_size, object_filter, own_size
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.dynamics.closed.tip_response import tip_response
from tests.dynamics.closed.answered import nonrigid, rigid
from tests.dynamics.problems import motion_of, random_problem, relative_gap, stored

systems = pytest.mark.parametrize("seed", range(6))
makers = pytest.mark.parametrize("make", [rigid, nonrigid])


def filtered(motion, order=None):
    """Return the filter's solution, the arms in any order, and the tips' responses."""
    tips = [tip_response(arm, "auto") for arm in motion.holding]
    order = range(len(tips)) if order is None else order
    return object_filter([motion.contacts[i] for i in order], [tips[i] for i in order], motion.body.free), tips


@makers
@systems
def test_mobility(make, seed):
    """P at the end is the inverse of M(C) + sum A^T K^T (K Lambda K^T)^-1 K A, the information form."""
    motion = make(seed).motion
    found, tips = filtered(motion)
    s = Stacked(motion)
    information, at = s.M_C.copy(), 0
    for c, tip in zip(motion.contacts, tips, strict=True):
        KA = c.K @ s.A[at : at + 6]
        information += KA.T @ np.linalg.solve(c.K @ tip.mobility.dense() @ c.K.T, KA)
        at += 6
    assert relative_gap(found.mobility, np.linalg.inv(information)) < 1e-9


@makers
@systems
def test_wrenches(make, seed):
    """H f = 0, the object's equation holds, and the oracle's wrenches come out."""
    o = make(seed)
    found, _ = filtered(o.motion)
    f = np.concatenate(found.wrenches)
    assert np.abs(o.HT.T @ f).max(initial=0.0) < 1e-13 * np.abs(f).max()
    assert relative_gap(f, o.f) < 1e-9
    assert relative_gap(found.object_acceleration, o.alpha_C) < 1e-9
    assert relative_gap(o.MC @ found.object_acceleration + o.b, o.A.T @ f) < 1e-9
    assert found.rank == len(f)


@systems
def test_order_of_arms(seed):
    """Whichever arm is measured first, the answer is the same."""
    motion = nonrigid(seed).motion
    found, _ = filtered(motion)
    order = list(np.random.default_rng(seed).permutation(len(motion.contacts)))
    other, _ = filtered(motion, order)
    assert relative_gap(other.object_acceleration, found.object_acceleration) < 1e-10
    assert relative_gap(np.array(other.wrenches), np.array(found.wrenches)[order]) < 1e-10
    assert relative_gap(other.mobility, found.mobility) < 1e-10
    assert other.rank == found.rank


@pytest.mark.parametrize("scale", [1e-8, 1e-4, 1.0])
def test_mobility_of_light_objects(scale):
    """However light the object, what the arms leave of its mobility stays exact."""
    options = {"arms": 3, "joints": 7, "grasps": "rigid"}
    heavy = motion_of(random_problem(4, **options))
    light = motion_of(random_problem(4, **options, object_scale=scale))
    found, tips = filtered(light)
    information = np.linalg.inv(filtered(heavy)[0].mobility) - (1 - scale) * Stacked(heavy).M_C
    assert relative_gap(found.mobility, np.linalg.inv(information)) < 1e-9
    body = light.body.free
    about = [c.about(body.centre, body.centripetal) for c in light.contacts]
    size = initial_size(body, [measurement(c, t) for c, t in zip(about, tips, strict=True)])
    part = size / own_size(body)  # pivots are judged by the arms' mobility if it is the smaller
    assert (part > 0).all() and (part <= 1).all()
    assert (part.max() < 0.5) == (scale < 1e-2)


@pytest.mark.parametrize("kind", ["rigid", "hinge", "softfinger", "ball"])
@pytest.mark.parametrize("scale", [1e-16, 1e-12, 1e12])
def test_rank_of_light_and_heavy_objects(kind, scale):
    """Sound rows stay sound, however mobile the object would be by itself."""
    motion = motion_of(random_problem(4, arms=3, joints=7, grasps=kind, object_scale=scale))
    found, _ = filtered(motion)
    assert found.rank == 18
    assert found.weakest_pivot > 1e-9


def test_nobody_holds():
    """Without grasps the object falls: alpha = M(C)^-1 (w - b), P = M(C)^-1, rank 0."""
    body = motion_of(random_problem(1, grasps="ball", arms=2)).body
    found = object_filter([], [], body.free)
    assert found.wrenches == []
    assert (found.rank, found.weakest_pivot) == (0, 1.0)
    assert relative_gap(body.inertia.apply(found.object_acceleration) + body.bias, body.wrench) < 1e-12
    assert relative_gap(found.mobility, body.mobility.dense()) < 1e-14


@pytest.mark.parametrize(
    ("name", "rank"),
    [
        ("planar_2arm_6_6_omega_singular", 9),
        ("planar_3arm_6_7_6_omega_singular", 12),
        ("stewart_6_RRP_ball", 36),
        ("rigid_12arm", 72),
    ],
)
def test_rank(name, rank):
    """Repeated rows are dropped and counted; the mobility is zero where the object is held fast."""
    found, _ = filtered(motion_of(stored(name)))
    assert found.rank == rank
    assert found.weakest_pivot > 1e-6
    if name.startswith("planar"):
        z = np.eye(6)[[0, 1, 5]]  # turns about x, y and lifting: out of the plane
        assert np.abs(z @ found.mobility).max() < 1e-13
