"""Linearisation of a closed chain in independent coordinates: of its dynamics, or of a time step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from holdfast.compiled.structure import Options, Structure
from holdfast.control.controller import held_torques
from holdfast.dynamics.forward import forward_dynamics
from holdfast.dynamics.linearise import Linearisation, basis_at, coordinates, linearised_dynamics, turned_towards
from holdfast.dynamics.result import ForwardResult
from holdfast.dynamics.tree.mechanism_linearise import mechanism_linearisation
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import answered_as_forest, require_unused, serial_chain, without_contacts
from holdfast.names import called
from holdfast.simulation.environment import MOVING_BASES, BaseMotion, Environment
from holdfast.simulation.rollout.traced_step import StepModel
from holdfast.simulation.rollout.varied_step import LinearStep, VariedStep, state_arrays
from holdfast.simulation.runge_kutta import scheme as scheme_of
from holdfast.simulation.stepper import ReferenceStepper
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, shaped_inputs


@called
@dataclass(frozen=True, eq=False)
class DiscreteLinearisation(Frozen):
    """The linearisation of a time step, z' = A z + B (tau - tau_0).

    The coordinates z describe deviations from the state at the start of the step, and z' deviations from its end.

    Attributes:
        state: the state at the start of the step.
        end: the state at the end of the step.
        A: (m, m) derivative with respect to z.
        B: (m, n) derivative with respect to the joint torques, which are constant during the step.
        basis: (2n + 12, m) basis T at the start, as in `Linearisation`.
        end_basis: basis T at the end, aligned with the one at the start; use it as `basis` for the next step.
        step: length of the step [s].
    """

    state: State
    end: State
    A: Array
    B: Array
    basis: Array
    end_basis: Array
    step: float

    def coordinates(self, state: State) -> Array:
        """Return z of a state near that at the start of the step, (m,); see `Linearisation.coordinates`.

        Raises:
            StateError: the state has other joints, or another base.
        """
        return coordinates(self.basis, self.state, state)

    def __repr__(self) -> str:
        """Return the numbers of coordinates and torques, and the step."""
        sizes = f"{self.A.shape[1]} coordinates, {self.B.shape[1]} torques"
        return f"<DiscreteLinearisation: {sizes}, a step of {self.step:g} s from {self.state!r}>"


@overload
def linearise(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    *,
    inputs: Inputs | None = ...,
    basis: Array | None = ...,
    check: bool = ...,
    generic_rank: int | None = ...,
    step: None = ...,
    scheme: str = ...,
) -> Linearisation: ...
@overload
def linearise(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    *,
    step: float,
    inputs: Inputs | None = ...,
    basis: Array | None = ...,
    check: bool = ...,
    generic_rank: int | None = ...,
    scheme: str = ...,
    base_motion: Mapping[str, BaseMotion] | None = ...,
    t: float = ...,
) -> DiscreteLinearisation: ...
@np.errstate(all="ignore")  # what overflows is refused
def linearise(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    *,
    inputs: Inputs | None = None,
    basis: Array | None = None,
    check: bool = True,
    generic_rank: int | None = None,
    step: float | None = None,
    scheme: str = "rk4",
    base_motion: Mapping[str, BaseMotion] | None = None,
    t: float = 0.0,
) -> Linearisation | DiscreteLinearisation:
    """Return the linearisation of forward dynamics, or of a time step, at a state, e.g. for LQR. O(n^3).

    Dynamics: dz/dt = A z + B (tau - tau_0) + rate. Step: z' = A z + B (tau - tau_0) with A = T'^+ (dPhi/dx) T and
    B = T'^+ dPhi/du. Phi is the step that `simulate` takes, a Runge-Kutta step followed by two iterations of the
    projection onto the grasps; all of it is differentiated. (dPhi/dx) T lies in the span of T'.

    Args:
        chain: arms, object and grasps.
        state: positions and velocities; must satisfy the grasps.
        tau: (n,) joint torques [N m or N].
        inputs: external wrenches and base motion, constant; zero by default. For a step, the motion of bases is given
            by `base_motion` instead.
        basis: the basis at a neighbouring state; the new basis is aligned with it, so that the basis changes
            continuously along a trajectory.
        check: False skips the consistency check.
        generic_rank: rank of the constraint away from singular configurations, if known.
        step: length of a time step to linearise [s]; None to linearise the dynamics.
        scheme: integration scheme of the step, see `simulate`.
        base_motion: t -> (pose, twist, acceleration) of bases that move through the step, see `simulate`.
        t: when the step begins, which matters to `base_motion` only [s].

    Returns:
        A `Linearisation`, or a `DiscreteLinearisation` if `step` is given. The dimension m is twice the mobility of the
        chain, less one for each constraint row that the grasps impose on velocities only. For a chain with branches,
        loops, couplings or several objects a `MechanismLinearisation`, of the dynamics only.

    Raises:
        StateError: a shape is wrong, the state violates a grasp, or the step is too long for the motion.
        SingularChainError: the constraint loses rank at this state.
        ModelError: the scheme is unknown.

    Reference:
        docs/theory/derivatives.md.
    """
    if answered_as_forest(chain):
        require_unused(
            generic_rank=generic_rank is not None, step=step is not None, base_motion=base_motion is not None
        )
        found = mechanism_linearisation(chain, state, tau, inputs, basis, check)
        return found  # pyright: ignore[reportReturnType]
    serial_chain(chain, "chain")
    without_contacts(chain, "linearise")
    checks.instance(state, State, "state", StateError)
    if step is None:
        if base_motion is not None:
            raise StateError("linearise: base_motion: expected a step, got none; try inputs=, which has rates of bases")
        return linearised_dynamics(
            chain, state, tau, inputs=inputs, basis=basis, check=check, generic_rank=generic_rank
        )
    h, tableau = checks.number(step, "linearise: step", above=0.0), scheme_of(scheme)
    begin = checks.number(t, "linearise: t")
    environment = Environment(chain, base_motion or {}, _held(chain, inputs))
    here, acting = environment.at(begin, state)
    found = forward_dynamics(here, state, tau, inputs=acting, check=check, generic_rank=generic_rank)
    torques = checks.numbers(tau, (chain.joint_count,), "tau", StateError)
    T = basis_at(here, state, acting)
    T = T if basis is None else turned_towards(T, basis)
    stepper = ReferenceStepper(environment, lambda t, state, memory: (torques, memory), found.rank, tableau)
    now = stepper.evaluate(begin, state, None)
    (reached,) = stepper.advance(now, [begin + h])
    if reached.instant is None:
        assert reached.failure is not None
        raise reached.failure
    end = reached.instant.state
    model = StepModel(Structure(chain, Options()), held_torques(chain.joint_count), {}, None)
    step_model = VariedStep(model, tableau, environment, many=True)
    linear = step_model.linear(_given(chain, state, torques, (begin, h), now.result), (*_moving(chain), TORQUES))
    there, acting = environment.at(begin + h, end)
    T_end = basis_at(there, end, acting)
    T_end = turned_towards(T_end, T) if T.shape == T_end.shape else T_end
    inverse = np.linalg.pinv(T_end)
    A = np.array([_rates(chain, linear, column) for column in T.T]).reshape(-1, len(T)) @ inverse.T
    B = np.array([_rates(chain, linear, np.zeros(len(T)), unit) for unit in np.eye(chain.joint_count)]) @ inverse.T
    checks.finite(np.append(A, B), "linearise")
    return DiscreteLinearisation(state, end, A.T, B.T, T, T_end, h)


TORQUES = "control.tau"  # name of the constant torques among the arguments of the step


def _held(chain: ClosedChain, inputs: Inputs | None) -> Inputs:
    """Return the inputs as arrays; moving bases are refused.

    Raises:
        StateError: bases move.
    """
    shaped = shaped_inputs(chain, inputs)
    for name in MOVING_BASES:
        x = getattr(shaped, name)
        if x is not None and x.any():
            raise StateError(
                f"linearise: inputs: {name}: expected none, as a step asks where bases are while they move; try"
                " base_motion={name: t -> (pose, twist, acceleration)}"
            )
    return shaped


def _given(
    chain: ClosedChain, state: State, tau: Array, times: tuple[float, float], found: ForwardResult
) -> dict[str, Array]:
    """Return the arguments of a step, with the names that rollouts use."""
    begin, h = times
    numbers = {"begin": begin, "step": h, "last.count": 0.0, "generic_rank": float(found.rank)}
    given = {name: np.array(x) for name, x in numbers.items()} | {TORQUES: tau, "last.before": np.zeros(0)}
    given |= {} if found.held is None else {"last.held_rows": found.held}
    return given | {f"last.{name}": x for name, x in state_arrays(chain, state).items()}


def _moving(chain: ClosedChain) -> list[str]:
    """Return the names of the quantities in the rows of a basis, in order."""
    of_bodies = [f"{body}_{{}}" for body in ("object", *(["floating"] if chain.floats else []))]
    return ["q", *(x.format("pose") for x in of_bodies), "qd", *(x.format("twist") for x in of_bodies)]


def _rates(chain: ClosedChain, linear: LinearStep, x: Array, torques: Array | None = None) -> Array:
    """Return the rate of change of the step's end for given rates of its start and of the torques."""
    names, tangents, first = _moving(chain), {}, 0
    for name, shape in zip(names, linear.linear.shapes, strict=False):
        tangents[name] = x[first : first + shape[0]]
        first += shape[0]
    found = linear.rates(tangents if torques is None else tangents | {TORQUES: torques})
    return np.concatenate([found[name] for name in names])
