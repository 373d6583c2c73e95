"""Run-time parameters: a chain built with them has the same bits, and the same code."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast
from holdfast import ClosedChain, Grasp, HeldObject, Link
from holdfast.compiled import CompiledChain
from holdfast.errors import StateError
from tests.compiled import problems
from tests.compiled.problems import STATE, chain_named, compiled, forces, numbers, one, outputs, part, pose
from tests.compiler.programs import all_same_bits, same_bits

NAME = "rows first"


def fast_of(chain: ClosedChain) -> CompiledChain:
    """Return a chain as machine code with the options of `compiled`."""
    return holdfast.compile(chain, parameters=("link_inertia", "link_wrench"))


def another(seed: int) -> tuple[ClosedChain, dict]:
    """Return the chain with other bases, contacts, links, object and gravity, and these as parameters."""
    chain, random = chain_named(NAME), np.random.default_rng(seed)
    bases = {name: pose(random, 1.0).wxyz_xyz for name in chain.names}
    frames = {name: pose(random, 0.3).wxyz_xyz for name in chain.grasps}
    held = HeldObject(random.uniform(1, 5), np.diag(random.uniform(1, 1.5, 3)), random.normal(size=3))
    arms, links = {}, []
    for name, arm in chain.arms.items():
        scale = random.uniform(0.5, 2.0)
        arms[name] = replace(arm, links=[Link(scale * k.mass, 0.9 * k.com, scale * k.inertia) for k in arm.links])
        arms[name] = arms[name].at(bases[name])
        links += arms[name].links
    grasps = {name: Grasp(grasp.kind, frames[name]) for name, grasp in chain.grasps.items()}
    gravity = random.normal(size=3)
    return ClosedChain(arms, held, grasps, gravity), {
        "base_pose": list(bases.values()),
        "grasp_pose": list(frames.values()),
        "object_mass": held.mass,
        "object_com": held.com,
        "object_inertia": held.inertia,
        "link_mass": [link.mass for link in links],
        "link_com": [link.com for link in links],
        "link_inertia": [link.inertia for link in links],
        "gravity": gravity,
    }


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_as_if_built_with_them(seed):
    """Bases, contacts, links, object and gravity at run time: the bits of a chain that has them, by the same code."""
    fast, (chain, parameters) = compiled(NAME), another(seed)
    other = fast_of(chain)
    assert other.forward_dynamics.calls.kernel is fast.forward_dynamics.calls.kernel
    given = one(numbers(chain, 1, seed) | forces(chain, 1, seed), 0)
    expected = other.forward_dynamics(**given)
    assert all_same_bits(outputs(fast.forward_dynamics(**given, **parameters)), outputs(expected))
    assert problems.relative_disagreement(expected, problems.reference(chain, given)) <= 1e-11
    assert not all_same_bits(outputs(fast.forward_dynamics(**given)), outputs(expected))


def test_of_each_system_in_a_batch():
    """Parameters with a leading axis are each system's own, mixed with shared ones."""
    fast, count = compiled(NAME), 11
    chains = [another(seed) for seed in range(count)]
    given = numbers(chains[0][0], count) | forces(chains[0][0], count)
    expected = [fast_of(chain).forward_dynamics(**one(given, i)) for i, (chain, _) in enumerate(chains)]
    every = {name: np.array([parameters[name] for _, parameters in chains]) for name in chains[0][1]}
    for threads in (1, 2):
        found = fast.forward_dynamics(**given, **every, threads=threads)
        assert all(all_same_bits(outputs(found, i), outputs(expected[i])) for i in range(count))
    one_mass = fast.forward_dynamics(**given, **every | {"object_mass": 2.5})
    same = [same_bits(one_mass.qdd[i], expected[i].qdd) for i in range(count)]
    assert not any(same)
    last = fast.forward_dynamics(**one(given, 4), **one(every, 4) | {"object_mass": 2.5})
    assert all_same_bits(outputs(one_mass, 4), outputs(last))
    batch_of_parameters = fast.forward_dynamics(**one(given, 2), **every)  # nothing but parameters differs
    assert batch_of_parameters.batch == count
    assert all_same_bits(outputs(batch_of_parameters, 2), outputs(expected[2]))


