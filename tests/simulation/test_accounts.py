"""What machine code says in a run's balances is what the reference says; the split of a chain is that of any state."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast import Inputs
from holdfast.forces.force_split import Splitter, split
from holdfast.simulation.accounts import CompiledAccounts, accounts_of
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import evaluate
from tests.simulation.problems import PROBLEMS
from tests.systems.bushed import random_bushed

MIXED = ("pandas", "rigid, hinge, ball", "Stewart platform", "parallelogram")
ROUNDING = 1e-12


def instant(name: str):
    """Return an instant of a chain in motion, under torques and a wrench on its object."""
    chain, state = PROBLEMS[name]()
    tau = np.linspace(-3.0, 5.0, chain.joint_count)
    environment = Environment(chain, {}, Inputs(object_wrench=np.arange(6.0) - 2.0))
    return evaluate(environment, lambda t, x, m: (tau, m), 0.3, state, None)


@pytest.mark.parametrize("name", MIXED)
def test_by_machine_code(name):
    """Energies, momentum, its rate, and what the wrists carry."""
    at = instant(name)
    assert CompiledAccounts.suit(at.chain, at.inputs)
    for mine, theirs in zip(CompiledAccounts(at.chain).of(at), accounts_of(at), strict=True):
        assert np.shape(mine) == np.shape(theirs)
        assert np.abs(mine - theirs).max() <= ROUNDING * max(1.0, np.abs(theirs).max())


def test_what_machine_code_leaves_to_the_reference():
    """Moving bases and wrenches on links, which it is not given; and joints turned further than it takes."""
    at = instant("pandas")
    moving = Inputs(base_twists=np.ones((2, 6)))
    assert not CompiledAccounts.suit(at.chain, moving)
    assert not CompiledAccounts.suit(at.chain, Inputs(link_wrenches=np.ones((14, 6))))
    far = evaluate(
        Environment(at.chain), lambda t, x, m: (at.tau, m), 0.0,
        at.state.__class__(at.state.q + 2e5 * np.pi, at.state.qd, at.state.object_pose), None,
    )  # fmt: skip
    for mine, theirs in zip(CompiledAccounts(at.chain).of(far), accounts_of(far), strict=True):
        assert np.array_equal(mine, theirs)


@pytest.mark.parametrize("name", [*MIXED, "soft finger, ball, hinge", "hinges", "bushing"])
def test_splitter(name):
    """The map found once, in object axes, splits wrenches anywhere as the smallest ones found there."""
    if name in PROBLEMS:
        chain, state = PROBLEMS[name]()
    else:
        chain, state = (p := random_bushed(1)).chain, p.state
    f = np.zeros((len(chain.arms), 6))
    for k, arm in enumerate(chain.grasps):
        f[chain.names.index(arm)] = np.sin(np.arange(6.0) + 7 * k)
    mine, theirs = Splitter(chain)(state, f), split(chain, state, f)
    assert mine.length == pytest.approx(theirs.length, rel=1e-14)
    for part in ("motion", "internal", "load_share"):
        np.testing.assert_allclose(getattr(mine, part), getattr(theirs, part), atol=ROUNDING)
