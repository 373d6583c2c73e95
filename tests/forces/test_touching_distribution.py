"""Distribution with contacts of the object with the world: forward dynamics gives it back, and Clarabel agrees."""

from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from scipy import sparse

import holdfast as hf
from holdfast.dynamics import ContactMode, ContactStatus
from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.constraint import constraint_rows
from holdfast.dynamics.contact.rows import contact_rows
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.forces import ForceCost, ForceLimits, distribute, least_peak, lift_margin
from holdfast.forces.force_question import force_question
from holdfast.forces.margins import conditions
from holdfast.world import HalfSpace, Touching, corners
from tests.control.two_pandas import rubber_pandas
from tests.longer import mostly_long, mostly_slow
from tests.systems.touched import touched_problem

WEIGHT = 3.0 * 9.81
CORNERS = [0, 2, 4, 6]  # those below
UP, ASIDE = np.eye(6)[5], 0.5 * np.eye(6)[3]
AT_LEAST = 0.5  # N


def on_table(mu: float = 0.5, rubber: float = 0.8) -> tuple[hf.ClosedChain, hf.State]:
    """Return two arms whose box of 3 kg stands on a table."""
    chain, state = rubber_pandas(rubber)
    table = HalfSpace(offset=float(state.object_pose[6]) - 0.1, friction=mu)
    return replace(chain, touching=Touching(corners(0.3, 0.2, 0.2), {"table": table})), state


def firmly(p) -> ForceLimits:
    """Return limits with which every contact keeps its mode with some room."""
    names = p.chain.touching.names
    slides = p.state.object_twist.any()
    return ForceLimits(**{"least_normal" if slides else "least_margin": dict.fromkeys(names, AT_LEAST)})


def assert_laws(chain, state, found, inputs=None):
    """Assert that torques and contact forces give the accelerations, and that the forces obey Signorini and Coulomb."""
    rows = contact_rows(chain.touching, state.object_frame, state.object_twist)
    forces = np.einsum("kij,kj->ki", rows.axes, found.touch_force)
    given = hf.Inputs() if inputs is None else inputs
    known = np.zeros(6) if given.object_wrench is None else given.object_wrench
    pushed = replace(given, object_wrench=known + rows.wrench(forces))
    without = hf.forward_dynamics(replace(chain, touching=None), state, found.tau, inputs=pushed)
    size = max(1.0, float(np.abs(found.qdd).max(initial=0.0)))
    np.testing.assert_allclose(without.object_acceleration, found.object_acceleration, rtol=0, atol=1e-10 * size)
    np.testing.assert_allclose(without.qdd, found.qdd, rtol=0, atol=1e-10 * size)
    a, u = rows.C @ found.object_acceleration + rows.drift, rows.velocity(state.object_twist)
    least = 1e-9 * max(1.0, float(np.abs(forces).max()))
    for j, f in enumerate(forces):
        mu, slip = rows.friction[j], u[j, :2] if np.linalg.norm(u[j, :2]) > 1e-9 else a[j, :2]
        if rows.gap[j] > 1e-9 or a[j, 2] > 1e-9 * size:
            assert not f.any()
            continue
        assert abs(a[j, 2]) < 1e-9 * size
        assert f[2] > -least
        assert np.hypot(*f[:2]) <= mu * f[2] + least
        if np.hypot(*slip) > 1e-9 * size:
            np.testing.assert_allclose(f[:2], -mu * f[2] * slip / np.hypot(*slip), rtol=0, atol=least)


def assert_given_back(chain, state, found, inputs=None, atol=1e-9):
    """Assert that forward dynamics with the laws of contact returns the motion, and the forces where unique."""
    back = hf.forward_dynamics(chain, state, found.tau, inputs=inputs)
    size = max(1.0, float(np.abs(found.qdd).max(initial=0.0)))
    np.testing.assert_allclose(back.object_acceleration, found.object_acceleration, rtol=0, atol=atol * size)
    np.testing.assert_allclose(back.qdd, found.qdd, rtol=0, atol=atol * size)
    forces = max(1.0, float(np.abs(found.grasp_wrench).max()), float(np.abs(found.touch_force).max()))
    np.testing.assert_allclose(back.grasp_wrench, found.grasp_wrench, rtol=0, atol=atol * forces)
    if found.touch_status is ContactStatus.OK:
        np.testing.assert_allclose(back.touch_force, found.touch_force, rtol=0, atol=atol * forces)
        assert np.array_equal(back.touch_mode, found.touch_mode)
    return back


