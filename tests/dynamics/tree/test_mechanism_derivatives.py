"""Derivatives of the forward dynamics of chains with branches, in their own terms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.linearise import basis_at
from holdfast.dynamics.tree.mechanism_terms import chain_arguments, chain_results, flat_state
from holdfast.dynamics.tree.varied_forest import displacement
from holdfast.errors import MethodNotApplicable, StateError
from tests.dynamics.tree.as_branched import gap, serial_problems, with_stray
from tests.longer import mostly_slow
from tests.systems.branched import branched_problems

POSITIONS = {"q": "q", "object_pose": "object_pose", "floating_pose": "base_pose"}
FLOATING = ("floating_pose", "floating_twist")
VELOCITIES = {"qd": "qd", "object_twist": "object_twist", "floating_twist": "base_twist"}


def part_of(chain, name, flat):
    """Return a part of a forest's tangent or rates in the chain's shape."""
    place = chain_arguments(chain)[name]
    return place.of({place.name: flat})


def along(chain, before, after, size):
    """Return the difference of two states by argument, divided by a number."""
    (q0, v0), (q1, v1) = flat_state(chain, before), flat_state(chain, after)
    step = displacement(chain.as_forest.forest, q0, q1) / size
    names = chain_arguments(chain)
    found = {name: part_of(chain, name, step) for name in POSITIONS if name in names}
    return found | {name: part_of(chain, name, (v1 - v0) / size) for name in VELOCITIES if name in names}


def shown(result):
    """Return the results of forward dynamics by name."""
    found = {name: getattr(result, name) for name in ("qdd", "object_acceleration", "grasp_wrench", "coupling_force")}
    return found | ({} if result.base_acceleration is None else {"floating_acceleration": result.base_acceleration})


@pytest.mark.parametrize("name", mostly_slow(branched_problems(), ("palletiser", "on a shoulder")))
def test_along_motions(name):
    """Rates along closed states are differences of forward dynamics between them."""
    chain, state, tau = branched_problems()[name]
    random, h = np.random.default_rng(1), 1e-5
    kick, push = random.normal(size=len(state.q)), random.normal(size=len(state.qd))
    if name == "on a shoulder":
        kick[1:5] = 0.0  # a quaternion, which follows from the others

    def there(sign):
        guess = replace(state, q=state.q + sign * h * kick, qd=state.qd + sign * h * push)
        return hf.close(chain, guess)

    ends = [there(sign) for sign in (-1.0, 1.0)]
    (before, after), moved = (shown(hf.forward_dynamics(chain, end, tau)) for end in ends), along(chain, *ends, 2 * h)
    found = hf.forward_dynamics.jvp(chain, state, tau, along=moved)
    assert set(found.parts) == set(chain_results(chain)) == set(before)
    for result, x in found.parts.items():
        assert gap(x, (after[result] - before[result]) / (2 * h)) < 1e-6, result


@pytest.mark.parametrize("name", mostly_slow(branched_problems(), ("palletiser", "on a shoulder")))
def test_jacobian_and_gradients(name):
    """Columns of the Jacobian are rates, and rows are gradients, for every argument and result."""
    chain, state, tau = branched_problems()[name]
    names, results = chain_arguments(chain), chain_results(chain)
    J = hf.forward_dynamics.jacobian(chain, state, tau, of=[*results], by=[*names])
    random = np.random.default_rng(2)
    bars = {result: random.normal(size=place.shape) for result, place in results.items()}
    gradients = hf.forward_dynamics.vjp(chain, state, tau, by=[*names], **bars)
    rates = {argument: random.normal(size=place.shape) for argument, place in names.items()}
    for argument in rates:
        if argument.endswith("inertia"):
            rates[argument] = rates[argument] + np.swapaxes(rates[argument], -1, -2)
    moved = hf.forward_dynamics.jvp(chain, state, tau, along=rates)
    for result, bar in bars.items():
        wanted = sum(np.tensordot(J[result, a], x, x.ndim) for a, x in rates.items())
        assert gap(moved[result], wanted) < 1e-9, result
        assert moved[result].shape == bar.shape
    for argument, x in rates.items():
        wanted = sum(np.sum(bar * np.tensordot(J[result, argument], x, x.ndim)) for result, bar in bars.items())
        assert gap(np.sum(gradients[argument] * x), wanted) < 1e-9, argument
        assert gradients[argument].shape == names[argument].shape
    assert gap(gradients.result.qdd, hf.forward_dynamics(chain, state, tau).qdd) == 0.0


@pytest.mark.parametrize("name", mostly_slow(serial_problems(), ("anchors", "an anchor on a trunk")))
def test_as_serial_chains(name):
    """With an object that falls beside it, gradients are those of the serial chain, by positions along its motions."""
    p = serial_problems()[name]
    chain, state, tau, inputs = with_stray(p)
    by = ["tau", "gravity", "link_mass", "link_com", "link_inertia", "link_wrench", "armature", "damping"]
    by += ["trunk_link_mass", "trunk_link_wrench"] if chain.trunk is not None else []
    of_object = ["object_mass", "object_com", "object_inertia", "object_wrench", "object_pose", "object_twist"]
    of_state = ["q", "object_pose", *FLOATING[:1], "qd", "object_twist", *FLOATING[1:]]
    of_state = of_state if chain.floats else [x for x in of_state if x not in FLOATING]
    random, held = np.random.default_rng(3), [list(chain.arms).index(name) for name in chain.grasps]
    bars = {"qdd": random.normal(size=len(tau)), "object_acceleration": random.normal(size=6)}
    bars |= {"grasp_wrench": random.normal(size=(len(chain.arms), 6))}
    bars |= {"floating_acceleration": random.normal(size=6)} if chain.floats else {}
    every = [*dict.fromkeys([*by, *of_object, *of_state])]
    wanted = hf.forward_dynamics.vjp(p.chain, p.state, tau, inputs=p.inputs, by=every, check=False, **bars)
    bars["grasp_wrench"] = bars["grasp_wrench"][held]
    bars["object_acceleration"] = [bars["object_acceleration"], np.zeros(6)]
    found = hf.forward_dynamics.vjp(chain, state, tau, inputs=inputs, by=every, check=False, **bars)
    own = {x: found[x][0] if x in of_object else found[x] for x in every}
    for argument in (*by, *of_object[:4]):
        assert gap(own[argument], wanted[argument]) < 1e-8, argument
    T = basis_at(p.chain, p.state, p.inputs.shaped(p.chain))
    x, y = (np.concatenate([of[name] for name in of_state]) @ T for of in (own, wanted))
    assert gap(x, y) < 1e-8


def test_what_is_asked_by_default():
    """A chain without objects has no columns of them."""
    chain, state, tau = branched_problems()["palletiser"]
    J = hf.forward_dynamics.jacobian(chain, state, tau)
    assert {key: x.shape for key, x in J.parts.items() if key[0] == "qdd"} == {
        **{("qdd", name): (4, 4) for name in ("q", "qd", "tau")},
        **{("qdd", name): (4, 0, 6) for name in ("object_pose", "object_twist")},
    }
    assert gap(J["grasp_wrench", "tau"].shape, (1, 6, 4)) == 0.0


def test_refusals():
    """Unknown names are refused with the known ones, wrong shapes, and what forests do not take."""
    chain, state, tau = branched_problems()["pot and lid"]
    with pytest.raises(StateError, match=r"forward_dynamics_vjp: no 'base_pose'"):
        hf.forward_dynamics.vjp(chain, state, tau, by=["base_pose"], qdd=tau)
    with pytest.raises(StateError, match=r"no 'floating_acceleration'"):
        hf.forward_dynamics.vjp(chain, state, tau, floating_acceleration=np.ones(6))
    with pytest.raises(StateError, match=r"object_pose: expected shape \(2, 6\)"):
        hf.forward_dynamics.jvp(chain, state, tau, along={"object_pose": np.ones(6)})
    with pytest.raises(MethodNotApplicable, match="generic_rank"):
        hf.forward_dynamics.jacobian(chain, state, tau, generic_rank=3)
