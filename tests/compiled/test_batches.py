"""Bits do not depend on how many systems run together; arrays are taken as NumPy takes them; bound calls."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import holdfast
from holdfast.compiler.targets import cpu
from holdfast.dynamics import Status
from holdfast.errors import SingularChainError, StateError
from tests.compiled import problems
from tests.compiled.problems import CHAINS, STATE, chain_named, compiled, forces, numbers, one, outputs
from tests.compiler.programs import all_same_bits
from tests.longer import mostly_slow
from tests.systems import planar_parallelogram, two_collinear_stretched_6r
from tests.systems.as_chain import as_chain

LANES = cpu.lanes()
NAME = "interleaved"


@pytest.mark.parametrize("name", mostly_slow(CHAINS, ("interleaved", "nobody holds")))
def test_same_bits(name):
    """Interpreter = single = lanes = tails = threads, in all outputs."""
    chain, fast = chain_named(name), compiled(name)
    given = numbers(chain, 2 * LANES + 1) | problems.forces(chain, 2 * LANES + 1)
    singles = [outputs(fast.forward_dynamics(**one(given, i))) for i in range(2 * LANES + 1)]
    assert all_same_bits(singles[0], problems.interpreted(fast, one(given, 0)))
    for batch in (*range(1, LANES + 2), 2 * LANES + 1):  # every tail, and a tail behind two full rows
        part = {name: x[:batch] for name, x in given.items()}
        for threads in (1, 2, 3) if batch > LANES else (1,):
            found = fast.forward_dynamics(**part, threads=threads)
            assert all(all_same_bits(outputs(found, i), singles[i]) for i in range(batch))


def test_shared_arrays():
    """Arguments without a leading axis are every system's."""
    chain, fast = chain_named("nine"), compiled("nine")
    given = numbers(chain, 11)
    for name in problems.STATE:
        mixed = {k: x if k == name else x[3] for k, x in given.items()}
        found = fast.forward_dynamics(**mixed)
        assert found.batch == 11
        each = [fast.forward_dynamics(**one(given, 3) | {name: given[name][i]}) for i in range(11)]
        assert all(all_same_bits(outputs(found, i), outputs(each[i])) for i in range(11))


def test_empty_batch():
    """No systems, no numbers, no error."""
    chain, fast = chain_named("nine"), compiled("nine")
    found = fast.forward_dynamics(**numbers(chain, 0), threads=4)
    assert found.qdd.shape == (0, 27) and found.status.shape == found.rank.shape == (0,)
    again = fast.forward_dynamics(**numbers(chain, 0), out=found)
    assert again is found


def test_other_arrays():
    """Lists, integers, float32, Fortran order, strides and read-only arrays: as if converted first."""
    chain, fast = chain_named("nine"), compiled("nine")
    given = {name: np.round(x * 4) / 4 for name, x in numbers(chain, 5).items()}
    given["object_pose"][:, :4] = [0.0, 1.0, 0.0, 0.0]
    expected = fast.forward_dynamics(**given)
    frozen = {name: x.copy() for name, x in given.items()}
    for x in frozen.values():
        x.flags.writeable = False
    others = [
        frozen,
        {name: x.tolist() for name, x in given.items()},
        {name: x.astype(np.float32) for name, x in given.items()},
        {name: x.astype(">f8") for name, x in given.items()},
        {name: np.asfortranarray(x) for name, x in given.items()},
        {name: np.repeat(np.repeat(x, 2, 0), 3, 1)[::2, ::3] for name, x in given.items()},
        {name: x[::-1].copy()[::-1] for name, x in given.items()},
        {name: np.broadcast_to(x[0], x.shape) if name == "tau" else x for name, x in given.items()},
    ]
    for other in others[:-1]:
        assert all_same_bits(outputs(fast.forward_dynamics(**other)), outputs(expected))
        single = fast.forward_dynamics(**{name: x[2] for name, x in other.items()})
        assert all_same_bits(outputs(single), outputs(expected, 2))
    one_torque = fast.forward_dynamics(**given | {"tau": given["tau"][0]})
    assert all_same_bits(outputs(fast.forward_dynamics(**others[-1])), outputs(one_torque))
    whole = {name: np.round(x).astype(int) for name, x in given.items()}
    floats = {name: x.astype(float) for name, x in whole.items()}
    assert all_same_bits(outputs(fast.forward_dynamics(**whole)), outputs(fast.forward_dynamics(**floats)))


