"""Laws of a chain with a trunk: inverse dynamics, power, momentum, projection, gripping in flight."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import (
    attach,
    closure,
    kinetic_energy,
    momentum,
    momentum_rate,
    motion_basis,
    object_mobility,
    potential_energy,
    power,
)
from holdfast.dynamics.projection import Change, displaced_by, quickened
from tests.systems.problems import largest_gaps, relative_gap
from tests.systems.trunk_problems import cases, random_on_trunk

CASES = [
    "torso3_three_arms_one_free_head",
    "space_wheel_and_arms",
    "links_and_moving_world_arms",
    "drives_wrenches_floating",
    "many_forces_links_3joint_rigid",
    "floating_legs_and_arms",
]
RANDOM = [(seed, joints, seed % 2 == 1) for seed, joints in enumerate((1, 2, 3, 6))]
some = pytest.mark.parametrize("name", CASES)
random = pytest.mark.parametrize(("seed", "joints", "floating"), RANDOM)


def along(state, result, t):
    """Return the state after a time at constant accelerations, to second order."""
    half, floats = t * t / 2, state.base_twist is not None
    there = displaced_by(
        state,
        Change(
            t * state.qd + half * result.qdd,
            t * state.object_twist + half * result.object_acceleration,
            t * state.base_twist + half * result.base_acceleration if floats else None,
        ),
    )
    by_base = t * result.base_acceleration if floats else None
    return quickened(there, Change(t * result.qdd, t * result.object_acceleration, by_base))


@random
def test_inverse_of_forward(seed, joints, floating):
    """The torques of the accelerations are those that were given."""
    p = random_on_trunk(seed, joints, floating=floating)
    r = p.solved()
    tau = hf.inverse_dynamics(p.chain, p.state, r.qdd, r.grasp_wrench, p.inputs, r.base_acceleration)
    assert relative_gap(tau, p.tau, np.abs(r.grasp_wrench).max()) < 1e-11


def test_a_floating_base_has_no_drive():
    """Accelerations that it cannot have, or that are missing, are refused."""
    p = random_on_trunk(1, 2, floating=True)
    r = p.solved()
    with pytest.raises(hf.errors.StateError, match="no drive, but would need the wrench"):
        hf.inverse_dynamics(p.chain, p.state, r.qdd, r.grasp_wrench, p.inputs, r.base_acceleration + 0.1)
    with pytest.raises(hf.errors.StateError, match="expected the acceleration of the floating base"):
        hf.inverse_dynamics(p.chain, p.state, r.qdd, r.grasp_wrench, p.inputs)
    fixed = random_on_trunk(0, 1, floating=False)
    with pytest.raises(hf.errors.StateError, match="no base floats"):
        hf.inverse_dynamics(fixed.chain, fixed.state, 0 * fixed.tau, np.zeros((len(fixed.chain.arms), 6)),
                            base_acceleration=np.zeros(6))  # fmt: skip


@pytest.mark.parametrize("name", [name for name in CASES if "moving" not in name])
def test_power_is_the_rate_of_energy(name):
    """d(T + U)/dt is what drives, damping and external wrenches put in; differences to second order."""
    case = cases()[name]
    r = hf.forward_dynamics(case.chain, case.state, case.tau, inputs=case.inputs)
    found = power(case.chain, case.state, case.tau, r, case.inputs).total

    def energy(t):
        at = along(case.state, r, t)
        return kinetic_energy(case.chain, at) + potential_energy(case.chain, at)

    h = 1e-5
    rate = (energy(h) - energy(-h)) / (2 * h)
    assert abs(rate - found) < 1e-6 * max(abs(found), kinetic_energy(case.chain, case.state), 1.0)


@random
def test_momentum_rate(seed, joints, floating):
    """Momentum changes by bases, weights and external wrenches alone: by no drive and by no grasp."""
    p = random_on_trunk(seed, joints, floating=floating)
    r = p.solved()
    wanted = momentum_rate(p.chain, p.state, r, inputs=p.inputs)
    h = 1e-5
    if not floating:  # a driven base: its own motion to second order
        p = replace(p, inputs=replace(p.inputs, trunk_base_twist=None, trunk_base_acceleration=None))
        p = replace(p, state=hf.dynamics.project_velocity(p.chain, p.state, inputs=p.inputs))
        r = p.solved()
        wanted = momentum_rate(p.chain, p.state, r, inputs=p.inputs)
    ends = [momentum(p.chain, along(p.state, r, t)) for t in (h, -h)]
    rate = (ends[0] - ends[1]) / (2 * h)
    assert relative_gap(rate, wanted, np.abs(ends[0]).max()) < 1e-6


@some
def test_project_and_close(name):
    """States beside the grasps come back, trunk and floating base moving too; or the base is held."""
    case = cases()[name]
    noise = np.random.default_rng(1)
    off = replace(case.state, q=case.state.q + 1e-3 * noise.normal(size=len(case.state.q)))
    for found in (
        hf.project(case.chain, off, case.inputs)[0],
        hf.close(case.chain, off, inputs=case.inputs),
        hf.close(case.chain, off, inputs=case.inputs, hold_base=True),
    ):
        assert (largest_gaps(closure(case.chain, found, case.inputs)) < (1e-12, 1e-10)).all()
    if case.chain.floats:
        np.testing.assert_array_equal(found.base_pose, off.base_pose)
        np.testing.assert_array_equal(found.base_twist, off.base_twist)


@pytest.mark.parametrize("seed", range(4))
def test_a_held_base_keeps_its_bits(seed):
    """A rotation by zero changes the last bit of one base pose in two, and is not applied."""
    case, draw = cases()["drives_wrenches_floating"], np.random.default_rng(seed)
    for _ in range(4):
        turned = case.state.base_pose + np.append(1e-3 * draw.normal(size=4), np.zeros(3))
        turned[:4] /= np.linalg.norm(turned[:4])
        q = case.state.q + 1e-3 * draw.normal(size=len(case.state.q))
        off = replace(case.state, q=q, base_pose=turned)
        found = hf.close(case.chain, off, inputs=case.inputs, hold_base=True)
        np.testing.assert_array_equal(found.base_pose, off.base_pose)


@random
def test_projected_velocities_are_the_nearest_in_kinetic_energy(seed, joints, floating):
    """What projection takes away is orthogonal, in the kinetic metric, to every velocity that the grasps allow."""
    p = random_on_trunk(seed, joints, floating=floating)
    noise = np.random.default_rng(seed)
    base = None if p.state.base_twist is None else p.state.base_twist + noise.normal(size=6)
    off = replace(p.state, qd=p.state.qd + noise.normal(size=len(p.tau)), base_twist=base)
    still = hf.Inputs()
    found, _ = hf.project(p.chain, off)
    left = quickened(off, Change(-found.qd, -found.object_twist, None if base is None else -found.base_twist))
    n = len(p.tau)

    def energy(v):
        return kinetic_energy(p.chain, replace(p.state.at_rest(), **v), still)

    for direction in motion_basis(p.chain, found).T[:4]:
        allowed = {"qd": direction[:n], "object_twist": direction[n : n + 6]}
        taken = {"qd": left.qd, "object_twist": left.object_twist}
        if floating:
            allowed["base_twist"], taken["base_twist"] = direction[n + 6 :], left.base_twist
        plus, minus = ({key: taken[key] + sign * allowed[key] for key in taken} for sign in (1, -1))
        assert abs(energy(plus) - energy(minus)) < 1e-11 * (energy(taken) + energy(allowed))


@random
def test_mobility_is_what_a_wrench_on_the_object_changes(seed, joints, floating):
    """The trunk gives way too."""
    p = random_on_trunk(seed, joints, floating=floating)
    P, none = object_mobility(p.chain, p.state), p.solved()
    w = np.random.default_rng(seed).normal(size=6)
    pushed = replace(p, inputs=replace(p.inputs, object_wrench=p.inputs.object_wrench + w)).solved()
    assert relative_gap(pushed.object_acceleration - none.object_acceleration, P @ w) < 1e-9


def test_a_free_flyer_grips_a_tumbling_object():
    """No momentum is lost when a free arm grips, and the energy lost is that of the velocity mismatch."""
    case = cases()["space_one_holds_one_free"]
    chain, state = case.chain, case.state
    before = momentum(chain, state), kinetic_energy(chain, state)
    (name,) = set(chain.arms) - set(chain.grasps)
    done = attach(chain, state, name, hf.Grasp("rigid"), here=True)
    after = momentum(done.chain, done.state), kinetic_energy(done.chain, done.state)
    assert relative_gap(after[0], before[0]) < 1e-13
    assert done.energy_change < 0
    assert abs(after[1] - before[1] - done.energy_change) < 1e-13 * before[1]
    assert largest_gaps(closure(done.chain, done.state))[1] < 1e-12


@some
def test_diagnosis(name):
    """Rank, mobility and regularity agree with the stored ones."""
    case = cases()[name]
    found = hf.diagnose(case.chain, case.state)
    r = hf.forward_dynamics(case.chain, case.state, case.tau, inputs=case.inputs)
    assert (found.rank, found.mobility) == (r.rank, r.mobility)
    assert found.status == ("indeterminate" if name.startswith("many_forces") else "regular")
    assert motion_basis(case.chain, case.state).shape[1] == found.mobility
