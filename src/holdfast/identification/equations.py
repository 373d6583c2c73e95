"""The equations of the identification, which are linear in features: the unknowns and some of their products.

With known gravity the features are [pi; b; 1], otherwise [pi; g_x pi; g_y pi; g_z pi; b; 1; g]:

    rows @ features(x) = -maps @ noise,    x = [pi; b; tilt]

Here pi are the object's ten inertial parameters about the model's mass centre, object axes, so that the rows are well
conditioned; b are the offsets of the wrist sensors; tilt rotates gravity. Wrist wrenches give six rows per sample,
about C,

    Y_C pi + sum X_i b_i - (sum X_i m_i + w) = -sum X_i noise_i,     X_i from the tip of arm i to C

and torques give as many rows as the chain has degrees of freedom. With N, a basis of the chain's motions, along which
grasp forces do no work, these are

    N_C^T (Y_C pi - w) + N_q^T (M qdd + C + damping qd + friction + ... - tau) = -N_q^T noise

A floating base stays where it is in the motions N, while the base itself moves as recorded. Other motions would add the
balance of the base, in which no measurement has a share: it would count as exact, and is not, since rates and
accelerations of base and joints are measured or smoothed.

The unknowns have two sets of coordinates. The equations are linear in products of the entries of x; plain quantities

    xi = [m; c; I about c; b; tilt]

are reported, and keep the model's values where they are not identified. c is relative to the model's mass centre.
Gravity is tilted by g = |g| (n + E tilt) / |n + E tilt|.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion
from holdfast.dynamics.closed.force_elements import with_force_elements
from holdfast.dynamics.constraint import constraint_rows
from holdfast.dynamics.inverse import trunk_torques
from holdfast.dynamics.regressor import UNIT_BODIES, object_columns
from holdfast.identification.recording import Recording
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.joint_friction import friction_torque, joint_friction
from holdfast.spatial.inertia import PARAMETERS
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate, shift_wrench
from holdfast.state import Inputs, State

PARAMETER_NAMES = ("mass", "com x", "com y", "com z", *(f"inertia {name[1:]}" for name in PARAMETERS[4:]))
WRENCH_AXES = ("moment x", "moment y", "moment z", "force x", "force y", "force z")
ENTRIES = np.triu_indices(3)  # of I among the parameters


@dataclass(frozen=True)
class Settings:
    """What is to be found besides the payload.

    Attributes:
        source: "wrist_wrench" or "tau".
        sensor_bias: whether wrist sensors have offsets.
        gravity: whether gravity's direction is unknown.
    """

    source: str
    sensor_bias: bool
    gravity: bool


@dataclass(frozen=True, eq=False)
class Equations:
    """The rows of all samples.

    Attributes:
        rows: (samples, r, features) coefficients of the features.
        motions: (samples, r, freedoms) orthonormal, along which the rows are: of joints and object; with wrists, axes
            at C.
        maps: (samples, r, channels) from the noise of the channels to the rows.
        measured: (samples, channels) measurements [N m, N].
        kept: by recording, which samples these are. Others are left out because their configuration is singular, so
            that the number of degrees of freedom differs.
    """

    rows: Array
    motions: Array
    maps: Array
    measured: Array
    kept: list[Array]

    @property
    def left_out(self) -> int:
        """The number of samples that are left out."""
        return sum(int((~one).sum()) for one in self.kept)


def equations(chain: ClosedChain, recordings: list[Recording], settings: Settings) -> Equations:
    """Return the equations of completed recordings. O(samples n), with torques O(samples n^3)."""
    found = [rows_of_samples(chain, recording, settings) for recording in recordings]
    usual = Counter(len(one[0]) for part in found for one in part).most_common(1)[0][0]
    kept = [np.array([len(one[0]) == usual for one in part]) for part in found]
    used = [one for part in found for one in part if len(one[0]) == usual]
    rows, motions, maps, measured = (np.array(part) for part in zip(*used, strict=True))
    return Equations(rows, motions, maps, measured, kept)


def rows_of_samples(chain: ClosedChain, recording: Recording, settings: Settings) -> list[tuple[Array, ...]]:
    """Return rows, motions, maps and measurements of each sample."""
    of_sample = wrist_rows if settings.source == "wrist_wrench" else torque_rows
    return [of_sample(chain, recording, k, settings) for k in range(len(recording))]


def wrist_rows(chain: ClosedChain, recording: Recording, k: int, settings: Settings) -> tuple[Array, ...]:
    """Return rows, motions, maps and measurements of a sample, from wrist wrenches."""
    assert recording.wrist_wrench is not None
    state, alpha, inputs = _sample(chain, recording, k)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), inputs)
    known = with_force_elements(chain, state, inputs).object_wrench
    assert known is not None
    places = [chain.names.index(name) for name in chain.grasps]
    measured = recording.wrist_wrench[k][places]
    X = np.hstack([
        np.array([shift_wrench(c.offset, rotate(arm.at.tip.R, unit)) for unit in np.eye(6)]).T
        for c, arm in zip(motion.contacts, motion.holding, strict=True)
    ])  # fmt: skip
    right = known + X @ measured.ravel()
    bias = X if settings.sensor_bias else np.zeros((6, 0))
    columns = _object_columns(chain, state, alpha, settings)
    last = [-right[:, None]] + ([np.zeros((6, 3))] if settings.gravity else [])
    return np.hstack([*columns, bias, *last]), np.eye(6), X, measured.ravel()


def torque_rows(chain: ClosedChain, recording: Recording, k: int, settings: Settings) -> tuple[Array, ...]:
    """Return the rows that joint torques give at a sample, their motions, their maps and their measurements."""
    assert recording.tau is not None and recording.qd is not None and recording.qdd is not None
    state, alpha, inputs = _sample(chain, recording, k)
    qdd, tau, n = recording.qdd[k], recording.tau[k], chain.joint_count

    def moved(gravity: Array) -> ChainMotion:
        return chain_motion(replace(chain, gravity=gravity), state, np.zeros(n), inputs)

    base = None if recording.base_acceleration is None else recording.base_acceleration[k]

    def needed(motion: ChainMotion) -> Array:
        """Return the torques that trunk and arms need without the object."""
        none = np.zeros((len(chain.arms), 6))
        return trunk_torques(motion, qdd, none, base).tau

    motion = moved(np.zeros(3) if settings.gravity else chain.gravity)
    assert motion.object_case is not None
    N = constraint_rows(motion).on_driven_base.motions
    joints, free = N[:n].T, N[n:].T
    here = needed(motion)
    tau = tau - friction_torque(joint_friction(chain), recording.qd[k])
    last = [(joints @ (here - tau) - free @ motion.object_case.wrench)[:, None]]
    if settings.gravity:
        last += [np.array([joints @ (needed(moved(axis)) - here) for axis in np.eye(3)]).T]
    columns = [free @ part for part in _object_columns(chain, state, alpha, settings)]
    return np.hstack([*columns, *last]), N.T, joints, recording.tau[k]


def _sample(chain: ClosedChain, recording: Recording, k: int) -> tuple[State, Array, Inputs]:
    """Return the state, the object's acceleration, and the inputs of a sample."""
    assert recording.object_acceleration is not None
    return recording.state(k), recording.object_acceleration[k], (recording.inputs or Inputs()).shaped(chain)


