"""Recordings of a chain: joint positions, and torques or wrenches, in a sequence of samples."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from holdfast.errors import StateError
from holdfast.io.result_reader import Result
from holdfast.model import checks
from holdfast.model.held_object import HeldObject
from holdfast.model.serial_chain import serial_chain
from holdfast.names import called
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.frozen import NOT_GIVEN, REQUIRED, ArrayField, Frozen, OptionalArrayField
from holdfast.state import Inputs, State

FEWEST_SAMPLES = 8  # samples required by a spline of degree 7
FREE_BODIES = ("object", "base")
JOINT_ARRAYS = ("q", "qd", "qdd", "tau", "current", "used")
OF_RECORDINGS = ("current", "wrist_force", "used", "inputs", "added", "notes")  # what runs do not have


@called
@dataclass(frozen=True, eq=False)
class Recording(Frozen):
    """A recording; the first axis of every array is the sample. Arrays that were not recorded are None.

    Joint rates and accelerations that were not recorded are found by smoothing splines from the positions (or rates),
    which are smoothed as much as their noise calls for. An object motion that was not recorded is computed from the
    tips that hold the object rigidly.

    Attributes:
        t: (samples,) increasing times [s].
        q: (samples, n) joint positions [rad or m].
        qd: (samples, n) joint rates.
        qdd: (samples, n) joint accelerations.
        tau: (samples, n) joint torques [N m or N].
        current: (samples, n) currents of the drives, or other signals in proportion to their torques [A].
        wrist_wrench: (samples, arms, 6) [moment; force] that each arm exerts across its tip frame on the held body,
            about the tip's origin, tip axes [N m, N], as `forces.wrist_wrenches` returns it. The wrench of the object
            on the sensor has the opposite sign.
        wrist_force: (samples, arms, 3) the forces of `wrist_wrench` alone, of sensors without moments [N].
        object_pose: (samples, 7) wxyz_xyz of the object frame in the world.
        object_twist: (samples, 6) [omega; v of C], world axes.
        object_acceleration: (samples, 6) [omega_dot; v_dot of C], world axes.
        base_pose: (samples, 7) wxyz_xyz of a trunk's floating base in the world; a chain with such a base requires it
            and the base's twist and acceleration.
        base_twist: (samples, 6) [omega; v of its origin], world axes.
        base_acceleration: (samples, 6) [omega_dot; v_dot of its origin], world axes.
        used: (samples, n) 0 where a joint's torque or current is not to be used, else 1; all are used by default. Only
            `identify` with `unknowns` reads it.
        inputs: external wrenches and base motion, the same for all samples; zero by default.
        added: a known body that is fixed to the object in this recording, in object axes, for example a weight that
            tells the scale of torques; only `identify` with `unknowns` reads it.
        notes: remarks of the reader, such as rows that it dropped.
    """

    t: ArrayField = REQUIRED
    q: ArrayField = REQUIRED
    qd: OptionalArrayField = NOT_GIVEN
    qdd: OptionalArrayField = NOT_GIVEN
    tau: OptionalArrayField = NOT_GIVEN
    current: OptionalArrayField = NOT_GIVEN
    wrist_wrench: OptionalArrayField = NOT_GIVEN
    wrist_force: OptionalArrayField = NOT_GIVEN
    object_pose: OptionalArrayField = NOT_GIVEN
    object_twist: OptionalArrayField = NOT_GIVEN
    object_acceleration: OptionalArrayField = NOT_GIVEN
    base_pose: OptionalArrayField = NOT_GIVEN
    base_twist: OptionalArrayField = NOT_GIVEN
    base_acceleration: OptionalArrayField = NOT_GIVEN
    used: OptionalArrayField = NOT_GIVEN
    inputs: Inputs | None = None
    added: HeldObject | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "t", checks.vector(self.t, "recording: t", StateError))
        checks.instance(self.inputs, (Inputs, type(None)), "recording: inputs", StateError)
        checks.instance(self.added, (HeldObject, type(None)), "recording: added", StateError)
        if not isinstance(self.notes, list | tuple) or not all(isinstance(note, str) for note in self.notes):
            raise StateError("recording: notes: expected texts")
        put(self, "notes", tuple(self.notes))
        samples = len(self.t)
        if not samples or (np.diff(self.t) <= 0.0).any():
            raise StateError("recording: t: expected increasing times of at least one sample")
        q = checks.numbers(self.q, None, "recording: q", StateError)
        if q.ndim != 2:
            raise StateError(f"recording: q: expected shape (samples, joints), got shape {q.shape}")
        n = q.shape[1]
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(JOINT_ARRAYS, (samples, n))
        for body in FREE_BODIES:
            shapes |= {f"{body}_pose": (samples, 7)}
            shapes |= dict.fromkeys((f"{body}_twist", f"{body}_acceleration"), (samples, 6))
        for name, shape in shapes.items():
            if getattr(self, name) is not None:
                put(self, name, checks.numbers(getattr(self, name), shape, f"recording: {name}", StateError))
        for name, size in (("wrist_wrench", 6), ("wrist_force", 3)):
            if getattr(self, name) is not None:
                w = checks.numbers(getattr(self, name), None, f"recording: {name}", StateError)
                if w.ndim != 3 or w.shape[::2] != (samples, size):
                    raise StateError(
                        f"recording: {name}: expected shape ({samples}, arms, {size}), got shape {w.shape}"
                    )
                put(self, name, w)

    def __len__(self) -> int:
        return len(self.t)

    def part(self, chosen: Any) -> Recording:
        """Return some of the samples, by a mask, a slice or indices."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("inputs", "added", "notes")}
        return replace(self, **{name: x[chosen] for name, x in arrays.items() if x is not None})

    def with_notes(self, *notes: str) -> Recording:
        """Return the recording with further remarks."""
        return replace(self, notes=(*self.notes, *notes))

    @staticmethod
    def of_run(run: Trajectory | Result, inputs: Inputs | None = None) -> Recording:
        """Return a simulated run, or a result of `load_result`, as a recording.

        Args:
            run: a run in which no grasp closes or opens.
            inputs: the inputs of the run, which it does not contain.

        Raises:
            StateError: it is not a run, or grasps close or open in it.
            MethodNotApplicable: it is of a chain that is answered as a forest.
        """
        if isinstance(run, Result):
            run = run.trajectory
        checks.instance(run, Trajectory, "recording: run", StateError)
        if run.setting is not None:
            serial_chain(run.setting.chain, "recording: run: chain")
        if (run.holding != run.holding[0]).any():
            k = int(np.flatnonzero((run.holding != run.holding[0]).any(axis=1))[0])
            raise StateError(
                f"recording: expected the same grasps throughout, but they change at {run.t[k]:.9g} s; try a"
                " Recording of the arrays before and another of those after"
            )
        names = [f.name for f in fields(Recording) if f.name not in OF_RECORDINGS]
        if not run.base_pose.shape[1]:
            names = [name for name in names if not name.startswith("base_")]
        given: dict[str, Any] = {name: getattr(run, name) for name in names}
        return Recording(**given, inputs=inputs)

    def state(self, k: int) -> State:
        """Return the state in a sample; the recording must have the object's motion."""
        pose, twist = self.object_pose, self.object_twist
        assert self.qd is not None and pose is not None and twist is not None
        return self.on_base(k, State(self.q[k], self.qd[k], pose[k], twist[k]))

    def on_base(self, k: int, state: State) -> State:
        """Return a state with the pose and twist of the floating base in a sample, if they were recorded."""
        if self.base_pose is None:
            return state
        twist = None if self.base_twist is None else self.base_twist[k]
        return replace(state, base_pose=self.base_pose[k], base_twist=twist)