@pytest.mark.parametrize("seed", [*mostly_slow(range(16), range(8)), *mostly_long(range(16, 48), ())])
def test_contacts_that_stay(seed):
    """At rest or sliding, with nothing asked of the object: forward dynamics gives it back to 1e-9."""
    p = touched_problem(seed)
    none = np.zeros((0, 6))
    found = distribute(p.chain, p.state, np.zeros(0), task=none, limits=firmly(p), inputs=p.inputs)
    if found.violation:
        assert found.status == "infeasible"
        return
    assert_laws(p.chain, p.state, found, p.inputs)
    assert found.touch_margin.min() > AT_LEAST - 1e-6
    if found.touch_status is ContactStatus.AMBIGUOUS:
        assert "another motion" in found.why
    else:
        assert_given_back(p.chain, p.state, found, p.inputs)


@pytest.mark.slow
def test_few_are_ambiguous():
    """Two walls at most that slide have one motion with given torques in all but a few of 16 questions."""
    statuses = []
    for seed in range(100, 116):
        p = touched_problem(seed, most=2, slides=True)
        limits = firmly(p)
        found = distribute(p.chain, p.state, np.zeros(0), task=np.zeros((0, 6)), limits=limits, inputs=p.inputs)
        statuses.append(found.touch_status)
    assert statuses.count(ContactStatus.AMBIGUOUS) <= 1
    assert statuses.count(ContactStatus.OK) >= 8


@pytest.mark.parametrize(
    ("asked", "mode"),
    [(None, ContactMode.STICKS), (ASIDE, ContactMode.SLIPS), (UP, ContactMode.OPEN)],
    ids=["rests", "slips", "lifts"],
)
@pytest.mark.parametrize("press", [None, 20.0])
def test_modes_of_an_acceleration(asked, mode, press):
    """A box on a table rests, begins to slip with friction at its limit against the slip, or lifts."""
    if press is not None and mode is ContactMode.OPEN:
        return
    chain, state = on_table()
    force = None if press is None else {"table": press}
    found = distribute(chain, state, asked, normal_force=force)
    assert found.status == "optimal"
    assert set(found.touch_mode[CORNERS]) == {int(mode)}
    assert_laws(chain, state, found)
    assert_given_back(chain, state, found)
    total = found.touch_force.sum(axis=0)
    if press is not None:
        assert total[2] == pytest.approx(press, abs=1e-9)
    if mode is ContactMode.SLIPS:
        np.testing.assert_allclose(total[:2], [-0.5 * total[2], 0.0], atol=1e-9)
    if mode is ContactMode.OPEN:
        assert not found.touch_force.any()


def test_the_table_carries_the_weight():
    """All of it, or a part of it, as is asked: the hands then carry the rest."""
    chain, state = on_table()
    found = distribute(chain, state, normal_force={"table": WEIGHT})
    np.testing.assert_allclose(found.grasp_wrench[:, 3:].sum(axis=0), 0.0, atol=1e-7)
    np.testing.assert_allclose(found.touch_force.sum(axis=0), [0, 0, WEIGHT], atol=1e-6)
    assert set(found.touches) == set(chain.touching.names)
    np.testing.assert_allclose(found.touches["+--/table"], found.touch_force[4])
    half = distribute(chain, state, normal_force={"table": 0.5 * WEIGHT})
    carried = hf.forces.split(chain, state, half.grasp_wrench).motion[:, 5].sum()
    assert carried == pytest.approx(0.5 * WEIGHT, abs=1e-8)


