"""A kind of force element is one class and its law: one that is defined here acts in everything."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import mpmath
import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import potential_energy, power
from holdfast.model.force_element import EndLoad, EndMotion, ForceElement
from holdfast.spatial.frozen import REQUIRED
from holdfast.spatial.scalar import array
from tests.derivatives.test_bushings import assert_derivatives_are_differences
from tests.dynamics.problems import later
from tests.laws.test_springs import frame_of, with_wrenches
from tests.oracles.differenced_positions import exact, rotation_about
from tests.simulation.runs import limp
from tests.systems.as_chain import Problem
from tests.systems.problems import random_problem, relative_gap

STEP = mpmath.mpf(10) ** -20


@dataclass(frozen=True, eq=False)
class Magnet(ForceElement):
    """Pulls its ends together with a force k s^3, aligns the axes of their bodies, and damps relative turning."""

    k: float = REQUIRED
    aligning: float = 0.0
    damping: float = 0.0

    def between(self, a: EndMotion, b: EndMotion):
        """Return the magnet at one instant."""
        return MagnetAt(self, b.position - a.position, b.R @ a.R.T, b.omega - a.omega)


class MagnetAt(NamedTuple):
    """U = k s^4 / 4 + aligning (3 - tr Q) / 2, and a moment -damping omega."""

    magnet: Magnet
    d: np.ndarray
    Q: np.ndarray
    omega: np.ndarray

    def loads(self):
        """Return force and moment at both ends."""
        Q, pull = self.Q, self.magnet.k * (self.d @ self.d) * self.d
        axial = array([Q[2, 1] - Q[1, 2], Q[0, 2] - Q[2, 0], Q[1, 0] - Q[0, 1]])
        moment = 0.5 * self.magnet.aligning * axial + self.magnet.damping * self.omega
        return EndLoad(pull, moment), EndLoad(-pull, -moment)

    def energy(self):
        """Return U."""
        return 0.25 * self.magnet.k * (self.d @ self.d) ** 2 + 0.5 * self.magnet.aligning * (3.0 - np.trace(self.Q))

    def loss(self):
        """Return damping |omega|^2."""
        return self.magnet.damping * (self.omega @ self.omega)


def magnetic(*, moving_base: bool = False) -> Problem:
    """Return two arms with magnets between all sorts of bodies."""
    p = random_problem(
        3, joints=(6, 7), grasps=("rigid", "ball"), moving_base=moving_base, extras=False, joint_speed=0.5
    )
    first, second = p.chain.arms
    magnets = [
        Magnet(("world", [0.2, 0.1, 0.0]), ("object", [0.0, 0.1, 0.1]), 2.0, 4.0, 0.7),
        Magnet(("object", [0.1, 0.0, 0.0]), (second, 2, [0.0, 0.2, 0.1]), 1.0, 3.0, 0.7),
        Magnet((first, 1, [0.1, 0.1, 0.0]), (second, 4, [0.0, 0.0, 0.3]), 3.0, 5.0),
        hf.Spring((first, 3, [0.0, 0.1, 0.0]), ("world", [0.0, 0.0, 1.0]), 20.0, 0.3, 1.0),
    ]
    return replace(p, chain=replace(p.chain, springs=magnets))


def stored(magnet: Magnet, frames, dx) -> mpmath.mpf:
    """Return U after displacements of both bodies, [turn; shift] each, in sixty digits."""
    (R_a, x_a), (R_b, x_b) = (
        (R := rotation_about(turn) @ exact(frame.R), exact(frame.p) + shift + R @ exact(end.point))
        for frame, end, turn, shift in zip(frames, magnet.ends, dx[::2], dx[1::2], strict=True)
    )
    return magnet.k * ((x_b - x_a) @ (x_b - x_a)) ** 2 / 4 + magnet.aligning * (3 - np.trace(R_a.T @ R_b)) / 2


def differenced(magnet: Magnet, frames) -> np.ndarray:
    """Return minus the derivative of U by the displacements of both bodies, (2, 6): their wrenches."""
    found = []
    for unit in np.eye(12, dtype=int):
        ahead, behind = (stored(magnet, frames, (sign * STEP * unit).reshape(4, 3)) for sign in (1, -1))
        found.append(-float((ahead - behind) / (2 * STEP)))
    return np.reshape(found, (2, 6))


def turning(p: Problem) -> list[np.ndarray]:
    """Return the relative angular velocity of the bodies of every magnet, by differences of attitudes."""
    h, found = 1e-6, []
    ahead, behind = (replace(p, state=later(p, sign * h)[1]) for sign in (1, -1))
    for magnet in p.chain.springs[:3]:
        R = [(frame_of(ahead, end).R - frame_of(behind, end).R) @ frame_of(p, end).R.T / (2 * h) for end in magnet.ends]
        found.append(np.array([x[[2, 0, 1], [1, 2, 0]] - x[[1, 2, 0], [2, 0, 1]] for x in R]) / 2)
    return [b - a for a, b in found]


def test_forward_dynamics_energy_and_power():
    """Its wrenches are the gradient of its energy, written a second time from positions, and the damper's moment."""
    p = magnetic()
    chain, state, plain = p.chain, p.state, replace(p.chain, springs=p.chain.springs[3:])
    loads, energy, lost = [], 0.0, 0.0
    with mpmath.workdps(60):
        for magnet, omega in zip(chain.springs[:3], turning(p), strict=True):
            frames = [frame_of(p, end) for end in magnet.ends]
            energy += float(stored(magnet, frames, np.zeros((4, 3), dtype=int)))
            lost += magnet.damping * omega @ omega
            damper = np.r_[magnet.damping * omega, np.zeros(3)]
            loads += zip(magnet.ends, differenced(magnet, frames) + np.array([damper, -damper]), strict=True)
    inputs = with_wrenches(p, loads)
    expected = hf.forward_dynamics(plain, state, p.tau, inputs=inputs)
    found = hf.forward_dynamics(chain, state, p.tau)
    for name in ("qdd", "grasp_wrench", "base_wrench", "object_acceleration"):
        assert relative_gap(getattr(found, name), getattr(expected, name)) < 1e-7  # of the differenced turning
    assert relative_gap(hf.forward_dynamics(plain, state, p.tau).qdd, found.qdd) > 1e-3
    assert potential_energy(chain, state) - potential_energy(plain, state) == pytest.approx(energy, rel=1e-12)
    with_, without = (power(c, state, p.tau, found) for c in (chain, plain))
    assert without.damping - with_.damping == pytest.approx(lost, rel=1e-7)