@pytest.mark.parametrize("name", ["base_pose", "grasp_pose", "object_mass", "object_com", "object_inertia", "gravity"])
def test_each_alone(name):
    """Every parameter counts, changes nothing for later calls, and is not needed twice."""
    fast, (chain, parameters) = compiled(NAME), another(5)
    given = one(numbers(chain, 1), 0)
    plain = outputs(fast.forward_dynamics(**given))
    beside = {"object_inertia": chain_named(NAME).held_object.inertia} if name == "object_mass" else {}
    changed = outputs(fast.forward_dynamics(**given, **beside, **{name: parameters[name]}))
    assert not all_same_bits(changed, plain)
    assert all_same_bits(outputs(fast.forward_dynamics(**given)), plain)


def test_scaled_inertia():
    """A mass with "scale" beside it is a body of the same shape and another density, one or each its own in a batch."""
    fast, chain = compiled(NAME), chain_named(NAME)
    held, given = chain.held_object, one(numbers(chain, 1), 0)
    masses = held.mass * np.array([0.5, 1.0, 4.0])
    state = [given[name] for name in STATE if name != "tau"]
    found = fast.forward_dynamics(**given, object_inertia="scale", object_mass=masses)
    energies = fast.kinetic_energy(*state, object_mass=masses, object_inertia="scale")
    for i, mass in enumerate(masses):
        denser = replace(held, mass=float(mass), inertia=mass / held.mass * held.inertia)
        expected = fast_of(replace(chain, held_object=denser)).forward_dynamics(**given)
        single = fast.forward_dynamics(**given, object_mass=mass, object_inertia="scale")
        assert all_same_bits(outputs(found, i), outputs(expected)) and all_same_bits(outputs(single), outputs(expected))
        bound = fast.bind(**{name: np.array(x) for name, x in given.items()})
        bound.set(object_mass=mass, object_inertia="scale")
        bound()
        assert all_same_bits(outputs(bound.result), outputs(expected))
    assert energies[2] > energies[1] == fast.kinetic_energy(*state)


def test_same_code():
    """Chains of the same arm types in the same order share their code; others do not."""
    chain = chain_named("nine")
    fast = compiled("nine")
    heavier = replace(chain, held_object=HeldObject.box(9.0, 1.0, 1.0, 1.0), gravity=np.zeros(3))
    named = replace(chain, arms=dict(zip("abcdefghi", chain.arms.values(), strict=True)), grasps={})
    regrasped = replace(named, grasps=dict(zip("abcdefghi", chain.grasps.values(), strict=True)))
    turned = holdfast.compile(chain, parameters=["link_wrench", "link_inertia"])
    kernel = fast.forward_dynamics.calls.kernel
    assert {of.forward_dynamics.calls.kernel for of in (fast_of(heavier), fast_of(regrasped), turned)} == {kernel}
    fewer = {name: grasp for name, grasp in chain.grasps.items() if name != "arm4"}
    assert replace(chain, grasps=fewer).contact_freedom_count == 24
    released = fast_of(replace(chain, grasps=fewer))
    assert released.forward_dynamics.calls.kernel is not kernel
    given = one(numbers(chain, 1), 0)
    expected = problems.reference(released.chain, given)
    np.testing.assert_allclose(released.forward_dynamics(**given).qdd, expected.qdd, rtol=1e-10, atol=1e-10)


