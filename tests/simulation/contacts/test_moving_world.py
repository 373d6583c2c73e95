"""Worlds that move: a conveyor against its closed form, a lift, a shaken table, and the energy that they give."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import ModelError
from holdfast.world import HalfSpace, Sphere, Touching, corners
from tests.longer import mostly_slow

MU, G, SPEED = 0.3, 9.81, 0.8
EDGES = (0.2, 0.2, 0.1)


def no_torque(t, state, memory):
    """Return no torques of a chain without joints."""
    return np.zeros(0), memory


def box_on(*shape, restitution=0.0, **keys):
    """Return a chain of a free box of 2 kg above a half-space, and the state at rest on it."""
    plane = HalfSpace(friction=MU, restitution=restitution, **keys)
    touching = Touching(corners(*EDGES), {"plane": plane})
    chain = hf.ClosedChain({}, hf.HeldObject.box(2.0, *EDGES), {}, touching=touching)
    return chain, hf.State([], [], hf.Pose.translation(0, 0, 0.05 + (shape[0] if shape else 0.0)))


def energy_error(run):
    """Return the largest error of the energy account."""
    return float(np.abs(run.imbalance).max())


def test_conveyor_picks_up_a_box():
    """x'' = mu g until the box rides at v / (mu g), having slid v^2 / (2 mu g) relative to the belt."""
    chain, start = box_on(surface_twist=[0, 0, 0, SPEED, 0, 0])
    run = hf.simulate(chain, start, no_torque, 0.4, 0.05)
    rides = next(one for one in run.occurrences if one.kind == "stick")
    t = SPEED / (MU * G)
    assert abs(rides.t - t) <= 1e-10
    x = np.where(run.t < t, 0.5 * MU * G * run.t**2, SPEED * run.t - 0.5 * SPEED**2 / (MU * G))
    v = np.minimum(MU * G * run.t, SPEED)
    assert np.abs(run.object_pose[:, 4] - x).max() <= 1e-10
    assert np.abs(run.object_twist[:, 3] - v).max() <= 1e-10
    assert np.abs(run.object_twist[:, :3]).max() <= 1e-10
    assert energy_error(run) <= 1e-10


def lift(t):
    """Return a motion up with a smooth acceleration."""
    z, v, a = 0.1 * (1 - np.cos(3 * t)), 0.3 * np.sin(3 * t), 0.9 * np.cos(3 * t)
    return hf.Pose.translation(0, 0, z), [0, 0, 0, 0, 0, v], [0, 0, 0, 0, 0, a]


@pytest.mark.parametrize("contacts", mostly_slow(["events", "steps"], ("steps",)))
def test_lift_carries_a_box(contacts):
    """The box follows; the force is m (g + a), and its power is that of the energy that the box gains."""
    chain, start = box_on()
    run = hf.simulate(chain, start, no_torque, 0.1, 0.01, base_motion={"plane": lift}, contacts=contacts)
    z = np.array([lift(t)[0].p[2] for t in run.t])
    assert np.abs(run.object_pose[:, 6] - 0.05 - z).max() <= 1e-12
    instants = run.t[1:] if contacts == "events" else run.t[1:] - 0.005
    force = np.array([2.0 * (G + 0.9 * np.cos(3 * t)) for t in instants])
    np.testing.assert_allclose(
        run.touch_force[1:, :, 2].sum(axis=1), force, atol=1e-9 if contacts == "events" else 1e-3
    )
    assert energy_error(run) <= (1e-6 if contacts == "events" else 1e-4)


@pytest.mark.slow
def test_turning_table_drags_a_ball():
    """On a table that turns with a constant rate, a rolling ball goes round in circles of 2/7 of that rate."""
    rate = 2.0
    touching = Touching({"ball": Sphere([0, 0, 0], 0.1)}, {"table": HalfSpace(friction=5.0)})
    chain = hf.ClosedChain({}, hf.HeldObject.sphere(1.0, 0.1), {}, touching=touching)

    def turning(t):
        pose = hf.Pose.from_rpy(0, 0, rate * t)
        return pose, [0, 0, rate, 0, 0, 0], np.zeros(6)

    v = np.array([0.2, 0.0, 0.0])
    x = np.array([0.3, 0.0, 0.1])
    # rolls: v + w x (-r z) = rate z x x, so w = z x (v - rate z x x) / r
    slip = v - rate * np.cross([0, 0, 1], x)
    w = np.cross([0, 0, 1], slip) / 0.1
    start = hf.State([], [], hf.Pose.translation(*x), np.concatenate([w, v]))
    run = hf.simulate(chain, start, no_torque, 0.5, 0.01, base_motion={"table": turning})
    omega = 2.0 / 7.0 * rate
    angle = omega * run.t
    expected = x[:2] + 0.2 / omega * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1)
    assert np.abs(run.object_pose[:, 4:6] - expected).max() <= 1e-9
    assert energy_error(run) <= 1e-8


def test_rising_table_strikes():
    """An impact on a rising table: Poisson's law at the relative velocity, and the energy is the table's work."""
    chain, start = box_on(0.02, restitution=0.5)

    def rising(t):
        return hf.Pose.translation(0, 0, 0.4 * t), [0, 0, 0, 0, 0, 0.4], np.zeros(6)

    run = hf.simulate(chain, start, no_torque, 0.06, 0.01, base_motion={"plane": rising})
    touch = next(one for one in run.occurrences if one.kind == "touch")
    t = (np.sqrt(0.4**2 + 2 * G * 0.02) - 0.4) / G
    assert abs(touch.t - t) <= 1e-10
    after = 0.4 + 0.5 * (0.4 + G * t)
    np.testing.assert_allclose(run.object_twist[-1, 5], after - G * (run.t[-1] - touch.t), atol=1e-9)
    assert energy_error(run) <= 1e-9


def test_wrong_motions_are_named():
    """A twist of an instant, a name that is not known, and a function of something else."""
    chain, start = box_on(twist=[0, 0, 0, 0.1, 0, 0])
    with pytest.raises(ModelError, match="'plane': its twist is that of an instant"):
        hf.simulate(chain, start, no_torque, 0.1, 0.01)
    chain, start = box_on()
    with pytest.raises(ModelError, match="no such arm or shape of the world"):
        hf.simulate(chain, start, no_torque, 0.1, 0.01, base_motion={"plan": lift})
