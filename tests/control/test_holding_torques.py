"""Torques for an acceleration and an internal wrench give both back; as a law, they are machine code."""

import numpy as np
import pytest

import holdfast as hf
from holdfast import ClosedChain, Friction, State, forward_dynamics
from holdfast.assembly.assemble import assemble
from holdfast.control.compiled_law import compile_law
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.control.holding_law import holding_law
from holdfast.control.holding_torques import holding_torques
from holdfast.dynamics import project_velocity
from holdfast.dynamics.result import Status
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.forces.force_split import split
from holdfast.robots import stewart_platform, three_finger_hand
from tests.control.two_pandas import pushes, two_pandas
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain

LAW = 1e-10
ACCELERATION = np.array([0.5, -1.0, 2.0, 0.3, -0.4, 1.5])
LEVEL = State(np.zeros(18), np.zeros(18), [1, 0, 0, 0, 0, 0, 0.45])
TILTS = [f"leg{k}/tilt_{axis}" for k in range(1, 7) for axis in "xy"]


def moving(chain, state):
    """Return the state with consistent velocities of every kind."""
    rng = np.random.default_rng(len(state.q))
    guess = State(state.q, 0.2 * rng.normal(size=len(state.q)), state.object_pose, 0.2 * rng.normal(size=6))
    return project_velocity(chain, guess)


def internal_wrenches(chain, state, seed=0):
    """Return random internal, transmissible wrenches, (arms, 6)."""
    rng = np.random.default_rng(seed)
    wild = forward_dynamics(chain, state, 10 * rng.normal(size=len(state.q))).grasp_wrench
    return split(chain, state, wild).internal


@pytest.mark.parametrize("kinds", [("rigid", "rigid"), ("rigid", "ball"), ("hinge", "softfinger"), ("hinge", "hinge")])
def test_given_back_by_forward_dynamics(kinds):
    """The object accelerates as asked, and the internal part of the grasp wrenches is the chosen one."""
    chain, state = two_pandas(*kinds)
    assert given_back(chain, moving(chain, state)).status is Status.OK


def given_back(chain, state, seed=0):
    """Return the result under torques for an acceleration and internal wrenches, having asserted that it has both."""
    chosen = internal_wrenches(chain, state, seed)
    assert np.abs(chosen).max() > 1.0
    found = forward_dynamics(chain, state, holding_torques(chain, state, ACCELERATION, chosen))
    assert found.object_acceleration == pytest.approx(ACCELERATION, abs=LAW)
    size = max(1.0, float(np.abs(found.grasp_wrench).max()))
    assert split(chain, state, found.grasp_wrench).internal == pytest.approx(chosen, abs=LAW * size)
    return found


def test_random_chains():
    """So it is for arms of any shape, damped, with armature, under any gravity, one of them without a grasp."""
    for seed in range(4):
        kinds = ["rigid", "hinge", None, "ball"]
        p = as_chain(well_conditioned_system(seed, grasps=kinds, joints=[6, 7, 5, 6], moving_base=False))
        given_back(p.chain, p.state, seed)


def test_holding_is_gravity_compensation():
    """At rest, without an acceleration, it is what the controller does, internal force included."""
    chain, state = two_pandas("rigid", "ball")
    expected = GravityCompensation(chain, internal_force=20.0)(0.0, state, None)[0]
    assert holding_torques(chain, state, internal_force=20.0) == pytest.approx(expected, abs=1e-12)


def test_only_the_internal_part_counts():
    """What moves the object, and what a grasp cannot transmit, is taken off the chosen wrenches."""
    chain, state = two_pandas("rigid", "ball")
    chosen = internal_wrenches(chain, state)
    extra = np.zeros((2, 6))
    extra[1, :3] = 5.0  # a moment at a ball
    lifted = chosen + split(chain, state, np.tile([0, 0, 0, 0, 0, 9.0], (2, 1))).motion
    expected = holding_torques(chain, state, internal_force=chosen)
    for wrenches in (chosen + extra, lifted):
        assert holding_torques(chain, state, internal_force=wrenches) == pytest.approx(expected, abs=1e-10)


