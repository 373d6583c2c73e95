"""Modes as numbers give the forces of `touch_with`, or say that these have to be asked for."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.contact.fixed_modes import ContactModes, RestResponses, touch_with
from holdfast.dynamics.contact.masked_modes import FOREVER, MaskedModes, forces_in_modes
from holdfast.dynamics.contact.solved_contacts import ContactMode
from holdfast.spatial import rotation
from holdfast.world import HalfSpace, Touching, corners
from tests.control.two_pandas import two_pandas

OPEN, STICKS, SLIPS = (ContactMode[name] for name in ("OPEN", "STICKS", "SLIPS"))
FLOORED = {name: (STICKS if name[2] == "-" else OPEN) for name in corners(1.0, 1.0, 1.0)}


def both(seed, mode, friction=0.4, along=None, held=False):
    """Return what both find for a box on a floor, free or held by two arms; `along` pulls it, relative to weight."""
    dice = np.random.default_rng(seed)
    if held:
        chain, state = two_pandas()[:2]
        frame, q = state.object_frame, state.q
    else:
        chain, q = hf.ClosedChain({}, hf.HeldObject.box(2.0, 0.3, 0.2, 0.2), {}), np.zeros(0)
        frame = hf.Pose(rotation.exp(dice.normal(size=3)), dice.normal(size=3))
    normal, points = frame.R[:, 2], corners(0.3, 0.2, 0.2)
    floor = HalfSpace(normal=normal, offset=normal @ frame.p - 0.1, friction=friction)
    chain = replace(chain, touching=Touching(points, {"floor": floor}))
    twist = np.concatenate([dice.normal() * normal, np.cross(normal, dice.normal(size=3))])
    twist *= mode in (OPEN, SLIPS)
    state = hf.State(q, 0.0 * q, frame, twist)
    modes = np.array([mode if FLOORED[name] else OPEN for name in points])
    push = 0.3 * dice.normal(size=6) - 9.81 * np.concatenate([np.zeros(3), normal])
    if along is not None:
        push = np.concatenate([np.zeros(3), 9.81 * (along * frame.R[:, 0] - normal)])
    at_rest = RestResponses(chain)
    rows = at_rest.rows(state)
    axes, u = rows.axes, rows.velocity(twist)
    slip = np.array(
        [
            a[:2].T @ t / np.linalg.norm(t) if m == SLIPS else np.zeros(3)
            for a, t, m in zip(axes, u[:, :2], modes, strict=True)
        ]
    )
    of = ContactModes(modes, slip)
    true = touch_with(at_rest, state, push, of)
    masks = MaskedModes.of(modes.astype(float))
    return true, forces_in_modes(rows, at_rest.mobility(state), twist, push, masks, slip)


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("mode", [OPEN, STICKS, SLIPS, ContactMode.CLOSED])
def test_as_the_reference(mode, held):
    """Forces, slips and turning times, with contacts that share their load; with friction and without."""
    lawful = 0
    for seed in range(10):
        true, found = both(seed, mode, 0.4 if mode != ContactMode.CLOSED else 0.0, held=held)
        if found.lawful < 0.5:
            continue
        lawful += 1
        size = max(1.0, np.abs(true.force).max())
        assert np.abs(found.force - true.force).max() < 1e-11 * size
        assert np.abs(found.wrench - true.rows.wrench(true.force)).max() < 1e-11 * size
        np.testing.assert_allclose(found.slip, true.modes.slip, atol=1e-15)
        slips = true.modes.mode == SLIPS
        np.testing.assert_allclose(found.speed[slips], true.slip_speed[slips], rtol=1e-12)
        time = np.inf if found.turning_time == FOREVER else found.turning_time
        assert time == pytest.approx(true.turning_time, rel=1e-8)
    assert lawful == 10


def test_loads_that_are_shared_in_another_way():
    """Near the border of the cones, the motion is that of the reference, and it is noticed that the share is not."""
    for part, shared in ((0.5, 1.0), (0.95, 0.0)):
        true, found = both(0, STICKS, along=part * 0.4)
        assert found.shared == shared and found.lawful == 1.0
        assert bool(np.abs(found.force - true.force).max() < 1e-11) is bool(shared)
        assert np.abs(found.wrench - true.rows.wrench(true.force)).max() < 1e-11
