"""A closed chain made linear, in as many coordinates as it has: its dynamics, or a time step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from holdfast.compiled.structure import Options, Structure
from holdfast.control.controller import held_torques
from holdfast.dynamics.forward import forward_dynamics
from holdfast.dynamics.linearise import Linearisation, basis_at, linearised_dynamics, turned_towards
from holdfast.dynamics.result import ForwardResult
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.environment import BaseMotion, Environment
from holdfast.simulation.rollout.varied_step import LinearStep, VariedStep, state_arrays
from holdfast.simulation.runge_kutta import scheme as scheme_of
from holdfast.simulation.stepper import ReferenceStepper
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, shaped_inputs


@dataclass(frozen=True, eq=False)
class DiscreteLinearisation(Frozen):
    """A time step made linear: z' = A z + B (tau - tau_0), z about a state and z' about the one that follows it.

    Attributes:
        state: at the step's beginning.
        end: at its end.
        A: (m, m).
        B: (m, n) by joint torques, held through the step.
        basis: (2n + 12, m) T at the beginning, as of `Linearisation`.
        end_basis: T at the end, turned towards that at the beginning: the `basis` of the next step.
        step: its length [s].
    """

    state: State
    end: State
    A: Array
    B: Array
    basis: Array
    end_basis: Array
    step: float


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
    """Return forward dynamics, or a time step, made linear about a state, for regulators such as LQR. O(n^3).

    dz/dt = A z + B (tau - tau_0) + rate, or z' = A z + B (tau - tau_0) with A = T'^+ (dPhi/dx) T, B = T'^+ dPhi/du,
    Phi the step as `simulate` takes it: Runge-Kutta, then both rounds of the projection onto the grasps, differentiated
    as they run. (dPhi/dx) T lies in the span of T'.

    Args:
        chain: arms, object and grasps.
        state: positions and velocities; must satisfy the grasps.
        tau: (n,) joint torques [N m or N].
        inputs: external wrenches and base motion, held; zero by default. Through a step bases move as `base_motion`
            says, not as these.
        basis: one that a neighbouring state has, which the new one is turned towards, so that along a trajectory it
            does not jump.
        check: False skips the consistency check.
        generic_rank: rank of the constraint away from singular configurations, if known.
        step: of time [s]; None: no step, but the dynamics.
        scheme: of the step, see `simulate`.
        base_motion: t -> (pose, twist, acceleration) of bases that move through the step, see `simulate`.
        t: when the step begins, which matters to `base_motion` only [s].

    Returns:
        A `Linearisation`, or of a step a `DiscreteLinearisation`; m is twice the chain's mobility, less one for each
        row that grasps hold in velocity only.

    Raises:
        StateError: wrong shapes, the state breaks a grasp, or the step is too long for the motion.
        SingularChainError: the constraint's rank drops here.
        ModelError: no such scheme.

    Reference:
        docs/theory/derivatives.md.
    """
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
    model = VariedStep(
        Structure(chain, Options()), held_torques(chain.joint_count), {}, None, tableau, environment, True
    )
    linear = model.linear(_given(chain, state, torques, (begin, h), now.result), (*_moving(chain), TORQUES))
    there, acting = environment.at(begin + h, end)
    T_end = basis_at(there, end, acting)
    T_end = turned_towards(T_end, T) if T.shape == T_end.shape else T_end
    inverse = np.linalg.pinv(T_end)
    A = np.array([_rates(chain, linear, column) for column in T.T]).reshape(-1, len(T)) @ inverse.T
    B = np.array([_rates(chain, linear, np.zeros(len(T)), unit) for unit in np.eye(chain.joint_count)]) @ inverse.T
    checks.finite(np.append(A, B), "linearise")
    return DiscreteLinearisation(state, end, A.T, B.T, T, T_end, h)


TORQUES = "control.tau"  # of the law that holds them


def _held(chain: ClosedChain, inputs: Inputs | None) -> Inputs:
    """Return shaped inputs, which move no bases.

    Raises:
        StateError: bases move.
    """
    shaped = shaped_inputs(chain, inputs)
    for name in ("base_twists", "base_accelerations", "trunk_base_twist", "trunk_base_acceleration"):
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
    """Return what a step is given, as rollouts name it."""
    begin, h = times
    numbers = {"begin": begin, "step": h, "last.count": 0.0, "generic_rank": float(found.rank)}
    given = {name: np.array(x) for name, x in numbers.items()} | {TORQUES: tau, "last.before": np.zeros(0)}
    given |= {} if found.held is None else {"last.held_rows": found.held}
    return given | {f"last.{name}": x for name, x in state_arrays(chain, state).items()}


def _moving(chain: ClosedChain) -> list[str]:
    """Return the names of what a basis has rows of, in their order."""
    of_bodies = [f"{body}_{{}}" for body in ("object", *(["floating"] if chain.floats else []))]
    return ["q", *(x.format("pose") for x in of_bodies), "qd", *(x.format("twist") for x in of_bodies)]


def _rates(chain: ClosedChain, linear: LinearStep, x: Array, torques: Array | None = None) -> Array:
    """Return how fast the step's end changes while its beginning does, and the torques."""
    names, tangents, first = _moving(chain), {}, 0
    for name, shape in zip(names, linear.linear.shapes, strict=False):
        tangents[name] = x[first : first + shape[0]]
        first += shape[0]
    found = linear.rates(tangents if torques is None else tangents | {TORQUES: torques})
    return np.concatenate([found[name] for name in names])
