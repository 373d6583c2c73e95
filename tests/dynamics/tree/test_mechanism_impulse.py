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


def test_a_loop_between_objects():
    """A lid that is joined to a pot while both move gets the impulses that change its momentum."""
    p = branched_problems()["pot and lid"]
    chain, state = dynamics.release(p.chain, "knob"), hf.close(dynamics.release(p.chain, "knob"), p.state)
    state = replace(state, qd=state.qd + np.where(np.arange(len(state.qd)) == 8, 0.3, 0.0))
    state = hf.close(chain, state)
    assert not chain.loops
    on = hf.Closure("object", "lid", hf.Grasp("rigid"))
    done = dynamics.attach(chain, state, "rest", on, here=True)
    assert list(done.chain.loops) == ["rest"]
    kinetic = [dynamics.kinetic_energy(one, s) for one, s in ((chain, state), (done.chain, done.state))]
    assert done.energy_change == pytest.approx(kinetic[1] - kinetic[0], rel=1e-9)
    assert done.energy_change < 0.0
    k = list(chain.free_objects).index("lid")
    jump, body = (done.state.object_twist - state.object_twist)[k], chain.objects["lid"]
    com = hf.Pose.from_wxyz_xyz(state.object_pose[k]).R @ body.com
    impulse = done.by_grasp["rest"][3:] + done.by_grasp["arm2", "link6"][3:]
    assert gap(impulse, body.mass * (jump[3:] + np.cross(jump[:3], com))) < 1e-10
    hf.forward_dynamics(done.chain, done.state, p.tau)  # which is closed
    with pytest.raises(ModelError, match="loop 'rest': expected a new name"):
        dynamics.attach(done.chain, done.state, "rest", on)
    assert not dynamics.release(done.chain, "rest").loops


def test_a_loop_at_a_frame():
    """A closure to a frame that is not the origin of its link closes where the ends are, too."""
    p = branched_problems()["grippers"]
    arm = next(name for name, one in p.chain.arms.items() if "pad1" in one.frames)
    hinge = hf.Closure(None, f"{arm}/pad1", hf.Grasp("ball"), hf.Pose.translation(0.3, 0.2, 0.4))
    done = dynamics.attach(p.chain, p.state, "held", hinge, here=True)
    hf.forward_dynamics(done.chain, done.state, p.tau)
    assert "held" in done.chain.loops and done.energy_change < 0.0
