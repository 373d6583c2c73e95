"""Forward dynamics of arms on a trunk: the stored answers, the dense equations, and chains without a trunk."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.cli.solve import error_vs_expected
from holdfast.dynamics import METHODS
from holdfast.dynamics.closed.chain_motion import chain_motion
from tests.longer import mostly_slow
from tests.systems.problems import random_problem, relative_gap
from tests.systems.trunk_problems import cases, names, on_trunk, random_on_trunk

EXACT = 1e-11  # measured: 1.3e-12
DENSE = 1e-9
RANDOM = [(seed, joints, floating) for seed, joints in enumerate((1, 2, 3, 5, 7, 12)) for floating in (False, True)]
UNIQUE = ("many_forces_hand_two_ball_fingers_hinge",)
ANSWERS = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench")


@pytest.mark.parametrize("route", ["recursive", "mass_matrix"])
@pytest.mark.parametrize("name", mostly_slow(names(), names()[::3]))
def test_stored_answers(name, route):
    """Torsos, hands, free flyers, arms on several links and in the world: `sequential` has the 180-digit answers."""
    case = cases()[name]
    found = hf.forward_dynamics(case.chain, case.state, case.tau, inputs=case.inputs, route=route)
    motion = chain_motion(case.chain, case.state, case.tau, case.inputs.shaped(case.chain))
    assert error_vs_expected(found, case.expected, motion) < EXACT


@pytest.mark.parametrize("name", mostly_slow(names(), names()[1::3]))
def test_stored_answers_by_dense_equations(name):
    """`kkt` has them too where forces are unique, and refuses by name elsewhere; the paper's algorithms refuse."""
    case = cases()[name]
    motion = chain_motion(case.chain, case.state, case.tau, case.inputs.shaped(case.chain))
    given = {"inputs": case.inputs, "method": "kkt"}
    if name.startswith("many_forces") and name not in UNIQUE:
        with pytest.raises(hf.errors.MethodNotApplicable, match="nullity"):
            hf.forward_dynamics(case.chain, case.state, case.tau, **given)
        return
    found = hf.forward_dynamics(case.chain, case.state, case.tau, **given)
    assert error_vs_expected(found, case.expected, motion) < EXACT


def test_papers_methods_refuse():
    """Their arms stand on bases of their own."""
    case = cases()["torso1_rigid_7_7"]
    for name, method in METHODS.items():
        if not method.takes_trunk:
            with pytest.raises(hf.errors.MethodNotApplicable, match=f"{name}: .*trunk"):
                hf.forward_dynamics(case.chain, case.state, case.tau, inputs=case.inputs, method=name)


@pytest.mark.parametrize(("seed", "joints", "floating"), RANDOM)
def test_random_chains_by_dense_equations(seed, joints, floating):
    """Any grasps, some arms free or in the world, a driven base: `sequential` and `kkt` agree, rank included."""
    p = random_on_trunk(seed, joints, floating=floating)
    found, dense = p.solved(), p.solved(method="kkt")
    for name in ANSWERS:
        assert relative_gap(getattr(found, name), getattr(dense, name)) < DENSE
    assert relative_gap(found.trunk_base_wrench, dense.trunk_base_wrench, 1.0) < DENSE
    if floating:
        assert relative_gap(found.base_acceleration, dense.base_acceleration) < DENSE


@pytest.mark.parametrize("seed", range(4))
def test_trunk_and_one_arm_are_a_longer_arm(seed):
    """A trunk that carries one arm answers as the serial arm of all their joints."""
    p = on_trunk(random_problem(seed, arms=1, moving_base=False), seed, 3, in_world=0.0)
    (name, arm), trunk = *p.chain.arms.items(), p.chain.trunk
    outermost = {name: trunk.joint_count - 1}
    at = replace(p.chain, mounts=outermost)
    placed = chain_motion(p.chain, p.state, p.tau, p.inputs.shaped(p.chain))
    base = placed.trunk.bodies[-1].frame.inverse() @ placed.arms[name].arm.base
    at = at.with_bases({name: base})
    first = replace(arm.joints[0], placement=base @ arm.joints[0].placement)
    joints, links = [*trunk.joints, first, *arm.joints[1:]], [*trunk.links, *arm.links]
    serial = hf.Arm(joints, links, arm.tip, trunk.base)
    alone = hf.ClosedChain({name: serial}, p.chain.held_object, p.chain.grasps, p.chain.gravity)
    same = {
        "object_wrench": p.inputs.object_wrench,
        "base_twists": p.inputs.trunk_base_twist[None],
        "base_accelerations": p.inputs.trunk_base_acceleration[None],
        "link_wrenches": np.concatenate([p.inputs.trunk_link_wrenches, p.inputs.link_wrenches]),
    }
    state = hf.dynamics.project_velocity(at, p.state, inputs=p.inputs)
    found = hf.forward_dynamics(at, state, p.tau, inputs=p.inputs)
    wanted = hf.forward_dynamics(alone, state, p.tau, inputs=hf.Inputs(**same))
    assert relative_gap(found.qdd, wanted.qdd) < DENSE
    assert relative_gap(found.grasp_wrench, wanted.grasp_wrench) < DENSE
    assert relative_gap(found.object_acceleration, wanted.object_acceleration) < DENSE
    assert relative_gap(found.trunk_base_wrench, wanted.base_wrench[0]) < DENSE
    assert (found.rank, found.mobility) == (wanted.rank, wanted.mobility)


