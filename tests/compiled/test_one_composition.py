"""Machine code is traced from the very functions that the reference runs."""

import ast
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import holdfast
from holdfast.compiled import traced_chain
from holdfast.compiled.derivative_computation import computation_of
from holdfast.compiled.forward_schedule import forward_schedule
from holdfast.compiled.structure import Options, Structure
from holdfast.control.controller import held_torques
from holdfast.dynamics.projection import STEP_ROUNDS
from holdfast.questions.question import QUESTIONS
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout import traced_step
from holdfast.simulation.rollout.step_code import carried_shapes, step_externals
from holdfast.simulation.runge_kutta import RK4
from holdfast.simulation.stepper import ReferenceStepper
from tests.dynamics.problems import random_problem

ROOT = Path(holdfast.__file__).parent
GRASPS = ("rigid", "hinge", None, "softfinger", "ball")

# What only one backend needs: questions whose answers are Python's truths.
ON_FLOATS = {"rank", "consistency", "indeterminate", "forward", "result", "methods", "impulse", "split"}


# What measures the gaps of grasps and closes them, in every step.
GAPS = {"largest_gaps", "position_mismatch", "small_displacement", "small_gap", "position_contact"}
ROUNDS = {"position_mismatch", "small_displacement", "small_gap", "closer", "constraint_impulses", "project_velocities"}


def functions_run(call, rooms, but=ON_FLOATS) -> dict:
    """Return how often each function of the given rooms ran during a call, by its code.

    Args:
        call: what is called.
        rooms: folders or files of the package.
        but: files whose functions are left out.
    """
    found: dict = {}

    def note(frame, event, _):
        if event == "call" and any(f"/holdfast/{room}" in frame.f_code.co_filename for room in rooms):
            found[frame.f_code] = found.get(frame.f_code, 0) + 1

    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(None)
    return {code: n for code, n in found.items() if Path(code.co_filename).stem not in but}


def names(codes) -> set:
    """Return functions as file and name, for messages."""
    return {f"{Path(code.co_filename).stem}.{code.co_qualname}" for code in codes}


@pytest.fixture(scope="module")
def problem():
    """Every grasp, an arm without one."""
    return random_problem(0, grasps=GRASPS, joints=(6, 5, 2, 4, 3), moving_base=False, extras=False)


@pytest.mark.slow
def test_forward_dynamics(problem):
    """All that the reference runs on floats is traced; of arms of one type only one is."""
    rooms = ("dynamics/arm", "dynamics/closed", "dynamics/tree")
    holdfast.forward_dynamics(problem.chain, problem.state, problem.tau)  # finds the plan, which is remembered
    on_floats = functions_run(lambda: holdfast.forward_dynamics(problem.chain, problem.state, problem.tau), rooms)
    traced = functions_run(lambda: forward_schedule(Structure(problem.chain, Options())), rooms)
    assert names(on_floats) <= names(traced)
    assert on_floats.keys() <= traced.keys()  # the same objects
    assert {"elimination", "leaves", "filter_updates", "sequential", "chain_solution"} <= {
        Path(code.co_filename).stem for code in traced
    }


@pytest.fixture(scope="module")
def stepping():
    """Every grasp, on arms that can move: where they are, the stepper, and what a traced step runs."""
    problem = random_problem(0, grasps=GRASPS[:4], joints=(6, 4, 2, 4), moving_base=False, extras=False)
    chain, structure = problem.chain, Structure(problem.chain, Options())
    stepper = ReferenceStepper(Environment(chain), lambda t, state, memory: (problem.tau, memory), 18, RK4)
    law = held_torques(chain.joint_count)
    step = partial(traced_step.step, traced_step.StepModel(structure, law, {}, None), RK4)
    arrays = step_externals(structure, law, carried_shapes(chain, law, structure.options))
    traced = functions_run(lambda: traced_chain.traced(arrays, step), ("",), ())
    now, _ = stepper.start(0.0, problem.state, None)
    return SimpleNamespace(chain=chain, state=problem.state, stepper=stepper, now=now, traced=traced)


