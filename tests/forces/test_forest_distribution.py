"""Distribution of forces in forests: forward dynamics gives it back, and serial chains are answered alike both ways."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.random_distributions import by_clarabel
from benchmarks.talos_box import LIMITS, asked, checked, talos, urdf

import holdfast as hf
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.forces import (
    ForceCost,
    ForceLimits,
    distribute,
    distribution_parameters,
    grasp_margins,
    least_peak,
    lift_margin,
)
from holdfast.forces.cone_solver import Verdict
from holdfast.forces.distribute import distribution
from holdfast.forces.force_question import ForceQuestion, force_question
from holdfast.forces.forest_equations import forest_equations
from holdfast.forces.forest_map import forest_force, forest_map, scaled_forest_map
from holdfast.forces.forest_task import named_tasks
from holdfast.forces.limit_rows import limit_rows
from holdfast.forces.programmes import costs
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
from tests.systems.standing import Standing, humanoid_with_box

Z, UP = np.eye(6)[5:], np.eye(6)[5]
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


@cache
def humanoid() -> Standing:
    return humanoid_with_box()


def robots() -> list:
    """Return the humanoid in code, and Talos where its file is."""
    missing = pytest.mark.skipif(urdf() is None, reason="needs Talos: make robots")
    return ["humanoid", pytest.param("talos", marks=missing)]


def robot(name: str) -> Standing:
    return humanoid() if name == "humanoid" else talos(urdf())


@pytest.mark.parametrize("name", robots())
@pytest.mark.parametrize("up", [0.0, 1.0])
def test_two_soles(name, up):
    """Feet carry the weight at rest; soles and palms keep their cones, and forward dynamics agrees, box up or not."""
    p = robot(name)
    done = checked(p, up)
    assert done.found.status == "optimal"
    assert done.found.residual <= 1e-9
    assert done.given_back <= 1e-9
    assert done.margins.min() >= 1.0 - 1e-5
    assert done.found.margin == done.margins.min()
    limits = np.array([joint.effort_limit for joint in p.chain.all_joints])
    assert (np.abs(done.found.tau) <= limits * (1 + 1e-7)).all()
    if up == 0.0:
        assert done.unbalanced <= 1e-10
        assert not np.abs(done.found.qdd).max() > 1e-9


@pytest.mark.parametrize("name", robots())
def test_too_much(name):
    """The limits that conflict are named, with a proof."""
    p = robot(name)
    found = distribute(p.chain, p.state, asked(p, 80.0), limits=LIMITS)
    assert (found.status, found.certificate is None) == ("infeasible", False)
    assert "edge limit" in found.why if name == "humanoid" else "effort limit" in found.why
    assert sum(found.certificate.shares.values()) == pytest.approx(1.0, abs=1e-4)
    assert_given_back(p, found)


@pytest.mark.parametrize("form", ["effort", "elastic", "margin", "violation"])
def test_clarabel(form):
    """Another solver finds the same value of the same programme."""
    pytest.importorskip("clarabel", reason="needs Clarabel: pip install 'holdfast[dev]'")
    p = humanoid()
    question = force_question(p.chain, p.state, asked(p, 1.0), None, None, LIMITS, None)
    done, posed = question.asked(form, 1e4), question.posed(form, 1e4)
    status, value = by_clarabel(posed)
    assert done.verdict is Verdict.OPTIMAL
    assert status in ("Solved", "AlmostSolved")
    own = done.extra * (-1.0 if form == "margin" else 1.0) if form in ("margin", "violation") else done.value
    constant = posed.constant if form in ("effort", "elastic") else 0.0
    assert own == pytest.approx(value + constant, rel=1e-7, abs=1e-7)


def random_question(seed: int) -> tuple[hf.ClosedChain, hf.State, dict]:
    """Return a question of which limits may conflict: of the humanoid in motion, or of grippers with random drives."""
    random = np.random.default_rng(seed)
    if seed % 2:
        p = humanoid()
        rates = 0.1 * random.normal(size=33)
        guess = replace(p.state, q=p.state.q + 0.1 * random.normal(size=27), qd=rates[6:], base_twist=rates[:6])
        wanted = {"trunk/base": 3.0 * random.normal(size=6), "object": 2.0 * random.normal(size=6)}
        return p.chain, hf.close(p.chain, guess), wanted
    p, share = grippers(seed), random.uniform(0.1, 2.0)
    arms = {
        name: replace(arm, joints=[replace(joint, effort_limit=20.0 * share) for joint in arm.joints])
        for name, arm in p.chain.arms.items()
    }
    return replace(p.chain, arms=arms), p.state, {"object": 2.0 * random.normal(size=6)}


@pytest.mark.parametrize("seed", mostly_slow(range(20), (0, 1)))
def test_random_questions(seed):
    """Given back by forward dynamics, with the verdict and the value that Clarabel finds for hard limits."""
    pytest.importorskip("clarabel", reason="needs Clarabel: pip install 'holdfast[dev]'")
    chain, state, wanted = random_question(seed)
    found = distribute(chain, state, wanted)
    assert found.residual <= 1e-7
    assert_given_back(Branched(chain, state, found.tau), found)
    question = force_question(chain, state, wanted, None, None, None, None)
    done, posed = question.asked("effort"), question.posed("effort")
    status, value = by_clarabel(posed)
    assert (done.verdict is Verdict.OPTIMAL) == (found.status == "optimal") == (status in ("Solved", "AlmostSolved"))
    if found.status == "optimal":
        assert done.value == pytest.approx(value + posed.constant, rel=1e-7, abs=1e-7)
        assert found.value == pytest.approx(done.value, rel=1e-6)


@pytest.mark.slow
def test_reports():
    """Beyond the largest share of an acceleration limits conflict; with weaker drives than the least peak, too."""
    p = humanoid()
    most = lift_margin(p.chain, p.state, asked(p, 1.0), limits=LIMITS)
    assert most.status == "optimal"
    for share, status in ((0.999, "optimal"), (1.001, "infeasible")):
        assert distribute(p.chain, p.state, asked(p, share * most.value), limits=LIMITS).status == status
    least = least_peak(p.chain, p.state, asked(p, 1.0), limits=LIMITS)
    for share, status in ((1.001, "optimal"), (0.999, "infeasible")):
        limits = replace(LIMITS, effort=share * least.value)
        assert distribute(p.chain, p.state, asked(p, 1.0), limits=limits).status == status


def test_centre_of_mass():
    """Feet give all bodies together what is asked of their centre of mass, whatever else moves."""
    p = humanoid()
    wanted = np.array([0.3, -0.2, 0.5])
    rest = {"trunk/base": np.eye(6)[:3], "object": np.eye(6)[:3]}
    given = dict.fromkeys(rest, np.zeros(3)) | {"centre_of_mass": wanted}
    found = distribute(p.chain, p.state, given, task=rest, limits=LIMITS)
    assert found.status == "optimal"
    mass = sum(body.link.mass for body in p.chain.forest.bodies)
    feet = found.wrenches["left_leg_sole"][3:] + found.wrenches["right_leg_sole"][3:]
    np.testing.assert_allclose(feet, mass * (wanted - p.chain.gravity), rtol=1e-9)
    assert_given_back(p, found)
    with pytest.raises(StateError, match=r"'centre_of_mass': expected shape \(r, 3\)"):
        distribute(p.chain, p.state, {}, task={"centre_of_mass": np.eye(6)})


def test_payload():
    """With the largest payload instead of the box some limit is met, and with a little more limits conflict."""
    p = humanoid()
    still = asked(p, 0.0)
    most = lift_margin(p.chain, p.state, still, payload=True, limits=LIMITS)
    assert most.status == "optimal"
    box = p.chain.held_object
    for share, status in ((0.999, "optimal"), (1.001, "infeasible")):
        heavy = replace(box, mass=share * most.value * box.mass, inertia=share * most.value * box.inertia)
        assert distribute(replace(p.chain, held_object=heavy), p.state, still, limits=LIMITS).status == status
    serial = limited_problem(4)
    given, equations = {"inputs": serial.inputs}, forest_equations(serial.chain, serial.state, serial.inputs)
    tasks = named_tasks(equations, None, None)
    found, v1 = scaled_forest_map(equations, tasks, forest_force(equations, tasks), payload=True)
    rows, whole = limit_rows(found, serial.state, ForceLimits()), costs(found, ForceCost())
    own = distribution(ForceQuestion(serial.state, found, rows, whole, v1), "scale")
    assert own.value == pytest.approx(lift_margin(serial.chain, serial.state, payload=True, **given).value, rel=1e-6)


def test_a_weight_by_name():
    """The base's acceleration gives way to the limits, and the box keeps its own exactly."""
    p = humanoid()
    wanted = {"trunk/base": np.array([0, 0, 0, 60.0, 0, 0]), "object": np.zeros(6)}
    found = distribute(p.chain, p.state, wanted, cost=ForceCost(task={"trunk/base": 10.0}), limits=LIMITS)
    assert (found.status, found.violation) == ("optimal", 0.0)
    assert 0.1 < found.base_acceleration[3] < 59.0
    assert np.abs(found.object_acceleration).max() <= 1e-9
    assert_given_back(p, found)
    both = distribute(p.chain, p.state, wanted, cost=ForceCost(task=10.0), limits=LIMITS)
    assert both.status == "optimal" and np.abs(both.object_acceleration).max() > 1e-6
    gentle = {"trunk/base": np.array([0, 0, 0, 0.2, 0, 0]), "object": np.zeros(6)}
    near = distribute(p.chain, p.state, gentle, cost=ForceCost(task={"trunk/base": 1e3}), limits=LIMITS)
    assert abs(near.base_acceleration[3] - 0.2) < 1e-4


