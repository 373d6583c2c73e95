"""Derivatives of forward dynamics by dual numbers over the dense equations and one solve: the oracle.

The equations of `held_equations` are R(theta, z) = 0, linear in the accelerations and forces z. With K = dR/dz

    K z = -R(theta, 0),     K dz = -R'(theta; z held)

both slopes of R by dual numbers. Nothing is differentiated through a solver, no recursion of the library is used, and
nothing is lost with light objects. In float64, or in many digits.

Directions are those of the arguments and parameters by name: poses as [turn; shift] in the axes they are given in,
about their own origin (object and bases in world axes, bases on a trunk in their body's, grasps in the object's);
inertias as xx, xy, xz, yy, yz, zz, the mixed ones moving both entries.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.model.trunk import TRUNK
from holdfast.questions.arrays import arguments_of
from tests.oracles.arithmetic import Arithmetic, arithmetic, solve_by_elimination
from tests.oracles.arm_kinematics import cross_matrix
from tests.oracles.held_equations import missing, unknowns
from tests.spatial.dual import tangents_of, values_of, with_tangents
from tests.systems.as_chain import Problem

OUTPUTS = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench")
POSES = {"object_pose": "object", "grasp_pose": "grasp", "base_pose": "base", "floating_pose": "floating"}
INERTIAS = ("object_inertia", "link_inertia", "trunk_link_inertia")
names_of = arguments_of  # of all directions of a chain
SYMMETRIC = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def symmetric_basis() -> np.ndarray:
    """Return the six directions of an inertia, (6, 3, 3)."""
    basis = np.zeros((6, 3, 3))
    for k, (i, j) in enumerate(SYMMETRIC):
        basis[k, i, j] = basis[k, j, i] = 1.0
    return basis


def numbers_of(p: Problem, numbers: Arithmetic) -> dict[str, np.ndarray]:
    """Return the numbers of a problem by the names of `held_equations`."""
    chain, state, inputs = p.chain, p.state, p.inputs.shaped(p.chain)
    body, frame, l = chain.held_object, state.object_frame, len(chain.arms)
    links = [link for arm in chain.arms.values() for link in arm.links]
    joints = [joint for part in chain.joints_of.values() for joint in part]
    grasps, arms, trunk = chain.grasps.values(), chain.arms.values(), chain.trunk
    pushes = np.zeros((len(links), 6)) if inputs.link_wrenches is None else inputs.link_wrenches
    given: dict[str, Any] = {
        "q": state.q,
        "qd": state.qd,
        "tau": p.tau,
        "object_R": frame.R,
        "object_p": frame.p,
        "object_twist": state.object_twist,
        "object_wrench": inputs.object_wrench,
        "gravity": chain.gravity,
        "object_mass": body.mass,
        "object_com": body.com,
        "object_inertia": body.inertia,
        "grasp_R": np.reshape([grasp.frame.R for grasp in grasps], (-1, 3, 3)),
        "grasp_p": np.reshape([grasp.frame.p for grasp in grasps], (-1, 3)),
        "base_R": np.reshape([arm.base.R for arm in arms], (l, 3, 3)),
        "base_p": np.reshape([arm.base.p for arm in arms], (l, 3)),
        "base_twist": inputs.base_twists,
        "base_acceleration": inputs.base_accelerations,
        "link_mass": [link.mass for link in links],
        "link_com": [link.com for link in links],
        "link_inertia": [link.inertia for link in links],
        "link_wrench": pushes,
        "armature": [joint.armature for joint in joints],
        "damping": [joint.damping for joint in joints],
    }
    if trunk is not None:
        pushes = inputs.trunk_link_wrenches
        given["trunk_link_wrench"] = np.zeros((len(trunk.bodies), 6)) if pushes is None else pushes
        given["trunk_link_mass"] = [body.mass for body in trunk.bodies]
        given["trunk_link_com"] = [body.com for body in trunk.bodies]
        given["trunk_link_inertia"] = [body.inertia for body in trunk.bodies]
        if trunk.floating is None:
            given["trunk_base_twist"] = inputs.trunk_base_twist
            given["trunk_base_acceleration"] = inputs.trunk_base_acceleration
        else:
            assert state.base_frame is not None
            given["floating_R"], given["floating_p"] = state.base_frame.R, state.base_frame.p
            given["floating_twist"] = state.base_twist
    return {name: numbers.array(x) for name, x in given.items()}


class Seeded:
    """The numbers of a problem with a tangent along every direction asked for.

    Attributes:
        given: by name, arrays of dual numbers where they have tangents.
        at: where the directions of a name lie among all.
        count: how many there are.
    """

    def __init__(self, given: dict[str, np.ndarray], by: Iterable[str]) -> None:
        """Seed the directions of some names."""
        self.given, self.at, self.count = dict(given), {}, 0
        values = {name: given[f"{POSES[name]}_R"] if name in POSES else given[name] for name in by}
        for name, x in values.items():
            size = {True: 6 * (x.size // 9), False: x.size}[name in POSES or name in INERTIAS]
            self.at[name] = slice(self.count, self.count + size)
            self.count += size
        for name, x in values.items():
            if name in POSES:
                self._seed_pose(POSES[name], x, self.at[name].start)
            else:
                tangents = self._none(x.shape)
                flat = np.reshape(tangents, (x.size, self.count))
                if name in INERTIAS:
                    for k, row in enumerate(np.tile(symmetric_basis().reshape(6, 9), (x.size // 9, 1))):
                        body = 9 * (k // 6)
                        flat[body + np.flatnonzero(row), self.at[name].start + k] = 1
                else:
                    flat[range(x.size), range(self.at[name].start, self.at[name].stop)] = 1
                self.given[name] = with_tangents(x, tangents)

    def _seed_pose(self, what: str, R: np.ndarray, start: int) -> None:
        """Seed turn and shift of one pose or several: R -> exp(turn) R, p -> p + shift."""
        p = self.given[f"{what}_p"]
        of_R, of_p = self._none(R.shape), self._none(p.shape)
        for i in range(R.size // 9):
            where = (i,) if R.ndim == 3 else ()
            for k in range(3):
                unit = np.eye(3, dtype=int)[k]
                of_R[(*where, slice(None), slice(None), start + 6 * i + k)] = cross_matrix(unit) @ R[where]
                of_p[(*where, k, start + 6 * i + 3 + k)] = 1
        self.given[f"{what}_R"], self.given[f"{what}_p"] = with_tangents(R, of_R), with_tangents(p, of_p)

    def _none(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return tangents that are 0, of many digits too."""
        exact = self.given["gravity"].dtype == object
        return np.zeros((*shape, self.count), dtype=object if exact else float)