@pytest.mark.slow
def test_a_step(stepping):
    """Stages, projection and its rounds, gaps, forward dynamics."""
    rooms = ("dynamics/arm", "dynamics/closed", "dynamics/projection", "simulation/runge_kutta", "simulation/step.py")
    on_floats = functions_run(lambda: stepping.stepper.advance(stepping.now, [1e-4]), rooms)
    times = ("step_generator", "<genexpr>", "back_on_constraint")  # when the stages are, and which gaps are refused
    of_both = {code for code in on_floats if code.co_name not in times}
    assert names(of_both) <= names(stepping.traced)
    assert of_both <= stepping.traced.keys()
    for name in ("closer", "largest_gaps", "sequential", "runge_kutta_step", "take_step"):
        counts = [sum(n for code, n in run.items() if code.co_name == name) for run in (on_floats, stepping.traced)]
        assert counts[0] == counts[1] > 0, name
        assert name != "closer" or counts[0] == STEP_ROUNDS


@pytest.mark.slow
def test_gaps_and_projection(stepping):
    """Steps, `project` and `closure` measure gaps and close them by the same objects; a step takes two rounds."""
    chain, state = stepping.chain, stepping.state
    loose = replace(state, q=state.q + 1e-4 * np.sin(np.arange(len(state.q))), qd=state.qd + 1e-4)
    calls = {
        "step": lambda: stepping.stepper.advance(stepping.now, [1e-4]),
        "start": lambda: stepping.stepper.start(0.0, loose, None),
        "project": lambda: holdfast.project(chain, loose),
        "closure": lambda: holdfast.dynamics.closure(chain, loose),
        "compiled project": lambda: computation_of(QUESTIONS["project"], None, chain, Options()).schedule(),
        "compiled closure": lambda: computation_of(QUESTIONS["closure"], None, chain, Options()).schedule(),
    }
    rooms = ("dynamics/projection.py", "dynamics/consistency.py", "dynamics/grasp_gap.py", "model/grasp_kinds")
    run = {name: functions_run(call, rooms, ()) for name, call in calls.items()} | {"compiled step": stepping.traced}

    def of(name, wanted):
        return {code for code in run[name] if code.co_name in wanted and any(x in code.co_filename for x in rooms)}

    for wanted, of_all in ((GAPS, ("start", "compiled step")), (ROUNDS, ("start", "project", "compiled project"))):
        reference = of("step", wanted)
        assert {code.co_name for code in reference} == wanted
        assert [name for name in of_all if of(name, wanted) != reference] == []
    of_closure = {"residuals_at", "position_residual", "gap", "tip_from_contact"}
    assert {code.co_name for code in of("closure", of_closure)} == of_closure
    assert of("compiled closure", of_closure) == of("closure", of_closure)
    assert of("step", {"tip_from_contact"}) == of("closure", {"tip_from_contact"})  # both measure the same pose
    (closer,) = of("step", {"closer"})
    rounds = {name: run[name][closer] for name in ("step", "start", "compiled step", "compiled project")}
    assert rounds == dict.fromkeys(rounds, STEP_ROUNDS)


@pytest.mark.parametrize("path", [*(ROOT / "compiled").glob("*.py"), *(ROOT / "simulation" / "rollout").glob("*.py")])
def test_nothing_is_computed_there(path):
    """No products of matrices and no sines: what machine code computes of a chain is written in another room."""
    allowed = {("traced_chain", "unit_pose"), ("traced_step", "grasp_margins")}
    for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(function, ast.FunctionDef) and (path.stem, function.name) not in allowed:
            products = [x for x in ast.walk(function) if isinstance(x, ast.BinOp) and isinstance(x.op, ast.MatMult)]
            assert not products, (path.name, function.name)