def test_limits_by_key():
    """Of a sole by the name of its loop, of palms by arms; one number is for grasps and soles alike."""
    p = humanoid()
    wanted = asked(p, 0.0)
    limits = ForceLimits(least_normal={"left_leg_sole": 520.0}, most_normal={"left": 30.0})
    found = distribute(p.chain, p.state, wanted, limits=limits)
    assert found.wrenches["left_leg_sole"][5] >= 520.0 - 1e-4
    assert found.prices["left_leg_sole least normal force"] > 0.0
    every = distribute(p.chain, p.state, wanted, limits=ForceLimits(least_margin=20.0))
    assert grasp_margins(p.chain, p.state, every.grasp_wrench).min() == pytest.approx(20.0, abs=1e-4)
    wish = np.zeros((4, 6))
    wish[0, 5] = wish[1, 5] = 60.0  # the palms
    firm = distribute(p.chain, p.state, wanted, cost=ForceCost(wish=wish, wrench=10.0))
    assert abs(firm.wrenches["left"][4] + 60.0) < 5.0
    steady = ForceLimits(last_wrench=firm.grasp_wrench, wrench_change=1.0)
    again = distribute(p.chain, p.state, wanted, limits=steady)
    assert np.abs(again.grasp_wrench - firm.grasp_wrench)[:, 3:].max() <= 1.0 + 1e-4
    two = two_arms_with_grippers()
    tight = ForceLimits(most_normal={("arm1", "pad1"): 1.0})
    pad = distribute(two.chain, two.state, limits=tight).wrenches["arm1", "pad1"]
    frame = two.chain.grasps["arm1", "pad1"].frame
    assert (two.state.object_frame.R @ frame.R[:, 2]) @ pad[3:] <= 1.0 + 1e-6


