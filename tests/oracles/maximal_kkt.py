"""Forward dynamics of arms on one object by one dense KKT system: the oracle.

A case (plain dict, the layout of ``tests/data/cases.json``) becomes one linear
system in all unknowns at once,

    [ M   0    0    J^T ] [ qdd     ]   [ tau - bias            ]
    [ 0   M_C  0   -A^T ] [ alpha_C ] = [ -bias_C               ]
    [ 0   0    0    H   ] [ W_dot   ]   [ 0                     ]
    [ J  -A    H^T  0   ] [ f       ]   [ a_C - g - tip_bias    ]

where f is what each arm exerts on the object about the contact point, A carries the
object's acceleration to the contacts, H^T W_dot is the contacts' own motion and g the
part of its rate that comes from turning contact axes.
"""

import numpy as np

from tests.oracles.arithmetic import Arithmetic, arithmetic
from tests.oracles.arm_kinematics import centripetal, cross, cross_matrix
from tests.oracles.body_equations import (
    ArmEquations,
    BodyEquation,
    arm_equations,
    moved,
    object_equation,
)


class Grasp:
    """Hold the constraint rows of one arm's grasp, world axes, about the contact.

    Attributes:
        A: (6, 6) object acceleration at C to acceleration of the contact point.
        a_C: (6,) acceleration of the contact point at alpha_C = 0 [rad/s^2, m/s^2].
        H: (n_g, 6) directions the grasp leaves free; it transmits no wrench there.
        W: (n_g,) relative rates, object less tip, along H [rad/s].
        g: (6,) relative acceleration from turning contact axes [rad/s^2, m/s^2].
    """

    def __init__(self, grasp: dict, tip_twist: np.ndarray, body: BodyEquation, numbers: Arithmetic):
        """Derive all rows from the object's pose and the twists on both sides."""
        lever = body.R @ numbers.array(grasp["point_object"])
        self.lever = lever
        self.A = numbers.array(np.eye(6))
        self.A[3:, :3] = -cross_matrix(lever)
        self.a_C = np.concatenate([lever * 0, centripetal(body.omega, lever)])
        h = contact_axes(grasp, body.R, numbers)
        self.H = np.concatenate([h.T, h.T * 0], axis=1)
        self.W = h.T @ (body.omega - tip_twist[:3])
        # Ball axes are the world's, so they stand still; the others ride on the object.
        turning = body.omega if grasp["type"] != "ball" else body.omega * 0
        self.g = np.concatenate([cross(turning, h @ self.W), lever * 0])


def contact_axes(grasp: dict, R_object: np.ndarray, numbers: Arithmetic) -> np.ndarray:
    """Return the free rotation axes of a grasp as world columns, (3, n_g)."""
    if grasp["type"] == "ball":
        return numbers.array(np.eye(3))
    if grasp["type"] == "rigid":
        return numbers.array(np.zeros((3, 0)))
    return R_object @ numbers.array(grasp["h_object"]).T


