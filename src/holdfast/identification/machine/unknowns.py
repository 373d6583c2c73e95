"""The unknowns of a machine: their names, their priors, and how equations and reported values depend on them.

The coordinates z are ten log-Cholesky numbers for each body, then what is linear, then gains or scales, then the time
offset. Equations are linear in x: the inertial parameters of the bodies instead of their coordinates. Reported are
plain values: mass, mass centre, inertia about it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from holdfast.dynamics.regressor import inertial_parameters
from holdfast.errors import ModelError
from holdfast.identification.machine.log_cholesky import body_at, no_thinner, reference_factor
from holdfast.identification.machine.prior import Prior
from holdfast.identification.payload_unknowns import PARAMETER_NAMES, WRENCH_AXES, plain_body, plain_slopes
from holdfast.identification.rows import NOT_NEGATIVE, ON_DRIVES, ON_JOINTS, ON_WRISTS, Terms, named_bodies, terms_of
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

GAINS = ("drive_gain", "sensor_scale")
# by what is measured, the kinds of unknowns that it can tell, in the order of the unknowns
KINDS = {
    "tau": ("payload", "links", *ON_JOINTS, "time_offset"),
    "current": ("payload", "links", *ON_JOINTS, "drive_gain", "time_offset"),
    "wrist_wrench": ("payload", *ON_WRISTS, "sensor_scale", "time_offset"),
    "wrist_force": ("payload", *ON_WRISTS, "sensor_scale", "time_offset"),
}
USUAL_SCALE, USUAL_TIME_OFFSET = 0.3, 0.02  # deviations of a sensor's scale, and of time offsets [s]
OF_TORQUE = {"armature": 0.05, "damping": 0.1, "friction": 0.1, "friction_offset": 0.1, "friction_asymmetry": 0.1}


@dataclass(frozen=True, eq=False)
class MachineUnknowns(Terms):
    """The unknowns of a chain.

    Attributes:
        names: (p,) names of the plain values.
        kind_of: (p,) the kind of each.
        roots: (bodies, 4, 4) factors of the model's bodies: the object if it is unknown, then links.
        start: (p,) coordinates of the prior's mean, which are 0 for bodies.
        spread: (p,) standard deviations of the prior.
        lowest: (p,) lower bounds of the coordinates.
        left_out: names of links that have no mass and stay as they are.
    """

    names: tuple[str, ...]
    kind_of: tuple[str, ...]
    roots: Array
    start: Array
    spread: Array
    lowest: Array
    left_out: tuple[str, ...]

    def where(self, kind: str) -> Array:
        """Return the indices of a kind of unknowns."""
        return np.flatnonzero([one == kind for one in self.kind_of])

    @property
    def linear(self) -> int:
        """The number of coordinates that the equations have as x: all but gains and time offsets."""
        return sum(kind not in (*GAINS, "time_offset") for kind in self.kind_of)

    def x(self, z: Array) -> tuple[Array, Array]:
        """Return x (linear,) and its derivatives by the first coordinates, (linear, linear)."""
        value, slope = z[: self.linear].copy(), np.eye(self.linear)
        for k, root in enumerate(self.roots):
            of = slice(10 * k, 10 * k + 10)
            value[of], slope[of, of] = body_at(root, z[of])
        return value, slope

    def friction_of_features(self) -> Array:
        """Return (n, features) by which the features [x, 1] give the sizes of the joints' dry friction."""
        sizes, columns = self.model_joints["friction"], self.friction_columns()
        found = np.zeros((len(sizes), self.linear + 1))
        if len(columns):
            found[np.arange(len(sizes)), columns] = 1.0
        elif self.by in ON_DRIVES:
            found[:, -1] = sizes
        return found

    def gain(self, z: Array, channels: int) -> Array:
        """Return the factors of the measurements, (channels,)."""
        return z[np.isin(self.kind_of, GAINS)] if set(self.kinds) & set(GAINS) else np.ones(channels)

    def delay(self, z: Array) -> float:
        """Return the time offset [s]."""
        return float(z[-1]) if "time_offset" in self.kinds else 0.0

    def away_from_bounds(self, z: Array) -> Array:
        """Return coordinates with bodies as extended as a deviation above the prior's mean, for use of their slopes.

        Where a body is thin, its coordinates hardly move it: a covariance with these slopes would take it for known.
        """
        found = z.copy()
        for k in range(len(self.roots)):
            of = slice(10 * k, 10 * k + 10)
            found[of] = no_thinner(z[of], float(np.exp(self.spread[10 * k])))
        return found

    def plain(self, z: Array, around: Array | None = None) -> tuple[Array, Array]:
        """Return the reported values, (p,), and their derivatives by coordinates around z or others, (p, p)."""
        value, slope = z.copy(), np.eye(len(z))
        for k, root in enumerate(self.roots):
            of = slice(10 * k, 10 * k + 10)
            pi, by = body_at(root, z[of])
            by = by if around is None else body_at(root, around[of])[1]
            value[of], slope[of, of] = plain_body(pi), plain_slopes(pi) @ by
        return value, slope