@pytest.mark.slow
def test_balance_of_a_run():
    """What is stored and what is lost account for the motion."""
    p = magnetic()
    run = hf.simulate(p.chain, p.state, limp, 0.03, 1e-3, scheme="dop853", rtol=1e-13)
    left = run.kinetic + run.potential - run.kinetic[0] - run.potential[0] - run.work.sum(axis=1)
    assert np.ptp(run.kinetic) > 1e-2 and np.abs(left).max() <= 1e-11 * np.abs(run.kinetic).max()


def test_derivatives():
    """They are differences of forward dynamics, and transposes of each other; so are those of springs."""
    assert_derivatives_are_differences(magnetic(moving_base=True), 1e-7)


@pytest.mark.slow
def test_machine_code():
    """Compiled forward dynamics and energy are the reference's, and those of another strength are compiled anew."""
    p = magnetic()
    stronger = replace(p.chain, springs=[replace(p.chain.springs[0], k=3.0), *p.chain.springs[1:]])
    s, answers = p.state, []
    for chain in (p.chain, stronger):
        fast = hf.compile(chain)
        answers.append(fast.forward_dynamics(s.q, s.qd, p.tau, s.object_pose, s.object_twist).qdd)
        assert relative_gap(answers[-1], hf.forward_dynamics(chain, s, p.tau).qdd) < 1e-11
        assert fast.potential_energy(s.q, s.object_pose) == pytest.approx(potential_energy(chain, s), rel=1e-13)
    assert relative_gap(*answers) > 1e-6
