"""Grasps that close and open in chains with branches: impulses, momentum and energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast import dynamics
from holdfast.errors import ClosureError, ModelError
from tests.dynamics.tree.as_branched import gap, serial_problems, with_stray
from tests.systems.branched import branched_problems


def test_in_flight():
    """A flying robot with open hands catches a box: momentum stays as it was, and energy is lost."""
    p = branched_problems()["on a shoulder"]
    key = ("arm", "link3")
    grasp = p.chain.grasps[key]
    loose = dynamics.release(p.chain, key)
    assert not loose.grasps and loose.beyond_serial
    random = np.random.default_rng(5)
    state = replace(p.state, object_twist=random.normal(size=6))
    done = dynamics.attach(loose, state, key, grasp)
    assert list(done.chain.grasps) == [key] and done.status is dynamics.Status.OK
    about = [0.1, 0.2, 0.3]
    before, after = (dynamics.momentum(loose, s, about) for s in (state, done.state))
    assert gap(after, before) < 1e-12
    kinetic = [dynamics.kinetic_energy(loose, s) for s in (state, done.state)]
    assert done.energy_change == pytest.approx(kinetic[1] - kinetic[0], rel=1e-9)
    assert done.energy_change < 0.0
    jump = done.state.object_twist - state.object_twist
    box = loose.held_object
    mass = box.mass * (jump[3:] + np.cross(jump[:3], state.object_frame.R @ box.com))
    assert gap(done.by_grasp[key][3:], mass) < 1e-11  # the only impulse on the box
    hf.forward_dynamics(done.chain, done.state, p.tau)  # which is closed
    assert dynamics.attach(loose, p.state, key, grasp).energy_change == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize("name", ["moving bases", "an arm that holds nothing", "a floating base"])
def test_as_serial_chains(name):
    """With an object that falls beside it, velocities and impulses are those of the serial chain."""
    p = serial_problems()[name]
    chain, state, _, inputs = with_stray(p)
    caught = next(reversed(chain.grasps))
    grasp = chain.grasps[caught]
    random = np.random.default_rng(6)
    loose, alone = (dynamics.release(one, caught) for one in (chain, p.chain))
    own = chain.joints[caught]
    if name == "an arm that holds nothing":
        qd = np.array(p.state.qd)
        qd[own] += random.normal(size=own.stop - own.start)
        p, state = replace(p, state=replace(p.state, qd=qd)), replace(state, qd=qd)
    here = {"here": True, "inputs": p.inputs}
    wanted = dynamics.attach(alone, p.state, caught, grasp, **here)
    found = dynamics.attach(loose, state, caught, grasp, here=True, inputs=inputs)
    held = [list(chain.arms).index(key) for key in chain.grasps]
    assert gap(found.state.qd, wanted.state.qd) < 1e-10
    assert gap(found.state.object_twist[0], wanted.state.object_twist) < 1e-10
    assert gap(found.impulses, wanted.impulses[held]) < 1e-9
    assert found.energy_change == pytest.approx(wanted.energy_change, abs=1e-9)


def test_a_serial_arm_by_a_link():
    """An arm that grips by one of its links becomes a forest."""
    p = serial_problems()["an arm that holds nothing"]
    caught = next(reversed(p.chain.grasps))
    loose = dynamics.release(p.chain, caught)
    links = [replace(link, name=f"link{k}") for k, link in enumerate(loose.arms[caught].links)]
    loose = replace(loose, arms={**loose.arms, caught: replace(loose.arms[caught], links=links)})
    key = (caught, links[-1].name)
    done = dynamics.attach(loose, p.state, key, hf.Grasp("ball"), here=True, inputs=p.inputs)
    assert done.chain.beyond_serial == (f"a grasp by {key!r}",)
    before, after = (dynamics.kinetic_energy(loose, s, p.inputs) for s in (p.state, done.state))
    assert done.energy_change == pytest.approx(after - before)


def test_by_a_finger_where_it_is():
    """A pad that is not at the box grips it where it is; asked to grip elsewhere, it says how far that is."""
    p = branched_problems()["grippers"]
    apart = p.chain.grasps["arm2", "link6"]
    key, grasp = ("arm2", "pad1"), replace(apart, kind="ball")
    with pytest.raises(ClosureError, match=r"grasp \('arm2', 'pad1'\): 0\.\d+ m or rad away"):
        dynamics.attach(p.chain, p.state, key, grasp)
    done = dynamics.attach(p.chain, p.state, key, grasp, here=True)
    assert key in done.chain.grasps and done.chain.grasps[key].kind == "ball"
    hf.forward_dynamics(done.chain, done.state, p.tau)
    with pytest.raises(ModelError, match=r"grasp \('arm2', 'pad1'\): expected an arm without a grasp"):
        dynamics.attach(done.chain, done.state, key, grasp)
    with pytest.raises(ModelError, match=r"grasp \('arm2', 'pad2'\): no such grasp"):
        dynamics.release(done.chain, ("arm2", "pad2"))
