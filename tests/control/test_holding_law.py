"""`holding_torques` as a law: the reference's torques as machine code, its refusals, and not-a-number in batches."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast import ClosedChain, MethodNotApplicable, State, StateError
from holdfast.assembly.assemble import assemble
from holdfast.control.compiled_law import compile_law
from holdfast.control.holding_law import holding_law
from holdfast.control.holding_torques import holding_torques
from holdfast.robots import three_finger_hand
from tests.control.test_holding_torques import ACCELERATION, LEVEL, moving
from tests.control.two_pandas import two_pandas
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain


def arrays(state: State) -> tuple[np.ndarray, ...]:
    """Return a state's arrays as a law takes them."""
    return state.q, state.qd, state.object_pose, state.object_twist


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
        found = fast.torques(0.0, *arrays(state), **given).tau
        assert found == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())
        bound = fast.bind(**given)
        for name, x in zip(("q", "qd", "object_pose", "object_twist"), arrays(state), strict=True):
            bound.arrays[name][...] = x
        assert np.array_equal(bound(), found)
        wrenches = np.random.default_rng(1).normal(size=(len(chain.arms), 6))
        wrenches[[name not in chain.grasps for name in chain.names]] = 0.0
        expected = holding_torques(chain, state, ACCELERATION, wrenches)
        found = compile_law(holding_law(chain, each_arm=True), chain).torques(
            0.0, *arrays(state), acceleration=ACCELERATION, internal_force=wrenches
        )
        assert found.tau == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())


def test_batches_and_refusals():
    """What the reference refuses a single call refuses in its words; in a batch that system alone is not-a-number."""
    arms, platform, grasps = hf.robots.stewart_platform()
    poles = {name: hf.Arm([arm.joints[2]], [arm.links[2]], base=arm.base) for name, arm in arms.items()}
    chain = ClosedChain(poles, platform, grasps)
    state = State(np.zeros(6), np.zeros(6), LEVEL.object_pose)
    fast = compile_law(holding_law(chain), chain)
    sideways = np.array([np.zeros(6), [0, 0, 0, 0, 0, 1.0]])
    with pytest.raises(StateError, match=r"expected one that the arms can follow.*arm 'leg1' misses"):
        fast.torques(0.0, *arrays(state), acceleration=sideways[1], internal_force=0.0)
    many = fast.torques(0.0, *arrays(state), acceleration=sideways, internal_force=0.0).tau
    assert np.array_equal(many[0], fast.torques(0.0, *arrays(state), acceleration=sideways[0], internal_force=0.0).tau)
    assert np.isnan(many[1]).all()


def test_a_load_that_nothing_bears():
    """A ball bears no moment: one arm with one holds no box aside of it."""
    chain, state = two_pandas("ball", "rigid")
    alone = chain.without_grasp("right")
    with pytest.raises(StateError, match="cannot bear this load"):
        holding_torques(alone, state)
    with pytest.raises(StateError, match="cannot bear this load"):
        compile_law(holding_law(alone), alone).torques(
            0.0, *arrays(state), acceleration=np.zeros(6), internal_force=0.0
        )


def test_in_a_run():
    """A law like any other: under its torques an object at rest stays."""
    chain, state = two_pandas()
    law = holding_law(chain)
    run = hf.simulate(chain, state, law, 0.02, 0.01, parameters={"acceleration": np.zeros(6), "internal_force": 20.0})
    assert np.abs(run.object_twist).max() < 1e-9


def test_refused():
    """Chains that no drives hold, and laws that compute no numbers."""
    chain, state = two_pandas()
    with pytest.raises(MethodNotApplicable, match="got a chain with no grasp"):
        holding_law(chain.without_grasp("left").without_grasp("right"))
    with pytest.raises(hf.ModelError, match="holding law: chain: expected ClosedChain"):
        holding_law(3)  # pyright: ignore[reportArgumentType]
    poor = compile_law(hf.ControlLaw(lambda t, x, m, given: (x.q / (t - t), m)), chain)
    with pytest.raises(StateError, match="compiled law: expected finite torques"):
        poor.torques(0.0, *arrays(state))
