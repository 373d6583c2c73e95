"""Every question: numbers for what it takes, and what the reference answers, as arrays by name."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import compiled  # noqa: F401 (declares all questions)
from holdfast.questions.arrays import ARRAYS, CONTACTS, FLOATING_RESULT, LIMITS, value_of
from holdfast.questions.case import OF_INPUTS, VariedCase
from holdfast.questions.derivatives import with_link_wrenches
from holdfast.questions.question import QUESTIONS, Question
from holdfast.spatial.scalar import Array
from tests.surface import PUBLIC

Given = dict[str, Array]
SOLVED = ("forward_dynamics", "distribute")  # they have tests of their own
FUNCTIONS: dict[str, Any] = {
    f.question.name: f for f in PUBLIC.values() if hasattr(f, "question") and f.question.name not in SOLVED
}
OF_MODEL = ("generic_rank", LIMITS, CONTACTS)  # what the chain alone says


def direct() -> list[str]:
    """Return the names of the questions that are answered without equations of motion and without a programme."""
    return [name for name in QUESTIONS if name not in SOLVED]


def differentiable() -> list[str]:
    """Return the names of those among them that have derivatives."""
    return [name for name in direct() if QUESTIONS[name].arguments]


def flat(found: Any, name: str = "") -> Given:
    """Return an answer of any form as arrays by name."""
    if hasattr(found, "_asdict"):
        found = found._asdict()
    if not isinstance(found, Mapping):
        return {name: np.asarray(found)}
    return {key: x for part, of in found.items() for key, x in flat(of, f"{name}.{part}".lstrip(".")).items()}


def random_array(name: str, chain: hf.ClosedChain, batch: int, random: np.random.Generator) -> Array:
    """Return a batch of an array; arms that hold nothing bear nothing, masses are positive."""
    shape = (batch, *ARRAYS[name].shape(chain))
    if name.endswith("_pose"):
        q, p = random.normal(size=(*shape[:-1], 4)), random.normal(size=(*shape[:-1], 3))
        return np.concatenate([q / np.linalg.norm(q, axis=-1)[..., None], p], -1)
    if name.endswith("_mass"):
        return random.uniform(0.1, 5.0, shape)
    if name.endswith("_inertia"):
        return random.uniform(0.5, 0.9, (*shape[:-1], 1)) * np.eye(3)
    if name == "q":
        return random.uniform(-2, 2, shape)
    found = random.normal(size=shape)
    if name == "grasp_wrench":
        return np.where([[arm in chain.grasps] for arm in chain.names], 10.0 * found, 0.0)
    return found


def inputs_of(chain: hf.ClosedChain, batch: int, seed: int = 0) -> Given:
    """Return a batch of random inputs of all questions."""
    random = np.random.default_rng((seed, 2))
    names = dict.fromkeys(name for of in QUESTIONS.values() for name in (*of.inputs, *of.by_name(chain)))
    return {name: random_array(name, chain, batch, random) for name in names}


def taken_by(function: Any) -> list[str]:
    """Return the parameters that calls of a compiled function may give, as users name them."""
    arrays, question = function.externals, function.question
    given = (*question.inputs, *question.by_name(function.chain), *OF_MODEL)
    read = [name.replace("_R", "_pose") for name, e in arrays.items() if e.role != "output" and name not in given]
    return [name for name in read if not name.endswith("_p")]


def parameters_of(function: Any, batch: int, seed: int = 0) -> Given:
    """Return a batch of random parameters of a compiled function."""
    random = np.random.default_rng((seed, 3))
    return {name: random_array(name, function.chain, batch, random) for name in taken_by(function)}


def inputs_by_name(given: Given) -> hf.Inputs:
    """Return what acts on the chain."""
    return hf.Inputs(**{field: given[name] for name, field in OF_INPUTS.items() if name in given})


def state_by_name(chain: hf.ClosedChain, given: Given) -> hf.State:
    """Return a state; what is not given is zero."""
    known = {"q": np.zeros(chain.joint_count), "qd": np.zeros(chain.joint_count), "object_pose": np.eye(7)[0]} | given
    base = (known["floating_pose"], known.get("floating_twist", np.zeros(6))) if "floating_pose" in known else ()
    return hf.State(known["q"], known["qd"], known["object_pose"], known.get("object_twist", np.zeros(6)), *base)


def case_of(question: Question, chain: hf.ClosedChain, state: hf.State, inputs: hf.Inputs, given: Given) -> VariedCase:
    """Return what a question is asked about."""
    known = {"about": np.zeros(3)} | {name: value_of(name, chain) for name in (LIMITS, CONTACTS)} | given
    own = {name: known[name] for name in question.own(chain)}
    return VariedCase(chain, state, with_link_wrenches(chain, inputs), own)


def computed(question: Question, case: VariedCase) -> Given:
    """Return the results by name, of the text that both the reference and machine code run."""
    found = zip(question.shapes(case.chain), question.compute(case), strict=True)
    return {name: np.asarray(x, dtype=float) for name, x in found if name in question.names}


def reference(name: str, chain: hf.ClosedChain, given: Given, inputs: hf.Inputs | None = None) -> Given:
    """Return the reference's answer for one system, as arrays by name."""
    question, state = QUESTIONS[name], state_by_name(chain, given)
    case = case_of(question, chain, state, inputs or inputs_by_name(given), given)
    return flat(question.shown(chain)(computed(question, case)))


def asked(name: str, chain: Any, state: Any, inputs: Any, given: Mapping[str, Any], kind: str = "", **more: Any) -> Any:
    """Return what a function of the reference, or a derivative of it, returns.

    Args:
        name: of the question.
        chain: the chain.
        state: positions and velocities.
        inputs: what acts on the chain.
        given: the function's further arguments by the names of arrays; `result` is one of forward dynamics.
        kind: vjp, jvp or jacobian; "" for the answer.
        **more: keyword arguments of a derivative.
    """
    known = {"chain": chain, "state": state, "inputs": inputs, "base_acceleration": given.get(FLOATING_RESULT), **given}
    function = FUNCTIONS[name]
    own = {x: known[x] for x in inspect.signature(function).parameters if x in known}
    return (getattr(function, kind) if kind else function)(**own, **more)


def built_with(chain: hf.ClosedChain, given: Given) -> hf.ClosedChain:
    """Return the chain with parameters built in."""
    arms, grasps, held = dict(chain.arms), dict(chain.grasps), chain.held_object
    if "base_pose" in given:
        arms = {name: arm.at(pose) for (name, arm), pose in zip(arms.items(), given["base_pose"], strict=True)}
    if "link_mass" in given:
        for name, arm in arms.items():
            of = zip(*(given[f"link_{x}"][chain.joints[name]] for x in ("mass", "com", "inertia")), strict=True)
            arms[name] = replace(arm, links=[hf.Link(m, com, I) for m, com, I in of])
    if "grasp_pose" in given:
        poses = zip(grasps.items(), given["grasp_pose"], strict=True)
        grasps = {name: replace(grasp, frame=pose) for (name, grasp), pose in poses}
    if "object_mass" in given:
        held = hf.HeldObject(given["object_mass"], given["object_inertia"], given["object_com"])
    return hf.ClosedChain(arms, held, grasps, given.get("gravity", chain.gravity))
