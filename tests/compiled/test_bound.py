"""`bind`: write, call, read."""

import numpy as np
import pytest

import holdfast
from holdfast import SingularChainError, StateError
from holdfast.dynamics import Status
from tests.compiled import problems
from tests.compiled.problems import STATE, chain_named, compiled, forces, numbers, one, outputs
from tests.compiler.programs import all_same_bits
from tests.systems import planar_parallelogram, two_collinear_stretched_6r
from tests.systems.as_chain import as_chain

NAME = "interleaved"


def write(bound, given) -> None:
    """Write the inputs."""
    for name, x in given.items():
        getattr(bound, name)[...] = x


def test_same_bits():
    """The answers of the checked call, the status returned; `run` alone does the same."""
    chain, fast = chain_named(NAME), compiled(NAME)
    given = numbers(chain, 4) | {k: x for k, x in forces(chain, 4).items() if k.endswith("wrench")}
    bound = fast.bind()
    for i in range(4):
        write(bound, one(given, i))
        assert (bound() is Status.OK) if i % 2 else (bound.run() == 0)
        assert all_same_bits(outputs(bound.result), outputs(fast.forward_dynamics(**one(given, i))))
    assert bound.result.chain is chain and bound.result["arm1"].qdd.base is not None


def test_parameters():
    """`bind(...)` and `set(...)` are for this one until they are set again."""
    chain, fast = chain_named(NAME), compiled(NAME)
    given, acting = one(numbers(chain, 1), 0), one(forces(chain, 1), 0)
    moving = {name: acting[name] for name in ("base_twist", "base_acceleration")}
    plain, bound = fast.bind(), fast.bind(gravity=[0.0, 0.0, 1.0], **moving)
    for each in (plain, bound):
        write(each, given)
        assert each() is Status.OK
    expected = fast.forward_dynamics(**given, gravity=[0.0, 0.0, 1.0], **moving)
    assert all_same_bits(outputs(bound.result), outputs(expected))
    assert all_same_bits(outputs(plain.result), outputs(fast.forward_dynamics(**given)))
    plain.set(**moving, gravity=[0.0, 0.0, 1.0])  # bases that begin to move
    assert plain() is Status.OK and all_same_bits(outputs(plain.result), outputs(bound.result))
    plain.set(gravity=chain.gravity, **{name: 0.0 * x for name, x in moving.items()})
    mass = {"object_mass": 7.0, "object_inertia": "scale", "object_wrench": acting["object_wrench"]}
    bound.set(**mass)
    plain.set(base_pose=np.tile([0.5, 0.5, 0.5, 0.5, 0, 0, 0], (5, 1)))
    bound(), plain()
    expected = fast.forward_dynamics(**given, gravity=[0.0, 0.0, 1.0], **moving, **mass)
    assert all_same_bits(outputs(bound.result), outputs(expected))
    still = {name: 0.0 * x for name, x in moving.items()}
    expected = fast.forward_dynamics(**given, base_pose=np.tile([0.5, 0.5, 0.5, 0.5, 9, 9, 9], (5, 1)), **still)
    assert all_same_bits(outputs(plain.result), outputs(expected))


def test_wrong_parameters():
    """Refused, with nothing changed: no batches, no unknown names."""
    chain, fast = chain_named(NAME), compiled(NAME)
    bound = fast.bind()
    write(bound, one(numbers(chain, 1), 0))
    bound()
    kept = [x.copy() for x in outputs(bound.result)]
    for change, message in (
        ({"gravity": np.ones((2, 3))}, "gravity: expected numbers of one system, got a batch of 2"),
        ({"gravty": np.ones(3)}, "Did you mean 'gravity'"),
        ({"object_mass": 3.0}, "object_mass: expected object_inertia beside it"),
        ({"object_mass": 3.0, "object_inertia": "scale", "object_com": [1.0, 2.0]}, "object_com: expected shape"),
    ):
        with pytest.raises(StateError, match=message):
            bound.set(**change)
        bound()
        assert all_same_bits(outputs(bound.result), tuple(kept))


def test_arrays_of_a_state():
    """They cannot be written, so a loop cannot use them; the message says what can be."""
    fast = compiled(NAME)
    q = np.zeros(fast.chain.joint_count)
    q.flags.writeable = False
    with pytest.raises(StateError, match=r"q: .* such as an array of a State; try np.array\(q\)"):
        fast.bind(q=q)
    assert fast.bind(q=np.array(q)).q.shape == q.shape


def test_bad_inputs():
    """Nothing is raised: the status says so, and the results are not-a-number until the next good call."""
    chain, fast = chain_named(NAME), compiled(NAME)
    bound, given = fast.bind(), one(numbers(chain, 1), 0)
    for name in STATE:
        write(bound, given)
        getattr(bound, name)[0] = np.nan
        assert bound() is Status.INVALID and bound.run() == 4
        assert np.isnan(bound.result.qdd).all() and np.isnan(bound.result.base_wrench).all()
    write(bound, given)
    assert bound() is Status.OK


@pytest.mark.parametrize("known", [True, False])
def test_rank(known):
    """Where the generic rank matters it is found by the first call, for everybody."""
    p = as_chain(planar_parallelogram(0.3))
    fast = holdfast.compile(p.chain, generic_rank=9 if known else None)
    given = problems.given_by(p)
    first, second = fast.bind(), fast.bind()
    for bound in (first, second, first):
        write(bound, {name: given[name] for name in STATE})
        assert bound() is Status.INDETERMINATE_FORCES
        assert fast.generic_rank == 9
        assert all_same_bits(outputs(bound.result), outputs(fast.forward_dynamics(**given)))
    assert first.run() == 1


def test_singular():
    """SINGULAR is returned, not raised."""
    p = as_chain(two_collinear_stretched_6r(1))
    fast = holdfast.compile(p.chain)
    bound, given = fast.bind(), problems.given_by(p)
    write(bound, {name: given[name] for name in STATE})
    for _ in range(2):
        assert bound() is Status.SINGULAR
        assert bound.result.rank == 11 and np.isnan(bound.result.grasp_wrench).all()
    with pytest.raises(SingularChainError):
        fast.forward_dynamics(**given)
    bound.q[...] += 0.2 * np.arange(12)
    assert bound() is Status.OK


def test_nothing_is_set_in_vain():
    """`bound.q = x` would not reach the machine code, so it is refused and says what does; `+=` writes, as it reads."""
    chain, fast = chain_named(NAME), compiled(NAME)
    bound, given = fast.bind(), one(numbers(chain, 1), 0)
    write(bound, given)
    bound.qd *= 1.0
    for name, message in (
        ("q", r"bound: q: .*try bound.q\[...\] = values, or bind\(q=array\) again"),
        ("object_wrench", r"try bound.object_wrench\[...\] = values"),
        ("result", "bound: result: expected it to stay"),
        ("run", "bound: run: expected it to stay"),
        ("tua", "bound: no attribute 'tua'. Did you mean 'tau'"),
        ("gravity", r"bound: no attribute 'gravity'.*try bound.set\(gravity=...\)"),
    ):
        with pytest.raises(holdfast.FrozenError, match=message) as caught:
            setattr(bound, name, np.zeros(3))
        assert isinstance(caught.value, AttributeError)
    assert bound() is Status.OK
    assert all_same_bits(outputs(bound.result), outputs(fast.forward_dynamics(**given)))
    bound.set(base_twist=np.ones((5, 6)), base_acceleration=np.zeros((5, 6)))  # other code, the same arrays
    assert bound() is Status.OK