def test_short_legs_and_fingers():
    """Arms of fewer than six joints: the object accelerates as asked, the fingers squeeze."""
    for chain, state in ((ClosedChain(*stewart_platform()), LEVEL), assemble(*three_finger_hand())):
        state = moving(chain, state)
        found = forward_dynamics(chain, state, holding_torques(chain, state, ACCELERATION, 5.0))
        assert found.object_acceleration == pytest.approx(ACCELERATION, abs=LAW)
    internal = split(chain, state, found.grasp_wrench).internal
    assert pushes(chain, state, internal) == pytest.approx([5, 5, 5], abs=1e-9)
    assert isinstance(chain.grasps["finger1"].contact, Friction)


def test_passive_joints():
    """A platform moves by its six drives alone; then there is nothing left to choose inside it."""
    chain = ClosedChain(*stewart_platform())
    state = moving(chain, LEVEL)
    for internal_force in (0.0, 100.0):
        tau = holding_torques(chain, state, ACCELERATION, internal_force, passive=TILTS)
        assert not tau.reshape(6, 3)[:, :2].any()
        assert forward_dynamics(chain, state, tau).object_acceleration == pytest.approx(ACCELERATION, abs=LAW)
    assert tau == pytest.approx(holding_torques(chain, state, ACCELERATION, passive=TILTS), abs=1e-8)


def test_platform_weighs_what_it_weighs():
    """At rest and level, six equal drives push up the platform and their share of the legs."""
    chain = ClosedChain(*stewart_platform(payload=20.0))
    drives = holding_torques(chain, LEVEL, passive=TILTS).reshape(6, 3)[:, 2]
    assert drives == pytest.approx(np.full(6, drives[0]), abs=1e-9)
    assert drives[0] > 20.0 * 9.81 / 6


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"acceleration": np.zeros(5)}, "acceleration: expected shape"),
        ({"internal_force": np.zeros((3, 6))}, "internal_force: expected shape"),
        ({"internal_force": "firm"}, "internal_force: expected a number"),
        ({"passive": ["left/joint9"]}, "passive: no joint 'left/joint9'. Did you mean"),
        ({"passive": [f"left/joint{k}" for k in range(1, 7)]}, None),
        ({"passive": two_pandas()[0].joint_names()}, "cannot bear this load with 14 passive joints"),
    ],
)
def test_refused(options, message):
    """What cannot be is refused; one arm can carry the box and six joints of the other."""
    chain, state = two_pandas()
    if message is None:
        tau = holding_torques(chain, state, **options)
        assert np.abs(forward_dynamics(chain, state, tau).object_acceleration).max() <= LAW
        return
    with pytest.raises(StateError, match=message):
        holding_torques(chain, state, **options)


def test_refused_without_a_hold():
    """Arms that hold nothing bear nothing; an arm that does not hold has no internal wrench."""
    chain, state = two_pandas()
    alone = chain.without_grasp("right")
    with pytest.raises(StateError, match="arm 'right' holds nothing"):
        holding_torques(alone, state, internal_force=np.ones((2, 6)))
    with pytest.raises(StateError, match="no arm holds the object"):
        holding_torques(alone.without_grasp("left"), state)


