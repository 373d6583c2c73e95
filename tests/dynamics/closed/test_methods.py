"""Every algorithm finds the oracle's answer where it applies, and refuses by name where it does not."""

from dataclasses import replace

import numpy as np
import pytest

from holdfast.dynamics import METHODS, Status
from holdfast.dynamics.arm import free_dynamics
from holdfast.errors import MethodNotApplicable
from tests.oracles.maximal_kkt import solve
from tests.systems import planar_three_arms
from tests.systems.as_chain import as_chain
from tests.systems.problems import random_case, random_problem, relative_gap, stored

RIGID_ONLY = [name for name, method in METHODS.items() if method.rigid_only]
ANY_GRASP = [name for name in METHODS if name not in RIGID_ONLY]
RIGID = {"grasps": "rigid", "joints": (7, 6, 8), "moving_base": True}
MIXED = {"grasps": ("rigid", "hinge", "softfinger", "ball"), "joints": (6, 7, 7, 8), "moving_base": True}
TOLERANCE = 1e-11


def assert_oracle(case: dict, result) -> None:
    """Assert every quantity of a result, base wrenches included."""
    truth = solve(case)
    assert relative_gap(result.qdd, np.concatenate(truth["qdd"])) < TOLERANCE
    assert relative_gap(result.grasp_wrench, np.array(truth["f"])) < TOLERANCE
    assert relative_gap(result.object_acceleration, truth["alpha_C"]) < TOLERANCE
    assert relative_gap(result.contact_acceleration, np.concatenate(truth["W_dot"])) < TOLERANCE
    assert relative_gap(result.base_wrench, np.array(truth["base_wrench"])) < TOLERANCE


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", range(3))
def test_rigid_grasps(method, seed):
    """All twelve agree with the oracle on rigid grasps with everything on."""
    result = random_problem(seed, **RIGID).solved(method=method)
    assert (result.method, result.status, result.rank) == (method, Status.OK, 18)
    assert_oracle(random_case(seed, **RIGID), result)


@pytest.mark.parametrize("method", ANY_GRASP)
@pytest.mark.parametrize("seed", range(3))
def test_mixed_grasps(method, seed):
    """Those for every grasp agree with the oracle on all four kinds together."""
    assert_oracle(random_case(seed, **MIXED), random_problem(seed, **MIXED).solved(method=method))


@pytest.mark.parametrize("route", ["recursive", "mass_matrix", "auto"])
@pytest.mark.parametrize("seed", range(20, 27))
def test_any_chain_any_route(route, seed):
    """`sequential` on 1 to 8 arms of 3 to 12 joints, any grasps, by either route."""
    assert_oracle(random_case(seed), random_problem(seed).solved(route=route))


@pytest.mark.parametrize("scale", [1e-8, 1e-3, 1e6])
@pytest.mark.parametrize(("kind", "arms"), [("rigid", 2), ("softfinger", 2), ("ball", 3)])
def test_light_and_heavy_objects(scale, kind, arms):
    """An object of 1e-8 or 1e6 times its weight costs `sequential` no digits: 40-digit oracle."""
    options = {"arms": arms, "joints": 7, "grasps": kind, "object_scale": scale}
    case = random_case(5, **options)
    truth, result = solve(case, digits=40), random_problem(5, **options).solved()
    assert relative_gap(result.qdd, np.concatenate(truth["qdd"])) < TOLERANCE
    assert relative_gap(result.grasp_wrench, np.array(truth["f"])) < TOLERANCE
    assert relative_gap(result.object_acceleration, truth["alpha_C"]) < TOLERANCE


@pytest.mark.parametrize("kind", ["rigid", "hinge", "softfinger", "ball"])
@pytest.mark.parametrize("scale", [1e-16, 1e-12, 1e12])
def test_rank_of_light_and_heavy_objects(kind, scale):
    """Sound rows stay sound, however mobile the object would be by itself."""
    result = random_problem(4, arms=3, joints=7, grasps=kind, object_scale=scale).solved()
    assert (result.rank, result.status) == (18, Status.OK)