def machine_unknowns(
    chain: ClosedChain, by: str, kinds: tuple[str, ...], prior: Prior, y: Array, gains: Array, duration: float
) -> MachineUnknowns:
    """Return the unknowns of some kinds.

    Args:
        chain: the model.
        by: what is measured.
        kinds: the kinds.
        prior: its uncertainty.
        y: (samples, channels) all measurements.
        gains: (channels,) guesses of the gains; 1 without.
        duration: the longest recording [s].
    """
    kinds = tuple(kind for kind in KINDS[by] if kind in kinds)
    sizes = np.maximum(np.abs(y * gains).max(axis=0), 1e-9)
    joints, wrists = chain.joint_names(), [f"'{name}', {axis}" for name in chain.grasps for axis in WRENCH_AXES]
    if by == "wrist_force":
        wrists = [name for name in wrists if "force" in name]
    if by in ON_DRIVES:
        effort = np.array([joint.effort_limit for joint in chain.freedoms])
        sizes = np.where(np.isfinite(effort), effort, sizes)
    model = terms_of(chain, by, kinds)
    names: list[str] = []
    kind_of: list[str] = []
    roots: list[Array] = []
    start: list[float] = []
    spread: list[float] = []

    def add(kind: str, titles: list[str], mean: Array, usual: Array) -> None:
        names.extend(titles)
        kind_of.extend([kind] * len(titles))
        start.extend(mean.tolist())
        spread.extend(prior.deviations(kind, usual).tolist())

    links: list[int] = []
    left_out: list[str] = []
    for kind in kinds:
        if kind == "payload":
            root = reference_factor(inertial_parameters(chain.held_object))
            if root is None:
                raise ModelError("identify: object: expected a guess with mass and extents; try HeldObject.box")
            roots.append(root)
            add(kind, list(PARAMETER_NAMES), np.zeros(10), np.full(10, prior.payload))
        elif kind == "links":
            for k, (name, link) in enumerate(named_bodies(chain)):
                root = reference_factor(inertial_parameters(link))
                if root is None:
                    left_out.append(name)
                    continue
                links.append(k)
                roots.append(root)
                add(kind, [f"{name} {one}" for one in PARAMETER_NAMES], np.zeros(10), np.full(10, prior.links))
        elif kind in ON_JOINTS:
            title = kind.replace("_", " ")
            add(kind, [f"{joint} {title}" for joint in joints], model.model_joints[kind], OF_TORQUE[kind] * sizes)
        elif kind == "drive_gain":
            add(kind, [f"{joint} drive gain" for joint in joints], gains, np.maximum(np.abs(gains), 1e-9))
        elif kind == "time_offset":
            add(kind, ["time offset"], np.zeros(1), np.array([USUAL_TIME_OFFSET]))
        else:
            title = kind.replace("_", " ")
            usual = {
                "sensor_offset": 0.1 * sizes,
                "sensor_drift": 0.1 * sizes / max(duration, 1e-9),
                "sensor_scale": np.full(len(wrists), USUAL_SCALE),
            }
            mean = np.ones(len(wrists)) if kind == "sensor_scale" else np.zeros(len(wrists))
            add(kind, [f"{title} of {one}" for one in wrists], mean, usual[kind])
    positive = np.isin(kind_of, NOT_NEGATIVE)
    return MachineUnknowns(
        **vars(replace(model, links=links)),
        names=tuple(names),
        kind_of=tuple(kind_of),
        roots=np.array(roots).reshape(-1, 4, 4),
        start=np.array(start),
        spread=np.array(spread),
        lowest=np.where(positive, 0.0, -np.inf),
        left_out=tuple(left_out),
    )


def required_kinds(unknowns: object, by: str, chain: ClosedChain) -> tuple[str, ...]:
    """Return the kinds of unknowns that a user asks for; refuse what the measurements cannot tell."""
    checks.instance(unknowns, (list, tuple), "identify: unknowns")
    known = dict.fromkeys(kind for kinds in KINDS.values() for kind in kinds)
    for kind in unknowns:  # pyright: ignore[reportGeneralTypeIssues]
        if not isinstance(kind, str) or kind not in known:
            raise ModelError(f"identify: unknowns: expected names among {', '.join(known)}; got {checks.short(kind)}")
        if kind not in KINDS[by]:
            able = [one for one, kinds in KINDS.items() if kind in kinds]
            raise ModelError(f"identify: unknowns: '{kind}' cannot be told by='{by}'; try by='{able[0]}'")
        if kind == "payload" and not chain.grasps:
            raise ModelError("identify: unknowns: expected an arm that holds the object for 'payload', got none")
    if not unknowns:
        raise ModelError("identify: unknowns: expected at least one, got none")
    return tuple(unknowns)  # pyright: ignore[reportArgumentType]