@dataclass(frozen=True, eq=False)
class Derivatives:
    """What forward dynamics returns, and its partial derivatives.

    Attributes:
        values: by output, flat; a trunk's `floating_acceleration` and `trunk_base_wrench` too.
        matrices: by output, (size, all directions).
        at: where the directions of a name lie among all.
    """

    values: dict[str, np.ndarray]
    matrices: dict[str, np.ndarray]
    at: dict[str, slice]

    def block(self, of: str, by: str) -> np.ndarray:
        """Return the derivatives of an output by the directions of a name, (outputs, directions)."""
        return self.matrices[of][:, self.at[by]]


def chain_derivatives(p: Problem, by: Iterable[str] | None = None, digits: int | None = None) -> Derivatives:
    """Return forward dynamics and its partial derivatives; forces must be unique.

    Args:
        p: the problem.
        by: names of arguments and parameters; None for all.
        digits: None for float64, else as many throughout.
    """
    numbers = arithmetic(digits)
    with numbers.precision():
        equations = Equations(p, numbers, names_of(p.chain) if by is None else by)
        z = equations.solved(equations.rhs[:, None])[:, 0]
        of_z = equations.along(z)
        dz = equations.solved(-of_z.slopes)
        return equations.named(z, dz, of_z)


@dataclass(frozen=True, eq=False)
class Along:
    """Slopes of the equations and of the bases' wrenches along all directions, unknowns held."""

    slopes: np.ndarray
    of_bases: np.ndarray
    bases: np.ndarray


class Equations:
    """The equations of a problem, and their slopes.

    Attributes:
        at: where the unknowns are.
        K: (N, N) slopes by the unknowns.
        rhs: (N,) K z = rhs.
    """

    def __init__(self, p: Problem, numbers: Arithmetic, by: Iterable[str]) -> None:
        """Write down K and the right-hand side."""
        self.p, self.numbers, self.at = p, numbers, unknowns(p.chain)
        self.plain = numbers_of(p, numbers)
        self.seeded = Seeded(self.plain, by)
        N = self.at.size
        exact = self.plain["gravity"].dtype == object
        found = missing(
            p.chain,
            self.plain,
            with_tangents(numbers.array(np.zeros(N)), np.eye(N, dtype=object if exact else float)),
            numbers,
        )
        self.K, self.rhs = tangents_of(found.equations, N), -values_of(found.equations)
        bases = np.concatenate([found.base_wrench.ravel(), found.trunk_base_wrench])
        self.B = tangents_of(bases, N)

    def solved(self, b: np.ndarray) -> np.ndarray:
        """Return K^-1 b of columns."""
        if b.dtype == object:
            return solve_by_elimination(self.K, b)
        x = np.linalg.solve(self.K, b)
        return x + np.linalg.solve(self.K, b - self.K @ x)

    def along(self, z: np.ndarray) -> Along:
        """Return the slopes of the equations, z held."""
        found, count = missing(self.p.chain, self.seeded.given, z, self.numbers), self.seeded.count
        bases = np.concatenate([found.base_wrench.ravel(), found.trunk_base_wrench])
        return Along(tangents_of(found.equations, count), tangents_of(bases, count), values_of(bases))

    def named(self, z: np.ndarray, dz: np.ndarray, of_z: Along) -> Derivatives:
        """Name the parts of a solution and its slopes, arms that hold nothing with wrenches of 0."""
        chain, at = self.p.chain, self.at
        of_bases = of_z.of_bases + self.B @ dz
        count = 6 * len(chain.arms)

        def parts(x: np.ndarray, bases: np.ndarray) -> dict[str, np.ndarray]:
            x, bases = np.asarray(x, dtype=float), np.asarray(bases, dtype=float)
            f = np.zeros((len(chain.arms), 6, *x.shape[1:]))
            f[[name in chain.grasps for name in chain.arms]] = x[at.f].reshape(-1, 6, *x.shape[1:])
            found = {
                "qdd": x[at.qdd],
                "grasp_wrench": f.reshape(count, *x.shape[1:]),
                "object_acceleration": x[at.alpha],
                "contact_acceleration": x[at.rates],
                "base_wrench": bases[:count],
            }
            if TRUNK in chain.joints:
                found |= {"floating_acceleration": x[at.base], "trunk_base_wrench": bases[count:]}
            return found

        return Derivatives(parts(z, of_z.bases), parts(dz, of_bases), self.seeded.at)
