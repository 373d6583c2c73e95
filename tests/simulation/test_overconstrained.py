"""Chains whose constraint has rows that follow from others everywhere: a step holds the same ones throughout."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import motion_basis
from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.dynamics.rank import closed_near, constraint_pivots
from holdfast.simulation.stepper import ReferenceStepper
from tests.longer import mostly_long
from tests.oracles.planar_mechanism import random_mechanism
from tests.simulation.rollout.problems import arrays, tiled
from tests.systems.bricard import bars, bricard, line_symmetric

FREE = hf.ControlLaw(lambda t, state, memory, given: (0.0 * state.qd, memory), key="tests: no torques")
MODELS = [(0.0, 0.0), (0.3, 1.1), (0.7, -0.4), (1.5, 0.0), (-2.0, 0.9)]


def free(t, state, memory):
    """No torques, by a controller that is asked from Python."""
    return 0.0 * state.qd, memory


@cache
def moved(turns=MODELS[1], duration=0.5):
    """Return Bricard's mechanism, and a state of it in motion."""
    chain, state = bricard(turns)
    return chain, hf.simulate(chain, state, free, duration, 1e-2).state(-1)


def beside(state, gap):
    """Return the state with one joint off its place."""
    return replace(state, q=state.q + np.array([gap, 0, 0, 0]))


def energy_error(run) -> float:
    """Return the largest error of the energy, relative to the largest kinetic energy."""
    energy = run.kinetic + run.potential
    return float(np.abs(energy - energy[0]).max() / run.kinetic.max())


@pytest.fixture(scope="module")
def converged():
    """Bricard's mechanism after 1 s."""
    chain, state = bricard()
    return hf.simulate(chain, state, free, 1.0, 2e-2, scheme="dop853", rtol=1e-12)


@pytest.mark.slow
def test_printed_figure(converged):
    """Exudyn's sum, of a second-order method in 1 ms steps; two of it are the freedom and the redundant row."""
    chain, _ = bricard()
    shifted = bars(chain, converged.state(-1)) - bars(chain, converged.state(0))
    turned = []
    for bar in bars(chain, converged.state(-1)):
        w = 0.5 * np.sqrt(1.0 + np.trace(bar[:, :3]))
        axial = [bar[2, 1] - bar[1, 2], bar[0, 2] - bar[2, 0], bar[1, 0] - bar[0, 1]]
        turned.append([w - 1.0, *(np.array(axial) / (4 * w))])
    size = np.sqrt(np.sum(shifted[:, :, 3] ** 2) + np.sum(np.square(turned)))
    assert size + 2 == pytest.approx(4.172189649307425, abs=5e-6)
    assert energy_error(converged) < 1e-13
    assert converged.position_gap.max() < 1e-9 and converged.condition.max() < 100


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turns", "controller"),
    [(MODELS[0], FREE), (MODELS[1], free), pytest.param(MODELS[2], free, marks=pytest.mark.long)],
)
def test_order(converged, turns, controller):
    """Fourth order, however the contact frames are turned about the hinges; within 1e-5 in 2 ms steps by far."""
    chain, state = bricard(turns)
    errors, there = [], int(np.argmin(np.abs(converged.t - 0.6)))
    for step in (2e-2, 1e-2):
        run = hf.simulate(chain, state, controller, 0.6, step)
        assert run.stopped is None
        errors.append(np.abs(run.q[-1] - converged.q[there]).max())
    assert np.log2(errors[0] / errors[1]) > 3.8
    assert errors[1] * (2e-3 / 1e-2) ** 4 < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("seed", mostly_long([1, 3], [3]))
def test_line_symmetric_loops(seed):
    """With a freedom left, energy and closure determine the motion; half the step has a sixteenth of the error."""
    chain, state = line_symmetric(seed)
    runs = [hf.simulate(chain, state, free, 0.24, step) for step in (8e-3, 4e-3)]
    errors = [energy_error(run) for run in runs]
    assert errors[1] < 1e-9 and errors[0] / errors[1] > 2**3.8
    for run in runs:
        assert max(np.abs(gap.position).max() for gap in hf.dynamics.closure(chain, run.state(-1)).values()) < 1e-14


@pytest.mark.slow
@pytest.mark.parametrize("seed", mostly_long([3, 20], [3]))
def test_planar_mechanisms_in_space(seed):
    """As in the complex plane, where the constraint has no row too many."""
    mechanism = random_mechanism(seed)
    chain, state = mechanism.chain()
    run = hf.simulate(chain, state, free, 0.1, 2.5e-3)
    x, u = mechanism.after(0.1)
    assert hf.forward_dynamics(chain, state, np.zeros(chain.joint_count)).rank < chain.constraint_row_count
    assert np.abs(run.q[-1] - x[:-3]).max() < 1e-9
    assert np.abs(run.qd[-1] - u[:-3]).max() < 1e-8


@pytest.mark.slow
def test_soft_fingers():
    """Their spin rows follow from the others too, but hold no position: other rows are held in position."""
    mechanism = random_mechanism(0, ["softfinger"])
    chain, state = mechanism.chain()
    run = hf.simulate(chain, state, free, 0.1, 2.5e-3)
    assert run.stopped is None
    assert np.abs(run.q[-1] - mechanism.after(0.1)[0][:-3]).max() < 1e-8
    rollout = hf.compile_rollout(chain, FREE)
    systems = rollout.start(**arrays(state))
    rollout.step(systems, 2.5e-3, steps=40)
    assert np.abs(systems.q[0] - run.q[-1]).max() < 1e-11


