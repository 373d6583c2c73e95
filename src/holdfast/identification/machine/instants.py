"""What the equations of a machine are made of in every sample: by Python for a few, by machine code for many.

The same functions are run on the numbers of a sample, or once on nodes that record what they compute; the result is a
batch of samples either way.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from holdfast.compiled.kernels import compiling
from holdfast.compiled.traced_chain import Given, externals, traced, traced_state
from holdfast.compiler.kernel import BatchKernel
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE, constraint_rows
from holdfast.dynamics.inverse import acceleration_of_base
from holdfast.dynamics.regressor import Regressor, inertial_parameters, regressor_of
from holdfast.identification.recording import Recording
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.trunk import TRUNK
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

MANY = 300  # samples for which machine code is worth its compilation
SAMPLES_AT_ONCE = 1000  # samples, of which the columns of all links are in memory together
UNHELD_POSE = np.r_[1.0, np.zeros(6)]  # pose of an object that nobody holds


class Instants(NamedTuple):
    """The pieces of the equations of some samples, for motions with the recorded one of a floating base.

    Attributes:
        qd: (samples, n) joint rates.
        qdd: (samples, n) joint accelerations.
        links: (samples, n, bodies, 10) what trunk and links need, by their inertial parameters.
        drives: (samples, n) what does not depend on these: armature, damping, springs, external wrenches.
        object: (samples, 6, 10) what the object needs, by its parameters.
        object_wrench: (samples, 6) what acts on it besides the grasps.
        constraint: (samples, c, n + 6) K [J, -A].
        held: (10,) parameters of the model's object.
        added: (10,) parameters of a body that was added to it; None for none.
    """

    qd: Array
    qdd: Array
    links: Array
    drives: Array
    object: Array
    object_wrench: Array
    constraint: Array
    held: Array
    added: Array | None

    def motions(self) -> tuple[Array, Array]:
        """Return bases of the motions that the grasps allow, as rows (samples, m, n + 6), and their numbers.

        Where a sample has fewer motions than others, its last rows are 0. Arms that hold nothing move freely.
        """
        count, rows, columns = self.constraint.shape
        if not rows:
            n = self.qd.shape[1]
            basis = np.delete(np.eye(columns), np.s_[n : n + 6], axis=0)
            return np.broadcast_to(basis, (count, *basis.shape)), np.full(count, len(basis))
        _, sizes, Vt = np.linalg.svd(self.constraint)
        ranks = (sizes > NULL_SINGULAR_VALUE * sizes[:, :1]).sum(axis=1)
        N = np.zeros((count, columns - int(ranks.min()), columns))
        for rank in np.unique(ranks).tolist():
            of = ranks == rank
            N[of, : columns - rank] = Vt[of, rank:]
        return N, columns - ranks


def instants(chain: ClosedChain, recording: Recording) -> Iterator[Instants]:
    """Yield the pieces of the equations of a completed recording, some samples at a time.

    Raises:
        StateError: numbers overflow.
    """
    held = inertial_parameters(chain.held_object)
    added = None if recording.added is None else inertial_parameters(recording.added)
    many = len(recording) >= MANY and not chain.springs
    inputs = (recording.inputs or Inputs()).shaped(chain)
    code = _code(chain, recording.inputs) if many else None
    for first in range(0, len(recording), SAMPLES_AT_ONCE):
        x = _given(chain, recording.part(slice(first, first + SAMPLES_AT_ONCE)))
        if code is None:
            each = [_pieces(chain, inputs, _state(row), row) for row in _rows(x)]
            found = {name: np.array([one[name] for one in each]) for name in each[0]}
        else:
            count = len(x["q"])
            found = {name: np.empty((count, *e.shape)) for name, e in code.externals.items() if e.role == "output"}
            code.run_arrays(x | found, count)
        for one in found.values():
            checks.finite(one, "regressor")
        yield Instants(qd=x["qd"], qdd=x["qdd"], **found, held=held, added=added)


@lru_cache(maxsize=4)
def _code(chain: ClosedChain, inputs: Inputs | None) -> BatchKernel:
    """Return the machine code of `_pieces` for a chain, whose numbers and inputs are constants in it."""
    given, n, none = (inputs or Inputs()).shaped(chain), chain.joint_count, np.zeros(6)
    shapes = {"q": (n,), "qd": (n,), "qdd": (n,)}
    shapes |= {"object_pose": (7,), "object_twist": (6,), "alpha": (6,)} if chain.grasps else {}
    shapes |= {"floating_pose": (7,), "floating_twist": (6,), "base": (6,)} if chain.floats else {}
    still = State(np.zeros(n), np.zeros(n), UNHELD_POSE, none, *((UNHELD_POSE, none) if chain.floats else ()))
    found = _pieces(chain, given, still, {"qdd": np.zeros(n), "base": none})
    outputs = {name: np.shape(x) for name, x in found.items()}

    def pieces(x: Given) -> Mapping[str, Array]:
        return _pieces(chain, given, traced_state(chain, x), x)

    arrays = externals(shapes, (), outputs, shapes | outputs)
    shown = partial(compiling, chain, "equations", None)
    return BatchKernel(arrays, lambda: traced(arrays, pieces), quick=True, shown=shown)


def _given(chain: ClosedChain, recording: Recording) -> dict[str, Array]:
    """Return what the pieces depend on, (samples, ...) each."""
    assert recording.qd is not None and recording.qdd is not None
    found: dict[str, Array | None] = {"q": recording.q, "qd": recording.qd, "qdd": recording.qdd}
    if chain.grasps:
        names = {"object_pose": "object_pose", "object_twist": "object_twist", "alpha": "object_acceleration"}
        found |= {name: getattr(recording, field) for name, field in names.items()}
    if chain.floats:
        acceleration_of_base(chain, None if recording.base_acceleration is None else recording.base_acceleration[0])
        names = {"floating_pose": "base_pose", "floating_twist": "base_twist", "base": "base_acceleration"}
        found |= {name: getattr(recording, field) for name, field in names.items()}
    assert all(x is not None for x in found.values())
    return {name: np.ascontiguousarray(x, dtype=float) for name, x in found.items()}


def _rows(x: Mapping[str, Array]) -> Iterator[dict[str, Array]]:
    """Yield the arrays of every sample."""
    for k in range(len(x["q"])):
        yield {name: array[k] for name, array in x.items()}


def _state(x: Mapping[str, Array]) -> State:
    """Return the state of a sample."""
    pose, twist = x.get("object_pose", UNHELD_POSE), x.get("object_twist", np.zeros(6))
    return State(x["q"], x["qd"], pose, twist, x.get("floating_pose"), x.get("floating_twist"))


def _pieces(chain: ClosedChain, inputs: Inputs, state: State, x: Mapping[str, Array]) -> dict[str, Array]:
    """Return the pieces of a sample, by the names of `Instants`."""
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs)
    base = x["base"] if chain.floats else None
    Y = regressor_of(motion, state, x["qdd"], x.get("alpha", np.zeros(6)), base, inputs)
    return {
        "links": _link_columns(chain, Y),
        "drives": Y.drives,
        "object": Y.object,
        "object_wrench": Y.object_wrench,
        "constraint": constraint_rows(motion).on_driven_base.matrix,
    }


def _link_columns(chain: ClosedChain, Y: Regressor) -> Array:
    """Return the torques per parameters of trunk and links, (n, bodies, 10)."""
    n, found = chain.joint_count, []
    for name in ((TRUNK,) if TRUNK in Y.links else ()) + chain.names:
        own = Y.links[name]
        part = np.zeros((n, own.shape[1], 10), own.dtype)
        part[chain.joints[name]] = own
        if name in Y.under:
            part[chain.joints[TRUNK]] = Y.under[name]
        found.append(part)
    return np.concatenate(found, axis=1)