def test_slides_on():
    """A box that slides along the table: what is not asked keeps it there, and its friction is at the limit."""
    chain, state = on_table()
    twist = np.array([0, 0, 0, 0.1, 0.05, 0])
    rows = constraint_rows(chain_at_rest(chain, state))
    rates = np.linalg.lstsq(rows.joints, -rows.object @ twist)[0]
    level = replace(state, qd=rates, object_twist=twist)
    task = np.eye(6)[[2, 3, 4]]
    found = distribute(chain, level, [0.0, 0.2, 0.0], task=task, normal_force={"table": 15.0})
    assert set(found.touch_mode[CORNERS]) == {int(ContactMode.SLIPS)}
    np.testing.assert_allclose(found.object_acceleration[[2, 3, 4]], [0.0, 0.2, 0.0], atol=1e-10)
    np.testing.assert_allclose(found.object_acceleration[[0, 1, 5]], 0.0, atol=1e-8)
    assert_laws(chain, level, found)
    v = level.object_twist[3:5]
    np.testing.assert_allclose(found.touch_force.sum(axis=0)[:2], -7.5 * v / np.linalg.norm(v), atol=1e-6)


def test_bounds_by_name():
    """Normal forces between bounds, and demanded margins, of contacts and of shapes; prices and reasons name them."""
    chain, state = on_table()
    names = chain.touching.names
    low = ForceLimits(least_normal={"table": 60.0}, most_normal={"--+/table": 9.0, names[0]: 12.0, "left": 40.0})
    found = distribute(chain, state, limits=low)
    assert found.touch_force[:, 2].sum() == pytest.approx(60.0, abs=1e-6)
    assert found.prices["table least normal force"] > 0.0
    assert found.touches[names[0]][2] < 12.0 + 1e-7
    firm = distribute(chain, state, limits=ForceLimits(least_margin={names[0]: 6.0, "left": 3.0}))
    assert firm.touch_margin[0] >= 6.0 - 1e-7
    heavy = distribute(chain, state, limits=ForceLimits(most_normal={"left": 1.0}), normal_force={"table": 0.0})
    assert heavy.status == "infeasible"
    slow = distribute(chain, state, UP, limits=ForceLimits(least_normal={"table": 5.0}))
    assert slow.status == "infeasible"
    assert "least normal force of table" in slow.why


def test_friction_of_the_table_conflicts():
    """A certificate names the contact: hands that may not press cannot keep a box at rest in a side wind on a table."""
    chain, state = on_table(0.2)
    wind = hf.Inputs(object_wrench=[0, 0, 0, 20.0, 0, 0])
    found = distribute(chain, state, limits=ForceLimits(most_normal=0.0), inputs=wind)
    assert found.status == "infeasible"
    assert "friction of" in found.why
    assert "/table" in found.why
    assert found.touch_status is None
    assert found.certificate is not None
    assert found.certificate.residual < 1e-8
    assert found.certificate.lack > 1.0


def test_reports():
    """The least peak with a table is no larger, and a payload has no limit where the table carries it."""
    chain, state = on_table()
    free = replace(chain, touching=None)
    assert least_peak(chain, state).value < least_peak(free, state).value
    weak = ForceLimits(effort=0.3)
    alone, helped = (lift_margin(one, state, payload=True, limits=weak) for one in (free, chain))
    assert helped.value > 3.0 * alone.value
    faster = lift_margin(chain, state, UP, limits=weak)
    assert faster.value == pytest.approx(lift_margin(free, state, UP, limits=weak).value, rel=1e-6)
    aside = lift_margin(chain, state, ASIDE, limits=weak, normal_force={"table": 10.0})
    assert_laws(chain, state, aside)
    assert aside.value > 0.0


def test_without_arms():
    """A free object: only contacts carry it."""
    table = HalfSpace(friction=0.4)
    touching = Touching(corners(0.3, 0.2, 0.1), {"table": table})
    chain = hf.ClosedChain({}, hf.HeldObject.box(2.0, 0.3, 0.2, 0.1), {}, touching=touching)
    state = hf.State(np.zeros(0), np.zeros(0), hf.Pose.translation(0, 0, 0.05).wxyz_xyz, np.zeros(6))
    found = distribute(chain, state)
    np.testing.assert_allclose(found.touch_force.sum(axis=0), [0, 0, 19.62], atol=1e-10)
    with pytest.raises(StateError, match="no arm holds it"):
        distribute(chain, state, UP)


