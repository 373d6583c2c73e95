"""Runs of mechanisms whose grasp forces are not unique record the smallest ones, however their steps are taken."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.collocation import CollocationStepper
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import evaluate
from holdfast.simulation.rollout.compiled_steppers import StagewiseStepper
from holdfast.simulation.rollout.fused_stepper import FusedStepper
from holdfast.simulation.rollout.python_law_stepper import PythonLawStepper
from holdfast.simulation.runge_kutta import RK4
from holdfast.simulation.stepper import ReferenceStepper
from holdfast.spatial import scalar
from tests.longer import mostly_long
from tests.simulation.rollout.problems import arrays
from tests.simulation.test_overconstrained import FREE, free
from tests.systems.overconstrained import MECHANISMS

STEP, STEPS = 2e-3, 50
FORCES = ("grasp_wrench", "base_wrench", "trunk_base_wrench")


def by_rollout(chain: hf.ClosedChain, state: hf.State) -> hf.simulation.Trajectory:
    """Return one system of a rollout as a run."""
    rollout = hf.compile_rollout(chain, FREE)
    systems = rollout.start(**arrays(state))
    return rollout.run(systems, STEPS * STEP, STEP, every=5).trajectory(0)


def by(controller: Any, **options: Any) -> Callable[[hf.ClosedChain, hf.State], hf.simulation.Trajectory]:
    """Return what simulates a chain without torques."""
    return lambda chain, state: hf.simulate(chain, state, controller, STEPS * STEP, STEP, **options)


OTHERS = {"Python": by(free), "adaptive": by(FREE, scheme="dop853", rtol=1e-9), "rollout": by_rollout}


def swaying(t: Any) -> tuple[Any, Any, Any]:
    """Return the motion of bases that sway along x together."""
    along = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    pose = scalar.concatenate([[1.0, 0.0, 0.0, 0.0, 0.01 - 0.01 * scalar.cos(6.0 * t), 0.0, 0.0]])
    return pose, along * (0.06 * scalar.sin(6.0 * t)), along * (0.36 * scalar.cos(6.0 * t))


swaying.traceable = True  # type: ignore[attr-defined]


def require_smallest(run: hf.simulation.Trajectory, world: Environment) -> None:
    """Compare the forces of every sample with those of the reference at its state."""
    rank = hf.forward_dynamics(world.chain, run.state(0), run.tau[0]).rank
    assert rank < world.chain.constraint_row_count
    for k, t in enumerate(run.t.tolist()):
        now = evaluate(world, lambda *_, k=k: (run.tau[k], None), t, run.state(k), None, generic_rank=rank).result
        size = max(1.0, np.abs(now.base_wrench).max(), np.abs(now.qdd).max())
        for name in ("qdd", *FORCES):
            expected, found = getattr(now, name), getattr(run, name)[k]
            assert not found.size if expected is None else np.abs(found - expected).max() < 1e-12 * size, (name, k)


TELLING = ["threads by hand", "on a trunk", "floating"]
FURTHER = sorted(MECHANISMS.keys() - set(TELLING))


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_long(MECHANISMS, ["threads by hand", "on a trunk", "soft fingers"]))
def test_whole_steps(name):
    """Of steps of machine code, most of which are taken together."""
    chain, state = MECHANISMS[name]()
    require_smallest(by(FREE)(chain, state), Environment(chain))


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_long(MECHANISMS, ["springs"]))
@pytest.mark.parametrize("kind", OTHERS)
def test_other_steps(name, kind):
    """Of steps with a controller in Python, of adaptive steps, and of a rollout's system as a run."""
    chain, state = MECHANISMS[name]()
    require_smallest(OTHERS[kind](chain, state), Environment(chain))


@pytest.mark.slow
def test_moving_bases():
    """Places of bases that move are those at the time of each sample."""
    chain, state = MECHANISMS["Bricard"]()
    still = hf.State(state.q, 0.0 * state.qd, state.object_pose, 0.0 * state.object_twist)
    moving = dict.fromkeys(chain.arms, swaying)
    require_smallest(by(FREE, base_motion=moving)(chain, still), Environment(chain, moving))


@pytest.mark.slow
@pytest.mark.parametrize("name", [*mostly_long(TELLING, TELLING[:1]), *mostly_long(FURTHER, [])])
def test_steppers_agree(name):
    """Rows of the constraint and steps of collocation, by the reference and by machine code of every kind."""
    chain, state = MECHANISMS[name]()
    world, rank = Environment(chain), hf.forward_dynamics(chain, state, np.zeros(chain.joint_count)).rank
    steppers = [
        ReferenceStepper(world, free, rank),
        StagewiseStepper(world, free, rank, RK4, Tolerance()),
        FusedStepper.of(world, FREE, RK4, rank),
        PythonLawStepper.of_controller(world, free, RK4, rank),
    ]
    first, *rows = [stepper.constraint([0.0, 0.0], [state, state]) for stepper in steppers]
    assert first.shape == (
        2,
        rank - chain.contact_freedom_count + chain.constraint_row_count - rank,
        chain.velocity_count,
    )
    assert all(np.abs(x - first).max() < 1e-14 for x in rows)
    ends = []
    for stepper in steppers:
        now = stepper.start(0.0, state, None)[0]
        (reached,) = CollocationStepper(stepper).advance(now, [0.02])
        assert reached.instant is not None and reached.gaps.position[1] < 1e-13
        ends.append(reached.instant.velocities)
    assert all(np.abs(x - ends[0]).max() < 1e-12 * max(1.0, np.abs(ends[0]).max()) for x in ends[1:])