@pytest.mark.parametrize("method", RIGID_ONLY)
def test_rigid_only(method):
    """Algorithms for rigid grasps name the grasps they do not cover, and what does."""
    p = random_problem(0, **MIXED)
    others = r"'arm2' is a hinge grasp, 'arm3' is a softfinger grasp, 'arm4' is a ball grasp"
    message = rf"^{method}: for rigid grasps only, but {others}; try method='sequential' or 'nonrigid'$"
    with pytest.raises(MethodNotApplicable, match=message):
        p.solved(method=method)


@pytest.mark.parametrize("method", [*RIGID_ONLY, "nonrigid"])
def test_omega_singular(method):
    """Where Omega is singular the message names its nullity: planar arms, dim ker Omega = 6."""
    with pytest.raises(MethodNotApplicable, match=rf"^{method}: needs Omega regular, but its nullity is 6 of 18; try"):
        as_chain(planar_three_arms(1)).solved(method=method, generic_rank=12)


def test_nonrigid_on_stewart():
    """Six legs of three joints with balls: 12 of 36 null directions, though forces are unique."""
    with pytest.raises(MethodNotApplicable, match=r"^nonrigid: needs Omega regular, but its nullity is 12 of 36"):
        stored("stewart_6_RRP_ball").solved(method="nonrigid")


@pytest.mark.parametrize(
    ("name", "nullity", "size"),
    [("planar_2arm_6_6_omega_singular", 3, 30), ("planar_3arm_6_7_6_omega_singular", 6, 43)],
)
def test_kkt_singular(name, nullity, size):
    """The dense system is singular by the number of undetermined forces: rows - rank."""
    p = stored(name)
    message = rf"^kkt: needs the KKT matrix regular \(grasp forces unique\), but its nullity is {nullity} of {size};"
    with pytest.raises(MethodNotApplicable, match=message):
        p.solved(method="kkt")


@pytest.mark.parametrize("method", [*RIGID_ONLY, "nonrigid"])
def test_light_object_loses_digits(method):
    """An object of 1e-8 of its weight: Omega's sum loses the arms, and says so."""
    p = random_problem(5, grasps="rigid", arms=2, joints=7, object_scale=1e-8)
    with pytest.raises(MethodNotApplicable, match=rf"^{method}: Omega's smallest scaled pivot is .*e-\d\d: object and"):
        p.solved(method=method)


@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("seqential", r"no method 'seqential'\. Did you mean 'sequential'\?"),
        ("zzz", r"no method 'zzz'\. Known: sequential, kkt, reduced_kkt"),
        (None, r"no method None\. Known: sequential"),
        (7, r"no method 7\. Known: sequential"),
    ],
)
def test_no_such_method(method, message):
    """An unknown method is refused with the names there are."""
    with pytest.raises(MethodNotApplicable, match=message):
        random_problem(0, **RIGID).solved(method=method)


def test_own_free_dynamics():
    """A user's open-chain solver takes part in (4.9): called for free and for loaded arms."""
    calls = []

    def mine(motion, torque, tip_wrench):
        calls.append(tip_wrench)
        return free_dynamics.composite(motion, torque, tip_wrench)

    result = random_problem(1, **RIGID).solved(method=mine)
    assert result.method == "general:mine"
    assert len(calls) == 3 * (1 + 6 + 1)  # free motion, unit wrenches, correction: three arms
    assert_oracle(random_case(1, **RIGID), result)
    with pytest.raises(MethodNotApplicable, match=r"^general:mine: for rigid grasps only"):
        random_problem(1, **MIXED).solved(method=mine)


def test_grasp_opened_in_between():
    """Algorithms stack only the arms that hold: with one grasp opened all still agree."""
    p = random_problem(2, **RIGID)
    opened = replace(p, chain=p.chain.without_grasp("arm2"))
    expected = opened.solved()
    np.testing.assert_array_equal(expected["arm2"].grasp_wrench, np.zeros(6))
    for method in METHODS:
        result = opened.solved(method=method)
        assert relative_gap(result.qdd, expected.qdd) < TOLERANCE
        assert relative_gap(result.grasp_wrench, expected.grasp_wrench) < TOLERANCE
        assert relative_gap(result.base_wrench, expected.base_wrench) < TOLERANCE
