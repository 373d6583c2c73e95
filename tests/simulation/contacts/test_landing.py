"""Two arms under an impedance lay a box on a table: flat onto four redundant contacts, and tilted onto a corner."""

from itertools import pairwise

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.contact.rows import contact_rows
from tests.simulation.contacts.two_pandas import STIFFNESS, lowering

PRESS = 0.005  # m below the table


@pytest.mark.long
@pytest.mark.parametrize(("contacts", "step"), [("steps", 0.001), ("events", 0.002)])
def test_two_pandas_lay_a_box_flat_on_a_table(contacts, step):
    """The run is complete, gaps and grasps stay closed, and at rest the table carries what the spring presses."""
    chain, state, law = lowering([0, 0, -0.02 - PRESS], 0.5)
    run = hf.simulate(chain, state, law, 0.8, step, contacts=contacts)
    assert run.stopped is None
    assert run.touch_gap.min() >= -1e-12
    assert run.position_gap[:, 1].max() <= 1e-12  # after projection
    assert run.touch_force[-1, :, 2].sum() == pytest.approx(
        STIFFNESS * PRESS, rel=1e-3 if contacts == "steps" else 1e-9
    )
    assert (
        np.abs(run.object_twist[-1]).max() <= 1e-5
    )  # redundant joints still settle: ends of steps are of second order
    assert np.diff(run.impact, prepend=0.0).max() <= 1e-12  # impacts only take energy
    if contacts == "events":  # and forces do no work where contacts stick, and take it where they slip
        assert most_power(chain, run) <= 1e-12


def most_power(chain, run):
    """Return the largest power of the forces of the world on the object [W]."""
    powers = []
    for pose, twist, force in zip(run.object_pose, run.object_twist, run.touch_force, strict=True):
        rows = contact_rows(chain.touching, hf.Pose.from_wxyz_xyz(pose), twist)
        powers.append(float((rows.in_world(rows.velocity(twist)) * force).sum()))
    return max(powers)


def after(chain, state, law, duration, step, contacts):
    """Return positions and velocities of the object at the end of a run that lowers a tilted box."""
    run = hf.simulate(chain, state, law, duration, step, contacts=contacts)
    assert run.stopped is None
    assert run.touch_gap.min() >= -1e-12
    assert run.position_gap[:, 1].max() <= 1e-12
    return np.concatenate([run.object_pose[-1], run.object_twist[-1]])


@pytest.mark.long
def test_two_pandas_lower_a_tilted_box_by_events():
    """Gaps and closure stay at rounding, and ends have the order of the scheme, across the touch of a corner, too."""
    chain, state, law = lowering([0, 0, -0.02], 0.3, [0.05, -0.03, 0.0])
    for duration, steps in ((0.13, (0.01, 0.005, 0.0025)), (0.145, (0.0025, 0.00125, 0.000625))):
        ends = [after(chain, state, law, duration, h, "events") for h in steps]
        off = [np.abs(a - b).max() for a, b in pairwise(ends)]
        assert off[0] / off[1] > 11.0, duration  # 16
