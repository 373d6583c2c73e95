"""Signorini's and Coulomb's laws: residuals by other words, SciPy, invariance, statuses, and the text as a program."""

import numpy as np
import pytest
from benchmarks.contact_bars import drawn, from_clarabel
from scipy.optimize import linprog, minimize, nnls

from holdfast.compiler.interpret import interpret
from holdfast.compiler.trace import trace
from holdfast.dynamics import ContactMode, ContactStatus, solve_contacts
from holdfast.dynamics.contact.contact_forces import cold_forces, contact_problem, found_forces
from holdfast.dynamics.contact.pressing import forces_of_near
from holdfast.dynamics.contact.rows import ContactRows, contact_axes
from holdfast.dynamics.contact.uniqueness import proven_unique, squeezing_forces
from holdfast.errors import StateError
from holdfast.spatial.scalar import concatenate
from holdfast.spatial.vector import cross

UP = np.array([0.0, 0.0, 1.0])
GRAVITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -9.81])


def rows_at(points, normal=UP):
    """Return the rows C (k, 3, 6) of points from C with one normal."""
    return np.array([[concatenate([cross(l, t), t]) for t in contact_axes(normal)] for l in np.array(points, float)])


def table(half=(0.3, 0.2), at=(0.05, 0.02)):
    """Return mobility, rows and points of a body of 1 kg on four legs, its centre of mass beside their middle."""
    P = np.diag([1 / 0.02, 1 / 0.03, 1 / 0.04, 1.0, 1.0, 1.0])
    points = [(x * half[0] - at[0], y * half[1] - at[1], -0.1) for x in (-1, 1) for y in (-1, 1)]
    return P, rows_at(points), np.array(points)


def sliding(P, C, points, mu, twist):
    """Return the forces on a body that slides with a twist."""
    w = twist[:3]
    drift = np.array([contact_axes(UP) @ np.cross(w, np.cross(w, l)) for l in points])
    u = (C @ twist)[:, :2]
    return solve_contacts(P, C, C @ GRAVITY + drift, np.full(len(C), mu), slide=u / np.linalg.norm(u, axis=1)[:, None])


@pytest.mark.parametrize("mu", [0.0, 0.5])
def test_none_of_the_contacts_is_near(mu):
    """Contacts that take no part have no forces, and laws that hold."""
    P, C, _ = table()
    none, axes = np.zeros((4, 3)), np.array([contact_axes(UP)] * 4)
    rows = ContactRows(np.ones(4), C, none, none, none, axes, np.full(4, mu), np.zeros(4))
    found = forces_of_near(P, rows, C @ GRAVITY, np.zeros((4, 2)), np.zeros(4), None)
    assert not found.force.any() and not found.mode.any() and not found.residual


@pytest.mark.parametrize("k", [1, 2, 4, 8])
def test_laws(k):
    """Velocities follow from the forces, and every contact is open, sticks or slips as the laws say."""
    rng = np.random.default_rng(k)
    for _ in range(10):
        P, C, b, mu = drawn(rng, k, 0.6)
        found = solve_contacts(P, C, b, mu)
        size = np.abs(b).max()
        assert found.status in (ContactStatus.OK, ContactStatus.INDETERMINATE_FORCES, ContactStatus.AMBIGUOUS)
        np.testing.assert_allclose(found.wrench, np.einsum("kia,ki->a", C, found.force), atol=1e-12)
        np.testing.assert_allclose(found.velocity, b + C @ (P @ found.wrench), atol=1e-9 * size)
        for force, u, mode, friction in zip(found.force, found.velocity, found.mode, mu, strict=True):
            slip = np.hypot(*u[:2])
            assert force[2] >= 0.0
            assert np.hypot(*force[:2]) <= friction * force[2] * (1.0 + 1e-12)
            assert u[2] >= -1e-9 * size
            if mode == ContactMode.OPEN:
                assert not force.any()
                continue
            assert abs(u[2]) <= 1e-9 * size
            if mode == ContactMode.SLIPS:
                np.testing.assert_allclose(force[:2], -friction * force[2] * u[:2] / slip, atol=1e-6 * force[2])
            else:
                assert slip <= 1e-8 * size


def test_frictionless_is_the_nearest_motion():
    """Without friction V is the nearest velocity, in the kinetic metric, that no contact forbids: SciPy's NNLS."""
    rng = np.random.default_rng(3)
    for k in (1, 3, 6, 12):
        for _ in range(5):
            P, C, b, _ = drawn(rng, k, 1.0)
            found = solve_contacts(P, C, b, np.zeros(k))
            L = np.linalg.cholesky(P)
            G, h = C[:, 2] @ L, -b[:, 2]  # least |z| with G z >= h (Lawson and Hanson, ch. 23)
            E = np.vstack([G.T, h])
            p, _ = nnls(E, np.concatenate([np.zeros(6), [1.0]]))
            r = E @ p - np.concatenate([np.zeros(6), [1.0]])
            change = L @ (-r[:6] / r[6])
            np.testing.assert_allclose(C @ found.change, C @ change, atol=1e-9 * np.abs(b).max())
            assert found.proven


