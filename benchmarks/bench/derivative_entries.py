"""Times of derivatives of forward dynamics relative to forward dynamics, and of Pinocchio's relative to ours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from benchmarks.bench import entries
from benchmarks.bench.clock import Effort, summary, timed
from benchmarks.bench.entries import LIBRARY, NAMES, Timed
from benchmarks.bench.pinocchio_peer import PinocchioModel
from benchmarks.bench.systems import System
from holdfast import State, forward_dynamics_jacobian, forward_dynamics_jvp, forward_dynamics_vjp
from holdfast.spatial.scalar import Array

BATCH = 1024  # states in one call
FEWEST = 64  # states in one call at least, because
MOST = 1 << 21  # numbers in a result at most: batches of large Jacobians are smaller
OF = ("qdd", "grasp_wrench", "object_acceleration")
MATRIX = {"of": ("qdd", "grasp_wrench"), "by": ("q", "qd", "tau")}
VJP, JVP, JACOBIAN = "VJP", "JVP", "Jacobian"
FORWARD = {"call": entries.PUBLIC, "bound": entries.BIND, "batch": "batch"}
THEIRS = "constraintDynamics, computeConstraintDynamicsDerivatives"


def compare(system: System, fast: Any, effort: Effort, *, matrix: bool, pinocchio: bool) -> list[dict[str, Any]]:
    """Return the records of one system, all timed in the same rounds.

    Args:
        system: the system.
        fast: its machine code.
        effort: duration of the measurement.
        matrix: whether the Jacobian is timed, too.
        pinocchio: whether Pinocchio is installed.
    """
    forward = [entries.public(system, fast), entries.bind(system, fast), entries.batch(system, fast, BATCH)]
    ways = [make(system, fast, what) for what in (VJP, JVP) for make in (bound, batch)]
    ways += [make(system, fast, JACOBIAN) for make in (call, bound, batch) if matrix]
    theirs = [peer(system)] if matrix and pinocchio else []
    seconds = timed([*forward, *(way.entry for way in [*ways, *theirs])], effort).T
    plain = dict(zip(FORWARD, seconds, strict=False))
    records = []
    for way, taken in zip([*ways, *theirs], seconds[len(forward) :], strict=True):
        ours = {f"forward dynamics, {way.way}": plain[way.way]} if way in ways else {}
        if way in theirs:
            pairs = zip(ways, seconds[len(forward) :], strict=False)
            ours = {f"{JACOBIAN}, {other.way}": spent for other, spent in pairs if other.what == JACOBIAN}
        records.append(
            {
                "system": system.name,
                "what": way.what,
                "way": way.way,
                "library": way.entry.library,
                "note": way.entry.note,
                **summary(taken),
                "error": way.error(),
                "ratios": {name: float(np.median(taken / other)) for name, other in ours.items()},
            }
        )
    return records


class Way(NamedTuple):
    """One entry for one kind of derivatives.

    Attributes:
        what: VJP, JVP or Jacobian.
        way: call, bound or batch.
        entry: the entry to time.
        first: function that returns the derivatives at the first state as a flat array.
        truth: function that returns the same without machine code.
    """

    what: str
    way: str
    entry: Timed
    first: Callable[[], Array]
    truth: Callable[[], Array]

    def error(self) -> float:
        """Return the error of the derivatives at the first state relative to the largest entry."""
        expected = self.truth()
        return float(np.abs(self.first() - expected).max() / np.abs(expected).max())


class DerivativeRequest:
    """The derivatives requested at every state: random cotangents and directions, the same for all of them.

    Attributes:
        kind: argument of `bind`.
        names: keyword arguments that select results and arguments.
        parts: keys of the returned derivatives.
        numbers: cotangents or directions of one system, by name.
    """

    def __init__(self, system: System, what: str) -> None:
        chain, random = system.chain, np.random.default_rng(0)
        shapes = {"qdd": (chain.joint_count,), "grasp_wrench": (len(chain.arms), 6), "object_acceleration": (6,)}
        sizes = {name: chain.joint_count if name in ("q", "qd", "tau") else 6 for name in NAMES}
        rows: dict[str, tuple[str, dict[str, Any], Sequence[Any], dict[str, Any]]] = {
            VJP: ("vjp", {"by": NAMES}, NAMES, shapes),
            JVP: ("jvp", {"of": OF}, OF, sizes),
            JACOBIAN: ("jacobian", MATRIX, [(of, by) for of in MATRIX["of"] for by in MATRIX["by"]], {}),
        }
        self.kind, self.names, self.parts, drawn = rows[what]
        self.numbers = {name: random.normal(size=shape) for name, shape in drawn.items()}

    def of_many(self, count: int) -> dict[str, Any]:
        """Return the keyword arguments of one call for a number of systems; for a single system if it is 0."""
        numbers = {name: np.repeat(x[None], count, axis=0) if count else x for name, x in self.numbers.items()}
        return self.names | ({"along": numbers} if self.kind == "jvp" else numbers)

    def flat(self, found: Any, k: int | None = None) -> Array:
        """Return derivatives as a flat array; those of the k-th system if they belong to a batch."""
        return np.concatenate([np.ravel(found[part] if k is None else found[part][k]) for part in self.parts])

    def reference(self, system: System) -> Array:
        """Return the derivatives of the reference at the first state."""
        q, qd, tau, pose, twist = (x[0] for x in system.arrays)
        made = {"vjp": forward_dynamics_vjp, "jvp": forward_dynamics_jvp, "jacobian": forward_dynamics_jacobian}
        request = self.of_many(0)
        if self.kind == "jvp":
            del request["of"]
        return self.flat(made[self.kind](system.chain, State(q, qd, pose, twist), tau, **request))


def call(system: System, fast: Any, what: str) -> Way:
    """Return the checked call with a reused result."""
    request, states = DerivativeRequest(system, what), entries.each_state(system)
    solve, given = getattr(fast, f"forward_dynamics_{request.kind}"), request.of_many(0)
    out = solve(*states[0], **given)

    def sweep() -> None:
        for state in states:
            solve(*state, **given, out=out)

    entry = Timed(f"{what}, call", LIBRARY, sweep, system.states, "arrays in, result re-used")
    return Way(what, "call", entry, lambda: request.flat(solve(*states[0], **given)), lambda: request.reference(system))


def bound(system: System, fast: Any, what: str) -> Way:
    """Return the bound calls, one for each state."""
    request = DerivativeRequest(system, what)
    options = {"of": OF, "by": NAMES} | request.names
    made = []
    for state in entries.each_state(system):
        one = fast.forward_dynamics.bind(request.kind, **options, **dict(zip(NAMES, state, strict=True)))
        for name, x in request.numbers.items():
            one.given[name][...] = x
        made.append(one)

    def sweep() -> None:
        for step in made:
            step()

    def first() -> Array:
        made[0]()
        return request.flat(made[0].found)

    entry = Timed(f"{what}, bound", LIBRARY, sweep, system.states, "bound, one for each state")
    return Way(what, "bound", entry, first, lambda: request.reference(system))


def batch(system: System, fast: Any, what: str) -> Way:
    """Return one call for many states, on one thread."""
    request, count = DerivativeRequest(system, what), batch_size(system, what)
    solve, given = partial(getattr(fast, f"forward_dynamics_{request.kind}"), threads=1), request.of_many(count)
    arrays = system.repeated(count).arrays
    out = solve(*arrays, **given)

    def sweep() -> None:
        solve(*arrays, **given, out=out)

    note = f"one call for {count}, result re-used, one thread"
    entry = Timed(f"{what}, batch", LIBRARY, sweep, count, note)

    def first() -> Array:
        return request.flat(solve(*arrays, **given, out=out), 0)

    return Way(what, "batch", entry, first, lambda: request.reference(system))


def batch_size(system: System, what: str) -> int:
    """Return the number of states per call, which is smaller for large results."""
    if what != JACOBIAN:
        return BATCH
    numbers = (system.chain.joint_count + 6 * len(system.chain.arms)) * 3 * system.chain.joint_count
    return min(BATCH, max(FEWEST, MOST // numbers))


def peer(system: System) -> Way:
    """Return Pinocchio's entry with a free object; derivatives by torques, which need no tangents, are compared."""
    pin: Any = import_module("pinocchio")
    posed = PinocchioModel(system, "free")
    model, welds, data, weld_data = posed.model, posed.welds, posed.model.createData(), posed.weld_data()
    pin.initConstraintDynamics(model, data, welds, weld_data)
    solve, differentiate, inputs = pin.constraintDynamics, pin.computeConstraintDynamicsDerivatives, posed.inputs
    n = system.chain.joint_count

    def sweep() -> None:
        for q, v, tau in inputs:
            solve(model, data, q, v, tau, welds, weld_data)
            differentiate(model, data, welds, weld_data)

    def first() -> Array:
        solve(model, data, *inputs[0], welds, weld_data)
        return np.ravel(np.array(differentiate(model, data, welds, weld_data)[2])[:n, :n])

    def truth() -> Array:
        q, qd, tau, pose, twist = (x[0] for x in system.arrays)
        state = State(q, qd, pose, twist)
        return np.ravel(forward_dynamics_jacobian(system.chain, state, tau, of=["qdd"], by=["tau"])["qdd", "tau"])

    entry = Timed(THEIRS, "pinocchio", sweep, system.states, "object free, mu = 0; error of d qdd / d tau")
    return Way(JACOBIAN, "call", entry, first, truth)
