"""Distribution of forces in forests: forward dynamics gives it back, and serial chains are answered alike both ways."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.talos_box import asked

import holdfast as hf
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.forces import (
    ForceCost,
    ForceLimits,
    distribute,
    distribution_parameters,
    lift_margin,
)
from holdfast.forces.force_question import force_question
from holdfast.forces.forest_equations import forest_equations
from holdfast.forces.forest_map import forest_force, forest_map
from holdfast.forces.forest_task import named_tasks
from tests.longer import mostly_slow
from tests.systems.branched import (
    Branched,
    moving,
    on_a_shoulder,
    palletiser,
    pot_and_lid,
    two_arms_with_grippers,
)
from tests.systems.limited import asked_of, limited_problem
from tests.systems.standing import humanoid_with_box

Z = np.eye(6)[5:]
HEAVE = {"object": np.array([0.3])}  # of the box on a flying trunk, whose momentum nothing else changes


def grippers(seed: int = 0) -> Branched:
    p = two_arms_with_grippers(seed)
    return moving(p.chain, p.state, seed)


ASKED = {
    "grippers": (grippers, {"acceleration": [0.1, -0.2, 0.3, 0.5, 0.0, 1.0]}),
    "palletiser": (palletiser, {"acceleration": {"robot/hand": [0.7]}, "task": {"robot/hand": Z}}),
    "pot and lid": (pot_and_lid, {"acceleration": {"lid": [0.1, 0.0, 0.2, 0.0, 0.5, -0.3]}}),
    "one object of two": (pot_and_lid, {"task": {"object": np.eye(6)[3:], "lid": np.eye(6)[:2]}}),
    "on a shoulder": (on_a_shoulder, {"acceleration": HEAVE, "task": {"object": Z}}),
    "nothing asked": (on_a_shoulder, {"acceleration": {}}),
}


def assert_given_back(p, found, tolerance=1e-9, inputs=None):
    """Assert that forward dynamics with the torques returns accelerations, wrenches and forces of couplings."""
    back = hf.forward_dynamics(p.chain, p.state, found.tau, inputs=inputs)
    pairs = [(back.qdd, found.qdd), (back.object_acceleration, found.object_acceleration)]
    pairs += [(back.grasp_wrench, found.grasp_wrench), (back.coupling_force, found.coupling_force)]
    pairs += [(back.base_acceleration, found.base_acceleration)] if p.chain.floats else []
    for x, y in pairs:
        assert x.shape == y.shape
        assert np.abs(x - y).max(initial=0.0) <= tolerance * max(1.0, float(np.abs(y).max(initial=0.0)))
    return back


@pytest.mark.parametrize("name", ASKED)
def test_given_back(name):
    """By forward dynamics, with what was asked of each frame, and without torque in passive joints."""
    make, given = ASKED[name]
    p = make()
    found = distribute(p.chain, p.state, **given)
    assert found.status == "optimal"
    assert found.residual <= 1e-9
    back = assert_given_back(p, found)
    passive = [j for j, joint in enumerate(p.chain.all_joints) if not joint.actuated]
    assert not found.tau[passive].any()
    values, rows = given.get("acceleration", {}), given.get("task", {})
    if isinstance(values, list):
        values = {"object": values}
    for frame in {*values, *rows}:
        S = rows.get(frame, np.eye(6))
        k, _ = p.chain.as_forest.frame(p.chain, frame, "")
        np.testing.assert_allclose(S @ back.bodies.acceleration[k], values.get(frame, np.zeros(len(S))), atol=1e-9)


@pytest.mark.parametrize("make", [grippers, palletiser, pot_and_lid])
def test_under_wrenches(make):
    """Wrenches on links and objects, and a base that moves, are part of the motion."""
    p, random = make(), np.random.default_rng(1)
    links = sum(arm.joint_count for arm in p.chain.arms.values())
    of_objects = random.normal(size=(*np.shape(p.state.object_twist)[:-1], 6)) if p.chain.free_objects else None
    inputs = hf.Inputs(
        object_wrench=of_objects,
        link_wrenches=random.normal(size=(links, 6)),
        base_accelerations=random.normal(size=(len(p.chain.arms), 6)),
    )
    found = distribute(p.chain, p.state, {}, inputs=inputs)
    assert np.abs(found.tau - distribute(p.chain, p.state, {}).tau).max() > 0.01
    assert_given_back(p, found, inputs=inputs)


def test_a_frame_beside_its_link():
    """The acceleration of a finger's pad is that of a point of its rigid body."""
    p = grippers()
    wanted = np.array([0.2, -0.1, 0.4])
    found = distribute(p.chain, p.state, {"arm2/pad2": wanted}, task={"arm2/pad2": np.eye(6)[3:]})
    back, forest = assert_given_back(p, found), p.chain.as_forest
    k = forest.arms["arm2"][7]
    motion = forest_equations(p.chain, p.state, None).motion.bodies[k].at
    l, w, a = motion.frame.R @ [0.0, 0.0, 0.04], motion.twist[:3], back.bodies.acceleration[k]
    np.testing.assert_allclose(a[3:] + np.cross(a[:3], l) + np.cross(w, np.cross(w, l)), wanted, atol=1e-9)