def test_clarabel():
    """At the slip that was found, the forces are those of a convex problem."""
    pytest.importorskip("clarabel")
    rng = np.random.default_rng(11)
    for k in (1, 3, 6):
        for _ in range(4):
            one = drawn(rng, k, 0.5)
            problem = contact_problem(*one, np.zeros(k), np.zeros((k, 2)), False)
            forces, residual = cold_forces(problem)
            assert residual < 1e-9
            assert from_clarabel(one, found_forces(problem, forces).change, problem) < 1e-6


def test_tangents_do_not_matter():
    """Turning t1 and t2 about n turns the forces with them."""
    rng = np.random.default_rng(5)
    P, C, b, mu = drawn(rng, 3, 0.5)
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    first, second = solve_contacts(P, C, b, mu), solve_contacts(P, turn @ C, b @ turn.T, mu)
    np.testing.assert_allclose(second.wrench, first.wrench, rtol=1e-9, atol=1e-12)


def test_a_singular_mobility():
    """An object that can only move along some directions: the others take no part, whatever the rank."""
    rng = np.random.default_rng(9)
    for rank in (1, 2, 3, 5):
        P, C, _, mu = drawn(rng, 4, 0.5)
        L = np.linalg.cholesky(P)[:, :rank]
        V = L @ rng.standard_normal(rank)
        found = solve_contacts(L @ L.T, C, C @ V, mu)
        assert found.residual < 1e-9
        assert np.linalg.matrix_rank(np.column_stack([L, found.change]), tol=1e-9) == rank


def test_the_traced_text_is_the_same():
    """The program that is traced from the text computes what the text does with floats."""
    rng, k = np.random.default_rng(1), 1

    def asked(P, C, b, mu, slide):
        problem = contact_problem(P, C, b, mu, np.zeros(k), slide, False)
        found = found_forces(problem, cold_forces(problem)[0])
        return found.force, found.change, found.mode, found.residual

    program = trace(asked, [(6, 6), (k, 3, 6), (k, 3), (k,), (k, 2)])
    assert len(program.instructions) < 25_000
    for _ in range(3):
        given = (*drawn(rng, k, 0.5), np.zeros((k, 2)))
        with np.errstate(all="ignore"):
            force, change, mode, residual = asked(*given)
        traced = interpret(program, *given)
        np.testing.assert_allclose(traced[0], force, rtol=1e-9, atol=1e-10 * np.abs(force).max())
        np.testing.assert_allclose(traced[1], change, rtol=1e-9, atol=1e-10 * np.abs(change).max())
        np.testing.assert_array_equal(traced[2], mode)
        assert traced[3] < 1e-9 > residual


def test_indeterminate_loads():
    """Four legs: loads are not unique; where all stick, slide alike, or have no friction, the motion is."""
    P, C, points = table()
    still = solve_contacts(P, C, C @ GRAVITY, np.full(4, 0.3))
    assert still.status is ContactStatus.INDETERMINATE_FORCES
    np.testing.assert_allclose(still.change, -GRAVITY, atol=1e-11)
    straight = sliding(P, C, points, 0.3, np.array([0, 0, 0, 1.0, 0, 0]))
    assert straight.status is ContactStatus.INDETERMINATE_FORCES
    np.testing.assert_allclose(straight.change, [0, 0, 0, -0.3 * 9.81, 0, 9.81], atol=1e-10)
    for found in (still, straight):  # the smallest loads have no part along the legs' null vector
        np.testing.assert_allclose(found.force[:, 2] @ [1, -1, -1, 1], 0.0, atol=1e-10)
    three = solve_contacts(P, C[:3], C[:3] @ GRAVITY, np.zeros(3))
    assert three.status is ContactStatus.OK


def test_a_turning_table_is_ambiguous():
    """Four legs that slide and turn: linear programmes give the whole range, in which the range that is told lies."""
    P, C, points = table()
    twist = np.array([0.0, 0.0, 2.0, 0.3, 0.0, 0.0])
    found = sliding(P, C, points, 0.3, twist)
    assert found.status is ContactStatus.AMBIGUOUS
    u = (C @ twist)[:, :2]
    t = u / np.linalg.norm(u, axis=1)[:, None]
    along = C[:, 2] - 0.3 * (t[:, :1] * C[:, 0] + t[:, 1:] * C[:, 1])
    for i in (2, 3, 4):
        row = P[i] @ along.T
        ends = [
            sign * linprog(sign * row, A_eq=C[:, 2] @ P @ along.T, b_eq=-(C @ GRAVITY)[:, 2]).fun for sign in (1, -1)
        ]
        np.testing.assert_allclose(found.range[:, i], ends, rtol=1e-7)  # one null vector: the bound is exact here
        assert ends[0] < found.change[i] < ends[1]


