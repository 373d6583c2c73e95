"""Diagnosis of chains with branches, in words of the chain."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import StateError
from tests.dynamics.tree.as_branched import serial_problems, with_stray
from tests.systems.branched import branched_problems, palletiser


@pytest.mark.parametrize("name", branched_problems())
def test_rank(name):
    """Rank and mobility are those of forward dynamics, and the parts have all closures and couplings."""
    p = branched_problems()[name]
    found, wanted = hf.diagnose(p.chain, p.state), hf.forward_dynamics(*p)
    assert (found.rank, found.mobility) == (wanted.rank, wanted.mobility)
    assert sorted(i for part in found.parts for i in part.closures) == [*range(len(p.chain.as_forest.closures))]
    assert sorted(i for part in found.parts for i in part.couplings) == [*range(len(p.chain.all_couplings))]


@pytest.mark.parametrize("name", ["moving bases", "an arm that holds nothing"])
def test_as_serial_chains(name):
    """An object that nothing holds adds six motions to those of the serial chain."""
    p = serial_problems()[name]
    chain, state, _, _ = with_stray(p)
    found, wanted = hf.diagnose(chain, state), hf.diagnose(p.chain, p.state)
    assert found.mobility == wanted.mobility + 6
    assert found.status == wanted.status
    assert found.rows - found.rank == wanted.rows - wanted.rank


def test_a_flat_parallelogram():
    """Flat, it has a motion more than nearby, and the loop and its bodies are named."""
    chain, state, _ = palletiser()
    found = hf.diagnose(chain, state)
    assert found.status == "indeterminate"
    assert "loop 'robot/level' (robot/upper, robot/hand, robot/rod): 1 force" in str(found)
    flat = np.array([0.4, 0.0, 0.0, 0.0])
    flat[1:] = [np.pi / 2, -np.pi / 2, np.pi / 2]  # the rod on the line of the upper arm
    found = hf.diagnose(chain, hf.State(flat, np.zeros(4)))
    assert found.status == "singular"
    assert found.generic_rank == found.rank + 1
    assert "1 motion more than nearby" in found.report()


def test_names():
    """Grasps, couplings and links are named, also where several arms have links of one name."""
    p = branched_problems()["grippers"]
    names = " ".join(part.name for part in hf.diagnose(p.chain, p.state).parts)
    for known in ("grasp 'arm1/pad1'", "coupling of 'arm2/finger1' and 'arm2/finger2'", "arm1/link6", "object"):
        assert known in names
    with pytest.raises(StateError, match="grasp"):
        hf.diagnose(p.chain, hf.State(p.state.q + 0.1, p.state.qd, p.state.object_pose))
