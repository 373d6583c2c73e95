"""A real function: two seven-joint arms hold a box, `sequential` with q, qd, tau, object pose and twist as inputs."""

import numpy as np
import pytest

from holdfast import ClosedChain, Grasp, HeldObject, Inputs, Pose, State
from holdfast.compiler.interpret import interpret
from holdfast.compiler.program import Program
from holdfast.compiler.trace import trace
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.sequential import sequential
from holdfast.robots import ROBOTS
from tests.compiler.programs import ArrayKernel, all_same_bits, compile_program

ARMS = {"left": ROBOTS["panda"](), "right": ROBOTS["panda"]().at(Pose.translation(1.0, 0.0, 0.0))}
SIDES = {"left": -0.2, "right": 0.2}


def chain(kind: str) -> ClosedChain:
    """Return two arms and a box, both grasps of one kind."""
    grasps = {name: Grasp(kind, Pose.translation(x, 0.0, 0.0)) for name, x in SIDES.items()}
    return ClosedChain(ARMS, HeldObject.box(3.0, 0.4, 0.3, 0.2), grasps)


def function(kind: str):
    """Return the algorithm as a function of arrays."""
    held = chain(kind)

    def accelerations(q, qd, tau, pose, twist):
        motion = chain_motion(held, State(q, qd, pose, twist), tau, Inputs().shaped(held))
        found = sequential(motion)
        assert found.base_wrenches is not None
        joined = [np.concatenate(x) for x in (found.qdd, found.wrenches, found.base_wrenches)]
        return (*joined, found.object_acceleration, found.rank, found.weakest_pivot)

    return accelerations


def states(batch: int) -> tuple[np.ndarray, ...]:
    """Return random q, qd, tau, pose, twist."""
    random = np.random.default_rng(6)
    q, qd, tau = (random.uniform(-1, 1, (batch, 14)) for _ in range(3))
    quaternions = random.normal(size=(batch, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1)[:, None]
    return q, qd, tau, np.hstack([quaternions, random.normal(size=(batch, 3))]), random.normal(size=(batch, 6))


SHAPES = [(14,), (14,), (14,), (7,), (6,)]


@pytest.fixture(scope="module", params=["rigid", "ball"])
def traced(request) -> tuple[str, Program, ArrayKernel]:
    """Grasp kind, program and kernel."""
    program = trace(function(request.param), SHAPES)
    return request.param, program, compile_program(program)


def test_against_floats(traced):
    """The same function on floats agrees to 1e-11 of each result's size."""
    kind, _, kernel = traced
    batch = states(11)
    results = kernel(*batch)
    for i in range(11):
        for found, expected in zip(results, function(kind)(*(x[i] for x in batch)), strict=True):
            assert np.abs(found[i] - expected).max() <= 1e-11 * max(1.0, np.abs(expected).max())


def test_same_bits(traced):
    """Interpreter = single = lanes = tails = threads."""
    _, program, kernel = traced
    batch = states(2 * kernel.lanes + 3)
    singles = [kernel(*(x[i] for x in batch)) for i in range(len(batch[0]))]
    for i in (0, 1):
        assert all_same_bits(singles[i], interpret(program, *(x[i] for x in batch)))
    stacked = tuple(np.stack(results) for results in zip(*singles, strict=True))
    for threads in (1, 2):
        assert all_same_bits(kernel(*batch, threads=threads), stacked)
