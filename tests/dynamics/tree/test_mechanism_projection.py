"""Residuals, projections and margins of chains with branches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ClosureError
from tests.control.two_pandas import two_pandas
from tests.dynamics.tree.as_branched import AWAY, STRAY, gap
from tests.longer import mostly_slow
from tests.systems.branched import branched_problems, palletiser


@pytest.mark.parametrize("name", mostly_slow(branched_problems(), ("palletiser", "grippers")))
def test_projection_closes(name):
    """A state beside the closures returns to them; what is closed stays, and residuals are those of every closure."""
    chain, state, _ = branched_problems()[name]
    random = np.random.default_rng(3)
    off = replace(state, qd=state.qd + random.normal(size=len(state.qd), scale=1e-3))
    if chain.position_count == chain.joint_count:
        off = replace(off, q=state.q + random.normal(size=len(state.q), scale=1e-3))
    opened, closed = hf.dynamics.closure(chain, off), hf.dynamics.closure(chain, hf.project(chain, off)[0])
    assert [*opened] == [*closed] == [*chain.as_forest.closures]
    assert max(np.abs(np.append(*one)).max() for one in opened.values()) > 1e-4
    assert max(np.abs(np.append(*one)).max() for one in closed.values()) < 1e-12
    kept = hf.project(chain, state)[0]
    assert gap(kept.q, state.q) < 1e-12 and gap(kept.qd, state.qd) < 1e-11


def test_far_states_are_refused():
    """What no step leaves is refused, and names `close`."""
    chain, state, _ = palletiser()
    with pytest.raises(ClosureError, match=r"open by 0\.[0-9]* .*try holdfast\.close"):
        hf.project(chain, replace(state, q=state.q + np.array([0.0, 0.4, 0.0, 0.0])))


def test_as_of_a_serial_chain():
    """Beside an object that falls, two arms have the residuals and margins of their own chain."""
    chain, state = two_pandas("softfinger", "ball")
    contacts = {"left": hf.Friction(0.8, torsion_radius=0.02), "right": hf.Friction(0.8)}
    grasps = {name: replace(one, contact=contacts[name]) for name, one in chain.grasps.items()}
    chain = replace(chain, grasps=grasps)
    off = replace(state, q=state.q + 1e-3, qd=state.qd + 1e-2)
    beside = replace(chain, objects={"stray": STRAY})
    apart = replace(off, object_pose=[off.object_pose, AWAY], object_twist=np.zeros((2, 6)))
    found, wanted = hf.dynamics.closure(beside, apart), hf.dynamics.closure(chain, off)
    for name in ("left", "right"):
        assert gap(np.append(*found[name]), np.append(*wanted[name])) < 1e-14
    f = np.random.default_rng(1).normal(size=(2, 6), scale=20.0)
    assert gap(hf.forces.grasp_margins(beside, apart, f), hf.forces.grasp_margins(chain, off, f)) < 1e-12
    tau = np.linspace(-3.0, 3.0, 14)
    for mine, theirs in zip(
        hf.forces.joint_margins(beside, apart, tau), hf.forces.joint_margins(chain, off, tau), strict=True
    ):
        assert mine.tolist() == theirs.tolist()