@pytest.mark.parametrize("seed", mostly_slow(range(16), range(4)))
def test_serial_chains_alike(seed):
    """Chains of serial arms: every motion with its forces and torques is one of the forest, and none is missing."""
    p, (acceleration, task) = limited_problem(seed), asked_of(seed)
    if p.chain.bushings or p.chain.springs:
        pytest.skip("springs between bodies are no part of a forest")
    serial = force_question(p.chain, p.state, acceleration, task, None, None, p.inputs).found
    equations = forest_equations(p.chain, p.state, p.inputs)
    tasks = named_tasks(equations, acceleration, task)
    found = forest_map(equations, tasks, forest_force(equations, tasks))
    assert (found.N.shape, found.unfelt) == (serial.N.shape, serial.unfelt)
    assert found.force == pytest.approx(serial.force, rel=1e-12)
    assert found.length == pytest.approx(serial.length, rel=1e-12)
    for x in np.random.default_rng(seed).normal(size=(5, serial.N.shape[1])):
        v = serial.v0 + serial.N @ x
        y = np.linalg.lstsq(found.N, v - found.v0)[0]
        size = max(1.0, float(np.abs(v).max()))
        assert np.abs(found.v0 + found.N @ y - v).max() <= 1e-9 * size
        tau = serial.T @ v + serial.t
        assert np.abs(found.T @ v + found.t - tau).max() <= 1e-9 * max(1.0, float(np.abs(tau).max()))


def test_accelerations_of_joints():
    """Limits by name, also of a sampled controller and of a spherical joint, and wished accelerations."""
    p = on_a_shoulder()
    free = distribute(p.chain, p.state, {})
    name, at = "arm/ball", p.chain.joints["arm"].start
    bound = 0.5 * float(np.abs(free.qdd[at : at + 3]).max())
    held = distribute(p.chain, p.state, {}, limits=ForceLimits(acceleration={name: (-bound, bound)}))
    assert held.status == "optimal"
    assert np.abs(held.qdd[at : at + 3]).max() <= bound * (1 + 1e-6) < np.abs(free.qdd[at : at + 3]).max()
    stands = humanoid_with_box()
    sampled = distribute(stands.chain, stands.state, asked(stands, 0.0), limits=ForceLimits(sample_time=1e-3))
    assert sampled.status == "optimal"
    wished = np.zeros(27)
    wished[1] = 2.0
    turned = distribute(stands.chain, stands.state, {}, cost=ForceCost(joint_acceleration=wished))
    assert turned.qdd[1] > 0.5


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"acceleration": {"lids": np.zeros(6)}}, ModelError, "lids.*lid"),
        ({"acceleration": {"lid": np.zeros(5)}}, StateError, "'lid': expected shape"),
        ({"acceleration": np.zeros(6)}, StateError, "acceleration: expected"),
        ({"acceleration": {3: np.zeros(6)}}, StateError, "expected names of frames"),
        ({"task": np.eye(6)}, StateError, "expected rows by name"),
        ({"acceleration": {"lid": np.zeros(6)}, "task": np.eye(6)}, StateError, "a mapping by name"),
        ({"task": {"lid": np.eye(5)}}, StateError, r"\(r, 6\)"),
        ({}, StateError, "'object' along .* with .* 'lid' along"),
        ({"acceleration": {}, "cost": ForceCost(barrier=1e-5)}, MethodNotApplicable, "barrier"),
        ({"acceleration": {}, "cost": ForceCost(task={"lid": 1.0})}, StateError, "nothing is asked of 'lid'"),
        ({"acceleration": {}, "limits": ForceLimits(least_normal={"knop": 1.0})}, ModelError, "knop.*knob"),
        ({"acceleration": {}, "cost": ForceCost(wish=np.zeros((2, 6)))}, StateError, "cost: wish"),
    ],
)
def test_refused_by_name(given, error, words):
    """Unknown names, wrong shapes, what a moving pot and its lid cannot do, and what forests are not asked."""
    p = pot_and_lid()
    with pytest.raises(error, match=words):
        distribute(p.chain, p.state, **given)


def test_what_is_not_asked_of_forests():
    """The payload of two objects, or of one that is free; derivatives; an object that nothing holds."""
    p, two = two_arms_with_grippers(), pot_and_lid()
    with pytest.raises(StateError, match="payload: expected False in a chain with 2 objects"):
        lift_margin(two.chain, two.state, {"lid": np.zeros(6)}, payload=True)
    with pytest.raises(StateError, match="expected that of 'object'"):
        lift_margin(p.chain, p.state, {}, payload=True)
    with pytest.raises(MethodNotApplicable, match="expected serial arms"):
        distribute.vjp(p.chain, p.state, tau=np.zeros(16))
    alone = palletiser()
    with pytest.raises(StateError, match="by name of links or frames"):
        distribute(alone.chain, alone.state)
    loose = replace(p.chain, grasps={})
    with pytest.raises(StateError, match=r"cannot change .* 'object'|satisfy all grasps"):
        distribute(loose, p.state)
    serial = limited_problem(4)
    given, named = {"inputs": serial.inputs}, {"object": np.zeros(6)}
    with pytest.raises(StateError, match="one weight"):
        distribute(serial.chain, serial.state, **given, cost=ForceCost(task={"object": 1.0}))
    with pytest.raises(StateError, match="one weight"):
        distribution_parameters(serial.chain, serial.state, cost=ForceCost(task={"object": 1.0}))
    for what in ("acceleration", "task"):
        with pytest.raises(StateError, match=f"{what}: expected that of the object"):
            distribute(serial.chain, serial.state, **given, **{what: named})
