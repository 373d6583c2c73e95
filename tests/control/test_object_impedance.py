"""Object impedance: the object behaves as its mass, damper and spring, for every grasp and whatever pushes it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import holdfast as hf
from holdfast.control import InternalForce, ObjectImpedance, RestToRest, cooperative_law
from holdfast.errors import ModelError
from holdfast.forces import split
from tests.control.kit import DAMPER, HERE, MASS, PATH, SPRING, STATE, moving
from tests.control.two_pandas import pushes, two_pandas

PUSH = np.array([0.4, -0.3, 0.2, 6.0, -4.0, 8.0])
pairs = pytest.mark.parametrize("kinds", [("rigid", "rigid"), ("rigid", "ball"), ("hinge", "softfinger")])


def pulled(target, state):
    """Return D (V_d - V) + K e."""
    turn = hf.spatial.rotation.log(target.pose.R @ state.object_frame.R.T)
    error = np.r_[turn, target.pose.p - state.object_frame.p]
    return DAMPER * (target.twist - state.object_twist) + SPRING * error


@pairs
def test_own_inertia(kinds):
    """Nothing is measured: with the chain's inertia L, L (alpha - alpha_d) + D (V - V_d) = K e + w for unknown w."""
    chain, state = two_pandas(*kinds)
    law = cooperative_law(chain, ObjectImpedance(PATH, SPRING, DAMPER), InternalForce(20.0))
    for seed in range(3):
        now, t = moving(seed, chain, state), 0.3 * (seed + 1)
        tau, _ = law(t, now, None)
        found = hf.forward_dynamics(chain, now, tau, inputs=hf.Inputs(object_wrench=PUSH))
        left = hf.dynamics.object_inertia(chain, now) @ (found.object_acceleration - PATH.at(t).acceleration)
        assert left == pytest.approx(pulled(PATH.at(t), now) + PUSH, abs=1e-9)


@pairs
def test_chosen_inertia(kinds):
    """With M_d, and w known, M_d (alpha - alpha_d) + D (V - V_d) = K e + w; the internal force is as wished."""
    chain, state = two_pandas(*kinds)
    law = cooperative_law(chain, ObjectImpedance(PATH, SPRING, DAMPER, MASS), InternalForce(20.0))
    for seed in range(3):
        now, t = moving(seed, chain, state), 0.3 * (seed + 1)
        tau, _ = law.given({"external_wrench": PUSH})(t, now, None)
        found = hf.forward_dynamics(chain, now, tau, inputs=hf.Inputs(object_wrench=PUSH))
        left = MASS * (found.object_acceleration - PATH.at(t).acceleration)
        assert left == pytest.approx(pulled(PATH.at(t), now) + PUSH, abs=1e-9)
        assert pushes(chain, now, split(chain, now, found.grasp_wrench).internal) == pytest.approx([20, 20], abs=1e-8)


@pytest.mark.slow
def test_error_is_that_of_a_linear_system():
    """From 2 cm off, M_d e'' + D e' + K e = 0: the run has the exponential's values, to 1e-9."""
    chain, state = two_pandas()
    offset = np.array([0.01, -0.02, 0.015])
    goal = RestToRest(hf.Pose(state.object_frame.R, state.object_frame.p + offset))
    mass, damper = np.r_[MASS[:3], 4.0, 5.0, 6.0], np.r_[DAMPER[:3], 50.0, 20.0, 90.0]
    law = cooperative_law(chain, ObjectImpedance(goal, SPRING, damper, mass))
    run = hf.simulate(chain, state, law, 0.2, 1e-3, parameters={"external_wrench": np.zeros(6)})
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.diag(SPRING[3:] / mass[3:]), -np.diag(damper[3:] / mass[3:])]])
    for k in (50, 100, 200):
        e = expm(A * run.t[k]) @ np.r_[offset, np.zeros(3)]
        assert goal.at(0.0).pose.p - run.object_pose[k, 4:] == pytest.approx(e[:3], abs=1e-9)


@pytest.mark.slow
def test_energy_only_leaves():
    """The energy of spring and mass falls by what the damper takes, less what the push brings: power to 1e-9 W."""
    chain, state = two_pandas()
    start = moving(5)
    law = cooperative_law(chain, ObjectImpedance(HERE, SPRING, DAMPER, MASS))
    for push in (np.zeros(6), PUSH):
        given, inputs = {"external_wrench": push}, hf.Inputs(object_wrench=push)
        run = hf.simulate(chain, start, law, 0.1, 1e-3, parameters=given, inputs=inputs)
        turn = [hf.spatial.rotation.log(state.object_frame.R @ run.state(k).object_frame.R.T) for k in range(len(run))]
        e, V = np.c_[turn, state.object_frame.p - run.object_pose[:, 4:]], run.object_twist
        change = (V * (MASS * run.object_acceleration) - V * (SPRING * e)).sum(axis=1)
        assert change == pytest.approx((V * push - V * (DAMPER * V)).sum(axis=1), abs=1e-9)
        energy = 0.5 * (V * MASS * V + e * SPRING * e).sum(axis=1)
        assert (np.diff(energy) < 0.0).all() or push.any()


@pytest.mark.slow
def test_gives_way_by_its_stiffness():
    """At rest under a push that nobody measures, the spring carries it: displacement = K^-1 w."""
    chain, state = two_pandas()
    push = np.array([0.0, 0.0, 0.0, 4.0, 0.0, -6.0])
    law = cooperative_law(chain, ObjectImpedance(HERE, SPRING, np.repeat([10.0, 100.0], 3)), InternalForce(20.0))
    run = hf.simulate(chain, state, law, 3.0, 2e-3, inputs=hf.Inputs(object_wrench=push))
    assert run.stopped is None
    assert run.object_pose[-1, 4:] - STATE.object_pose[4:] == pytest.approx(push[3:] / SPRING[3:], abs=1e-4)


def test_refused():
    """Matrices that are none of a spring, parts in each other's place."""
    chain, _ = two_pandas()
    with pytest.raises(ModelError, match=r"stiffness: expected a number, \(6,\) or \(6, 6\), got shape \(3,\)"):
        ObjectImpedance(HERE, [1, 2, 3], 1.0)
    with pytest.raises(ModelError, match=r"damping: expected a positive semidefinite matrix, got one with .* -2"):
        ObjectImpedance(HERE, 1.0, -2.0)
    with pytest.raises(ModelError, match="inertia: expected a positive definite matrix"):
        ObjectImpedance(HERE, 1.0, 1.0, 0.0)
    with pytest.raises(ModelError, match="stiffness: expected a symmetric matrix"):
        ObjectImpedance(HERE, np.eye(6) + np.eye(6, k=1), 1.0)
    with pytest.raises(ModelError, match="motion: expected CommandedMotion, got InternalForce; try ObjectImpedance"):
        cooperative_law(chain, InternalForce())  # pyright: ignore[reportArgumentType]
    with pytest.raises(ModelError, match=r"internal force: expected a number, \(2,\) or \(2, 6\), got shape \(3,\)"):
        cooperative_law(chain, ObjectImpedance(HERE, 1.0, 1.0), InternalForce([1.0, 2.0, 3.0]))