@pytest.mark.slow
def test_all_steppers_and_rollouts_agree():
    """The reference, machine code stage by stage, whole steps of it, and rollouts, which choose rows themselves."""
    chain, state = bricard(MODELS[1])
    runs = [
        hf.simulate(chain, state, free, 0.2, 1e-2, make_stepper=ReferenceStepper),
        hf.simulate(chain, state, free, 0.2, 1e-2),
        hf.simulate(chain, state, FREE, 0.2, 1e-2),
    ]
    rollout = hf.compile_rollout(chain, FREE)
    systems = rollout.start(**tiled(state, 3))
    rollout.step(systems, 1e-2, steps=20)
    assert rollout.generic_rank == 11
    for run in runs[1:]:
        assert np.abs(run.q - runs[0].q).max() < 1e-13 and np.abs(run.qd - runs[0].qd).max() < 1e-12
        assert np.abs(run.grasp_wrench - runs[0].grasp_wrench).max() < 1e-10
    assert np.abs(systems.q - runs[0].q[-1]).max() < 1e-13 and np.abs(systems.qd - runs[0].qd[-1]).max() < 1e-12


@pytest.mark.slow
def test_rank_is_that_of_the_closed_state():
    """However the state is displaced before it is projected back; a run that starts beside the grasps knows it too."""
    chain, there = moved()
    random = np.random.default_rng(0)
    for size in (1e-6, 1e-5, 1e-4):
        off = replace(there, q=there.q + size * random.normal(size=4))
        closed = closed_near(chain, off)
        assert closed is not None and constraint_pivots(chain, closed).rank == 11
        projected, _ = hf.project(chain, off)
        assert constraint_pivots(chain, projected).rank == 11
    rollout = hf.compile_rollout(chain, FREE)
    rollout.start(**arrays(off))
    assert rollout.generic_rank == 11


@pytest.mark.slow
def test_a_single_call_beside_the_constraint():
    """Where the rank is another on it, the message gives both and the gap; with the rank known the answer is near."""
    chain, there = moved(duration=0.6)
    off = beside(there, 1e-4)
    expected = r"open by 7\.58e-05 .*: 12 of 12 here, 11 where they are closed.*generic_rank=11"
    with pytest.raises(hf.errors.StateError, match=expected):
        hf.forward_dynamics(chain, off, np.zeros(4), check=False)
    near = hf.forward_dynamics(chain, off, np.zeros(4), check=False, generic_rank=11)
    exact = hf.forward_dynamics(chain, there, np.zeros(4))
    assert near.rank == exact.rank == 11
    assert np.abs(near.qdd - exact.qdd).max() < 1e-2


@pytest.mark.slow
def test_machine_code_beside_the_constraint():
    """Single calls raise the same, systems of a batch are INVALID, whichever comes first: never a silent answer."""
    chain, there = moved(duration=0.6)
    given, off = arrays(there) | {"tau": np.zeros(4)}, beside(there, 1e-4).q
    exact = hf.forward_dynamics(chain, there, np.zeros(4))
    for known in (None, 11):
        fast = hf.compile(chain, generic_rank=known)
        with pytest.raises(hf.errors.StateError, match="12 of 12 here, 11 where they are closed"):
            fast.forward_dynamics(**given | {"q": off})
        assert fast.generic_rank == 11
        many = hf.compile(chain, generic_rank=known).forward_dynamics(**given | {"q": [off, there.q]})
        assert [status.name for status in many.status] == ["INVALID", "INDETERMINATE_FORCES"]
        assert np.isnan(many.qdd[0]).all() and np.abs(many.qdd[1] - exact.qdd).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("gap", mostly_long([0.0, 1e-12, 1e-10, 1e-8, 1e-7], [1e-12, 1e-7]))
def test_velocities_beside_the_constraint(gap):
    """Positions that are a little off stop no motion: the dependent row is left out, as where the grasps are closed."""
    chain, there = moved()
    (way,) = motion_basis(chain, there).T
    random = np.random.default_rng(1)
    given = np.concatenate([random.normal(size=4), random.normal(size=6)])
    off = hf.State(there.q + gap * random.normal(size=4), given[:4], there.object_pose, given[4:])
    found = hf.dynamics.project_velocity(chain, off)
    velocities = np.concatenate([found.qd, found.object_twist])
    sizes = coordinate_sizes(chain_at_rest(chain, there))
    expected = way * ((way / sizes) @ (given / sizes)) / ((way / sizes) @ (way / sizes))
    assert np.abs(velocities - expected).max() < 1e-12 + 100 * gap


@pytest.mark.slow
@pytest.mark.parametrize("gap", mostly_long([0.0, 1e-9, 3e-7], [3e-7]))
def test_an_arm_that_grips_beside_its_grasp(gap):
    """Bricard's loop closes with a row too many: the impulse leaves the motion that the loop allows."""
    chain, there = moved(MODELS[2])
    (way,) = motion_basis(chain, there).T
    random = np.random.default_rng(2)
    left = chain.joints["left"]
    q, qd = there.q.copy(), there.qd.copy()
    q[left] += gap * random.normal(size=2)
    qd[left] += random.normal(size=2)
    loose, grasp = chain.without_grasp("left"), chain.grasps["left"]
    grip = hf.dynamics.attach(loose, replace(there, q=q, qd=qd), "left", grasp)
    velocities = np.concatenate([grip.state.qd, grip.state.object_twist])
    assert np.abs(velocities - way * (way @ velocities)).max() < 1e-10 + 100 * gap
    assert np.abs(velocities).max() > 0.1 and grip.energy_change < 0.0
    assert grip.status.name == "INDETERMINATE_FORCES"
