"""Chains by the elimination of their forests: the same as by the filter across their arms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import Status
from holdfast.errors import MethodNotApplicable
from tests.systems.anchored import pinned, pinned_to_trunk
from tests.systems.as_chain import Problem
from tests.systems.bushed import random_bushed
from tests.systems.problems import random_problem
from tests.systems.random_trunks import random_trunk_system
from tests.systems.trunk_problems import random_on_trunk

DATA = Path(__file__).parents[2] / "data"
STORED = [case for name in ("cases.json", "cases_trunk.json") for case in hf.io.load_cases(DATA / name)]


def gap(found, wanted) -> float:
    """Return max|x - e| / max(1, max|e|)."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    return float(np.abs(found - wanted).max(initial=0.0)) / max(1.0, float(np.abs(wanted).max(initial=0.0)))


def differences(p, **options) -> dict[str, float]:
    """Return by field the gap between the results of both methods."""
    given = {"inputs": p.inputs, **options}
    by = {"sequential": hf.forward_dynamics(p.chain, p.state, p.tau, **given)}
    known = by["sequential"].rank  # it was accepted, and finding the generic one again would take most of the time
    by["tree"] = hf.forward_dynamics(p.chain, p.state, p.tau, method="tree", generic_rank=known, **given)
    fields = ["qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench"]
    if p.chain.trunk is not None:
        fields += ["trunk_base_wrench", *(["base_acceleration"] if p.chain.floats else [])]
    return {name: gap(getattr(by["tree"], name), getattr(by["sequential"], name)) for name in fields}


@pytest.mark.parametrize("case", STORED, ids=lambda case: case.name)
def test_stored_chains(case):
    """All stored chains, arms in the world, on trunks and on floating bases, to 1e-12."""
    assert max(differences(case).values()) <= 1e-12


def chains() -> dict[str, Problem]:
    """Return chains with what the stored ones lack, by name."""
    return {
        "moving bases": random_problem(11, arms=3, moving_base=True),
        "an arm that holds nothing": random_problem(5, arms=3, grasps=("rigid", None, "hinge")),
        "anchors": pinned(random_problem(7, arms=2), ("ball", "hinge")),
        "an anchor on a trunk": pinned_to_trunk(random_on_trunk(2, 3), "ball"),
        "bushings": random_bushed(1),
        "a floating base": random_on_trunk(4, 2, floating=True),
        "a trunk": random_on_trunk(6, 5),
    }


@pytest.mark.parametrize("name", chains())
def test_every_feature(name):
    """Moving bases, lone arms, anchors, bushings, springs and trunks: known wrenches act on the forest as they do."""
    assert max(differences(chains()[name], check=False).values()) <= 1e-10


@pytest.mark.parametrize("seed", [0, 1, 3, 5, 6, 8, 10, 11, 12, 13])
def test_every_kind_of_grasp(seed):
    """Random chains on trunks and floating bases with all kinds of grasps, most of them on bases that move."""
    assert max(differences(random_trunk_system(seed), check=False).values()) <= 1e-10


def test_rows_to_hold():
    """Given rows to hold are refused by name: the elimination chooses its rows by their pivots."""
    case = next(case for case in STORED if "2joint_rigid" in case.name)
    first = hf.forward_dynamics(case.chain, case.state, case.tau, inputs=case.inputs, check=False)
    assert first.status is Status.INDETERMINATE_FORCES
    again = hf.forward_dynamics(case.chain, case.state, case.tau, inputs=case.inputs, generic_rank=first.rank)
    with pytest.raises(MethodNotApplicable, match="tree: chooses the rows that it imposes by their pivots"):
        hf.forward_dynamics(case.chain, case.state, case.tau, inputs=case.inputs, held=again.held, method="tree")