@pytest.mark.parametrize(("seed", "joints", "floating"), RANDOM[:6])
def test_arms_on_bases_that_move_as_the_trunk_does(seed, joints, floating):
    """Arms in the world whose bases are driven as the trunk carries them have the same accelerations and forces."""
    p = random_on_trunk(seed, joints, floating=floating)
    found = p.solved()
    motion = chain_motion(p.chain, p.state, p.tau, p.inputs.shaped(p.chain))
    betas = motion.trunk.accelerations(
        hf.dynamics.trunk.trunk_motion.TrunkAcceleration(found.qdd[p.chain.joints["trunk"]], found.base_acceleration)
    )
    twists, accelerations, bases = np.zeros((2, len(p.chain.arms), 6)), {}, {}
    twists, rates = twists
    for i, name in enumerate(p.chain.arms):
        if name in motion.trunk.mounts:
            mount = motion.trunk.mounts[name]
            bases[name], twists[i] = mount.frame, mount.twist
            rates[i] = mount.acceleration + motion.trunk.under(name, betas) + np.r_[np.zeros(3), p.chain.gravity]
    accelerations = rates
    n = p.chain.trunk.joint_count
    world = replace(p.chain, trunk=None, mounts={}).with_bases(bases)
    state = hf.State(p.state.q[n:], p.state.qd[n:], p.state.object_pose, p.state.object_twist)
    inputs = hf.Inputs(p.inputs.object_wrench, p.inputs.link_wrenches, twists, accelerations)
    wanted = hf.forward_dynamics(world, state, p.tau[n:], inputs=inputs)
    assert relative_gap(found.qdd[n:], wanted.qdd) < DENSE
    for name in ANSWERS[1:]:
        assert relative_gap(getattr(found, name), getattr(wanted, name)) < DENSE


@pytest.mark.parametrize("scale", [1e-8, 1e-4, 1e2])
@pytest.mark.parametrize("name", ["torso3_rigid_7_7", "space_rigid_7_7", "links_four_grasp_kinds"])
def test_light_and_heavy_objects(name, scale):
    """Mass ratios from 1e-8 to 1e2 lose no digits: the recursion and the mass matrices agree."""
    case = cases()[name]
    body = case.chain.held_object
    chain = replace(case.chain, held_object=hf.HeldObject(scale * body.mass, scale * body.inertia, body.com))
    found = [hf.forward_dynamics(chain, case.state, case.tau, route=route) for route in ("recursive", "mass_matrix")]
    assert relative_gap(found[0].qdd, found[1].qdd) < EXACT
    assert relative_gap(found[0].object_acceleration, found[1].object_acceleration) < EXACT


def test_long_trunks_release_many_joints_between_arms():
    """Factors of the mobility are compressed where many joints lie between the arms, and nothing is lost."""
    p = on_trunk(random_problem(5, arms=3, grasps="ball", moving_base=False), 5, 16, in_world=0.0)
    spread = dict(zip(p.chain.arms, (15, 8, 0), strict=True))
    motion = chain_motion(p.chain, p.state, p.tau, p.inputs.shaped(p.chain))
    frames = [body.frame for body in motion.trunk.bodies]
    bases = {name: frames[k].inverse() @ motion.arms[name].arm.base for name, k in spread.items()}
    chain = replace(p.chain, mounts=spread).with_bases(bases)
    state = hf.dynamics.project_velocity(chain, p.state, inputs=p.inputs)
    found = hf.forward_dynamics(chain, state, p.tau, inputs=p.inputs)
    dense = hf.forward_dynamics(chain, state, p.tau, inputs=p.inputs, method="kkt")
    assert relative_gap(found.qdd, dense.qdd) < DENSE
    assert relative_gap(found.grasp_wrench, dense.grasp_wrench) < DENSE


@pytest.mark.parametrize(("kind", "given"), [("cylinder", {}), ("universal", {}), ("screw", {"pitch": 0.03})])
def test_grasps_that_slide_or_cross(kind, given):
    """Motion subspaces and trunks know nothing of each other, and go together."""
    p = random_on_trunk(3, 5, floating=True)
    grasps = {name: hf.Grasp(kind, grasp.frame, **given) for name, grasp in p.chain.grasps.items()}
    placed = chain_motion(p.chain, p.state, p.tau, p.inputs.shaped(p.chain))
    arms = dict(p.chain.arms)
    for name, grasp in grasps.items():  # tips turned to their contact frames
        seen = placed.arms[name].at.R[-1].T @ p.state.object_frame.R @ grasp.frame.R
        arms[name] = arms[name].with_tip(hf.Pose(seen, arms[name].tip.p))
    chain = replace(p.chain, arms=arms, grasps=grasps)
    state = hf.dynamics.project_velocity(chain, p.state, inputs=p.inputs)
    found = hf.forward_dynamics(chain, state, p.tau, inputs=p.inputs)
    dense = hf.forward_dynamics(chain, state, p.tau, inputs=p.inputs, method="kkt")
    for part in ANSWERS:
        assert relative_gap(getattr(found, part), getattr(dense, part)) < DENSE
