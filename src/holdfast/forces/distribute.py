"""Which torques? The distribution of forces under limits, and reports on what the limits allow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.contact.solved_contacts import ContactStatus
from holdfast.errors import StateError
from holdfast.forces.certificate import Certificate, certificate, kept
from holdfast.forces.cone_solver import Verdict
from holdfast.forces.elastic_distribution import DISTRIBUTE
from holdfast.forces.force_question import ForceQuestion, force_question, scaled_question
from holdfast.forces.limit_rows import Limit
from holdfast.forces.limits import Distribution, ForceCost, ForceLimits
from holdfast.forces.margins import grasp_margins
from holdfast.forces.programmes import Form, Solved
from holdfast.forces.smooth_distribution import smooth_parameters, smooth_solution
from holdfast.forces.touched_result import of_contacts
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import asked, asked_case, attach
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

ROUNDING = 1e-7  # multipliers below this, and below this part of the largest, are 0
KEPT = 1e-7  # violations below this, relative to F0, are rounding
DEARER = 10.0  # factor of a price at which a violation that is not necessary was cheaper
MOST_RISES = 4
FORMS = ("elastic", "effort", "margin")


@asked
@np.errstate(all="ignore")  # what overflows is refused
def distribute(
    chain: ClosedChain,
    state: State,
    acceleration: ArrayLike | Mapping[str, ArrayLike] | None = None,
    *,
    task: ArrayLike | Mapping[str, ArrayLike] | None = None,
    cost: ForceCost | None = None,
    limits: ForceLimits | None = None,
    inputs: Inputs | None = None,
    normal_force: Mapping[str, float] | None = None,
    form: Literal["elastic", "effort", "margin"] = "elastic",
) -> Distribution:
    """Return the torques of least cost that accelerate the object as asked, within all limits.

    minimise cost(tau, lambda, qdd) + price v + v^2 / 2 subject to the equations of motion of the whole chain, and
    every limit gives way by v >= 0 times its weight. v is 0 wherever the limits can be kept. The torques exist for
    every acceleration that the arms can give, are unique, and depend continuously on the state. Redundant joints and a
    trunk move as the cost prefers. `forward_dynamics` with the torques returns the accelerations and the wrenches,
    unless the configuration is singular. Forces that no joint feels are the smallest, as there; `Distribution.unfelt`
    counts them. The torques do not include joint friction. A convex programme, some 12 steps of O(n^3).

    Closed contacts of the object with the world (`touching`) take part with forces in their cones, so that a table
    carries weight and a wall can be pressed. They do what the asked acceleration makes of them: open, stick, or slip
    with friction against the slip. Where some of it is free, or gives way, they stay as they are: at rest, or sliding.
    The motion with the torques is one that the laws of contact allow; `touch_status` says whether another is known.

    Args:
        chain: the chain.
        state: positions and velocities, which must satisfy the grasps.
        acceleration: (6,) true acceleration [omega_dot; v_dot] of C, world axes, or (r,) the values of the task's rows;
            None for zero. In a chain that is answered as a forest it is (k, 6) for k objects, or a mapping by name: of
            an object, of "trunk/base", which floats, or of any link or frame, "arm/link"; of its origin, world axes.
            That of the "centre_of_mass" of all bodies is (3,). What is not named is free. Without an object None is for
            a floating base.
        task: (r, 6) rows on the object's acceleration; what they leave out is free. None asks for all six. A mapping by
            name like the acceleration.
        cost: what makes a distribution good.
        limits: the limits, in addition to the conditions of the grasps.
        inputs: external wrenches and base motion.
        normal_force: normal forces of the world on the object that are to act [N], by name of a contact, "point/shape",
            or of a shape, the sum over its contacts. For bounds see `ForceLimits`.
        form: "elastic"; "effort", where limits do not give way; or "margin", the torques of least cost for the largest
            margin, in which bounds on normal forces count like conditions. If no torques keep the limits, the last two
            return those that pass the limits least.

    Raises:
        StateError: a shape is wrong, the arms cannot give the object this acceleration, or it presses the object into
            the world.
        ModelError: a limit or an acceleration names nothing in the chain.
        MethodNotApplicable: with `cost.barrier`, something is asked that machine code is not, or of a forest, or of a
            chain with `touching`.

    Reference:
        S. Boyd, B. Wegbreit, Fast computation of optimal contact forces, IEEE Transactions on Robotics, 2007.
    """
    if not isinstance(form, str) or form not in FORMS:
        raise StateError(f"form: expected one of {', '.join(FORMS)}, got {checks.short(form)}")
    if form == "margin" and limits is not None and limits.least_margin is not None:
        raise StateError("limits: least_margin: expected none with form='margin', which asks for the largest one")
    if form == "margin":
        _exactly_asked(cost, "a largest margin")
    question = force_question(chain, state, acceleration, task, cost, limits, inputs, normal_force)
    if cost is not None and cost.barrier:
        given: dict[str, Any] = {"chain": chain, "state": state, "acceleration": acceleration, "task": task}
        given |= {"cost": cost, "limits": limits, "inputs": inputs, "form": form}
        return _smooth(question, asked_case(DISTRIBUTE, given, smooth_parameters))
    if form == "elastic":
        return elastic(question, (cost or ForceCost()).price)
    return distribution(question, form)


@np.errstate(all="ignore")  # what overflows is refused
def least_peak(
    chain: ClosedChain,
    state: State,
    acceleration: ArrayLike | Mapping[str, ArrayLike] | None = None,
    *,
    task: ArrayLike | Mapping[str, ArrayLike] | None = None,
    cost: ForceCost | None = None,
    limits: ForceLimits | None = None,
    inputs: Inputs | None = None,
    normal_force: Mapping[str, float] | None = None,
) -> Distribution:
    """Return the least r for which |tau_j| <= r effort_j gives the acceleration, and the torques of least cost then.

    Above 1, the drives are too weak by this factor. Arguments as in `distribute`; `value` is r. Two
    convex programmes of O(n^3) per step.

    Args:
        chain: the chain.
        state: positions and velocities.
        acceleration: what is asked of the object.
        task: rows on the object's acceleration.
        cost: what makes a distribution good.
        limits: the limits; those on torques are r times the share `effort`.
        inputs: external wrenches and base motion.
        normal_force: as in `distribute`.

    Raises:
        StateError: as in `distribute`.
    """
    _exactly_asked(cost, "a least peak")
    return distribution(force_question(chain, state, acceleration, task, cost, limits, inputs, normal_force), "peak")


@np.errstate(all="ignore")  # what overflows is refused
def lift_margin(
    chain: ClosedChain,
    state: State,
    acceleration: ArrayLike | Mapping[str, ArrayLike] | None = None,
    *,
    payload: bool = False,
    cost: ForceCost | None = None,
    limits: ForceLimits | None = None,
    inputs: Inputs | None = None,
    normal_force: Mapping[str, float] | None = None,
) -> Distribution:
    """Return the largest share sigma of an acceleration, or multiple of the payload, that the limits allow.

    The object's acceleration is sigma times the given one; with `payload` it is the given one, and mass and inertia of
    the object are multiplied by sigma. `value` is sigma: infinite if no limit binds, and minus infinity if no sigma is
    possible; `why` then says which limits conflict at sigma = 0. The torques are those of least cost for sigma. Two
    convex programmes of O(n^3) per step.

    Args:
        chain: the chain.
        state: positions and velocities.
        acceleration: (6,) true acceleration of C, world axes; None for zero, with `payload` only. Of forests as in
            `distribute`.
        payload: whether sigma multiplies the inertia of the only object instead of the acceleration.
        cost: what makes a distribution good.
        limits: the limits.
        inputs: external wrenches and base motion.
        normal_force: as in `distribute`.

    Raises:
        StateError: as in `distribute`, or there is nothing to scale.
    """
    if acceleration is None and not payload:
        raise StateError("acceleration: expected one to scale, got None; try payload=True for the largest payload")
    checks.flag(payload, "payload", StateError)
    _exactly_asked(cost, "a lift margin")
    return distribution(
        scaled_question(chain, state, acceleration, payload, cost, limits, inputs, normal_force), "scale"
    )


def explain(found: Distribution) -> str:
    """Return what a distribution met in words: the limits that cost most, or that conflict and by how much. O(1).

    Args:
        found: the result of `distribute`, `least_peak` or `lift_margin`.

    Raises:
        ModelError: it is none.
    """
    checks.instance(found, Distribution, "found")
    return found.why


def _exactly_asked(cost: ForceCost | None, what: str) -> None:
    """Refuse a cost of the distance from what is asked, and a barrier, where only limits count.

    Raises:
        StateError: there is one.
    """
    if not isinstance(cost, ForceCost):
        return
    if cost.task is not None:
        raise StateError(
            f"cost: task: expected None, got {checks.short(cost.task)}: {what} is that of an acceleration kept exactly"
        )
    if cost.barrier:
        raise StateError(f"cost: barrier: expected 0, got {cost.barrier:g}: {what} lies on the limits")


def elastic(question: ForceQuestion, price: float) -> Distribution:
    """Return the elastic distribution; if it passes limits that could be kept, at a price that keeps them."""
    done = question.asked("elastic", price)
    if done.extra <= KEPT:
        return _described(question, done, 0.0, None)
    least = question.asked("violation")
    if least.extra > KEPT:
        return _described(question, done, done.extra, proof(question, least))
    for _ in range(MOST_RISES):
        price *= DEARER
        done = question.asked("elastic", price)
        if done.extra <= KEPT:
            break
    else:
        hard = question.asked("effort")  # as at any price
        done = hard if hard.verdict is Verdict.OPTIMAL else done
    inside = done.extra <= KEPT
    return _described(question, done, 0.0 if inside else done.extra, None, status=None if inside else "undecided")


def _smooth(question: ForceQuestion, case: VariedCase) -> Distribution:
    """Return the elastic distribution at a barrier, and the certificate where limits conflict."""
    done, proven = smooth_solution(case, question.found, question.limits, question.costs), None
    if done.extra > KEPT and (least := question.asked("violation")).extra > KEPT:
        proven = proof(question, least)
    return _described(question, done, done.extra, proven)


def distribution(question: ForceQuestion, form: Form) -> Distribution:
    """Return the answer to a form whose limits do not give way, and the certificate where they conflict."""
    done = question.asked(form)
    if done.verdict is Verdict.INFEASIBLE:
        still = question._replace(v1=None)
        least = still.asked("violation")
        reached = still.cheapest("violation", least.extra)
        value = {"effort": reached.value, "peak": np.inf}.get(form, -np.inf)
        return _described(still, reached, least.extra, proof(still, least), value)
    if form == "effort":
        return _described(question, done, 0.0, None)
    if done.verdict is Verdict.UNBOUNDED:
        still = question._replace(v1=None)
        value = -np.inf if form == "peak" else np.inf
        return _described(still, still.asked("effort"), 0.0, None, value, "unbounded")
    unit = question.found.force if form == "margin" else 1.0
    reached = question.cheapest(form, done.extra)
    if reached.verdict is not Verdict.OPTIMAL:
        reached = done
    parts = [unit * part for part in done.parts]  # what counts is the value, not the cost
    return _described(question, reached._replace(parts=parts), 0.0, None, unit * done.extra)


def proof(question: ForceQuestion, least: Solved) -> Certificate:
    """Return the certificate of a least violation, the answer to the form "violation"."""
    words = [limit.words for limit in question.limits]
    force = question.found.force
    return certificate(words, least.parts, least.extra * force, least.dual_residual * force)


def _described(
    question: ForceQuestion,
    done: Solved,
    violation: float,
    proof: Certificate | None,
    value: float | None = None,
    status: str | None = None,
) -> Distribution:
    """Return a distribution with its margin, its prices, and words."""
    found = question.found
    chain, v = found.chain, checks.finite(done.v, "distribution of forces")
    wrenches = found.grasp_wrenches(v)
    margins = grasp_margins(chain, question.state, wrenches)
    touched = {} if found.touched is None else of_contacts(question, found.T @ v + found.t, v)
    prices = _prices(question.limits, done.parts, found.force)
    status = status or ("infeasible" if proof is not None else done.verdict.value)
    why = kept(prices, {limit.name: limit.unit for limit in question.limits})
    if violation > KEPT:  # at a barrier; otherwise the price is raised
        why = "limits give way, but could be kept: try a higher price, or a smaller barrier"
    words = {"unbounded": "no limit bounds the value"}
    words |= {"undecided": f"rounding hides whether the limits can be kept (residual {done.residual:.1g})"}
    why = words.get(status, why) if proof is None else proof.words
    why += f"; forces that no joint feels ({found.unfelt}) are taken as the smallest" if found.unfelt else ""
    if touched.get("touch_status") is ContactStatus.AMBIGUOUS:
        why += "; with these torques the laws of contact allow another motion, too"
    return Distribution(
        found.T @ v + found.t,
        v[found.qdd],
        v[found.alpha] if len(chain.free_objects) == 1 else v[found.alpha].reshape(-1, 6),
        wrenches,
        v[found.base] if chain.floats else None,
        violation * found.force,
        float(margins.min(initial=np.inf)),
        prices,
        status,
        done.value if value is None else value,
        why,
        proof,
        done.residual,
        found.unfelt,
        FrozenDict({one.key: wrenches[one.row] for one in found.grasps}),
        v[found.coupled],
        **touched,
    )


def _prices(limits: Sequence[Limit], parts: Sequence[Array], force: float) -> dict[str, float]:
    """Return the sum of the multipliers of both sides of every limit, per its own unit."""
    prices = {limit.name: 0.0 for limit in limits}
    rounding = ROUNDING * max((float(part[0]) for part in parts), default=0.0)
    for limit, part in zip(limits, parts, strict=True):
        if part[0] > max(rounding, ROUNDING):
            prices[limit.name] += float(part[0]) / (limit.weight * force)
    return prices


attach(DISTRIBUTE, distribute, smooth_parameters)