def test_jammed():
    """Two walls that move towards each other press on a body that cannot give way: a proof by Farkas' lemma."""
    C = np.concatenate([rows_at([(0, 0, 0)], np.array([1.0, 0, 0])), rows_at([(0, 0, 0)], np.array([-1.0, 0, 0]))])
    b = np.array([[0, 0, -1.0], [0, 0, -1.0]])
    found = solve_contacts(np.eye(6), C, b, [0.3, 0.3])
    assert found.status is ContactStatus.JAMMED
    p = squeezing_forces(contact_problem(np.eye(6), C, b, np.zeros(2), np.zeros(2), np.zeros((2, 2)), False).contacts)
    assert p is not None
    assert p.min() > 0.0
    assert solve_contacts(np.eye(6), C, b, [0.3, 0.3], compliance=[0.1, 0.1]).residual < 1e-9  # these give way


@pytest.mark.parametrize(("mu", "rate", "status"), [(1.0, 1.0, "OK"), (2.0, 1.0, "JAMMED"), (2.0, 4.0, "AMBIGUOUS")])
def test_painleve(mu, rate, status):
    """A rod dragged by its end: p <= 0 leaves no acceleration, or two."""
    c, s = np.cos(1.1071), np.sin(1.1071)
    P = np.diag([3.0, 3.0, 3.0, 1.0, 1.0, 1.0])
    C = rows_at([(c, 0.0, -s)])
    b = np.array([[0.0, 0.0, -9.81 + rate**2 * s]])
    found = solve_contacts(P, C, b, [mu], slide=[[1.0, 0.0]])
    assert found.status.name == status
    p = 1.0 + 3.0 * (c * c - mu * c * s)
    if status == "OK":
        assert found.force[0, 2] == pytest.approx(-b[0, 2] / p, rel=1e-12)


def test_the_certificate_holds():
    """Where uniqueness is proven, starts of all kinds end at the same motion."""
    rng, proofs = np.random.default_rng(2), 0
    for i in range(30):
        P, C, b, mu = drawn(rng, 1 + i % 3, 0.1)
        mu[1:] = 0.0  # two points of a rigid body have dependent rows
        k = len(mu)
        problem = contact_problem(P, C, b, mu, np.zeros(k), np.zeros((k, 2)), False)
        if not proven_unique(problem.contacts):
            continue
        proofs += 1
        first = solve_contacts(P, C, b, mu)
        for _ in range(3):
            other = solve_contacts(P, C, b, mu, start=np.abs(rng.standard_normal((k, 3))))
            np.testing.assert_allclose(C @ other.change, C @ first.change, atol=1e-8 * np.abs(b).max())
    assert proofs > 3


def test_compliant_contacts():
    """A compliance gives way by itself times the force; without friction it is a quadratic programme of SciPy's."""
    rng = np.random.default_rng(8)
    P, C, b, _ = drawn(rng, 3, 0.5)
    give = np.array([0.05, 0.2, 0.0])
    found = solve_contacts(P, C, b, np.zeros(3), compliance=give)
    G = C[:, 2] @ P @ C[:, 2].T + np.diag(give)

    def cost(x):
        return 0.5 * x @ G @ x + b[:, 2] @ x

    best = minimize(cost, np.ones(3), bounds=[(0, None)] * 3, method="L-BFGS-B", options={"ftol": 1e-15, "gtol": 1e-12})
    np.testing.assert_allclose(found.force[:, 2], best.x, atol=1e-5)
    soft = solve_contacts(P, C, b, [0.4, 0.4, 0.4], compliance=give + 0.01)
    u = soft.velocity + (give + 0.01)[:, None] * soft.force
    assert u[:, 2].min() > -1e-9
    assert soft.residual < 1e-9


def test_refusals():
    """Wrong shapes and numbers are refused with what was expected."""
    P, C, _ = table()
    with pytest.raises(StateError, match="friction"):
        solve_contacts(P, C, C @ GRAVITY, [-0.1, 0, 0, 0])
    with pytest.raises(StateError, match="rows"):
        solve_contacts(P, C[:3], C @ GRAVITY, np.zeros(4))
    with pytest.raises(StateError, match="free"):
        solve_contacts(P, C, np.full((4, 3), np.nan), np.zeros(4))
    assert solve_contacts(P, np.zeros((0, 3, 6)), np.zeros((0, 3)), []).status is ContactStatus.OK