def test_misaligned_arrays():
    """Arrays that begin between two doubles."""
    chain, fast = chain_named("nine"), compiled("nine")
    given = numbers(chain, 3)
    odd = {}
    for name, x in given.items():
        raw = np.zeros(x.nbytes + 1, dtype=np.uint8)[1:]
        odd[name] = raw.view(np.float64).reshape(x.shape)
        odd[name][...] = x
    assert all_same_bits(outputs(fast.forward_dynamics(**odd)), outputs(fast.forward_dynamics(**given)))
    single = fast.forward_dynamics(**one(odd, 1))
    for _ in range(2):
        assert all_same_bits(outputs(fast.forward_dynamics(*one(odd, 1).values(), out=single)), outputs(single))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": np.zeros(26)}, r"q: expected shape \(27,\) or \(batch, 27\), got \(26,\)"),
        ({"q": np.zeros((2, 2, 27))}, "q: expected shape"),
        ({"qd": 1.0}, r"qd: expected shape .* got \(\)"),
        ({"object_pose": np.zeros((4, 6))}, r"object_pose: expected shape \(7,\)"),
        ({"tau": np.zeros((4, 27)), "qd": np.zeros((3, 27))}, "expected one batch size, got qd: 3, tau: 4"),
        ({"tau": "abc"}, "tau: expected real numbers"),
        ({"tau": [1.0, [2.0]]}, r"tau: expected real numbers, got \[1.0, \[2.0\]\]"),
        ({"tau": None}, "tau: expected real numbers, got None"),
        ({"tau": np.zeros(27, dtype=complex)}, "tau: expected real numbers, got .*complex128"),
        ({"object_wrench": np.zeros((2, 6)), "qd": np.zeros((3, 27))}, "expected one batch size"),
        ({"object_wrench": np.full(6, np.nan)}, "object_wrench: expected finite numbers"),
        ({"threads": 0}, "threads: expected an integer >= 1, got 0"),
        ({"threads": 1.5}, "threads: expected an integer >= 1, got 1.5"),
    ],
)
def test_wrong_arguments(change, message):
    """Wrong shapes and sizes are refused before anything is computed; each message says what was expected."""
    chain, fast = chain_named("nine"), compiled("nine")
    with pytest.raises(StateError, match=message):
        fast.forward_dynamics(**one(numbers(chain, 1), 0) | change)


def test_missing_argument():
    """As any function of Python's."""
    with pytest.raises(TypeError, match="expected qd, tau, object_pose, object_twist too"):
        compiled("nine").forward_dynamics(np.zeros(27))


def test_threads_of_python():
    """Single calls with and without `out`, bound calls and batches at the same time: nobody's numbers are mixed up."""
    chain, fast = chain_named("nine"), compiled("nine")
    given = numbers(chain, 40)
    expected = fast.forward_dynamics(**given)
    start = threading.Barrier(4)

    def singles():
        return (fast.forward_dynamics(**one(given, i % 40)) for i in range(200))

    def with_out():
        out = fast.forward_dynamics(**one(given, 0))
        return (fast.forward_dynamics(*one(given, i % 40).values(), out=out) for i in range(200))

    def batches():
        return (fast.forward_dynamics(**given, threads=2) for _ in range(60))

    def bound():
        call = fast.bind()
        for i in range(200):
            for name in problems.STATE:
                getattr(call, name)[...] = given[name][i % 40]
            call()
            yield call.result

    def right(calls):
        found = calls()
        start.wait()
        rows = (None if calls is batches else i % 40 for i in range(200))
        return all(all_same_bits(outputs(x), outputs(expected, i)) for x, i in zip(found, rows, strict=False))

    with ThreadPoolExecutor(4) as pool:
        started = [pool.submit(right, each) for each in (singles, with_out, batches, bound)]
        assert all(future.result() for future in started)


def write(bound, given) -> None:
    """Write the inputs."""
    for name, x in given.items():
        getattr(bound, name)[...] = x


def test_bound_calls():
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


@pytest.mark.slow
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
        with pytest.raises(holdfast.errors.FrozenError, match=message) as caught:
            setattr(bound, name, np.zeros(3))
        assert isinstance(caught.value, AttributeError)
    assert bound() is Status.OK
    assert all_same_bits(outputs(bound.result), outputs(fast.forward_dynamics(**given)))
    bound.set(base_twist=np.ones((5, 6)), base_acceleration=np.zeros((5, 6)))  # other code, the same arrays
    assert bound() is Status.OK
