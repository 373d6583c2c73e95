"""Questions about forces in case files: which torques and grasp wrenches, under limits?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.forces.acceleration_map import acceleration_map, motion_without_torques, scaled_map
from holdfast.forces.affine_map import AccelerationTask
from holdfast.forces.force_question import ForceQuestion
from holdfast.forces.limit_rows import Limit, limit_rows
from holdfast.forces.limits import ForceCost, ForceLimits
from holdfast.forces.programmes import costs
from holdfast.io import force_case_data
from holdfast.io.case_mechanism import mechanism
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Friction, Grasp, WrenchLimits
from holdfast.model.grasp_kinds import GRASP_KINDS
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class ForceCase:
    """A question about forces, ready to be asked.

    Attributes:
        name: its name.
        chain: arms, object and grasps.
        state: positions and velocities.
        inputs: base motion.
        rates: relative rates W in the file, flat; None if it gives none.
        form: "effort", "margin", "peak" or "scale".
        asked: what is asked of the object; for a scale, its acceleration at sigma = 0.
        more: (6,) change of the acceleration per unit of sigma; None but for a scale.
        cost: the cost.
        limits: the limits.
        force: F0, the unit of forces [N].
        expected: the answer, if the file contains one.
    """

    name: str
    chain: ClosedChain
    state: State
    inputs: Inputs
    rates: Array | None
    form: force_case_data.ForceForm
    asked: AccelerationTask
    more: Array | None
    cost: ForceCost
    limits: ForceLimits
    force: float
    expected: force_case_data.ForceExpected | None

    def question(self) -> ForceQuestion:
        """Return the question as cone programmes, in which forces that no joint feels may be chosen, too.

        Raises:
            StateError: the arms cannot give the object this acceleration.
        """
        motion = motion_without_torques(self.chain, self.state, self.inputs.shaped(self.chain))
        if self.more is None:
            found, v1 = acceleration_map(motion, self.asked, free_unfelt=True, force=self.force), None
        else:
            found, v1 = scaled_map(motion, self.asked, self.more, free_unfelt=True, force=self.force)
        return ForceQuestion(self.state, found, limit_rows(found, self.state, self.limits), costs(found, self.cost), v1)


def listed_name(limit: Limit) -> str:
    """Return the name of a limit as case files list it."""
    joint = limit.of.rpartition("/joint")
    if limit.what == "effort":
        return f"{joint[0]}/{joint[2]} at its {limit.side} limit"
    if limit.what == "acceleration":
        return f"{limit.of} accelerates at its {limit.side} limit"
    side = f"{limit.side} " if limit.side else ""
    return f"{side}{limit.what.removesuffix(' force')} of {limit.of}"


def build_force_case(data: force_case_data.ForceCaseData, source: str = "case", root: str = "$") -> ForceCase:
    """Return a question about forces from its typed data.

    Raises:
        SceneError: it is invalid; the message gives the JSON path of the first fault.
    """
    at = Location(source, root)
    with np.errstate(all="ignore"):  # of numbers near the end of float64's range, as for other cases
        found = mechanism(data, at, _grasp)
    chain, asked = found.chain, data.question
    where = at / "question"
    more = None
    with where.refusals():
        rows = np.eye(6) if asked.task is None else np.array(asked.task).reshape(-1, 6)
        wanted = AccelerationTask(rows, checks.numbers(asked.acceleration, (len(rows),), "question: acceleration"))
        force = checks.number(asked.force_scale, "question: force_scale", above=0.0)
        if (asked.form == "scale") != (asked.hold is not None):
            raise (where / "hold").refuse("expected the acceleration at sigma = 0 for a scale, and for nothing else")
        if asked.hold is not None:
            if asked.task is not None:
                raise (where / "task").refuse("expected none for a scale, which asks for the whole acceleration")
            hold = np.array(asked.hold)
            wanted, more = AccelerationTask(rows, hold), wanted.values - hold
        cost = ForceCost(wrench=asked.eps_force, acceleration=asked.eps_acceleration, wish=_wish(data, where / "wish"))
        grasps = {name: arm.grasp for name, arm in zip(chain.arms, data.arms, strict=True) if arm.grasp is not None}
        limits = ForceLimits(
            least_normal={name: g.least_normal for name, g in grasps.items() if g.least_normal is not None},
            most_normal={name: g.most_normal for name, g in grasps.items() if g.most_normal is not None},
            acceleration=_accelerations(data, chain, where / "acceleration_limits"),
        )
    _check_expected(data, chain, at / "expected")
    return ForceCase(
        data.name,
        chain,
        found.state,
        found.inputs,
        found.rates,
        asked.form,
        wanted,
        more,
        cost,
        limits,
        force,
        data.expected,
    )


def _grasp(data: force_case_data.ForceGrasp, at: Location) -> Grasp:
    freedoms = len(GRASP_KINDS[data.type].free)
    if data.W is not None and len(data.W) != freedoms:
        raise (at / "W").refuse(f"expected {freedoms} relative rates for a {data.type}, got {len(data.W)}")
    with at.refusals():
        frame = Pose(checks.rotation_matrix(data.frame_object, "grasp: frame_object"), np.array(data.point_object))
        given, strength = data.friction, data.wrench_limits
        friction = None
        if given is not None:
            friction = Friction(given.mu, given.torsion_radius, given.half_length, given.half_lengths)
        limits = None if strength is None else WrenchLimits(strength.moment, strength.force)
        return Grasp(data.type, frame, friction, limits)


def _wish(data: force_case_data.ForceCaseData, at: Location) -> Array:
    """Return the wished wrenches, (arms, 6), contact axes."""
    wish = np.zeros((len(data.arms), 6))
    for index, wrench in data.question.wish.items():
        if not index.isdecimal() or int(index) >= len(wish):
            raise (at / index).refuse(f"expected an index of an arm, 0 .. {len(wish) - 1}, got {checks.short(index)}")
        wish[int(index)] = wrench
    return wish


def _accelerations(
    data: force_case_data.ForceCaseData, chain: ClosedChain, at: Location
) -> dict[str, tuple[float, float]]:
    """Return the limits on accelerations by joint."""
    first, names = 6 if chain.floats else 0, chain.joint_names()
    found = {}
    for k, (_, row, low, high) in enumerate(data.question.acceleration_limits):
        if not 0 <= row - first < len(names):
            raise (at / k).refuse(f"expected an index of a joint, {first} .. {first + len(names) - 1}, got {row}")
        found[names[row - first]] = (low, high)
    return found


def _check_expected(data: force_case_data.ForceCaseData, chain: ClosedChain, at: Location) -> None:
    """Refuse an answer whose shape does not match the question."""
    if data.expected is None:
        return
    n = chain.joint_count + (6 if chain.floats else 0)
    for key, count in (("tau", n), ("qdd", n), ("f", len(data.arms))):
        given = getattr(data.expected, key)
        if given is not None and len(given) != count:
            raise (at / key).refuse(f"expected {count} entries, got {len(given)}")