def test_links_folded_in():
    """Without `link_inertia`, other links are other code; with other armature it is other code always."""
    one_arm = ClosedChain({"a": part(2, "ball")}, chain_named("nine").held_object, {"a": Grasp("ball")})
    arm = one_arm.arms["a"]
    heavier = replace(arm, links=[replace(link, mass=2 * link.mass) for link in arm.links])
    geared = replace(arm, joints=[replace(joint, armature=1.0) for joint in arm.joints])
    kernels = []
    for parameters in ((), ("link_inertia",)):
        chains = [replace(one_arm, arms={"a": a}) for a in (arm, heavier, geared)]
        every = [holdfast.compile(chain, parameters=parameters) for chain in chains]
        kernels.append([fast.forward_dynamics.calls.kernel for fast in every])
    (a, b, c), (d, e, f) = kernels
    assert len({id(k) for k in (a, b, c, d, f)}) == 5
    assert e is d


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gravty": [0, 0, 1]}, "no parameter 'gravty'. Did you mean 'gravity'?"),
        ({"object_mas": 1.0}, "no parameter 'object_mas'. Did you mean 'object_mass'?"),
        ({"generic_rank": 3}, "no parameter 'generic_rank'"),
        ({"base_R": np.eye(3)}, "no parameter 'base_R'"),
        ({"gravity": [0.0, 1.0]}, r"gravity: expected shape \(3,\) or \(batch, 3\), got \(2,\)"),
        ({"base_pose": [1.0, 0, 0, 0, 0, 0, 0]}, r"base_pose: expected shape \(9, 7\)"),
        ({"base_pose": np.ones((9, 7))}, r"base_pose: expected unit quaternions \(w, x, y, z\), got lengths \[2"),
        ({"object_mass": -1.0, "object_inertia": "scale"}, "object_mass: expected > 0 .*, got -1"),
        ({"object_mass": 0.0, "object_inertia": np.eye(3)}, "object_mass: expected > 0"),
        ({"object_mass": np.inf, "object_inertia": "scale"}, "object_mass: expected finite numbers"),
        ({"object_mass": 2.0}, "object_mass: expected object_inertia beside it.*try object_inertia='scale'"),
        ({"object_mass": 2, "object_inertia": "keep"}, r"object_inertia: expected \(3, 3\) numbers, or 'scale' beside"),
        ({"object_inertia": "scale"}, r"object_inertia: expected \(3, 3\) numbers, or 'scale' beside object_mass"),
        ({"gravity": np.ma.masked_equal([0.0, 0.0, -9.81], 0.0)}, "gravity: expected real numbers, got a masked array"),
        ({"object_com": [True, False, False]}, "object_com: expected real numbers, got .*True"),
        ({"object_inertia": -np.eye(3)}, "object_inertia: expected > 0"),
        ({"object_inertia": np.eye(3) + np.eye(3, k=1)}, "object_inertia: expected symmetric matrices"),
        ({"link_mass": np.full(27, -1.0)}, "link_mass: expected >= 0 .*, got -1"),
        ({"object_com": "here"}, "object_com: expected real numbers"),
        ({"object_com": [np.nan, 0, 0]}, "object_com: expected finite numbers"),
        ({"base_twist": np.full((9, 6), np.inf)}, "base_twist: expected finite numbers"),
    ],
)
def test_wrong_parameters(change, message):
    """Unknown names with what was meant, wrong shapes, bodies that cannot exist."""
    fast = compiled("nine")
    with pytest.raises(StateError, match=message):
        fast.forward_dynamics(**one(numbers(chain_named("nine"), 1), 0), **change)
    with pytest.raises(StateError, match=message):
        fast.bind(**change)


def test_only_what_was_asked_for():
    """Optional parameters exist if they were named in `compile`."""
    chain = chain_named("one")
    fast = holdfast.compile(chain)
    with pytest.raises(StateError, match="no parameter 'link_wrench'"):
        fast.forward_dynamics(**one(numbers(chain, 1), 0), link_wrench=np.zeros((7, 6)))
    assert fast.bind().link_wrench is None
