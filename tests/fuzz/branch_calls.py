"""Sound calls of chains with branches, loops, couplings and several objects, and of forests of several bodies."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import control, dynamics
from holdfast.model import forest
from tests.fuzz.calls import Later, call, named, numbers_of, state_of
from tests.systems.branched import Branched, branched_problems

POSE = [1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3]


@cache
def branched() -> dict[str, Branched]:
    """Return chains with all that makes a chain a forest."""
    return branched_problems()


def with_branches(ask: Callable[..., Any], which: str, /, name: str = "", **more: Any) -> None:
    """Add a call ask(chain, state, **more) of one of them, states as numbers; functions in `more` make arguments."""
    given = {key: Later(lambda x=x: x(branched()[which])) if callable(x) else x for key, x in more.items()}
    given["chain"] = Later(lambda: branched()[which].chain)
    given["state"] = Later(lambda: numbers_of(branched()[which].state))

    def make(chain: Any, state: Any, **others: Any) -> Any:
        return ask(chain, state_of(state), **others)

    call(f"{name or ask.__name__} ({which})", **given)(make)


def _tau(p: Branched) -> np.ndarray:
    return np.array(p.tau)


def _rates(p: Branched) -> np.ndarray:
    return np.ones(p.chain.joint_count)


def _one_step(chain: Any, state: Any, tau: Any = None, step: Any = 1e-3, **given: Any) -> Any:
    run = hf.simulate(chain, state, lambda t, state, memory: (tau, memory), step, step, **given)
    return run.q, run.tau


def _compensated(chain: Any, state: Any, **given: Any) -> Any:
    return control.GravityCompensation(chain, **given)(0.0, state, None)


for _which in ("palletiser", "pot and lid", "on a shoulder"):
    with_branches(hf.forward_dynamics, _which, tau=_tau, check=False)
    with_branches(hf.diagnose, _which)
    with_branches(hf.close, _which)
    with_branches(dynamics.momentum, _which, about=np.zeros(3))
    with_branches(dynamics.potential_energy, _which)
    with_branches(hf.linearise, _which, tau=_tau)
    with_branches(_one_step, _which, "simulate", tau=_tau, step=1e-3, scheme="rk4")
    if _which != "on a shoulder":  # a base that floats
        with_branches(_compensated, _which, "GravityCompensation", joint_damping=1.0)
    with_branches(hf.forward_dynamics_vjp, _which, tau=_tau, qdd=_rates, by=["q", "tau"])


# Parts, of numbers.

_BAR = {"mass": 2.0, "com": np.array([0.0, 0.0, 0.5]), "inertia": np.diag([0.2, 0.2, 0.01])}
_HINGE = {"axis": np.array([0.0, 1.0, 0.0]), "placement": np.array(POSE), "stiffness": 1.0, "rest": 0.1}


@call(
    "four bars",
    hinge=_HINGE,
    bar=_BAR,
    parents=[None, 0, None],
    tip=np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0, -0.1, -0.2, 0.7]),
    frame=np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0, 0.0, 0.0, 1.0]),
    terms={"j0": 1.0, "j2": -1.0},
    offset=0.0,
    base=np.array(POSE),
    q=np.zeros(3),
    qd=np.zeros(3),
)
def _four_bars(
    hinge: Any, bar: Any, parents: Any, tip: Any, frame: Any, terms: Any, offset: Any, base: Any, q: Any, qd: Any
) -> Any:
    if not (named(hinge, hf.Joint) and named(bar, hf.Link)) or "name" in {*hinge, *bar}:
        return None
    loop = hf.Closure("l1", "l2", hf.Grasp("hinge", frame), tip=tip)
    joints = [hf.Joint(**hinge, name=f"j{k}") for k in range(3)]
    links = [hf.Link(**bar, name=f"l{k}") for k in range(3)]
    couplings = [hf.Coupling(terms, offset)]
    arm = hf.Arm(joints, links, parents=parents, loops={"loop": loop}, couplings=couplings, base=base)
    chain = hf.ClosedChain({"arm": arm})
    state = hf.State(q, qd)
    answers: list[Any] = [hf.forward_dynamics(chain, state, np.zeros(3), check=False), hf.diagnose(chain, state)]
    return [*answers, hf.close(chain, state), dynamics.link_poses(arm, q)]


_HULL = {"mass": 3.0, "inertia": np.eye(3)}
_DRUM = {"kind": "screw", "axis": np.array([0.0, 0.0, 1.0]), "pitch": 0.01, "placement": np.array(POSE)}
_BALL = {"kind": "spherical", "placement": np.array(POSE), "armature": 0.1, "damping": 0.2}


def _forest(hull: Any, drum: Any, ball: Any, frame: Any, tip: Any, terms: Any) -> Any:
    body = hf.Link(**hull) if named(hull, hf.Link) else hull
    joints = [{"kind": "free"}, drum, ball, {"kind": "cylindrical"}]
    made = [forest.BodyJoint(**one) if named(one, forest.BodyJoint) else one for one in joints]
    bodies = [forest.ForestBody(body, joint, parent) for joint, parent in zip(made, (None, 0, 0, None), strict=True)]
    pins = [forest.Closure(1, 2, hf.Grasp("planar", frame), tip), forest.Closure(None, 2, hf.Grasp("ball", frame), tip)]
    return forest.Forest(bodies, pins, [forest.JointCoupling(terms)])


_NUMBERS: dict[str, Any] = {
    "hull": _HULL,
    "drum": _DRUM,
    "ball": _BALL,
    "frame": np.array(POSE),
    "tip": np.array(POSE),
    "terms": [(1, 0, 1.0), (3, 1, -2.0)],
    "q": np.array([*POSE, 0.1, 1.0, 0.0, 0.0, 0.0, 0.2, 0.3]),
    "qd": np.zeros(12),
}


def of_several(ask: Callable[..., Any], **own: Any) -> None:
    """Add a function of a forest of four bodies, which is made of numbers, with its own arguments."""

    def asked(hull: Any, drum: Any, ball: Any, frame: Any, tip: Any, terms: Any, **given: Any) -> Any:
        return repr(ask(_forest(hull, drum, ball, frame, tip, terms), **given))

    call(f"{ask.__name__} of several", **_NUMBERS, **own)(asked)


def _closed_answers(forest: Any, q: Any = None, qd: Any = None, **given: Any) -> Any:
    there = dynamics.forest_close(forest, q, qd)
    found = dynamics.forest_dynamics(forest, there.q, there.qd, **given)
    return found, dynamics.forest_impulse(forest, there.q, there.qd), dynamics.forest_diagnose(forest, there.q)


of_several(_closed_answers, tau=np.ones(12))
of_several(dynamics.forest_close)
of_several(dynamics.forest_balance, tau=np.ones(12), about=np.zeros(3))


@call("compiled forest", q=_NUMBERS["q"], qd=np.zeros(12), tau=np.ones(12), link_wrench=np.zeros((4, 6)), threads=1)
def _compiled(**given: Any) -> Any:
    return compiled().forward_dynamics(**given)


@cache
def compiled() -> Any:
    """Return machine code of the forest."""
    parts = {key: x for key, x in _NUMBERS.items() if key not in ("q", "qd")}
    return hf.compile(_forest(**parts), parameters=["link_wrench"])
