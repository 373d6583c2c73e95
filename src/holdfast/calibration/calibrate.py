"""Calibration of a chain from postures in which loops are closed or frames were measured; its result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.calibration.adjusted_chain import adjusted_chain
from holdfast.calibration.fit import Fit, fit, settled
from holdfast.calibration.geometry import adjusted
from holdfast.calibration.layout import FrameLayout, layout_of
from holdfast.calibration.noise import ClosureNoise
from holdfast.calibration.postures import Postures, postures_of
from holdfast.calibration.problem import Problem, evaluated, whitened
from holdfast.calibration.words import not_determined
from holdfast.errors import ModelError, StateError
from holdfast.identification.base_parameters import parts_kept
from holdfast.identification.joint_region import in_region
from holdfast.identification.notes import POORLY
from holdfast.identification.recording import Recording
from holdfast.identification.suspicions import positions_beyond_limits
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial import rotation
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

PostureSource = Postures | Recording | ArrayLike | str | PathLike[str]
LARGEST_WIDENING = 1.5  # factor of the covariance for dependent residuals, below which these may be noise of joints
CONTRADICTED = 6.0  # standard deviations by which the model's values fit worse, above which a note is added


@called
@dataclass(frozen=True, eq=False)
class Calibration(Frozen):
    """The adjusted chain, the corrections of the model, and their uncertainty.

    Attributes:
        chain: the chain with the corrections in place, for every other question.
        names: (p,) names of the unknowns, such as `base right shift z` or `offset left/joint2`.
        values: (p,) corrections to the model's values [rad or m]: turns are rotation vectors. Those of bases, grasps,
            loops, tips, markers and sensors are along the axes of what they stand on; those of joints along their own.
        covariance: (p, p) covariance of the values; 0 along directions that are not determined and have no prior.
        deviations: standard deviations by name; infinite for values that keep the model's, entirely or partly.
        kept: names of the values that are the model's, because the postures do not determine them.
        partly: names of values that are partly the model's, because only combinations of them are determined.
        undetermined: the directions that the postures do not determine, as sentences.
        errors: by name of a grasp, loop or measurement, root mean squares of the angles [rad] and lengths [m] that are
            still open after the fit; an object's pose is the one that fits best.
        held_out: the same for the postures that were held out; None if there were none.
        residuals: (postures, rows) the open angles and lengths; NaN where a closure did not hold.
        noise: standard deviations by channel, which weight the rows [rad or m]; if they were estimated, also those of
            the positions of turning and of sliding joints.
        freedoms: degrees of freedom by which estimated noise widens joint regions; infinite if it was given.
        misfit: mean square of the residuals in units of the noise; far above 1 if the noise was given too small or the
            unknowns do not explain the postures. 1 if the noise was estimated.
        weights: (postures,) weights of the postures; below 1 only with robust=True.
        markers: adjusted pose of the marker by measurement.
        sensors: adjusted pose of the sensor by measurement.
        notes: remarks, as text.
        problem: what was fitted, for `next_postures`.
        fitted: the estimate as it was found, likewise.
        model: the chain as it was given.
    """

    chain: ClosedChain
    names: tuple[str, ...]
    values: Array
    covariance: Array
    deviations: Mapping[str, float]
    kept: tuple[str, ...]
    partly: tuple[str, ...]
    undetermined: tuple[str, ...]
    errors: Mapping[Any, tuple[float, float]]
    held_out: Mapping[Any, tuple[float, float]] | None
    residuals: Array
    noise: Mapping[str, float]
    freedoms: float
    misfit: float
    weights: Array
    markers: Mapping[str, Pose]
    sensors: Mapping[str, Pose]
    notes: tuple[str, ...]
    problem: Problem = field(repr=False)
    fitted: Fit = field(repr=False)
    model: ClosedChain = field(repr=False)

    def __repr__(self) -> str:
        """Return the number of values and of postures; `print` shows all of them."""
        return f"<Calibration of {len(self.names)} values from {len(self.residuals)} postures>"

    def __str__(self) -> str:
        """Return a table of the values, followed by what is left open, undetermined directions and notes."""
        width, said = max(map(len, self.names)), dict.fromkeys(self.kept, "the model's")
        said |= dict.fromkeys(self.partly, "partly the model's")
        unit = ["rad" if one.turns else "m" for one in self.problem.layout.unknowns]
        lines = [
            f"{name:<{width}}  {value:>+12.6f} {of:<3}  {said.get(name, f'+- {self.deviations[name]:.2g}')}"
            for name, value, of in zip(self.names, self.values.tolist(), unit, strict=True)
        ]
        lines += [f"open at {_title(name)}: {_errors(*pair)}" for name, pair in self.errors.items()]
        lines += [f"held out, {_title(name)}: {_errors(*pair)}" for name, pair in (self.held_out or {}).items()]
        lines.append(f"misfit {self.misfit:.3g}: mean square of the residuals, in units of the noise")
        return "\n".join([*lines, *self.undetermined, *(f"note: {note}" for note in self.notes)])

    def holds(self, values: Mapping[str, float], level: float = 0.9) -> bool:
        """Return whether corrections lie in the joint region of the estimates, as `Identification.holds`. O(k^3).

        Args:
            values: k corrections by name.
            level: probability with which the region holds the truth.

        Raises:
            ModelError: a name is unknown or not determined, or the level is not between 0 and 1.
        """
        estimate = dict(zip(self.names, self.values.tolist(), strict=True))
        return in_region(estimate, self.covariance, self.freedoms, values, level, (*self.kept, *self.partly))

    def urdf_origins(self) -> dict[str, tuple[Array, Array]]:
        """Return xyz (3,) [m] and rpy (3,) [rad] of every joint's frame on its parent link, by `arm/joint`.

        These are the values of the `<origin>` elements of URDF files in which no fixed joints stand between the links;
        `calibration.write_urdf` writes them into any file.
        """
        return {
            name: (np.array(joint.placement.p), rotation.to_euler_zyx(joint.placement.R)[::-1].copy())
            for name, joint in zip(self.chain.joint_names(), self.chain.all_joints, strict=True)
        }

    def errors_of(self, postures: PostureSource) -> dict[Any, tuple[float, float]]:
        """Return root mean squares of what is open in other postures, with this calibration, as in `errors`.

        Measurements are compared by their names, with the markers and sensors of this calibration.
        """
        given = postures_of(postures, self.model, "errors_of: postures")
        here = problem_of(self.problem, given)
        return _rms(here.layout, np.where(here.active_rows, settled(here, self.fitted.x)[1].gaps, np.nan))


def calibrate(
    chain: ClosedChain,
    postures: PostureSource,
    seek: str | Sequence[str] = ("bases", "grasps"),
    *,
    prior: Mapping[str, float | tuple[float, float]] | None = None,
    noise: ClosureNoise | None = None,
    held_out: PostureSource | None = None,
    robust: bool = False,
    largest_deviation: float = 0.01,
) -> Calibration:
    """Estimate where bases, joints, grasps and sensors are, by weighted least squares over the open gaps of closures.

    In every posture the grasps and loops are closed, and measured frames are where they were seen:

        0 = gap(x, q + noise, y) + noise

    with the corrections x, and with poses y of the objects and floating bases, and of joints that were not measured,
    which are found along the way. Directions of x that the postures do not determine keep the model's values and are
    named in the result. O(steps postures rows^2 (p + n)), with exact derivatives.

    Args:
        chain: the model: arms, trunk, branches, grasps, loops. Bushings count as rigid; their yield is noise.
        postures: `Postures`, an array (postures, n) of joint positions, a `Recording`, or the path of a .csv or
            .parquet file; see `load_postures`.
        seek: what is sought: "bases", of all arms but the first one, because closures do not show where the whole cell
            stands; "grasps", the frames of all grasps of an object but the first one, likewise; "loops", frames of
            loops; "tips", tip frames; "offsets" of joints; "geometry", two turns and two shifts of every joint's axis;
            "markers" and "sensors" of measurements. One of a group is `group:name`, such as "bases:left" or
            "offsets:left/joint2"; of joints, also "offsets:left".
        prior: by group, or by `group:name`, the standard deviation of the model's values: one number [rad and m], or a
            pair for turns and shifts. The values of others are not known beforehand.
        noise: standard deviations of the errors. With None, those of angles and lengths of all closures, of every
            measurement, and of the positions of all joints, are estimated from the residuals. If residuals of
            successive postures depend on each other, they are not noise of joints: then covariances are increased.
        held_out: postures that are not used, for `Calibration.held_out`.
        robust: whether postures whose residuals exceed the noise count less, by Huber's weights.
        largest_deviation: a direction without a prior is estimated if its standard deviation is below this [rad or m].

    Returns:
        A `Calibration`.

    Raises:
        ModelError: it is not a chain, nothing is sought, or options contradict each other.
        StateError: postures do not match the chain, are too few, or gaps are so large that nothing fits.
        MethodNotApplicable: a grasp is a screw or a subspace.
        ResultError: a file cannot be read.

    Reference:
        Hollerbach, Khalil and Gautier, Springer Handbook of Robotics, ch. 8; `docs/how_to/calibration.md`.
    """
    checks.instance(chain, ClosedChain, "calibrate: chain")
    checks.instance(noise, (ClosureNoise, type(None)), "calibrate: noise")
    checks.instance(robust, bool, "calibrate: robust")
    largest = checks.number(largest_deviation, "calibrate: largest_deviation", above=0.0)
    given = postures_of(postures, chain, "calibrate: postures")
    layout = layout_of(chain, given.measured, seek)
    sizes, known = _sizes(layout, prior, largest)
    problem = problem_of(Problem(layout, given.q, np.zeros(0), noise, sizes, known, robust), given)
    _require_enough(problem)
    found = fit(problem)
    if noise is None and found.widening < LARGEST_WIDENING:  # errors of joints do not depend on the posture before
        problem = replace(problem, noisy_joints=True)
        found = fit(problem)
    return _calibration(chain, problem, found, held_out)


def problem_of(like: Problem, postures: Postures) -> Problem:
    """Return the same problem with other postures; measurements that were not made do not count."""
    meetings, active = [], np.ones((len(postures), len(like.layout.meetings)), bool)
    for m, meeting in enumerate(like.layout.meetings):
        if not meeting.measured:
            active[:, m] = postures.holds.get(meeting.name, True)
        elif meeting.name in postures.measured:
            one = postures.measured[meeting.name]
            meeting, active[:, m] = replace(meeting, target=one.targets), one.seen
            if one.posed != bool(len(meeting.turns)):
                raise StateError(f"measurement '{meeting.name}': expected poses throughout, or positions throughout")
        else:
            empty = np.tile(np.eye(3), (len(postures), 1, 1)), np.zeros((len(postures), 3))
            meeting, active[:, m] = replace(meeting, target=empty), False
        meetings.append(meeting)
    return replace(like, layout=replace(like.layout, meetings=tuple(meetings)), q=postures.q, active=active)


def _sizes(layout: FrameLayout, prior: Any, largest: float) -> tuple[Array, Array]:
    """Return the sizes of the unknowns, and 1 for those with a prior.

    Raises:
        ModelError: a prior is of nothing that is sought, or no standard deviation.
    """
    checks.instance(prior, (Mapping, type(None)), "calibrate: prior")
    sizes, known = np.full(len(layout.unknowns), largest), np.zeros(len(layout.unknowns))
    for key, value in sorted((prior or {}).items(), key=lambda pair: str(pair[0]).count(":")):
        pair = checks.numbers(np.broadcast_to(value, 2) if np.ndim(value) == 0 else value, (2,), f"prior: {key!r}")
        turn, shift = (checks.number(float(x), f"calibrate: prior: {key!r}", above=0.0) for x in pair)
        met = False
        for k, one in enumerate(layout.unknowns):
            arm = one.owner.partition("/")[0]
            if key in (one.group, f"{one.group}:{one.owner}", f"{one.group}:{arm}"):
                sizes[k], known[k], met = turn if one.turns else shift, 1.0, True
        if not met:
            sought = dict.fromkeys(name for one in layout.unknowns for name in (one.group, f"{one.group}:{one.owner}"))
            raise ModelError(f"calibrate: prior: nothing is sought in {key!r}.{checks.did_you_mean(str(key), sought)}")
    return sizes, known


def _require_enough(problem: Problem) -> None:
    """Refuse postures that leave no residuals, or of joints that cannot be sought."""
    for k in np.flatnonzero(np.isnan(problem.q).any(axis=0)).tolist():
        if k not in problem.position_of_freedom.tolist():
            raise StateError(f"calibrate: postures: q[:, {k}]: expected numbers for a spherical joint, got NaN")
    rows = problem.active_rows
    if not rows.any():
        raise StateError("calibrate: postures: expected at least one in which a closure holds, got none")
    at = problem.start(np.zeros(len(problem.sizes)))
    white = whitened(problem, evaluated(problem, at), problem.first_variances(), np.ones(len(rows)))
    if (white.U**2).sum() > rows.sum() - 0.5:
        raise StateError(
            "calibrate: postures: expected more closed directions than those by which the objects, floating bases and"
            f" unmeasured joints are found, got {rows.sum(axis=1).max()} in a posture; try a second grasp, or"
            " measurements"
        )


def _calibration(chain: ClosedChain, problem: Problem, found: Fit, held_out: Any) -> Calibration:
    """Return the result of a fit."""
    layout, x = problem.layout, found.x
    poses = {name: adjusted(layout, x)[k][0] for name, k in layout.names.items() if layout.frames[k].unknowns}
    names = tuple(one.name for one in layout.unknowns)
    kept, partly = parts_kept(found.null)
    deviations = np.where(kept | partly, np.inf, np.sqrt(np.maximum(np.diag(found.covariance), 0.0)))
    made = Calibration(
        chain=adjusted_chain(chain, poses),
        names=names,
        values=x,
        covariance=found.covariance,
        deviations=dict(zip(names, deviations.tolist(), strict=True)),
        kept=tuple(name for name, one in zip(names, kept, strict=True) if one),
        partly=tuple(name for name, one in zip(names, partly, strict=True) if one),
        undetermined=not_determined(found.weak, problem.sizes, layout.unknowns, problem.known),
        errors=_rms(layout, found.residuals),
        held_out=None,
        residuals=found.residuals,
        noise=dict(zip([*problem.channels[0], *problem.joint_channels[0]], found.noise.tolist(), strict=True)),
        freedoms=found.freedoms,
        misfit=found.misfit,
        weights=found.weights,
        markers=_of(poses, "marker "),
        sensors=_of(poses, "sensor "),
        notes=(*positions_beyond_limits(chain, problem.q), *_notes(problem, found)),
        problem=problem,
        fitted=found,
        model=chain,
    )
    return made if held_out is None else replace(made, held_out=made.errors_of(held_out))


def _of(poses: Mapping[str, Pose], kind: str) -> dict[str, Pose]:
    return {name.removeprefix(kind): pose for name, pose in poses.items() if name.startswith(kind)}


def _rms(layout: FrameLayout, gaps: Array) -> dict[Any, tuple[float, float]]:
    """Return root mean squares of the lengths of the angles and of the shifts of every meeting."""
    found, start = {}, 0
    for meeting in layout.meetings:
        middle, stop = start + len(meeting.turns), start + len(meeting.turns) + len(meeting.shifts)
        pair = []
        for part in (gaps[:, start:middle], gaps[:, middle:stop]):
            part = part[np.isfinite(part).all(axis=1)]
            pair.append(float(np.sqrt((part**2).sum(axis=1).mean())) if part.size else 0.0)
        found[meeting.name], start = tuple(pair), stop
    return found


def _notes(problem: Problem, found: Fit) -> list[str]:
    """Return remarks on the fit."""
    notes = []
    if problem.noise is not None and found.misfit > POORLY:
        notes.append(
            f"residuals are {np.sqrt(found.misfit):.2g} times the given noise: the unknowns do not explain the"
            " postures, or the noise is larger, and deviations are too small; try noise=None, or seek more"
        )
    if found.widening > 1.05:
        notes.append(
            f"residuals of successive postures depend on each other: deviations are increased"
            f" {np.sqrt(found.widening):.2g} times"
        )
    if found.contradicted > CONTRADICTED:
        notes.append(
            "along what is not determined, the model's values fit worse than others, by"
            f" {found.contradicted:.2g} standard deviations: try a better guess, or a larger largest_deviation="
        )
    if not found.settled:
        notes.append("the iteration did not converge: values are rough; try a better guess, a prior, or noise=")
    if (few := np.flatnonzero(found.weights < 0.5)).size:
        notes.append(f"postures {', '.join(map(str, few[:8].tolist()))} fit badly and count less")
    return notes


def _title(name: Any) -> str:
    return name if isinstance(name, str) else "/".join(name)


def _errors(turn: float, shift: float) -> str:
    return f"{1e3 * turn:.3g} mrad, {1e3 * shift:.3g} mm rms"