def test_refusals():
    """What contacts forbid is refused by name."""
    chain, state = on_table()
    with pytest.raises(StateError, match=r"'---/table'.*approach"):
        distribute(chain, state, -UP)
    with pytest.raises(StateError, match="stay as they are"):
        distribute(chain, state, [1.0], task=UP[None])
    with pytest.raises(ModelError, match=r"no contact 'tabel'.*table"):
        distribute(chain, state, normal_force={"tabel": 5.0})
    with pytest.raises(StateError, match="'--\\+/table' is open"):
        distribute(chain, state, normal_force={"--+/table": 5.0})
    with pytest.raises(ModelError, match="without"):
        distribute(replace(chain, touching=None), state, normal_force={"table": 5.0})
    with pytest.raises(ModelError, match="normal_force"):
        distribute(chain, state, normal_force={"table": -5.0})
    with pytest.raises(ModelError, match="one contact"):
        distribute(chain, state, limits=ForceLimits(least_margin={"table": 1.0}))
    with pytest.raises(MethodNotApplicable, match="barrier"):
        distribute(chain, state, cost=ForceCost(barrier=1e-5))
    lift = HalfSpace(offset=float(state.object_pose[6]) - 0.1, friction=0.5, acceleration=[0, 0, 0, 0.3, 0, 0])
    starting = replace(chain, touching=Touching(corners(0.3, 0.2, 0.2), {"belt": lift}))
    with pytest.raises(MethodNotApplicable, match="depends on the share"):
        lift_margin(starting, state, UP)


@pytest.mark.slow
def test_no_machine_code():
    """The compiled question is refused by name."""
    chain, state = on_table()
    with pytest.raises(MethodNotApplicable, match="distribute"):
        hf.compile(chain).distribute(state.q, state.qd, state.object_pose, state.object_twist, np.zeros(6))


# Clarabel, on columns of forward dynamics without contacts: tau and the forces of the world are the unknowns


