"""Simulation of chains that are answered as forests, in fixed steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.compiled.forest_engine import CompiledForestEngine
from holdfast.control.controller import torques_and_memory
from holdfast.dynamics.tree.forest_inverse import inverse_code
from holdfast.dynamics.tree.forest_simulate import ForestEngine, ForestReference, ForestSample, forest_steps
from holdfast.dynamics.tree.mechanism_terms import chain_state, flat_state, joint_rows, mechanism_arguments
from holdfast.dynamics.tree.varied_forest import ForestArguments
from holdfast.errors import ClosureError, MethodNotApplicable, SingularChainError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.simulation.balance import imbalance
from holdfast.simulation.environment import Environment, require_wrenches
from holdfast.simulation.joint_friction import friction_torque, joint_friction
from holdfast.simulation.margins import Policy
from holdfast.simulation.rollout.compiled_steppers import STEPS_WORTH_COMPILING
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import State, require_state


@called
@dataclass(frozen=True, eq=False)
class MechanismRun(Frozen):
    """The samples of a run of a chain with branches; the first axis of every array is the sample. SI units, world axes.

    Attributes:
        chain: the chain.
        t: times [s].
        q: joint positions.
        qd: joint rates.
        object_pose: poses wxyz_xyz of the object, or of all objects.
        object_twist: their twists.
        base_pose: poses of a floating base; None without one.
        base_twist: its twists; None without one.
        tau: torques of the drives.
        qdd: joint accelerations.
        grasp_wrench: wrenches of grasps and loops, as in `MechanismResult`.
        coupling_force: forces of the couplings.
        position_gap: largest gap of grasps, loops and couplings in position [m and rad].
        velocity_gap: the same in velocity.
        drift: largest gap in position that the step left before it was closed.
        kinetic: kinetic energy [J].
        potential: potential energy of gravity and of the joints' springs [J].
        work: (samples, 4) work of drives less that of friction, dampers, bases and wrenches since the start [J].
        stopped: None for a run that reached its end, otherwise the reason why it ended, and when.
    """

    chain: ClosedChain
    t: Array
    q: Array
    qd: Array
    object_pose: Array
    object_twist: Array
    base_pose: Array | None
    base_twist: Array | None
    tau: Array
    qdd: Array
    grasp_wrench: Array
    coupling_force: Array
    position_gap: Array
    velocity_gap: Array
    drift: Array
    kinetic: Array
    potential: Array
    work: Array
    stopped: str | None = None

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t)

    def __repr__(self) -> str:
        """Return the number of samples, the time, the largest gap and the energy that no work explains."""
        head = f"{type(self).__name__}: {len(self)} samples to {self.t[-1]:g} s"
        gaps = f"gaps up to {self.position_gap.max():.2g}"
        lost = f"energy off by up to {np.abs(self.energy_imbalance).max():.2g} J"
        return f"<{head}, {gaps}, {lost}{'' if self.stopped is None else f'; stopped: {self.stopped}'}>"

    @property
    def energy_imbalance(self) -> Array:
        """Change of the energy since the start that no work explains, (samples,) [J]."""
        return imbalance(self.kinetic, self.potential, self.work, np.zeros(len(self.t)))

    def state(self, sample: int) -> State:
        """Return the state of a sample."""
        names = ("q", "qd", "object_pose", "object_twist", "base_pose", "base_twist")
        return State(**{name: x[sample] for name in names if (x := getattr(self, name)) is not None})


def mechanism_run(
    chain: ClosedChain, state: State, controller: Any, times: Array, inputs: Any, every: int
) -> MechanismRun:
    """Return the motion of a chain by Runge-Kutta steps, after each of which it is closed; see `simulate`.

    Args:
        chain: the chain, whose limits are not verified.
        state: initial state.
        controller: (t, state, memory) -> (torques, memory).
        times: (steps + 1,) times of the steps [s].
        inputs: external wrenches, as for `simulate`.
        every: number of steps between two samples.
    """
    require_state(chain, state)
    acting = _Acting(chain, controller, inputs)
    rows, stopped = [], None
    forest = chain.as_forest.forest
    code = CompiledForestEngine(forest) if len(times) > STEPS_WORTH_COMPILING else None
    engine: ForestEngine = code or ForestReference(forest)
    steps = forest_steps(engine, forest, *flat_state(chain, state), acting, times)
    token = inverse_code.set(code and code.inverse)
    try:
        for k, sample in enumerate(steps):
            if k % every == 0 or k + 1 == len(times):
                rows.append(_row(chain, engine, sample, acting.tau))
    except (SingularChainError, ClosureError) as cause:
        if not rows:
            raise
        stopped = f"after {acting.begun:g} s: {cause}"
    finally:
        inverse_code.reset(token)
    columns = zip(*rows, strict=True)
    return MechanismRun(chain, *(None if x[0] is None else np.array(x) for x in columns), stopped=stopped)  # pyright: ignore


class _Acting:
    """The arguments of a forest at a time and state; the controller's memory is updated once per step, at its start.

    Attributes:
        tau: the torques of the drives at the start of the step.
        begun: when that was [s].
    """

    def __init__(self, chain: ClosedChain, controller: Any, inputs: Any) -> None:
        self.chain, self.controller, self.memory = chain, controller, None
        self.environment, self.friction = Environment(chain, {}, inputs), joint_friction(chain)
        self.tau, self.begun = np.zeros(0), 0.0

    def __call__(self, t: float, q: Array, qd: Array, begins: bool) -> ForestArguments:
        state = chain_state(self.chain, q, qd)
        tau, memory = torques_and_memory(self.controller(t, state, self.memory))
        tau = checks.numbers(tau, (self.chain.joint_count,), "controller: torques", StateError)
        if begins:
            self.tau, self.begun, self.memory = tau, t, memory
        inputs = self.environment.at(t, state)[1]
        require_wrenches(inputs, "of a chain that is answered as a forest")
        given = mechanism_arguments(self.chain, state, tau, inputs)
        lost, net = friction_torque(self.friction, state.qd), given.tau.copy()
        net[joint_rows(self.chain)] -= lost
        return given._replace(tau=net)


def _row(chain: ClosedChain, engine: ForestEngine, sample: ForestSample, tau: Array) -> tuple[Any, ...]:
    """Return the entries of a sample in the order of `MechanismRun`."""
    given, state = sample.given, chain_state(chain, sample.given.q, sample.given.qd)
    found = engine.account(given, sample.now)
    return (
        *(sample.t, state.q, state.qd, state.object_pose, state.object_twist, state.base_pose, state.base_twist),
        *(tau, sample.now.qdd[joint_rows(chain)], found.closure_wrench, found.coupling_force),
        *(found.position_gap, found.velocity_gap, sample.drift, found.kinetic, found.potential, sample.work),
    )


def require_simulated(chain: ClosedChain, policy: Policy) -> None:
    """Refuse grasps and loops whose limits would have to be verified.

    Raises:
        MethodNotApplicable: naming one.
    """
    grasps = {key: chain.as_forest.forest.closures[i].grasp for key, i in chain.as_forest.closures.items()}
    limited = [key for key, grasp in grasps.items() if grasp.contact is not None or grasp.wrench_limits is not None]
    if limited and policy.on_slip != "record":
        what = "grasp" if limited[0] in chain.grasps else "loop"
        raise MethodNotApplicable(
            f"on_slip: expected 'record' for {what} {limited[0]!r}, whose friction or limits are not verified in a"
            " chain that is answered as a forest; the run goes on as if it held, and has its wrenches"
        )