def test_accelerations_of_joints():
    """Limits by name, also of a sampled controller and of a spherical joint, and wished accelerations."""
    p = on_a_shoulder()
    free = distribute(p.chain, p.state, {})
    name, at = "arm/ball", p.chain.joints["arm"].start
    bound = 0.5 * float(np.abs(free.qdd[at : at + 3]).max())
    held = distribute(p.chain, p.state, {}, limits=ForceLimits(acceleration={name: (-bound, bound)}))
    assert held.status == "optimal"
    assert np.abs(held.qdd[at : at + 3]).max() <= bound * (1 + 1e-6) < np.abs(free.qdd[at : at + 3]).max()
    stands = humanoid()
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


def test_names_of_frames():
    """A frame that cannot move at all is named once, and wrong names lead to the right ones."""
    p = humanoid()
    with pytest.raises(StateError, match=r"it cannot change the acceleration of 'left_leg/link6' at all\. Try"):
        distribute(p.chain, p.state, {"left_leg/link6": UP, "object": np.zeros(6)})
    for name, meant in (("trunk", "trunk/base"), ("base", "trunk/base"), ("left_leg", "left_leg/link6")):
        with pytest.raises(ModelError, match=f"no '{name}'.*'{meant}'"):
            distribute(p.chain, p.state, {name: UP})


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


@pytest.mark.slow
def test_as_a_law():
    """In a run, the box rises as asked while the robot stands, and friction of loops is only recorded."""
    p = humanoid()

    def law(t, now, memory):
        wanted = {"trunk/base": -20.0 * now.base_twist, "object": np.array([0, 0, 0, 0, 0, 0.5])}
        calm = ForceCost(joint_acceleration=-20.0 * now.qd)
        return distribute(p.chain, now, wanted, limits=LIMITS, cost=calm).tau, memory

    run = hf.simulate(p.chain, p.state, law, 0.02, 0.01, on_slip="record")
    risen = run.object_pose[-1, 6] - p.state.object_pose[6]
    assert risen == pytest.approx(0.5 * 0.5 * 0.02**2, rel=1e-9)
    margins = grasp_margins(p.chain, run.state(2), run.grasp_wrench[-1])
    assert margins.min() > 1.0 - 1e-6
    legs = replace(p.chain, grasps={}, held_object=None)
    still = hf.State(p.state.q, p.state.qd, base_pose=p.state.base_pose)
    with pytest.raises(MethodNotApplicable, match="'record' for loop 'left_leg_sole'"):
        hf.simulate(legs, still, law, 0.02, 0.01)