def columns(p) -> Iterator[Any]:
    """Yield forward dynamics at zero, and for a unit of every torque and every component of the world's forces."""
    bare = replace(p.chain, touching=None)
    rows = contact_rows(p.chain.touching, p.state.object_frame, p.state.object_twist)
    known = np.zeros(6) if p.inputs.object_wrench is None else p.inputs.object_wrench
    n = p.chain.joint_count
    for i in range(-1, n + 3 * len(rows.gap)):
        tau, wrench = np.eye(n)[i] if 0 <= i < n else np.zeros(n), known
        if i >= n:
            wrench = known + rows.C[(i - n) // 3, (i - n) % 3]
        found = hf.forward_dynamics(bare, p.state, tau, inputs=replace(p.inputs, object_wrench=wrench))
        yield np.concatenate([found.qdd, found.object_acceleration, found.grasp_wrench.ravel()])


def in_torques(p) -> tuple[np.ndarray, np.ndarray]:
    """Return accelerations and wrenches as y = y0 + Y x."""
    at = list(columns(p))
    return at[0], np.array(at[1:]).T - at[0][:, None]


@pytest.mark.skipif(find_spec("clarabel") is None, reason="clarabel is not installed")
@pytest.mark.parametrize("seed", mostly_slow(range(200, 224), range(200, 202)))
def test_clarabel(seed):
    """The least cost and its torques are those of Clarabel's programme in the torques, from forward dynamics alone."""
    clarabel: Any = import_module("clarabel")
    p = touched_problem(seed)
    if p.chain.trunk is not None:
        return
    chain, limits = p.chain, replace(firmly(p), effort=None)
    call = {"limits": limits, "inputs": p.inputs, "form": "effort"}
    found = distribute(chain, p.state, np.zeros(0), task=np.zeros((0, 6)), **call)
    if found.status != "optimal":
        return
    y0, Y = in_torques(p)
    n, rows = chain.joint_count, contact_rows(chain.touching, p.state.object_frame, p.state.object_twist)
    k, size, slides = len(rows.gap), n + 3 * len(rows.gap), bool(p.state.object_twist.any())
    of_alpha, of_wrenches = slice(n, n + 6), slice(n + 6, None)
    cost, R = ForceCost(), p.state.object_frame.R
    units = force_question(chain, p.state, np.zeros(0), np.zeros((0, 6)), None, limits, p.inputs).found
    length, F0 = units.length, units.force
    # what is minimised: rows of squares
    root = np.sqrt(cost.effort_weights(chain))
    squares = [np.hstack([np.diag(root), np.zeros((n, 3 * k))]), cost.acceleration / 10.0 * Y[:n]]
    rest = [np.zeros(n), cost.acceleration / 10.0 * y0[:n]]
    squares.append(cost.wrench / F0 * np.hstack([np.zeros((3 * k, n)), np.eye(3 * k)]))
    rest.append(np.zeros(3 * k))
    cones, G, h = [], [], []

    def within(A, b):  # b + A x in a second-order cone
        cones.append(clarabel.SecondOrderConeT(len(b)) if len(b) > 1 else clarabel.NonnegativeConeT(1))
        G.append(-A)
        h.append(b)

    for i, (_, grasp) in enumerate(chain.grasps.items()):
        frame = R @ grasp.frame.R
        turn = np.kron(np.eye(2), frame.T)
        f0, F = (turn @ x[of_wrenches].reshape(len(chain.arms), 6, *x.shape[1:])[i] for x in (y0, Y))
        scale = 1.0 / np.repeat([length, 1.0], 3)
        squares.append(cost.wrench / F0 * scale[:, None] * F)
        rest.append(cost.wrench / F0 * scale * f0)
        for one in conditions(grasp):
            if np.isfinite(one.constant):
                loads = one.loading if np.any(one.loading) else np.zeros((0, 6))
                M = np.vstack([one.pressing, loads])
                within(M @ F, M @ f0 + one.constant * np.eye(len(M))[0])
    equal, values = [], []
    u = rows.velocity(p.state.object_twist)
    for j in range(k):
        at = n + 3 * j + np.arange(3)
        A = rows.C[j] @ Y[of_alpha]
        b = rows.C[j] @ y0[of_alpha] + rows.drift[j]
        if slides:
            t = u[j, :2] / np.hypot(*u[j, :2])
            equal += [A[2], *(np.eye(size)[at[i]] + rows.friction[j] * t[i] * np.eye(size)[at[2]] for i in (0, 1))]
            values += [-b[2], 0.0, 0.0]
            within(np.eye(size)[at[2]][None], np.array([-AT_LEAST]))
            squares[2][3 * j : 3 * j + 2] = 0.0  # the cost counts the unknown, which is the normal force
        else:
            equal += list(A)
            values += list(-b)
            rim = np.diag([rows.friction[j], 1.0, 1.0]) @ np.eye(size)[at[[2, 0, 1]]]
            within(rim, np.array([-AT_LEAST, 0.0, 0.0]))
    Q, r = np.vstack(squares), np.concatenate(rest)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = 1e-10
    all_G, all_h = np.vstack([np.array(equal), *G]), np.concatenate([values, *h])
    kinds = [clarabel.ZeroConeT(len(values)), *cones]
    P = sparse.csc_matrix(np.triu(Q.T @ Q))
    done = clarabel.DefaultSolver(P, Q.T @ r, sparse.csc_matrix(all_G), all_h, kinds, settings).solve()
    assert str(done.status) in ("Solved", "AlmostSolved")
    value = float(done.obj_val) + 0.5 * float(r @ r)
    assert value == pytest.approx(found.value, rel=1e-6)
    np.testing.assert_allclose(np.array(done.x)[:n], found.tau, atol=1e-4 * max(1.0, float(np.abs(found.tau).max())))
