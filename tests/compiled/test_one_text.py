"""Machine code is traced from the very functions that the reference runs."""

import ast
import sys
from pathlib import Path

import pytest

import holdfast
from holdfast.compiled.forward_schedule import forward_schedule
from holdfast.compiled.structure import Options, Structure
from holdfast.control.controller import held_torques
from holdfast.dynamics.projection import STEP_ROUNDS
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout.kernel import step_schedule
from holdfast.simulation.runge_kutta import RK4
from holdfast.simulation.stepper import ReferenceStepper
from tests.dynamics.problems import random_problem

ROOT = Path(holdfast.__file__).parent
GRASPS = ("rigid", "hinge", None, "softfinger", "ball")

# What only one backend needs: questions whose answers are Python's truths.
ON_FLOATS = {"rank", "consistency", "indeterminate", "forward", "result", "methods", "impulse", "split"}


def functions_run(call, rooms) -> dict:
    """Return how often each function of the given rooms ran during a call, by its code."""
    found: dict = {}

    def note(frame, event, _):
        if event == "call" and any(f"/holdfast/{room}" in frame.f_code.co_filename for room in rooms):
            found[frame.f_code] = found.get(frame.f_code, 0) + 1

    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(None)
    return {code: n for code, n in found.items() if Path(code.co_filename).stem not in ON_FLOATS}


def names(codes) -> set:
    """Return functions as file and name, for messages."""
    return {f"{Path(code.co_filename).stem}.{code.co_qualname}" for code in codes}


@pytest.fixture(scope="module")
def problem():
    """Every grasp, an arm without one."""
    return random_problem(0, grasps=GRASPS, joints=(6, 5, 2, 4, 3), moving_base=False, extras=False)


def test_forward_dynamics(problem):
    """All that the reference runs on floats is traced; of arms of one type only one is."""
    rooms = ("dynamics/arm", "dynamics/closed")
    on_floats = functions_run(lambda: holdfast.forward_dynamics(problem.chain, problem.state, problem.tau), rooms)
    traced = functions_run(lambda: forward_schedule(Structure(problem.chain, Options())), rooms)
    assert names(on_floats) <= names(traced)
    assert on_floats.keys() <= traced.keys()  # the same objects
    assert {"object_filter", "rigid_update", "row_updates", "sequential", "chain_solution"} <= {
        Path(code.co_filename).stem for code in traced
    }


@pytest.mark.slow
def test_a_step():
    """Stages, projection and its rounds, gaps, forward dynamics."""
    problem = random_problem(0, grasps=GRASPS[:4], joints=(6, 4, 2, 4), moving_base=False, extras=False)
    chain = problem.chain
    world, tau = Environment(chain), problem.tau
    stepper = ReferenceStepper(world, lambda t, state, memory: (tau, memory), 18, RK4, Tolerance(1e-6, 1e-9))
    now, _ = stepper.start(0.0, problem.state, None)
    rooms = ("dynamics/arm", "dynamics/closed", "dynamics/projection", "simulation/runge_kutta", "simulation/step.py")
    on_floats = functions_run(lambda: stepper.advance(now, [1e-4]), rooms)
    law = held_torques(chain.joint_count)
    traced = functions_run(lambda: step_schedule(Structure(chain, Options()), law, {}, None, RK4), rooms)
    times = ("step_generator", "<genexpr>", "back_on_constraint")  # when the stages are, and which gaps are refused
    of_both = {code for code in on_floats if code.co_name not in times}
    assert names(of_both) <= names(traced)
    assert of_both <= traced.keys()
    for name in ("closer", "largest_gaps", "sequential", "runge_kutta_step", "take_step"):
        counts = [sum(n for code, n in found.items() if code.co_name == name) for found in (on_floats, traced)]
        assert counts[0] == counts[1] > 0, name
        assert name != "closer" or counts[0] == STEP_ROUNDS


@pytest.mark.parametrize("path", [*(ROOT / "compiled").glob("*.py"), *(ROOT / "simulation" / "rollout").glob("*.py")])
def test_nothing_is_computed_there(path):
    """No products of matrices and no sines: what machine code computes of a chain is a text of another room."""
    allowed = {("traced_chain", "unit_pose"), ("traced_step", "grasp_margins")}
    for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(function, ast.FunctionDef) and (path.stem, function.name) not in allowed:
            products = [x for x in ast.walk(function) if isinstance(x, ast.BinOp) and isinstance(x.op, ast.MatMult)]
            assert not products, (path.name, function.name)
