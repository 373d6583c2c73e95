"""The same physics described otherwise: mirrored, turned, in other frames, other units, arms in another order."""

import numpy as np
import pytest

from holdfast import Pose
from holdfast.dynamics import METHODS
from tests.laws.systems import mixed, sample
from tests.laws.transformed import both, links_reframed, mirrored, object_reframed, rescaled, turned, with_arms
from tests.systems.problems import ANSWERS, random_problem, relative_gap
from tests.systems.random_parts import rotation, unit_vector

TOLERANCE = 1e-10
samples = pytest.mark.parametrize(("make", "seed"), [(make, seed) for make in (sample, mixed) for seed in range(8)])


def assert_answers(found, original, tolerance: float = TOLERANCE, **expected) -> None:
    """Assert a result of the same system described otherwise: what is not expected anew stays as it was."""
    for name in ANSWERS:
        assert relative_gap(getattr(found, name), expected.get(name, getattr(original, name))) < tolerance, name
    assert (found.rank, found.mobility, found.status) == (original.rank, original.mobility, original.status)


def vectors(p, result, R, axial, softfinger) -> dict[str, np.ndarray]:
    """Return what is expected where forces go to R f, moments and the rates of balls to axial m."""
    rates = np.array(result.contact_acceleration)
    for name, part in p.chain.contact_freedoms.items():  # those of hinges and soft fingers ride along
        if p.chain.grasps[name].kind == "ball":
            rates[part] = axial @ rates[part]
        if p.chain.grasps[name].kind == "softfinger":
            rates[part] *= softfinger
    wrenches = ("grasp_wrench", "base_wrench", "object_acceleration")
    return {"contact_acceleration": rates} | {name: both(axial, R, getattr(result, name)) for name in wrenches}


@samples
def test_mirror(make, seed):
    """Joint accelerations are the same, forces are reflected, moments reflected with another sign."""
    p, result = make(seed)
    image, S = mirrored(p, unit_vector(np.random.default_rng(seed)))
    assert_answers(image.solved(), result, **vectors(p, result, S, -S, [1.0, -1.0]))


@pytest.mark.parametrize("seed", range(4))
def test_mirror_without_the_sign_fails(seed):
    """Reflecting moments like forces is wrong: the law can fail."""
    p, result = mixed(seed)
    image, S = mirrored(p, np.array([0.0, 1.0, 0.0]))
    assert relative_gap(image.solved().base_wrench, both(S, S, result.base_wrench)) > 0.1


@samples
def test_world(make, seed):
    """Turn and shift the whole scene, gravity included: vectors turn, numbers stay."""
    p, result = make(seed)
    rng = np.random.default_rng(seed)
    Q = rotation(rng)
    assert_answers(turned(p, Q, rng.normal(size=3)).solved(), result, **vectors(p, result, Q, Q, 1.0))


@pytest.mark.parametrize("distance", [1.0, 1e3, 1e5])
def test_far_from_the_origin(distance):
    """A kilometre away only the closing gap's own rounding is felt: distances within the chain stay."""
    p, result = mixed(1)
    assert_answers(turned(p, np.eye(3), np.array([distance, -distance, distance])).solved(), result, 1e-12)


@samples
def test_object_frame(make, seed):
    """Another point C and other object axes: forces and joints stay, alpha is C's own."""
    p, result = make(seed)
    rng = np.random.default_rng(seed)
    frame = Pose(rotation(rng), rng.normal(size=3))
    lever, w, alpha = p.state.object_frame.R @ frame.p, p.state.object_twist[:3], result.object_acceleration
    moved = np.r_[alpha[:3], alpha[3:] + np.cross(alpha[:3], lever) + np.cross(w, np.cross(w, lever))]
    assert_answers(object_reframed(p, frame).solved(), result, object_acceleration=moved)


@samples
def test_link_frames(make, seed):
    """Links described in other axes move alike."""
    p, result = make(seed)
    rng = np.random.default_rng(seed)
    assert_answers(links_reframed(p, [rotation(rng) for _ in range(3)]).solved(), result)


@samples
@pytest.mark.parametrize(("length", "mass"), [(1e3, 1.0), (1e-3, 1e3)])
def test_units(make, seed, length, mass):
    """Millimetres for metres, grams for kilograms: every quantity scales by its dimension; condition has none."""
    p, result = make(seed)
    other, units = rescaled(p, length, mass)
    found = other.solved()
    wrenches = {name: getattr(result, name) * units.wrench for name in ("grasp_wrench", "base_wrench")}
    accelerations = {"qdd": result.qdd * units.joints, "object_acceleration": result.object_acceleration * units.twist}
    assert_answers(found, result, **wrenches, **accelerations)
    assert found.condition == pytest.approx(result.condition, rel=1e-8)


def assert_same_arm_by_arm(a, b) -> None:
    """Assert that two results agree under the arms' names."""
    for name in a.chain.names:
        for key, expected in vars(a[name]).items():
            assert relative_gap(getattr(b[name], key), expected) < TOLERANCE, (name, key)
    assert relative_gap(b.object_acceleration, a.object_acceleration) < TOLERANCE
    assert (a.rank, a.mobility) == (b.rank, b.mobility)


@samples
def test_order_of_arms(make, seed):
    """Arms in another order: the answer is permuted, every arm keeps its own."""
    p, result = make(seed)
    names = list(np.random.default_rng(seed).permutation(p.chain.names))
    assert_same_arm_by_arm(result, with_arms(p, names).solved())


@pytest.mark.parametrize("method", METHODS)
def test_order_of_arms_by_every_method(method):
    """The same for every algorithm, three rigid grasps."""
    p = random_problem(3, grasps="rigid", joints=(7, 6, 8), moving_base=True)
    assert_same_arm_by_arm(p.solved(method=method), with_arms(p, ["arm3", "arm1", "arm2"]).solved(method=method))
