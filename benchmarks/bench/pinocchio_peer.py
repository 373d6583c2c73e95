"""Pinocchio in its fastest settings: no conversion of lists in a call, preallocated data, one thread, tuned `lcaba`.

Its C++ library has further algorithms (`pv`, `constrainedABA`), which its Python package lacks. Pinocchio is optional
and is imported where it is used. Its spatial vectors are [linear; angular], ours are [angular; linear].

The problem is modelled in two ways:
    free: the object is a free body, one weld per arm (6 l rows);
    tree: the object is part of the first arm's hand, one weld for each other arm (6 (l - 1) rows).
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Iterable
from importlib import import_module
from typing import Any, Literal

import numpy as np

from benchmarks.bench.entries import ACCURATE, Answers, Candidate, Entry, relative_error
from benchmarks.bench.systems import System
from holdfast import Arm, Pose, Trunk
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array

LIBRARY = "pinocchio"
LARGE = 300e6  # bytes of Data above which its creation takes seconds
MUS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
ITERATIONS = (2, 3, 4, 5, 6, 8, 10)
MUS_IF_LARGE = (1e-5, 1e-6, 1e-7)
ITERATIONS_IF_LARGE = (3, 4, 6, 10)
UNREACHED = 1e-14  # requested accuracy, so low that only the iteration count matters
TRIAL = 0.05  # seconds of calls in which a setting must keep its accuracy, because errors build up in Data
PROBATION = 0.5  # the same for the chosen setting
MISSING_WRENCH = "without the wrench of the arm whose hand the object is part of"

Evaluate = Callable[[Any, Any, Any], Any]


def candidates(system: System) -> list[Candidate]:
    """Return every way to solve a system with Pinocchio; the first gives the reference solution."""
    memory = data_size(system)
    ways = [
        ("constraintDynamics, free", functools.partial(cholesky, system, "free")),
        ("constraintDynamics, tree", functools.partial(cholesky, system, "tree")),
        ("lcaba, free", functools.partial(lcaba, system, "free")),
        ("lcaba, tree", functools.partial(lcaba, system, "tree")),
        ("aba, no grasps", functools.partial(aba, system)),
    ]
    return [Candidate(name, LIBRARY, build, memory, exact=not i) for i, (name, build) in enumerate(ways)]


def data_size(system: System) -> int:
    """Return the approximate size of one Data, a few tensors of nv^3 doubles [bytes]."""
    return int(4.3 * 8 * (system.chain.joint_count + 6) ** 3)


def cholesky(system: System, form: Form, truth: Answers | None) -> Entry:
    """Return `constraintDynamics` with its default settings (mu = 0, exact)."""
    pin: Any = import_module("pinocchio")
    posed = PinocchioModel(system, form)
    model, welds, data, weld_data = posed.model, posed.welds, posed.model.createData(), posed.weld_data()
    pin.initConstraintDynamics(model, data, welds, weld_data)
    solve, inputs = pin.constraintDynamics, posed.inputs

    def sweep() -> None:
        for q, v, tau in inputs:
            solve(model, data, q, v, tau, welds, weld_data)

    def evaluate(q: Any, v: Any, tau: Any) -> Any:
        return solve(model, data, q, v, tau, welds, weld_data)

    note = "mu = 0" if form == "free" else f"mu = 0; {MISSING_WRENCH}"
    answers = functools.partial(posed.answers, evaluate, weld_data)
    return Entry(f"constraintDynamics, {form}", LIBRARY, sweep, system.states, note, answers=answers)


def lcaba(system: System, form: Form, truth: Answers | None) -> Entry:
    """Return `lcaba` with the fewest iterations, and the best mu, whose error stays below 1e-9 call after call.

    If there is no such setting, the most accurate one is returned.

    Args:
        system: the system.
        form: "free" or "tree".
        truth: the reference solution.
    """
    pin: Any = import_module("pinocchio")
    assert truth is not None
    posed = PinocchioModel(system, form)
    model, welds, inputs, solve = posed.model, posed.welds, posed.inputs, pin.lcaba

    def prepared(mu: float, iterations: int) -> tuple[Evaluate, Callable[[], None]]:
        data, weld_data = model.createData(), posed.weld_data()  # a bad setting spoils Data for every later call
        pin.computeJointMinimalOrdering(model, data, welds)
        settings = pin.ProximalSettings(UNREACHED, UNREACHED, mu, iterations)

        def sweep() -> None:
            for q, v, tau in inputs:
                solve(model, data, q, v, tau, welds, weld_data, settings)

        def evaluate(q: Any, v: Any, tau: Any) -> Any:
            return solve(model, data, q, v, tau, welds, weld_data, settings)

        return evaluate, sweep

    def error(mu: float, iterations: int, seconds: float) -> float:
        evaluate, sweep = prepared(mu, iterations)
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            sweep()
        return relative_error(posed.answers(evaluate).qdd, truth.qdd)

    large = data_size(system) > LARGE
    mus, counts = (MUS_IF_LARGE, ITERATIONS_IF_LARGE) if large else (MUS, ITERATIONS)
    mu, iterations = fewest_iterations(error, mus, counts)
    evaluate, sweep = prepared(mu, iterations)
    note = f"mu = {mu:g}, {iterations} iterations" + ("" if form == "free" else f"; {MISSING_WRENCH}")
    answers = functools.partial(posed.answers, evaluate)
    return Entry(f"lcaba, {form}", LIBRARY, sweep, system.states, note, answers=answers)


def fewest_iterations(
    error: Callable[[float, int, float], float], mus: Iterable[float], counts: Iterable[int]
) -> tuple[float, int]:
    """Return mu and the least number of iterations with an error below 1e-9; otherwise the most accurate pair.

    Args:
        error: function of mu, iterations and seconds that returns the error after so many seconds of calls.
        mus: values of mu to try.
        counts: numbers of iterations to try, in ascending order, because iterations cost time.
    """
    tried: dict[tuple[float, int], float] = {}
    for count in counts:
        row = {(mu, count): error(mu, count, TRIAL) for mu in mus}
        tried |= row
        for pair in sorted(row, key=row.__getitem__):
            if row[pair] <= ACCURATE and error(*pair, PROBATION) <= ACCURATE:
                return pair
    return min(tried, key=lambda pair: (math.isnan(tried[pair]), tried[pair]))


def aba(system: System, truth: Answers | None) -> Entry:
    """Return `aba` of the arms and the free object without grasps, a lower bound for every tree library."""
    pin: Any = import_module("pinocchio")
    posed = PinocchioModel(system, "free")
    model, data, inputs, solve = posed.model, posed.model.createData(), posed.inputs, pin.aba

    def sweep() -> None:
        for q, v, tau in inputs:
            solve(model, data, q, v, tau)

    answers = functools.partial(posed.answers, functools.partial(solve, model, data))
    return Entry("aba, no grasps", LIBRARY, sweep, system.states, "grasps left out", answers=answers, floor=True)


Form = Literal["free", "tree"]


class PinocchioModel:
    """A system as a Pinocchio model with its welds, and its states in Pinocchio's coordinates.

    Attributes:
        form: "free" or "tree".
        model: the Pinocchio model.
        welds: a StdVec of rigid constraints; a list would be converted in every call.
        inputs: q, v and tau of every state.
    """

    def __init__(self, system: System, form: Form) -> None:
        pin: Any = import_module("pinocchio")
        self.system, self.form = system, form
        chain = system.chain
        self.model = pin.Model()
        bodies = add_trunk(self.model, chain.trunk)
        on = {name: bodies[k] for name, k in chain.mounted_on.items()}
        last = {name: add_arm(self.model, arm, name, on.get(name, 0)) for name, arm in chain.arms.items()}
        tips = {name: se3(arm.tip) for name, arm in chain.arms.items()}
        frames = {name: se3(grasp.frame) for name, grasp in chain.grasps.items()}
        holder = next(iter(chain.arms))
        if form == "free":
            origin = pin.SE3.Identity()
            body = self.model.addJoint(0, pin.JointModelFreeFlyer(), origin, "object")
        else:
            body, origin = last[holder], tips[holder] * frames[holder].inverse()
        held = chain.held_object
        self.model.appendBodyToJoint(body, pin.Inertia(held.mass, np.array(held.com), np.array(held.inertia)), origin)
        free = np.zeros(6)
        drives = [*([free] if chain.floats else []), np.array([joint.armature for joint in chain.all_joints])]
        self.model.armature = np.concatenate(drives if form == "tree" else [*drives, free])
        self.model.gravity.linear = np.array(chain.gravity)
        self.welds = pin.StdVec_RigidConstraintModel()
        self.welded = [name for name in chain.grasps if form == "free" or name != holder]
        for name in self.welded:
            ends = (body, origin * frames[name], last[name], tips[name])
            self.welds.append(pin.RigidConstraintModel(pin.ContactType.CONTACT_6D, self.model, *ends, pin.LOCAL))
        self.inputs = [self._inputs(k) for k in range(system.states)]

    def _inputs(self, k: int) -> tuple[Array, Array, Array]:
        s = self.system
        parts = [(s.q[k], s.qd[k], s.tau[k])]
        if s.base_pose is not None and s.base_twist is not None:
            parts.insert(0, free_body(s.base_pose[k], s.base_twist[k]))
        if self.form == "free":
            parts.append(free_body(s.object_pose[k], s.object_twist[k]))
        q, v, tau = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        return q, v, tau

    def weld_data(self) -> Any:
        """Return new data of the welds."""
        pin: Any = import_module("pinocchio")
        data = pin.StdVec_RigidConstraintData()
        for weld in self.welds:
            data.append(weld.createData())
        return data

    def wrenches(self, weld_data: Any, k: int) -> Array:
        """Return (arms, 6) grasp wrenches at state k; NaN for the arm whose hand the object is part of."""
        chain, R = self.system.chain, rotation.from_quaternion(self.system.object_pose[k, :4])
        found = np.full((len(chain.arms), 6), np.nan)
        for name, data in zip(self.welded, weld_data, strict=True):
            world = R @ chain.grasps[name].frame.R
            force = data.contact_force  # on the first body, the object; contact axes
            found[chain.names.index(name)] = np.concatenate([world @ force.angular, world @ force.linear])
        return found

    def answers(self, evaluate: Any, weld_data: Any = None) -> Answers:
        """Return the results of `evaluate(q, v, tau)` at every state."""
        chain, qdd, wrenches = self.system.chain, [], []
        first = 6 if chain.floats else 0
        for k, given in enumerate(self.inputs):
            qdd.append(np.array(evaluate(*given)[first : first + chain.joint_count]))
            if weld_data is not None:
                wrenches.append(self.wrenches(weld_data, k))
        return Answers(np.array(qdd), np.array(wrenches) if wrenches else None)


def se3(pose: Any) -> Any:
    """Return a pose as a Pinocchio SE3."""
    pin: Any = import_module("pinocchio")
    return pin.SE3(np.array(pose.R), np.array(pose.p))


def free_body(pose: Array, twist: Array) -> tuple[Array, Array, Array]:
    """Return q, v and generalised forces, [linear; angular] in body axes, of a free flyer without a drive."""
    (w, x, y, z), p, R = pose[:4], pose[4:], rotation.from_quaternion(pose[:4])
    return np.concatenate([p, [x, y, z, w]]), np.concatenate([R.T @ twist[3:], R.T @ twist[:3]]), np.zeros(6)


def add_trunk(model: Any, trunk: Trunk | None) -> list[int]:
    """Append a trunk and return the number of the joint that moves each of its bodies."""
    pin: Any = import_module("pinocchio")
    bodies = []
    if trunk is not None and trunk.floating is not None:
        free, body = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base"), trunk.floating
        model.appendBodyToJoint(
            free, pin.Inertia(body.mass, np.array(body.com), np.array(body.inertia)), se3(Pose.identity())
        )
        bodies.append(free)
    if trunk is not None and trunk.serial is not None:
        serial = trunk.serial if trunk.floating is None else trunk.serial.at(Pose.identity())
        last = add_arm(model, serial, "trunk", bodies[0] if bodies else 0)
        bodies += range(last - trunk.joint_count + 1, last + 1)
    return bodies


def add_arm(model: Any, arm: Arm, name: str, parent: int = 0) -> int:
    """Append an arm to the world, or to the body moved by a joint, and return the number of its last joint."""
    pin: Any = import_module("pinocchio")
    # joints about a coordinate axis have cheaper models of their own
    aligned = dict(zip("xyz", (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ), strict=True))
    for k, (joint, link) in enumerate(zip(arm.joints, arm.links, strict=True)):
        placement = se3(joint.placement) if k else se3(arm.base) * se3(joint.placement)
        along = [axis for axis, unit in zip("xyz", np.eye(3), strict=True) if np.array_equal(joint.axis, unit)]
        kind = aligned[along[0]]() if along else pin.JointModelRevoluteUnaligned(np.array(joint.axis))
        parent = model.addJoint(parent, kind, placement, f"{name}/{k}")
        inertia = pin.Inertia(link.mass, np.array(link.com), np.array(link.inertia))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    return parent
