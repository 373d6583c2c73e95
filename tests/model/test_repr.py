"""What is typed at a prompt is answered in a few lines: names, sizes, status; never in pages of numbers."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from tests.control.two_pandas import two_pandas
from tests.systems.as_chain import as_chain
from tests.systems.random_systems import random_system
from tests.systems.trunk_problems import random_on_trunk

LONGEST, MOST_LINES = 100, 4  # characters of a line, besides names; lines besides one for each arm


def short(thing, arms: int = 0) -> str:
    """Return how a thing looks, which must be short."""
    text = repr(thing)
    assert text.startswith("<") and text.endswith(">")
    assert len(text.splitlines()) <= MOST_LINES + arms
    assert max(map(len, text.splitlines())) <= LONGEST + 60
    return text


def test_two_pandas():
    """A chain names its arms with their grasps, a state says whether anything moves, a result has the forces."""
    chain, state = two_pandas()
    assert short(chain, 2).splitlines() == [
        "<ClosedChain: 2 arms, 14 joints",
        "  left: 7 joints, base at (-0.55, 0, 0) m, rigid grasp",
        "  right: 7 joints, base at (0.55, 0, 0) m, rigid grasp",
        "  object: 3 kg>",
    ]
    assert short(chain.arms["left"]) == "<Arm 'left': 7 joints, base at (-0.55, 0, 0) m>"
    assert short(state) == "<State: 14 joints, object at (0, 0, 0.72) m, at rest>"
    assert short(replace(state, qd=np.ones(14))).endswith("in motion>")
    tau = hf.holding_torques(chain, state, internal_force=20.0)
    found = hf.forward_dynamics(chain, state, tau)
    assert "  left: force (20, 0, 14.71) N, moment (0, 0, 0) N m" in short(found, 2)
    assert "rank 12 of 12" in short(hf.diagnose(chain, state))
    fast = hf.compile(chain)
    assert short(fast, 2).startswith("<CompiledChain of <ClosedChain: 2 arms")
    one = fast.forward_dynamics(state.q, state.qd, tau, state.object_pose, state.object_twist)
    many = fast.forward_dynamics(state.q, state.qd, np.tile(tau, (5, 1)), state.object_pose, state.object_twist)
    assert short(one, 2).startswith("<CompiledResult by sequential: rank 12")
    short(many, 2)


@pytest.mark.slow
def test_results_of_functions():
    """Matrices are given by their sizes, runs and reports by what matters most."""
    chain, state = two_pandas()
    tau = hf.holding_torques(chain, state, internal_force=20.0)
    found = hf.forward_dynamics(chain, state, tau)
    assert short(found["left"]) == "<ArmResult: 7 joints, force (20, 0, 14.71) N, moment (0, 0, 0) N m on the object>"
    jacobian = hf.forward_dynamics_jacobian(chain, state, tau, of=["qdd"], by=["q", "tau"])
    assert short(jacobian) == "<Derivatives: qdd by q (14, 14), qdd by tau (14, 14)>"
    assert short(hf.forward_dynamics_vjp(chain, state, tau, by=["q"], qdd=np.ones(14))) == "<Derivatives: q (14,)>"
    still = "<State: 14 joints, object at (0, 0, 0.72) m, at rest>"
    assert short(hf.linearise(chain, state, tau)) == f"<Linearisation: 16 coordinates, 14 torques, about {still}>"
    step = short(hf.linearise(chain, state, tau, step=0.01))
    assert step == f"<DiscreteLinearisation: 16 coordinates, 14 torques, a step of 0.01 s from {still}>"
    assert short(hf.assembly.assembly_report(chain, state)) == "<AssemblyReport: 2 arms, mobility 8, rank 12 of 12>"
    assert short(hf.assembly.Assembly(chain, state), 3).startswith("<Assembly of <ClosedChain: 2 arms, 14 joints")
    bound = hf.compile(chain).bind(q=np.array(state.q), object_pose=np.array(state.object_pose))
    assert short(bound) == "<bound forward_dynamics of left, right>"
    law = hf.control.compile_law(hf.control.GravityCompensation(chain)).bind()
    assert short(law).startswith("<BoundLaw of 14 joints: t, q, qd, ")
    at = (state.q, state.qd, tau, state.object_pose, state.object_twist)
    compiled = hf.compile(chain).forward_dynamics_jacobian(*at, of=["qdd"], by=["q", "tau"])
    assert short(compiled) == "<Derivatives: jacobian of qdd by q, tau>"
    legs = ", ".join(f"leg{k}" for k in range(1, 7))
    assert short(hf.robots.stewart_platform()) == f"<Mechanism of {legs}: object 20 kg>"
    run = hf.simulate(chain, state, lambda t, now, memory: (tau, memory), 0.004, 0.002, name="held")
    assert short(run.playback()) == "<Playback 'held': 2 moments, to 0.004 s>"
    assert short(run.summary()).startswith("<Summary: 3 samples, to 0.004 s, complete; closure error ")
    assert short(run.summary()).endswith("; peak forces left 24.83 N, right 24.83 N>")
    assert "<td>peak grasp wrench, left</td>" in run.summary()._repr_html_()


@pytest.mark.parametrize("floating", [True, False])
def test_trunks(floating):
    """Trunks and what stands on them."""
    p = random_on_trunk(3, 2, floating=floating)
    text = short(p.chain, len(p.chain.arms))
    assert ("trunk: 2 joints, floats" in text) is floating
    assert ("a floating base" in short(p.chain.trunk)) is floating
    assert ("floating base at" in short(p.state)) is floating


def test_anchors_and_contacts():
    """An anchor is called one; friction is part of a grasp; an arm may hold nothing."""
    chain, _ = two_pandas("ball", "ball")
    grasps = {"left": replace(chain.grasps["left"], contact=hf.Friction(0.8))}
    other = replace(chain, arms={**chain.arms, "pin": hf.Anchor(hf.Pose.translation(0, 0, 1))}, grasps=grasps)
    text = short(other, 3)
    assert "left: 7 joints, base at (-0.55, 0, 0) m, ball grasp with friction 0.8" in text
    assert "pin: anchor, base at (0, 0, 1) m, holds nothing" in text


def test_notebooks_escape_names():
    """A name is text, whatever it contains."""
    chain = as_chain(random_system(2, arms=1, joints=6)).chain
    (arm,) = chain.arms.values()
    odd = hf.ClosedChain({"<b>&": arm}, chain.held_object, {})
    assert "&lt;b&gt;&amp;" in odd._repr_html_() and "<b>" not in odd._repr_html_()
    assert odd._repr_html_().count("<tr>") == 3