class KktSystem:
    """Hold a case's parts, its KKT matrix and right-hand side."""

    def __init__(self, case: dict, numbers: Arithmetic):
        """Build every block in the given arithmetic."""
        gravity = numbers.array(case["gravity"])
        self.numbers = numbers
        self.body: BodyEquation = object_equation(case["object"], gravity, numbers)
        self.arms: list[ArmEquations] = []
        self.grasps: list[Grasp | None] = []
        for arm in case["arms"]:
            parts = arm_equations(arm, gravity, numbers)
            grasp = arm["grasp"]
            self.arms.append(parts)
            self.grasps.append(grasp and Grasp(grasp, parts.tip_twist, self.body, numbers))
        self._lay_out()
        self.matrix, self.rhs = self._assemble()

    def _lay_out(self) -> None:
        """Fix which slice of the unknowns belongs to what."""
        rates = [0 if grasp is None else len(grasp.H) for grasp in self.grasps]
        wrenches = [0 if grasp is None else 6 for grasp in self.grasps]
        sizes = [len(arm.tau) for arm in self.arms] + [6] + rates + wrenches
        ends = np.cumsum(sizes)
        slices = [slice(int(e - n), int(e)) for e, n in zip(ends, sizes, strict=True)]
        count = len(self.arms)
        self.size = int(ends[-1])
        self.qdd, self.alpha = slices[:count], slices[count]
        self.W_dot, self.f = slices[count + 1 : 2 * count + 1], slices[2 * count + 1 :]

    def _assemble(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the symmetric KKT matrix and its right-hand side."""
        matrix = self.numbers.array(np.zeros((self.size, self.size)))
        rhs = self.numbers.array(np.zeros(self.size))
        matrix[self.alpha, self.alpha] = self.body.M
        rhs[self.alpha] = -self.body.bias
        for i, (arm, grasp) in enumerate(zip(self.arms, self.grasps, strict=True)):
            matrix[self.qdd[i], self.qdd[i]] = arm.M
            rhs[self.qdd[i]] = arm.tau - arm.bias
            if grasp is None:
                continue
            blocks = ((self.qdd[i], arm.J), (self.alpha, -grasp.A), (self.W_dot[i], grasp.H.T))
            for unknowns, block in blocks:
                matrix[self.f[i], unknowns] = block
                matrix[unknowns, self.f[i]] = block.T
            rhs[self.f[i]] = grasp.a_C - grasp.g - arm.tip_bias
        return matrix, rhs

    def answer(self, x: np.ndarray) -> dict:
        """Name the parts of a solution vector; everything rounded to float64."""
        zero = self.numbers.array(np.zeros(6))
        qdd = [x[part] for part in self.qdd]
        f = [zero if part.start == part.stop else x[part] for part in self.f]
        return {
            "qdd": _rounded(qdd),
            "f": _rounded(f),
            "W_dot": _rounded(x[part] for part in self.W_dot),
            "alpha_C": x[self.alpha].astype(float),
            "base_wrench": _rounded(map(base_wrench, self.arms, qdd, f)),
            "W": _rounded(zero[:0] if grasp is None else grasp.W for grasp in self.grasps),
            "M": _rounded(arm.M for arm in self.arms),
            "J": _rounded(arm.J for arm in self.arms),
            "bias": _rounded(arm.bias for arm in self.arms),
            "tip_bias": _rounded(arm.tip_bias for arm in self.arms),
            "tip": _rounded(arm.tip for arm in self.arms),
        }


def base_wrench(arm: ArmEquations, qdd: np.ndarray, f: np.ndarray) -> np.ndarray:
    """Return the wrench of the base on the arm about the base origin, world axes.

    The base supplies what changes the links' momentum and what the arm passes on to
    the object; weights and external wrenches are already taken off.  Rotor (armature)
    momentum counts for the joint equation only.
    """
    passed_on = moved(f[:3], f[3:], arm.tip - arm.base_origin)
    return arm.momentum_J @ qdd + arm.momentum_bias + passed_on


def _rounded(arrays) -> list[np.ndarray]:
    """Return the arrays in float64."""
    return [np.asarray(array).astype(float) for array in arrays]


def solve(case: dict, digits: int | None = None, softness: float = 0.0) -> dict:
    """Solve a case's forward dynamics with one LU of the full KKT system.

    W is derived by projecting omega_object - omega_tip on the contact axes; a W stored
    in the case is not read.  The contact sits at R_object @ point_object from C.

    Args:
        case: arms, object, grasps, state and inputs.  Optional beyond the stored cases:
            ``joints[j].armature`` and ``.damping``, ``arms[i].link_wrench`` (N x 6,
            [moment; force] about each link's frame origin, world axes),
            ``object.wrench`` (6, about C, world axes), ``arms[i].grasp`` None.
        digits: None for float64; otherwise this many decimal digits throughout, the
            float64 inputs taken as exact and the answer rounded at the end.
        softness: compliance of the grasps, J qdd - A alpha_C + H^T W_dot - softness f = ...
            With 1e-20 and 50 digits a grasp is still rigid to 1e-14 where a unit force moves something
            by 1e-6, and forces that move less than 1e-14, the rounding of right angles in
            float64, are left out: accelerations are then those of the ideal chain.

    Returns:
        Per arm ``qdd`` (N,), ``f`` (6,) [moment about the contact; force] on the object,
        ``W_dot`` and ``W`` (n_g,), ``base_wrench`` (6,) of the base on the arm about the
        base origin; ``alpha_C`` (6,) [omega_dot; v_dot of C]; and per arm the helpers
        ``M``, ``J``, ``bias``, ``tip_bias``, ``tip``.  World axes, SI, float64.

    Raises:
        ArithmeticError or numpy.linalg.LinAlgError: the KKT matrix is exactly singular.
    """
    numbers = arithmetic(digits)
    with numbers.precision():
        system = KktSystem(case, numbers)
        for part in system.f:
            for i in range(part.start, part.stop):
                system.matrix[i, i] -= softness
        return system.answer(numbers.solve(system.matrix, system.rhs))


def solve_min_norm(case: dict, cutoff: float = 1e-11) -> dict:
    """Solve a case whose forces are not unique, by least squares in float64.

    Args:
        case: as for ``solve``.
        cutoff: singular values below this share of the largest one count as zero.

    Returns:
        As ``solve``.  Where qdd, alpha_C, W_dot are unique, f has the least
        sum of squares (N m and N mixed).  ``rank`` is the KKT matrix's rank, ``residual``
        the largest row of K x - b: not small means that no acceleration keeps the
        constraints.
    """
    system = KktSystem(case, arithmetic(None))
    x, _, rank, _ = np.linalg.lstsq(system.matrix, system.rhs, rcond=cutoff)
    residual = float(np.max(np.abs(system.matrix @ x - system.rhs)))
    return system.answer(x) | {"rank": int(rank), "residual": residual}
