"""A five-bar linkage with springs and dampers against its two coordinates: in 30 digits, and for a second on floats."""

from dataclasses import replace

import mpmath
import pytest
from scipy.integrate import solve_ivp

import holdfast as hf
from holdfast.simulation.runge_kutta import dop853
from tests.oracles.planar_linkage import Motion, rate
from tests.simulation.runs import adaptive, balances_of, differences, limp, stepper_of
from tests.systems.five_bar import FiveBar, five_bar_chain, five_bar_state

BAR = FiveBar()
POINT = 0.2 + 0.1j  # on the left inner link, in its axes [m]
CORNER = 0.05 - 0.08j  # on the object, from C
HOOK = 0.3 + 0.9j  # in the world
ELBOW = (40.0, 0.35, 1.5)  # from the point to the right outer joint: stiffness, natural length, damping
STRING = (25.0, 0.2, 0.8)  # from the object's corner to the hook
TURN, REST = 6.0, -0.4  # of the left outer joint: N m/rad, rad


def chain() -> hf.ClosedChain:
    """Return the linkage with its springs."""
    plain = five_bar_chain(BAR)
    inner, outer = plain.arms["left"].joints
    left = replace(plain.arms["left"], joints=[inner, replace(outer, stiffness=TURN, rest=REST)])
    springs = [
        hf.Spring(("left", 0, point(POINT)), ("right", 1, point(0)), *ELBOW),
        hf.Spring(("object", point(CORNER)), ("world", point(HOOK)), *STRING),
    ]
    return replace(plain, arms={**plain.arms, "left": left}, springs=springs)


def point(z: complex) -> tuple[float, float, float]:
    """Return a point of the plane."""
    return complex(z).real, complex(z).imag, 0.0


def pulls(turns: list, ways: list, rates: list) -> list:
    """Return the generalised forces of the springs: what their forces do along each way of moving."""
    inner, outer, third, _ = BAR.bars
    # each point as what the four links carry it by, and what the world does
    ends = [
        (((POINT, 0, 0, 0), 0), ((0, 0, third.length, 0), BAR.span), *ELBOW),
        (((inner.length, outer.length - BAR.left + CORNER, 0, 0), 0), ((0, 0, 0, 0), HOOK), *STRING),
    ]
    load = [0, 0]
    for (a, at_a), (b, at_b), stiffness, natural, damping in ends:
        carried = [(y - x) * e for x, y, e in zip(a, b, turns, strict=True)]
        line = sum(carried) + at_b - at_a
        length = abs(line)
        grows = [(line.conjugate() * sum(1j * u * z for u, z in zip(way, carried, strict=True))).real for way in ways]
        rate = (line.conjugate() * sum(1j * w * z for w, z in zip(rates, carried, strict=True))).real / length
        tension = stiffness * (length - natural) + damping * rate
        load = [x - tension * g / length for x, g in zip(load, grows, strict=True)]
    bent = mpmath.atan2((turns[1] / turns[0]).imag, (turns[1] / turns[0]).real)
    torque = -TURN * (bent - REST)
    return [x + torque * (way[1] - way[0]) for x, way in zip(load, ways, strict=True)]


def test_thirty_digits():
    """After 0.05 s all positions and velocities agree to 1e-10."""
    motion = Motion(BAR, (0.2, -0.5), (1.0, -2.0), pulls)
    state = five_bar_state(BAR, *motion.links(motion.start))
    balances = balances_of(adaptive(*stepper_of(chain(), state, dop853(), 1e-12), 0.05))
    exact = five_bar_state(BAR, *motion.links(motion.after(0.05, 2)))
    assert balances.last is not None
    gap = differences(balances.last.state, exact).max()
    print(f"largest difference {gap:.1e}")
    assert gap <= 1e-10
    plain = Motion(BAR, (0.2, -0.5), (1.0, -2.0))
    unsprung = five_bar_state(BAR, *plain.links(plain.after(0.05, 2)))
    assert differences(balances.last.state, unsprung).max() > 1e-3  # the springs do count


@pytest.mark.slow
def test_a_second():
    """The same two equations on floats, by SciPy's order 8: a second of it to 1e-9."""
    motion = Motion(BAR, (0.2, -0.5), (1.0, -2.0), pulls)
    start = motion.start.astype(float)
    state = five_bar_state(BAR, *motion.links(start))
    run = hf.simulate(chain(), state, limp, 1.0, 0.05, scheme="dop853", rtol=1e-13)
    found = solve_ivp(
        lambda t, y: rate(BAR, y, mpmath.fp, pulls).astype(float), (0.0, 1.0), start, "DOP853", rtol=1e-13, atol=1e-14
    )
    gap = differences(run.state(-1), five_bar_state(BAR, *motion.links(found.y[:, -1]))).max()
    print(f"largest difference {gap:.1e}")
    assert run.stopped is None and gap <= 1e-9
    assert abs(run.imbalance).max() < 1e-10 * run.kinetic.max()
