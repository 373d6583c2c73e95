"""What the equations of a recording are made of in every sample: by Python for a few, by machine code for many.

The same functions are run on the numbers of a sample, or once on nodes that record what they compute; the result is a
batch of samples either way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from holdfast.compiled.kernels import compiling
from holdfast.compiled.traced_chain import Given, externals, traced, traced_state
from holdfast.compiler.kernel import BatchKernel
from holdfast.dynamics.arm.free_dynamics import tip_acceleration
from holdfast.dynamics.closed.chain_motion import chain_motion, pseudo_gravity
from holdfast.dynamics.closed.force_elements import with_force_elements
from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE, constraint_rows
from holdfast.dynamics.inverse import acceleration_of_base
from holdfast.dynamics.regressor import Regressor, inertial_parameters, object_columns, regressor_of
from holdfast.errors import StateError
from holdfast.identification.recording import Recording
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.trunk import TRUNK
from holdfast.spatial.frozen import changed
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate, shift_wrench
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


OfSample = Callable[[ClosedChain, Inputs, State, Mapping[str, Array]], dict[str, Array]]


def instants(chain: ClosedChain, recording: Recording, gravity: Array | None = None) -> Iterator[Instants]:
    """Yield the pieces of the equations of a completed recording, some samples at a time.

    Args:
        chain: the chain.
        recording: the recording.
        gravity: (3,) gravity; the chain's by default.

    Raises:
        StateError: numbers overflow.
    """
    held = inertial_parameters(chain.held_object)
    added = None if recording.added is None else inertial_parameters(recording.added)
    for part, found in _in_samples(_drives, chain, recording, gravity):
        assert part.qd is not None and part.qdd is not None
        yield Instants(qd=part.qd, qdd=part.qdd, **found, held=held, added=added)


def at_wrists(chain: ClosedChain, recording: Recording, gravity: Array | None = None) -> dict[str, Array]:
    """Return what relates the wrists of a completed recording to the object, for the chain's gravity or another.

    Returns:
        "object" and "object_wrench", as in `Instants`, and "maps", (samples, 6, 6 grasps), which take the wrenches of
        the tips, in their axes about their points, to their sum about C in world axes.

    Raises:
        StateError: numbers overflow.
    """
    return _whole(_in_samples(_wrists, chain, recording, gravity))


def tips(chain: ClosedChain, recording: Recording) -> dict[str, Array]:
    """Return the motion of the tips that hold the object, which need not be recorded.

    Returns:
        "R" (samples, grasps, 3, 3) and "p" (samples, grasps, 3), their frames; "twists" and "accelerations", (samples,
        grasps, 6), those without gravity, world axes.

    Raises:
        StateError: numbers overflow.
    """
    return _whole(_in_samples(_tips, chain, recording, np.zeros(3)))


def _whole(parts: Iterator[tuple[Recording, dict[str, Array]]]) -> dict[str, Array]:
    """Return the pieces of all samples."""
    found = [pieces for _, pieces in parts]
    return {name: np.concatenate([one[name] for one in found]) for name in found[0]}


def _in_samples(
    pieces: OfSample, chain: ClosedChain, recording: Recording, gravity: Array | None
) -> Iterator[tuple[Recording, dict[str, Array]]]:
    """Yield parts of a recording, and the pieces of the equations of their samples."""
    inputs = (recording.inputs or Inputs()).shaped(chain)
    many = len(recording) >= MANY and not chain.springs
    for first in range(0, len(recording), SAMPLES_AT_ONCE):
        part = recording.part(slice(first, first + SAMPLES_AT_ONCE))
        x, count = _given(chain, part, chain.gravity if gravity is None else gravity), len(part)
        if many:
            code = _code(pieces, chain, recording.inputs, tuple((name, a.shape[1:]) for name, a in x.items()))
            found = {name: np.empty((count, *e.shape)) for name, e in code.externals.items() if e.role == "output"}
            code.run_arrays(x | found, count)
        else:
            rows = [{name: array[k] for name, array in x.items()} for k in range(count)]
            each = [pieces(_under(chain, row), inputs, _state(row), row) for row in rows]
            found = {name: np.array([one[name] for one in each]) for name in each[0]}
        for one in found.values():
            checks.finite(one, "regressor")
        yield part, found


@lru_cache(maxsize=12)
def _code(
    pieces: OfSample, chain: ClosedChain, inputs: Inputs | None, shapes: tuple[tuple[str, tuple[int, ...]], ...]
) -> BatchKernel:
    """Return the machine code of pieces for a chain, whose numbers and inputs are constants in it, but for gravity."""
    given = (inputs or Inputs()).shaped(chain)
    still = {name: UNHELD_POSE if name.endswith("pose") else np.zeros(shape) for name, shape in shapes}
    outputs = {name: np.shape(x) for name, x in pieces(_under(chain, still), given, _state(still), still).items()}

    def traced_pieces(x: Given) -> Mapping[str, Array]:
        return pieces(_under(chain, x), given, traced_state(chain, x), x)

    arrays = externals(dict(shapes), (), outputs, dict(shapes) | outputs)
    shown = partial(compiling, chain, "equations", None)
    return BatchKernel(arrays, lambda: traced(arrays, traced_pieces), quick=True, shown=shown)


def _under(chain: ClosedChain, x: Mapping[str, Array]) -> ClosedChain:
    """Return the chain under the gravity of a sample."""
    return changed(chain, gravity=x["gravity"])


def _given(chain: ClosedChain, recording: Recording, gravity: Array) -> dict[str, Array]:
    """Return what the pieces depend on, (samples, ...) each, without the object's motion where it is not recorded."""
    found: dict[str, Array | None] = {"q": recording.q, "qd": recording.qd, "qdd": recording.qdd}
    if chain.grasps:
        names = {"object_pose": "object_pose", "object_twist": "object_twist", "alpha": "object_acceleration"}
        found |= {name: getattr(recording, field) for name, field in names.items()}
    if chain.floats:
        acceleration_of_base(chain, None if recording.base_acceleration is None else recording.base_acceleration[0])
        names = {"floating_pose": "base_pose", "floating_twist": "base_twist", "base": "base_acceleration"}
        found |= {name: getattr(recording, field) for name, field in names.items()}
    for name in ("object_pose", "base_pose"):
        _require_unit_quaternions(getattr(recording, name), name)
    found["gravity"] = np.broadcast_to(gravity, (len(recording), 3))
    return {name: np.ascontiguousarray(x, dtype=float) for name, x in found.items() if x is not None}