def test_refused_where_arms_cannot_follow():
    """A straight leg's tip cannot leave its line sideways without its tilts; of a batch that system is not-a-number."""
    arms, platform, grasps = stewart_platform()
    poles = {name: hf.Arm([arm.joints[2]], [arm.links[2]], base=arm.base) for name, arm in arms.items()}
    chain = ClosedChain(poles, platform, grasps)
    state = State(np.zeros(6), np.zeros(6), LEVEL.object_pose)
    fast, sideways = compile_law(holding_law(chain), chain), np.array([np.zeros(6), [0, 0, 0, 0, 0, 1.0]])

    def by_law(acceleration):
        return fast.torques(0.0, **arrays(state), acceleration=acceleration, internal_force=0.0).tau

    for torques in (by_law, lambda acceleration: holding_torques(chain, state, acceleration)):
        with pytest.raises(StateError, match=r"expected one that the arms can follow.*arm 'leg1' misses"):
            torques(sideways[1])
        assert np.isfinite(torques(sideways[0])).all()
    assert np.array_equal(by_law(sideways)[0], by_law(sideways[0])) and np.isnan(by_law(sideways)[1]).all()


def arrays(state):
    """Return a state's arrays by the names of a law's arguments."""
    return {name: getattr(state, name) for name in ("q", "qd", "object_pose", "object_twist")}


def chains():
    """Return chains with states in motion."""
    for kinds in (("rigid", "rigid"), ("rigid", "ball"), ("hinge", "softfinger")):
        chain, state = two_pandas(*kinds)
        yield chain, moving(chain, state)
    chain, state = assemble(*three_finger_hand())
    yield chain, moving(chain, state)
    p = as_chain(well_conditioned_system(1, grasps=["rigid", "hinge", None], joints=[6, 7, 5], moving_base=False))
    yield p.chain, p.state


@pytest.mark.slow
def test_the_reference_as_machine_code():
    """Torques to 1e-10 of the reference's, by a push and by wrenches of each arm, single and bound."""
    for chain, state in chains():
        fast = compile_law(holding_law(chain), chain)
        expected = holding_torques(chain, state, ACCELERATION, 12.0)
        given = {"acceleration": ACCELERATION, "internal_force": 12.0}
        found = fast.torques(0.0, **arrays(state), **given).tau
        assert found == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())
        bound = fast.bind(**given)
        for name, x in arrays(state).items():
            bound.arrays[name][...] = x
        assert np.array_equal(bound(), found)
        wrenches = np.random.default_rng(1).normal(size=(len(chain.arms), 6))
        wrenches[[name not in chain.grasps for name in chain.names]] = 0.0
        expected = holding_torques(chain, state, ACCELERATION, wrenches)
        by_arm = compile_law(holding_law(chain, each_arm=True), chain)
        found = by_arm.torques(0.0, **arrays(state), **given | {"internal_force": wrenches}).tau
        assert found == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())


def test_a_load_that_nothing_bears():
    """A ball bears no moment: one arm with one holds no box aside of it."""
    chain, state = two_pandas("ball", "rigid")
    alone = chain.without_grasp("right")
    fast, given = compile_law(holding_law(alone), alone), {"acceleration": np.zeros(6), "internal_force": 0.0}
    for torques in (lambda: holding_torques(alone, state), lambda: fast.torques(0.0, **arrays(state), **given)):
        with pytest.raises(StateError, match="cannot bear this load"):
            torques()


@pytest.mark.slow
def test_in_a_run():
    """A law like any other: under its torques an object at rest stays."""
    chain, state = two_pandas()
    law = holding_law(chain)
    run = hf.simulate(chain, state, law, 0.02, 0.01, parameters={"acceleration": np.zeros(6), "internal_force": 20.0})
    assert np.abs(run.object_twist).max() < 1e-9


def test_laws_refused():
    """Chains that no drives hold, and laws that compute no numbers."""
    chain, state = two_pandas()
    with pytest.raises(MethodNotApplicable, match="got a chain with no grasp"):
        holding_law(chain.without_grasp("left").without_grasp("right"))
    with pytest.raises(hf.errors.ModelError, match="holding law: chain: expected ClosedChain"):
        holding_law(3)  # pyright: ignore[reportArgumentType]
    poor = compile_law(hf.ControlLaw(lambda t, x, m, given: (x.q / (t - t), m)), chain)
    with pytest.raises(StateError, match="compiled law: expected finite torques"):
        poor.torques(0.0, **arrays(state))