def about_mass_centre(chain: ClosedChain) -> Array:
    """Return (10, 10), which maps parameters about the model's mass centre to parameters about C."""
    return np.array([body.moved(np.eye(3), chain.held_object.com).parameters for body in UNIT_BODIES]).T


def _object_columns(chain: ClosedChain, state: State, alpha: Array, settings: Settings) -> list[Array]:
    """Return the columns that multiply pi and, if gravity is unknown, g_x pi .. g_z pi."""
    frame, twist, to_C = state.object_frame, state.object_twist, about_mass_centre(chain)

    def columns(gravity: Array) -> Array:
        return object_columns(frame, twist, alpha - np.concatenate([np.zeros(3), gravity])) @ to_C

    if not settings.gravity:
        return [columns(chain.gravity)]
    without = columns(np.zeros(3))
    return [without, *(columns(axis) - without for axis in np.eye(3))]


@dataclass(frozen=True, eq=False)
class PayloadUnknowns:
    """The unknowns of a chain, and their values in the model.

    Attributes:
        names: names of the entries of xi.
        sizes: typical sizes of the entries of xi, by which they are scaled.
        model: xi of the model, and x, since c is 0; offsets and tilt are 0.
        gravity: (3,) gravity of the model.
        across: (2, 3) E, unit vectors perpendicular to gravity.
        biases: number of sensor offsets.
        tilted: whether gravity's direction is unknown.
    """

    names: tuple[str, ...]
    sizes: Array
    model: Array
    gravity: Array
    across: Array
    biases: int
    tilted: bool

    @property
    def linear_sizes(self) -> Array:
        """Typical sizes of the entries of x, in which first moments replace the mass centre."""
        return np.concatenate([self.sizes[:1], self.sizes[0] * self.sizes[1:4], self.sizes[4:]])

    def sized(self, mass: float, radius: float) -> PayloadUnknowns:
        """Return the unknowns with the sizes of a body of a mass and a radius of gyration."""
        own = [mass, *[radius] * 3, *[mass * radius**2] * 6]
        return replace(self, sizes=np.concatenate([own, self.sizes[10:]]))

    def plain(self, x: Array) -> Array:
        """Return xi of x."""
        return np.concatenate([plain_body(x[:10]), x[10:]])

    def slopes(self, x: Array) -> Array:
        """Return dxi/dx, (p, p), which is triangular."""
        found = np.eye(len(x))
        found[:10, :10] = plain_slopes(x[:10])
        return found

    def tilted_gravity(self, tilt: Array) -> tuple[Array, Array]:
        """Return gravity (3,) and its derivative (3, 2) by the tilt."""
        size = float(np.linalg.norm(self.gravity))
        v = self.gravity / size + tilt @ self.across
        s = float(np.linalg.norm(v))
        return size * v / s, size * (self.across.T / s - np.outer(v, tilt) / s**3)

    def features(self, x: Array) -> tuple[Array, Array]:
        """Return the features, by which the rows are multiplied, and their derivatives by x."""
        pi, b, one = x[:10], x[10 : 10 + self.biases], np.ones(1)
        p = len(x)
        of_b = np.eye(p)[10 : 10 + self.biases]
        if not self.tilted:
            return np.concatenate([pi, b, one]), np.vstack([np.eye(p)[:10], of_b, np.zeros((1, p))])
        g, slope = self.tilted_gravity(x[-2:])
        of_g = np.hstack([np.zeros((3, p - 2)), slope])
        of_products = np.kron(g[:, None], np.eye(10, p)) + np.kron(of_g, pi[:, None])
        values = np.concatenate([pi, np.kron(g, pi), b, one, g])
        return values, np.vstack([np.eye(10, p), of_products, of_b, np.zeros((1, p)), of_g])


