"""Chains to step, laws that move them, and what came of it as plain numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from holdfast import ClosedChain, ControlLaw, State, compile_rollout, simulate
from holdfast.simulation import Rollout, RolloutSystems
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import Instant, evaluate
from tests.compiler.programs import same_bits
from tests.simulation.runs import limp
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain
from tests.systems.problems import relative_gap

# Joint count and grasp of each arm: every kind, legs, arms that hold nothing, one arm to five.
CHAINS: dict[str, tuple[tuple[int, str | None], ...]] = {
    "one": ((6, "rigid"),),
    "legs": ((3, "ball"), (3, "ball"), (5, "rigid"), (2, None)),
    "five": ((6, "rigid"), (5, "hinge"), (4, "softfinger"), (3, "ball"), (2, None)),
    "nobody holds": ((3, None), (2, None)),
}


@cache
def problem(name: str) -> tuple[ClosedChain, State]:
    """Return one of `CHAINS`: prismatic joints, armature, damping, Coulomb friction; and a state in motion."""
    arms = CHAINS[name]
    options = {"joints": [n for n, _ in arms], "grasps": [kind for _, kind in arms]}
    p = as_chain(well_conditioned_system(7, **options, moving_base=False, joint_speed=0.7))
    random = np.random.default_rng(len(name))
    rough = {
        name: replace(arm, joints=[replace(j, friction=float(random.uniform(0.2, 1.0))) for j in arm.joints])
        for name, arm in p.chain.arms.items()
    }
    return replace(p.chain, arms=rough), p.state


def swinging_law(joint_count: int) -> ControlLaw:
    """Return torques that depend on time, state and memory; memory that begins as zeros does not matter."""
    size = np.random.default_rng(1).normal(size=joint_count)

    def torque(t: Any, state: State, memory: Any, given: Any) -> tuple[Any, Any]:
        drive = (2.0 + memory[0]) * size - 3.0 * (1.0 + t) * state.qd - state.object_twist[3] * size
        return drive, np.array([1.1 * memory[0], memory[1] + t])

    return ControlLaw(torque, memory=np.array([0.3, 0.0]), key="tests: swinging")


@cache
def swinging(name: str, scheme: str = "rk4") -> Rollout:
    """Return the rollout of a chain under `swinging_law`."""
    chain, _ = problem(name)
    return compile_rollout(chain, swinging_law(chain.joint_count), scheme=scheme)


@cache
def given_torques(name: str) -> Rollout:
    """Return the rollout of a chain under given torques."""
    return compile_rollout(problem(name)[0])


def started(rollout: Rollout, state: State, count: int, seed: int = 0, **given: Any) -> RolloutSystems:
    """Return systems near a state, each a little elsewhere; the first one at it."""
    return rollout.start(**elsewhere(rollout.chain, state, count, seed), **given)


def without_torques(chain: ClosedChain, state: State, duration: float, step: float) -> RolloutSystems:
    """Return the one system of a rollout after it has moved without torques."""
    rollout, none = compile_rollout(chain), np.zeros((1, chain.joint_count))
    systems = rollout.start(**{name: x[None] for name, x in arrays(state).items()}, tau=none)
    return rollout.run(systems, duration, step, tau=none).systems


def assert_rollout_is_run(chain: ClosedChain, state: State, duration: float = 0.01, relative_to_energy: bool = False):
    """Assert that a rollout and `simulate` move a chain without torques to the same state, with the same work."""
    after, run = without_torques(chain, state, duration, 1e-3), simulate(chain, state, limp, duration, 1e-3)
    for name in ("q", "qd", "object_pose", "object_twist"):
        assert relative_gap(getattr(after, name)[0], getattr(run, name)[-1]) <= 1e-11, name
    floor = np.abs(run.kinetic).max() if relative_to_energy else 0.0
    assert relative_gap(after.work[0], run.work[-1], floor) <= 1e-11


def elsewhere(chain: ClosedChain, state: State, count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Return states near one, (count, ...) by name; grasps are open by less than a millimetre."""
    random = np.random.default_rng(seed)
    found = tiled(state, count)
    for name in ("q", "qd"):
        found[name][1:] += 3e-4 * random.normal(size=found[name][1:].shape)
    return found


def tiled(state: State, count: int) -> dict[str, np.ndarray]:
    """Return one state for many systems, (count, ...) by name."""
    return {name: np.tile(x, (count, 1)) for name, x in arrays(state).items()}


def arrays(state: State) -> dict[str, np.ndarray]:
    """Return a state's arrays by the names of a rollout's arguments."""
    found = {name: getattr(state, name) for name in ("q", "qd", "object_pose", "object_twist")}
    if state.base_pose is not None:
        found |= {"floating_pose": state.base_pose, "floating_twist": state.base_twist}
    return found


def same(a: RolloutSystems, b: RolloutSystems) -> bool:
    """Return whether two batches are the same, to the last bit of all that is carried on, and of time."""
    return same_bits(a.t, b.t) and all(same_bits(x, b.arrays[name]) for name, x in a.arrays.items())


def numbers(at: Instant) -> dict[str, np.ndarray]:
    """Return all numbers of an instant, by name."""
    found = at.result
    of_trunk = {"trunk_base_wrench": found.trunk_base_wrench, "floating_acceleration": found.base_acceleration}
    of_trunk = {name: x for name, x in of_trunk.items() if x is not None}
    names = ["qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench", "rank", "condition"]
    memory = np.ravel(np.zeros(0) if at.memory is None else at.memory)
    own = {"t": np.array(at.t), "tau": at.tau, "memory": memory, "power": at.power}
    return arrays(at.state) | of_trunk | own | {name: np.array(getattr(found, name), float) for name in names}


def difference(found: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray]) -> float:
    """Return the largest difference of any array, relative to its size or to 1."""
    assert found.keys() == expected.keys()
    worst = 0.0
    for name, x in expected.items():
        assert found[name].shape == x.shape, name
        size = max(1.0, float(np.abs(x).max(initial=0.0)))
        worst = max(worst, float(np.abs(found[name] - x).max(initial=0.0)) / size)
    return worst


def generic_rank(chain: ClosedChain, state: State) -> int:
    """Return the rank at a regular state."""
    return evaluate(Environment(chain), lambda t, x, m: (np.zeros(len(x.q)), m), 0.0, state, None).result.rank
