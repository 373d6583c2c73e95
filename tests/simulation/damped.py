"""Random damped chains, and how right a run at a step is, explicit or linearly implicit."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np

from holdfast import ClosedChain, ControlLaw, State, WrenchLimits, simulate
from holdfast.simulation.stability import fastest_decay, passive_resistance
from tests.systems import well_conditioned_system
from tests.systems.as_chain import as_chain

KINDS = ("rigid", "hinge", "softfinger", "ball")
STEPS = {"rk4": 20, "midpoint": 40}  # after so many what decays slowest among accepted rates is gone to 1e-3
FINER = 16  # steps of the truth for one
AFFORDABLE = 100.0  # h lambda up to which an adaptive explicit scheme is the truth
BEARS = 2.0  # times the largest wrench of the true motion, what every grasp bears


@dataclass(frozen=True, eq=False)
class Problem:
    """A chain to be simulated with a step.

    Attributes:
        chain: damped, its grasps without limits.
        state: in motion.
        tau: constant torques [N m or N].
        step: h [s].
        ratio: h times the fastest decay rate.
    """

    chain: ClosedChain
    state: State
    tau: np.ndarray
    step: float
    ratio: float

    @property
    def torques(self) -> ControlLaw:
        """The torques as a law; they are its memory, so that chains of one family share their machine code."""
        return ControlLaw(lambda t, state, memory, given: (memory, memory), self.tau, key="tests: memory is torque")


@functools.cache
def family(seed: int) -> tuple[ClosedChain, State]:
    """Return one or two arms of three to seven joints that hold an object and move, some joints damped."""
    rng = np.random.default_rng([5, seed])
    arms = int(rng.integers(1, 3))
    joints = [int(rng.integers(3 if arms == 1 else 6, 8)) for _ in range(arms)]
    grasps = [str(rng.choice(KINDS)) for _ in range(arms)] if arms == 2 else ["rigid"]
    p = as_chain(
        well_conditioned_system(
            seed, arms=arms, joints=joints, grasps=grasps, moving_base=False, extras=False, joint_speed=0.3,
            gravity=(0.0, 0.0, -9.81),
        )
    )  # fmt: skip

    def damped(joint):
        return replace(joint, damping=float(10 ** rng.uniform(-1, 1) * (rng.random() < 0.6)))

    damped_arms = {name: replace(arm, joints=[damped(j) for j in arm.joints]) for name, arm in p.chain.arms.items()}
    first, arm = next(iter(damped_arms.items()))
    last = replace(arm.joints[-1], damping=max(arm.joints[-1].damping, 1.0))  # one is, whatever was drawn
    damped_arms[first] = replace(arm, joints=[*arm.joints[:-1], last])
    return replace(p.chain, arms=damped_arms), p.state


def problem(seed: int, families: int) -> Problem:
    """Return a chain of one of so many families, its masses such that h lambda is as drawn, 0.1 to 1e4."""
    rng = np.random.default_rng([6, seed])
    chain, state = family(seed % families)
    ratio, step = 10 ** rng.uniform(-1, 4), 10 ** rng.uniform(-3.5, -2.5)
    rate = fastest_decay(chain, state, passive_resistance(chain, state.qd)).rate
    scale = step * rate / ratio

    def heavier(body):
        return replace(body, mass=scale * body.mass, inertia=scale * body.inertia)

    arms = {name: replace(arm, links=[heavier(x) for x in arm.links]) for name, arm in chain.arms.items()}
    heavy = replace(chain, arms=arms, held_object=heavier(chain.held_object))
    return Problem(heavy, state, scale * rng.normal(size=chain.joint_count), step, ratio)


@dataclass(frozen=True)
class Outcome:
    """What came of a problem.

    Attributes:
        ratio: h lambda.
        implicit: whether steps became linearly implicit.
        stopped: why the run ended early, or None.
        position: largest error of positions at any common time [rad or m].
        velocity: error of velocities at the end, over the largest speed.
    """

    ratio: float
    implicit: bool
    stopped: str | None
    position: float
    velocity: float


def outcome(given: Problem, scheme: str) -> Outcome:
    """Return what comes of a run.

    The truth is dop853's at 1e-9 where it can afford that, else that of steps a sixteenth as long.

    Args:
        given: the problem.
        scheme: of fixed steps.
    """
    chain, step = given.chain, given.step
    duration = STEPS[scheme] * step
    if given.ratio <= AFFORDABLE:
        exact = simulate(chain, given.state, given.torques, duration, duration / 4, scheme="dop853", rtol=1e-9)
    else:
        exact = simulate(chain, given.state, given.torques, duration, step / FINER, scheme="imex")
    assert exact.stopped is None, exact.stopped
    halves = exact.grasp_wrench.reshape(len(exact), -1, 2, 3)
    moment, force = BEARS * np.hypot.reduce(halves, axis=3).max(axis=(0, 1))
    limits = WrenchLimits(force=float(force), moment=float(moment) or 1.0)
    grasps = {name: replace(grasp, wrench_limits=limits) for name, grasp in chain.grasps.items()}
    run = simulate(replace(chain, grasps=grasps), given.state, given.torques, duration, step, scheme=scheme)
    implicit = any(one.kind == "stiff" for one in run.occurrences)
    if run.stopped is not None:
        return Outcome(given.ratio, implicit, run.stopped, np.inf, np.inf)
    nearest = np.abs(run.t[:, None] - exact.t).argmin(axis=1)
    common = np.flatnonzero(np.abs(run.t - exact.t[nearest]) <= 1e-12 * duration)
    assert len(common) >= 5
    position = max(
        np.abs(run.q[common] - exact.q[nearest[common]]).max(),
        np.abs(run.object_pose[common] - exact.object_pose[nearest[common]]).max(),
    )
    velocities = [np.concatenate([x.qd, x.object_twist], axis=1) for x in (run, exact)]
    velocity = np.abs(velocities[0][-1] - velocities[1][-1]).max() / np.abs(velocities[1]).max()
    return Outcome(given.ratio, implicit, None, float(position), float(velocity))
