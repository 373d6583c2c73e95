"""Each system's status says why it has no answer; the others do not notice."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast
from holdfast import Arm, ClosedChain, Grasp, Joint, Link, Pose
from holdfast.dynamics import Status
from holdfast.errors import ModelError, SingularChainError, StateError
from tests.compiled import problems
from tests.compiled.problems import FIELDS, STATE, Given, chain_named, compiled, numbers, one, outputs
from tests.compiler.programs import all_same_bits
from tests.longer import mostly_slow
from tests.model.parts import BOX, arm
from tests.systems import planar_parallelogram, two_collinear_stretched_6r
from tests.systems.as_chain import as_chain

INVALID, SINGULAR, OK = Status.INVALID, Status.SINGULAR, Status.OK


def no_answer(result, i) -> bool:
    """Return whether the i-th system has not-a-number in every physical output."""
    return all(np.isnan(result.array(name)[i]).all() for name in FIELDS)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", mostly_slow(["all kinds", "factors only", "nobody holds"], ("factors only",)))
def test_numbers_that_are_not_finite(name, value):
    """One such number anywhere in the state: INVALID there, all other systems bit-identical; a single call raises."""
    chain, fast = chain_named(name), compiled(name)
    places = [(k, e) for k in STATE for e in range(numbers(chain, 1)[k].shape[1])]
    given = numbers(chain, 2 * len(places))
    clean = fast.forward_dynamics(**given)
    for i, (k, e) in enumerate(places):
        given[k][2 * i, e] = value
    found = fast.forward_dynamics(**given)
    for i, place in enumerate(places):
        assert found.status[2 * i] is INVALID and no_answer(found, 2 * i), place
        assert all_same_bits(outputs(found, 2 * i + 1), outputs(clean, 2 * i + 1)), place
    for i in range(0, len(places), 5):
        with pytest.raises(StateError, match=f"{places[i][0]}: expected finite numbers, got {value}"):
            fast.forward_dynamics(**one(given, 2 * i))


@pytest.mark.slow
def test_positions_too_far():
    """Angles beyond 1e5 rad are INVALID, at 1e5 they are not; sliding joints may be anywhere."""
    chain, fast = chain_named("all kinds"), compiled("all kinds")
    joints = [joint for a in chain.arms.values() for joint in a.joints]
    given = numbers(chain, 3 * len(joints))
    clean = fast.forward_dynamics(**given)
    for j in range(len(joints)):
        given["q"][3 * j, j], given["q"][3 * j + 1, j] = -100001.0, 1e5
    found = fast.forward_dynamics(**given)
    for j, joint in enumerate(joints):
        assert found.status[3 * j] is (INVALID if joint.kind == "revolute" else OK)
        assert no_answer(found, 3 * j) == (joint.kind == "revolute")
        assert found.status[3 * j + 1] is OK
        assert all_same_bits(outputs(found, 3 * j + 2), outputs(clean, 3 * j + 2))
    first = next(j for j, joint in enumerate(joints) if joint.kind == "revolute")
    with pytest.raises(StateError, match="q: expected at most 100000 rad, got 100001"):
        fast.forward_dynamics(**one(given, 3 * first))


def test_quaternions():
    """Within 1e-6 of unit length they are normalised as the reference does; beyond, INVALID."""
    chain, fast = chain_named("all kinds"), compiled("all kinds")
    given = numbers(chain, 4)
    given = {name: np.repeat(x[:1], 4, axis=0) for name, x in given.items()}
    for i, scale in enumerate((1.0, 1.0 + 9e-7, 1.0 + 2e-6, 0.0)):
        given["object_pose"][i, :4] *= scale
    found = fast.forward_dynamics(**given)
    assert found.status.tolist() == [OK, OK, INVALID, INVALID]
    np.testing.assert_allclose(found.qdd[1], found.qdd[0], rtol=1e-9)
    assert no_answer(found, 2) and no_answer(found, 3)
    with pytest.raises(StateError, match=r"object_pose: expected a unit quaternion .* first, got length 1.000002"):
        fast.forward_dynamics(**one(given, 2))


def test_overflow():
    """Rates whose squares overflow."""
    chain, fast = chain_named("all kinds"), compiled("all kinds")
    given = numbers(chain, 3)
    clean = fast.forward_dynamics(**given)
    given["qd"][1] *= 1e200
    found = fast.forward_dynamics(**given)
    assert found.status.tolist() == [OK, INVALID, OK] and no_answer(found, 1)
    assert all_same_bits(outputs(found, 2), outputs(clean, 2))
    with pytest.raises(ModelError, match=r"the accelerations are not finite: .* or sizes overflow"):
        fast.forward_dynamics(**one(given, 1))


@pytest.mark.parametrize("holding", mostly_slow([True, False], (True,)))
@pytest.mark.parametrize("method", ["recursive", "mass_matrix"])
def test_no_inertia(holding, method):
    """A massless link that nothing loads: INVALID by either route, whether its arm holds or not."""
    lame = Arm([*arm(2).joints, Joint(axis=[0, 1, 0])], [*arm(2).links, Link(0.0)])
    grasps = {"lame": Grasp("ball")} if holding else {"good": Grasp("ball")}
    chain = ClosedChain({"good": arm(3), "lame": lame}, BOX, grasps)
    fast, given = holdfast.compile(chain, method=method), numbers(chain, 9)
    found = fast.forward_dynamics(**given)
    assert set(found.status) == {INVALID} and all(no_answer(found, i) for i in range(9))
    with pytest.raises(ModelError, match="an arm's mass matrix is singular here"):
        fast.forward_dynamics(**one(given, 0))
    joints = [*lame.joints[:2], replace(lame.joints[2], armature=0.01)]
    mended = replace(chain, arms={"good": chain.arms["good"], "lame": replace(lame, joints=joints)})
    assert INVALID not in holdfast.compile(mended, method=method).forward_dynamics(**given).status


def stretched(batch: int) -> tuple[ClosedChain, Given, np.ndarray]:
    """Return two arms stretched along one line, as machine code, and a batch whose every third system is so."""
    p = as_chain(two_collinear_stretched_6r(1))
    given = problems.given_by(p)
    random = np.random.default_rng(0)
    many: Given = {name: np.repeat(given[name][None], batch, axis=0) for name in STATE}
    bent = np.arange(batch) % 3 > 0
    many["q"][bent] += random.uniform(-0.5, 0.5, (bent.sum(), 12))
    return p.chain, many, bent


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_singular_systems(known):
    """Singular systems of a batch: statuses exact, no numbers; the others as in a clean batch, and nothing raised."""
    chain, given, bent = stretched(20)
    fast = holdfast.compile(chain, generic_rank=12 if known else None)
    found = fast.forward_dynamics(**given)
    assert found.status.tolist() == [OK if x else SINGULAR for x in bent]
    assert found.rank.tolist() == [12 if x else 11 for x in bent]
    assert all(no_answer(found, i) for i in np.flatnonzero(~bent))
    assert fast.generic_rank == 12
    clean = fast.forward_dynamics(**given | {"q": np.where(bent[:, None], given["q"], given["q"] + 0.3)})
    assert set(clean.status) == {OK}
    assert all(all_same_bits(outputs(found, i), outputs(clean, i)) for i in np.flatnonzero(bent))
    again = fast.forward_dynamics(**given, out=found, threads=2)
    assert again.status.tolist() == [OK if x else SINGULAR for x in bent]


@pytest.mark.slow
def test_singular_and_invalid():
    """What is not finite is INVALID, even where the configuration is singular."""
    chain, given, bent = stretched(12)
    given["tau"][::2, 0] = np.nan
    found = holdfast.compile(chain).forward_dynamics(**given)
    expected = [INVALID if i % 2 == 0 else OK if x else SINGULAR for i, x in enumerate(bent)]
    assert found.status.tolist() == expected
    assert [no_answer(found, i) for i in range(12)] == [status is not OK for status in expected]


def cranks(*angles: float) -> tuple[ClosedChain, Given]:
    """Return a parallelogram and a batch of its closed states, cranks at these angles [rad]."""
    p = as_chain(planar_parallelogram(0.3))
    given = problems.given_by(p)
    many: Given = {name: np.repeat(given[name][None], len(angles), axis=0) for name in STATE}
    many["q"] = np.outer(angles, [1.0, -1.0, 1.0, -1.0])
    reach, start = (0.5 * np.column_stack([np.cos(a), np.sin(a), 0.0 * a]) for a in (np.array(angles), np.array([0.3])))
    many["object_pose"][:, 4:] += reach - start
    many["object_twist"][:, 3:] = 0.7 * np.cross([0.0, 0.0, 1.0], reach)
    return p.chain, many


@pytest.mark.parametrize("first", [0.0, 0.4])
@pytest.mark.parametrize("known", mostly_slow([True, False], (True,)))
def test_indeterminate_systems(known, first):
    """A mechanism whose rank is always low: solved, but for the flat position, whichever comes first."""
    angles = np.array([first, 0.3, 0.0, 0.5, 0.0, 0.7])
    chain, many = cranks(*angles)
    fast = holdfast.compile(chain, generic_rank=9 if known else None)
    found = fast.forward_dynamics(**many)
    flat, low = angles == 0.0, Status.INDETERMINATE_FORCES
    assert found.status.tolist() == [SINGULAR if x else low for x in flat]
    assert found.rank.tolist() == [8 if x else 9 for x in flat] and fast.generic_rank == 9
    assert all(no_answer(found, i) for i in np.flatnonzero(flat))
    for i in np.flatnonzero(~flat):
        expected = problems.reference(chain, one(many, i))
        np.testing.assert_allclose(found.qdd[i], expected.qdd, rtol=1e-9)
        single = fast.forward_dynamics(**one(many, i))
        assert single.status is low and all_same_bits(outputs(single), outputs(found, i))
    with pytest.raises(SingularChainError, match="rank 8 of 12 here, but 9 in general"):
        fast.forward_dynamics(**one(many, 2))


def test_bases_at_run_time():
    """The generic rank is sought where the bases are, not where they were when the chain was compiled."""
    chain, many = cranks(0.3, 0.0, 0.5)
    elsewhere = chain.with_bases({name: Pose.translation(40.0 * k, 0.0, 9.0) for k, name in enumerate(chain.names)})
    bases = [a.base.wxyz_xyz for a in chain.arms.values()]
    for batch in (many, one(many, 0)):
        found = holdfast.compile(elsewhere).forward_dynamics(**batch, base_pose=bases)
        assert np.ravel(found.rank)[0] == 9
        assert np.ravel(found.status)[0] is Status.INDETERMINATE_FORCES


def test_one_stray_system():
    """A system whose grasps are nowhere near closed does not decide what the others are, now or later."""
    chain, many = cranks(0.3, 0.3, 0.4, 0.5)
    many["object_pose"][0, 4:] = 1e200
    fast = holdfast.compile(chain)
    with np.errstate(all="ignore"):
        found = fast.forward_dynamics(**many)
    low = Status.INDETERMINATE_FORCES
    assert found.status.tolist()[1:] == [low] * 3
    assert fast.forward_dynamics(**one(many, 1)).status is low


def test_too_high_a_rank():
    """A generic rank that is given is trusted."""
    p = as_chain(planar_parallelogram(0.3))
    fast = holdfast.compile(p.chain, generic_rank=10)
    with pytest.raises(SingularChainError, match="rank 9 of 12 here, but 10 in general"):
        fast.forward_dynamics(**problems.given_by(p))


@pytest.mark.slow
def test_rank_is_sought_once(monkeypatch):
    """The neighbours are visited when a rank is low for the first time, and never for chains of full rank."""
    from holdfast.dynamics import rank

    sought = []
    seek = rank.generic_constraint_rank
    monkeypatch.setattr(rank, "generic_constraint_rank", lambda *given: sought.append(1) or seek(*given))
    chain, given, _ = stretched(9)
    fast = holdfast.compile(chain)
    fast.forward_dynamics(**{name: x[1::3] for name, x in given.items()})
    assert not sought and fast.generic_rank is None
    for _ in range(3):
        fast.forward_dynamics(**given)
        with pytest.raises(SingularChainError):
            fast.forward_dynamics(**one(given, 0))
    assert sought == [1]


@pytest.mark.slow
def test_out_after_an_error():
    """A call that raises leaves `out` with a status that says so; the next good one fills it."""
    chain, given, _ = stretched(3)
    fast = holdfast.compile(chain)
    out = fast.forward_dynamics(**one(given, 1))
    expected = [x.copy() for x in outputs(out)]
    for _ in range(3):
        with pytest.raises(SingularChainError):
            fast.forward_dynamics(*one(given, 0).values(), out=out)
        assert out.status is SINGULAR and np.isnan(out.qdd).all()
        fast.forward_dynamics(*one(given, 1).values(), out=out)
        assert all_same_bits(outputs(out), tuple(expected))
    with pytest.raises(StateError, match="tau: expected finite numbers"):
        fast.forward_dynamics(**one(given, 1) | {"tau": np.full(12, np.nan)}, out=out)
    assert out.status is INVALID and np.isnan(out.base_wrench).all()
