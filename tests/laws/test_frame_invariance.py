"""Nothing depends on where the world's, the links' or the object's frames are put."""

import numpy as np
import pytest

from holdfast import Pose
from tests.dynamics.problems import relative_gap
from tests.laws.systems import mixed, sample, solved
from tests.laws.transformed import answers, both, links_reframed, object_reframed, turned
from tests.systems.random_parts import rotation

TOLERANCE = 1e-10
makers = pytest.mark.parametrize("make", [sample, mixed])
seeds = pytest.mark.parametrize("seed", range(10))


def turned_rates(p, Q, W_dot) -> np.ndarray:
    """Return contact rates in a turned world: a ball's are along world axes, the others ride along."""
    result = np.array(W_dot)
    for name, part in p.chain.contact_freedoms.items():
        if p.chain.grasps[name].kind == "ball":
            result[part] = Q @ W_dot[part]
    return result


@makers
@seeds
def test_world(make, seed):
    """Turn and shift the whole scene, gravity included: vectors turn, numbers stay."""
    p, result = make(seed)
    rng = np.random.default_rng(seed)
    Q = rotation(rng)
    got = solved(turned(p, Q, rng.normal(size=3)))
    assert relative_gap(got.qdd, result.qdd) < TOLERANCE
    assert relative_gap(got.grasp_wrench, both(Q, Q, result.grasp_wrench)) < TOLERANCE
    assert relative_gap(got.base_wrench, both(Q, Q, result.base_wrench)) < TOLERANCE
    assert relative_gap(got.object_acceleration, both(Q, Q, result.object_acceleration)) < TOLERANCE
    rates = turned_rates(p, Q, result.contact_acceleration)
    assert relative_gap(got.contact_acceleration, rates) < TOLERANCE


@pytest.mark.parametrize("distance", [1.0, 1e3, 1e5])
def test_far_from_the_origin(distance):
    """A kilometre away only the closing gap's own rounding is felt: distances within the chain stay."""
    p, result = mixed(1)
    got = solved(turned(p, np.eye(3), np.array([distance, -distance, distance])))
    for name, expected in answers(result).items():
        assert relative_gap(answers(got)[name], expected) < 1e-12


@makers
@seeds
def test_object_frame(make, seed):
    """Another point C and other object axes: forces and joints stay, alpha is C's own."""
    p, result = make(seed)
    rng = np.random.default_rng(seed)
    frame = Pose(rotation(rng), rng.normal(size=3))
    got = solved(object_reframed(p, frame))
    lever, w, alpha = p.state.object_frame.R @ frame.p, p.state.object_twist[:3], result.object_acceleration
    moved = np.r_[alpha[:3], alpha[3:] + np.cross(alpha[:3], lever) + np.cross(w, np.cross(w, lever))]
    assert relative_gap(got.object_acceleration, moved) < TOLERANCE
    for name in ("qdd", "grasp_wrench", "contact_acceleration", "base_wrench"):
        assert relative_gap(answers(got)[name], answers(result)[name]) < TOLERANCE


@makers
@seeds
def test_link_frames(make, seed):
    """Links described in other axes move alike."""
    p, result = make(seed)
    rng = np.random.default_rng(seed)
    got = solved(links_reframed(p, [rotation(rng) for _ in range(3)]))
    for name, expected in answers(result).items():
        assert relative_gap(answers(got)[name], expected) < TOLERANCE
