"""A humanoid on two soles with a box between its palms: the bars of a distribution of forces, and other solvers."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.random_distributions import by_clarabel
from benchmarks.talos_box import LIMITS, asked, checked, talos, urdf

import holdfast as hf
from holdfast.errors import ModelError, StateError
from holdfast.forces import (
    ForceCost,
    ForceLimits,
    distribute,
    grasp_margins,
    least_peak,
    lift_margin,
)
from holdfast.forces.cone_solver import Verdict
from holdfast.forces.distribute import distribution
from holdfast.forces.force_question import ForceQuestion, force_question
from holdfast.forces.forest_equations import forest_equations
from holdfast.forces.forest_map import forest_force, scaled_forest_map
from holdfast.forces.forest_task import named_tasks
from holdfast.forces.limit_rows import limit_rows
from holdfast.forces.programmes import costs
from tests.forces.test_forest_distribution import assert_given_back, grippers
from tests.longer import mostly_slow
from tests.systems.branched import (
    Branched,
    two_arms_with_grippers,
)
from tests.systems.limited import limited_problem
from tests.systems.standing import Standing, humanoid_with_box

UP = np.eye(6)[5]


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


def test_names_of_frames():
    """A frame that cannot move at all is named once, and wrong names lead to the right ones."""
    p = humanoid()
    with pytest.raises(StateError, match=r"it cannot change the acceleration of 'left_leg/link6' at all\. Try"):
        distribute(p.chain, p.state, {"left_leg/link6": UP, "object": np.zeros(6)})
    for name, meant in (("trunk", "trunk/base"), ("base", "trunk/base"), ("left_leg", "left_leg/link6")):
        with pytest.raises(ModelError, match=f"no '{name}'.*'{meant}'"):
            distribute(p.chain, p.state, {name: UP})


@pytest.mark.slow
def test_as_a_law():
    """In a run, the box rises as asked while the robot stands; margins of loops are verified as those of grasps."""
    p = humanoid()

    def law(t, now, memory):
        wanted = {"trunk/base": -20.0 * now.base_twist, "object": np.array([0, 0, 0, 0, 0, 0.5])}
        calm = ForceCost(joint_acceleration=-20.0 * now.qd)
        return distribute(p.chain, now, wanted, limits=LIMITS, cost=calm).tau, memory

    run = hf.simulate(p.chain, p.state, law, 0.02, 0.01)
    assert run.stopped is None
    risen = run.object_pose[-1, 6] - p.state.object_pose[6]
    assert risen == pytest.approx(0.5 * 0.5 * 0.02**2, rel=1e-9)
    margins = grasp_margins(p.chain, run.state(2), run.grasp_wrench[-1])
    assert margins.min() > 1.0 - 1e-6
    np.testing.assert_allclose(run.margin[-1], margins, rtol=1e-9)