def plain_body(pi: Array) -> Array:
    """Return m, c and I about c of the ten inertial parameters of a body, (10,)."""
    m, h = pi[0], pi[1:4]
    return np.concatenate([[m], h / m, pi[4:10] - (h @ h * np.eye(3) - np.outer(h, h))[ENTRIES] / m])


def plain_slopes(pi: Array) -> Array:
    """Return the derivatives of `plain_body` by pi, (10, 10), which are triangular."""
    m, h, found = pi[0], pi[1:4], np.eye(10)
    found[1:4, 0], found[1:4, 1:4] = -h / m**2, np.eye(3) / m
    found[4:10, 0] = (h @ h * np.eye(3) - np.outer(h, h))[ENTRIES] / m**2
    for k, e in enumerate(np.eye(3)):
        found[4:10, 1 + k] = -(2.0 * h[k] * np.eye(3) - np.outer(e, h) - np.outer(h, e))[ENTRIES] / m
    return found


def unknowns_of(chain: ClosedChain, settings: Settings, wrench_sizes: Array) -> PayloadUnknowns:
    """Return the unknowns of a chain.

    Args:
        chain: chain with the model's values.
        settings: which unknowns are requested.
        wrench_sizes: (6,) typical sizes of a sensor offset [N m, N].
    """
    body, names = chain.held_object, list(PARAMETER_NAMES)
    m, radius = body.mass, float(np.sqrt(np.trace(body.inertia) / (2.0 * body.mass)))
    sizes = [m, *[radius] * 3, *[m * radius**2] * 6]
    model = [m, 0.0, 0.0, 0.0, *body.inertia[ENTRIES]]
    holding = list(chain.grasps) if settings.sensor_bias else []
    for name in holding:
        names += [f"sensor offset of '{name}', {axis}" for axis in WRENCH_AXES]
        sizes += wrench_sizes.tolist()
    across = np.zeros((2, 3))
    if settings.gravity:
        across = np.linalg.svd(chain.gravity[None, :])[2][1:]
        names += ["gravity's tilt, first", "gravity's tilt, second"]
        sizes += [1.0, 1.0]
    model += [0.0] * (len(names) - 10)
    arrays = (np.array(sizes), np.array(model), chain.gravity, across)
    return PayloadUnknowns(tuple(names), *arrays, 6 * len(holding), settings.gravity)
