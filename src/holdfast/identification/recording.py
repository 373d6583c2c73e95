"""What was recorded of a chain: joints, and torques or wrenches, at a row of instants."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from holdfast.errors import StateError
from holdfast.io.result_reader import Result
from holdfast.model import checks
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.converted import NOT_GIVEN, REQUIRED, ArrayField, OptionalArrayField
from holdfast.spatial.frozen import Frozen
from holdfast.state import Inputs, State

FEWEST = 6  # samples that a spline of fifth order needs
FREE_BODIES = ("object", "base")


@dataclass(frozen=True, eq=False)
class Recording(Frozen):
    """A recording; the first axis of every array is the sample. What is None was not recorded.

    Rates and accelerations of joints that were not recorded are those of a spline of fifth order through the positions
    (or rates), which smooths nothing: filter noisy positions beforehand. The object's motion that was not recorded is
    that of the tips which hold it rigidly.

    Attributes:
        t: (samples,) increasing times [s].
        q: (samples, n) joint positions [rad or m].
        qd: (samples, n) their rates.
        qdd: (samples, n) their accelerations.
        tau: (samples, n) joint torques [N m or N].
        wrist_wrench: (samples, arms, 6) [moment; force] of each arm across its tip frame on what it holds, about the
            tip's origin, tip axes [N m, N], as `forces.wrist_wrenches` returns it; what the object does to the
            sensor has its sign turned.
        object_pose: (samples, 7) wxyz_xyz of the object frame in the world.
        object_twist: (samples, 6) [omega; v of C], world axes.
        object_acceleration: (samples, 6) [omega_dot; v_dot of C], world axes.
        base_pose: (samples, 7) wxyz_xyz of a trunk's floating base in the world; it and its motion are needed with one.
        base_twist: (samples, 6) [omega; v of its origin], world axes.
        base_acceleration: (samples, 6) [omega_dot; v_dot of its origin], world axes.
        inputs: external wrenches and base motion, the same for all samples; zero by default.
    """

    t: ArrayField = REQUIRED
    q: ArrayField = REQUIRED
    qd: OptionalArrayField = NOT_GIVEN
    qdd: OptionalArrayField = NOT_GIVEN
    tau: OptionalArrayField = NOT_GIVEN
    wrist_wrench: OptionalArrayField = NOT_GIVEN
    object_pose: OptionalArrayField = NOT_GIVEN
    object_twist: OptionalArrayField = NOT_GIVEN
    object_acceleration: OptionalArrayField = NOT_GIVEN
    base_pose: OptionalArrayField = NOT_GIVEN
    base_twist: OptionalArrayField = NOT_GIVEN
    base_acceleration: OptionalArrayField = NOT_GIVEN
    inputs: Inputs | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "t", checks.vector(self.t, "recording: t", StateError))
        checks.instance(self.inputs, (Inputs, type(None)), "recording: inputs", StateError)
        samples = len(self.t)
        if not samples or (np.diff(self.t) <= 0.0).any():
            raise StateError("recording: t: expected increasing times of at least one sample")
        q = checks.numbers(self.q, None, "recording: q", StateError)
        if q.ndim != 2:
            raise StateError(f"recording: q: expected shape (samples, joints), got shape {q.shape}")
        n = q.shape[1]
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("q", "qd", "qdd", "tau"), (samples, n))
        for body in FREE_BODIES:
            shapes |= {f"{body}_pose": (samples, 7)}
            shapes |= dict.fromkeys((f"{body}_twist", f"{body}_acceleration"), (samples, 6))
        for name, shape in shapes.items():
            if getattr(self, name) is not None:
                put(self, name, checks.numbers(getattr(self, name), shape, f"recording: {name}", StateError))
        if self.wrist_wrench is not None:
            w = checks.numbers(self.wrist_wrench, None, "recording: wrist_wrench", StateError)
            if w.ndim != 3 or w.shape[::2] != (samples, 6):
                raise StateError(f"recording: wrist_wrench: expected shape ({samples}, arms, 6), got shape {w.shape}")
            put(self, "wrist_wrench", w)

    def __len__(self) -> int:
        return len(self.t)

    @staticmethod
    def of_run(run: Trajectory | Result, inputs: Inputs | None = None) -> Recording:
        """Return a simulated run, or one that `load_result` read, as a recording.

        Args:
            run: a run whose grasps stay as they are.
            inputs: what it was given, which a run does not hold.

        Raises:
            StateError: no run, or one in which grasps close or open.
        """
        if isinstance(run, Result):
            run = run.trajectory
        checks.instance(run, Trajectory, "recording: run", StateError)
        if (run.holding != run.holding[0]).any():
            k = int(np.flatnonzero((run.holding != run.holding[0]).any(axis=1))[0])
            raise StateError(
                f"recording: expected the same grasps throughout, but they change at {run.t[k]:.9g} s; try a"
                " Recording of the arrays before and another of those after"
            )
        names = [f.name for f in fields(Recording) if f.name != "inputs"]
        if not run.base_pose.shape[1]:
            names = [name for name in names if not name.startswith("base_")]
        given: dict[str, Any] = {name: getattr(run, name) for name in names}
        return Recording(**given, inputs=inputs)

    def state(self, k: int) -> State:
        """Return the state in a sample of a recording that has the object's motion."""
        pose, twist = self.object_pose, self.object_twist
        assert self.qd is not None and pose is not None and twist is not None
        return self.on_base(k, State(self.q[k], self.qd[k], pose[k], twist[k]))

    def on_base(self, k: int, state: State) -> State:
        """Return a state with the floating base where it is in a sample, if it was recorded."""
        if self.base_pose is None:
            return state
        twist = None if self.base_twist is None else self.base_twist[k]
        return replace(state, base_pose=self.base_pose[k], base_twist=twist)