def _require_unit_quaternions(poses: Array | None, name: str) -> None:
    """Refuse poses whose quaternions do not have unit length, which machine code would answer with NaN."""
    if poses is None:
        return
    lengths = np.sqrt((poses[:, :4] ** 2).sum(axis=1))
    if (off := np.abs(lengths - 1.0) > checks.ROTATION_TOLERANCE).any():
        length = lengths[int(np.argmax(off))]
        raise StateError(
            f"recording: {name}: expected unit quaternions (w, x, y, z) first, got length {length:.9g}; try dividing"
            " by it"
        )


def _state(x: Mapping[str, Array]) -> State:
    """Return the state of a sample."""
    pose, twist = x.get("object_pose", UNHELD_POSE), x.get("object_twist", np.zeros(6))
    return State(x["q"], x["qd"], pose, twist, x.get("floating_pose"), x.get("floating_twist"))


def _drives(chain: ClosedChain, inputs: Inputs, state: State, x: Mapping[str, Array]) -> dict[str, Array]:
    """Return the pieces of a sample, by the names of `Instants`."""
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs)
    Y = regressor_of(motion, state, x["qdd"], x.get("alpha", np.zeros(6)), x.get("base"), inputs)
    return {
        "links": _link_columns(chain, Y),
        "drives": Y.drives,
        "object": Y.object,
        "object_wrench": Y.object_wrench,
        "constraint": constraint_rows(motion).on_driven_base.matrix,
    }


def _wrists(chain: ClosedChain, inputs: Inputs, state: State, x: Mapping[str, Array]) -> dict[str, Array]:
    """Return the pieces of `at_wrists` in a sample."""
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs)
    pushed = with_force_elements(chain, state, inputs).object_wrench
    assert pushed is not None
    maps = [
        np.array([shift_wrench(c.offset, rotate(arm.at.tip.R, unit)) for unit in np.eye(6)]).T
        for c, arm in zip(motion.contacts, motion.holding, strict=True)
    ]
    Y = object_columns(state.object_frame, state.object_twist, x["alpha"] - pseudo_gravity(chain))
    return {"maps": np.hstack(maps), "object": Y, "object_wrench": pushed}


def _tips(chain: ClosedChain, inputs: Inputs, state: State, x: Mapping[str, Array]) -> dict[str, Array]:
    """Return the pieces of `tips` in a sample."""
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs)
    carried = motion.trunk.carried(x["qdd"], x.get("base"))
    arms = {name: motion.arms[name] for name in chain.grasps}
    return {
        "R": np.array([arm.at.tip.R for arm in arms.values()]),
        "p": np.array([arm.at.tip.p for arm in arms.values()]),
        "twists": np.array([arm.tip_twist for arm in arms.values()]),
        "accelerations": np.array(
            [tip_acceleration(arm, x["qdd"][chain.joints[name]], carried.get(name)) for name, arm in arms.items()]
        ),
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
