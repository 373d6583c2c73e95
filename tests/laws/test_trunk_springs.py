"""Springs between bodies where arms stand on a trunk: balances, momentum, and one chain written in two ways."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.simulation.stepper import ReferenceStepper
from tests.longer import mostly_long
from tests.systems.problems import relative_gap
from tests.systems.trunk_runs import one_long_arm, still_base


def sprung(p, floating):
    """Return a problem with springs between all sorts of bodies."""
    on, off = next(iter(p.chain.mounts)), p.chain.names[-1]
    first = "base" if floating else 0
    springs = [
        hf.Spring(("trunk", first, [0.1, 0.0, 0.2]), (off, 2, [0.0, 0.1, 0.0]), 300.0, 0.2, 5.0),
        hf.Spring(("trunk", 1, [0.0, 0.2, 0.0]), ("object", [0.0, 0.05, 0.0]), 200.0, 0.1, 3.0),
        hf.Spring((on, 0, [0.0, 0.0, 0.1]), (off, 1, [0.1, 0.0, 0.0]), 150.0, 0.3),
    ]
    if not floating:
        springs.append(hf.Spring(("world", [0.5, 0.5, 0.5]), ("trunk", 1, [0.0, 0.0, 0.1]), 100.0, 0.0, 1.0))
    return replace(p, chain=replace(p.chain, springs=springs))


def held(tau):
    """Return a controller of constant torques."""
    return lambda t, state, memory: (tau, memory)


@pytest.mark.slow
@pytest.mark.parametrize("floating", mostly_long([False, True], [True]))
def test_methods_agree(floating):
    """The filter, the dense equations and machine code; springs are external wrenches to all of them."""
    p = sprung(still_base(3, 2, floating=floating), floating)
    expected = p.solved(method="kkt")
    found = p.solved()
    plain = replace(p, chain=replace(p.chain, springs=())).solved()
    assert relative_gap(found.qdd, plain.qdd) > 1e-3
    assert relative_gap(found.qdd, expected.qdd) < 1e-10
    assert relative_gap(found.grasp_wrench, expected.grasp_wrench) < 1e-9
    s, base = p.state, {}
    if floating:
        base = {"floating_pose": s.base_pose, "floating_twist": s.base_twist}
    compiled = hf.compile(p.chain).forward_dynamics(
        s.q, s.qd, p.tau, s.object_pose, s.object_twist, object_wrench=p.inputs.object_wrench, **base
    )
    assert relative_gap(compiled.qdd, found.qdd) < 1e-10
    tau = hf.inverse_dynamics(p.chain, s, found.qdd, found.grasp_wrench, p.inputs, found.base_acceleration)
    assert relative_gap(tau, p.tau, np.abs(found.grasp_wrench).max()) < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("floating", mostly_long((False, True), (False,)))
def test_balances(floating):
    """Energy with what springs store and lose, momentum with what those to the world pull; free flight keeps it."""
    arms = {"arms": 3, "joints": 7, "grasps": "rigid", "gravity": (0.0, 0.0, 0.0)}
    p = sprung(still_base(3, 2, floating=floating, arms=arms, in_world=0.0), floating)
    p = replace(p, inputs=hf.Inputs())
    run = hf.simulate(p.chain, p.state, held(p.tau), 0.04, 1e-3, scheme="dop853", rtol=1e-12, atol=1e-13)
    assert run.stopped is None
    assert np.abs(run.imbalance).max() < 1e-9 * run.kinetic.max()
    assert np.abs(run.momentum_imbalance).max() < 1e-6 * np.abs(run.momentum).max()
    assert np.ptp(run.potential) > 1e-3
    if floating:
        assert np.abs(run.momentum - run.momentum[0]).max() < 1e-11 * np.abs(run.momentum).max()


@pytest.mark.slow
def test_one_chain_in_two_ways():
    """Springs on an arm's links and on those of a trunk that are the same bodies."""
    alone, on_trunk = one_long_arm(5, 3)
    other, name = alone.chain.names[:2]
    point = [0.05, 0.1, 0.0]
    pairs = [((name, 1, point), ("trunk", 1, point)), ((name, 4, point), (name, 1, point))]
    springs = [
        [hf.Spring(ends[which], (other, 2, [0.0, 0.0, 0.1]), 400.0, 0.1, 4.0) for ends in pairs] for which in (0, 1)
    ]
    runs = [
        hf.simulate(replace(p.chain, springs=some), p.state, held(p.tau), 0.02, 2e-3, make_stepper=ReferenceStepper)
        for p, some in zip((alone, on_trunk), springs, strict=True)
    ]
    for array in ("kinetic", "potential", "work", "momentum"):
        first, second = (getattr(run, array) for run in runs)
        assert second == pytest.approx(first, rel=1e-9, abs=1e-9 * np.abs(first).max()), array
    assert relative_gap(runs[1].grasp_wrench, runs[0].grasp_wrench) < 1e-8


def test_no_such_body():
    """A link of the trunk that is not there is named."""
    p = still_base(2, 3, floating=False)
    with pytest.raises(
        hf.errors.ModelError, match=r"spring: point on 'trunk': expected a link of the trunk, by its name"
    ):
        replace(p.chain, springs=[hf.Spring(("trunk", 7, [0, 0, 0]), ("world", [0, 0, 0]), 1.0)])
