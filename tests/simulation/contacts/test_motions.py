"""Motions with contacts against closed forms: the problem cases, and laws of every run."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.io.contact_motion import error_of
from holdfast.simulation.checkpoint import Checkpoint
from holdfast.world import HalfSpace, Sphere, Touching, corners
from tests.systems.stored_cases import stored_cases

STORED = stored_cases("cases_contact.json")
CASES = {name.removeprefix("contact_"): STORED[name] for name, of in STORED.raw.items() if of["kind"] == "trajectory"}
BARS = {  # largest relative error by events
    "block_on_slope": 1e-12,
    "ball_slides_then_rolls": 1e-12,
    "bouncing_ball": 1e-8,
    "ladder": 1e-8,
    "box_tips": 1e-8,
    "arm_strikes_wall": 1e-8,
}
SHORT = ("ball_slides_then_rolls", "block_on_slope")
WAYS = [pytest.param(name, marks=pytest.mark.slow if name in SHORT else pytest.mark.long) for name in BARS]


def run_of(case, step, contacts, duration=None):
    """Return the run of a case without torques."""
    chain = case.chain()
    law = lambda t, state, memory: (np.zeros(chain.joint_count), memory)  # noqa: E731
    return hf.simulate(chain, case.state(), law, duration or case.duration, step, contacts=contacts)


def require_laws(run, gap=-1e-12):
    """Check what every run with contacts keeps: gaps, one-sided forces, energies and momentum, by order of the step."""
    assert run.stopped is None
    assert run.touch_gap.min() >= gap
    normal = np.array([shape.shape.normal for shape in run.setting.chain.touching.candidates])
    assert np.einsum("tki,ki->tk", run.touch_force, normal).min() >= -1e-9
    assert np.diff(run.impact).max() <= 1e-12  # impacts never gain energy


@pytest.mark.parametrize("name", WAYS)
def test_by_events(name):
    """Closed forms of all times, speeds and forces of the six motions."""
    case = CASES[name]
    run = run_of(case, case.step, "events")
    require_laws(run)
    assert error_of(case, case.found(run)) <= BARS[name]


def test_three_bounces():
    """The first three touches and heights to 1e-10."""
    case = CASES["bouncing_ball"]
    run = run_of(case, case.step, "events", 1.6)
    require_laws(run)
    found, wanted = case.found(run), case.expected
    np.testing.assert_allclose(found["touches"][:3], wanted["touches"][:3], rtol=1e-10)
    np.testing.assert_allclose(found["height_after_each"][:2], wanted["height_after_each"][:2], rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ladder", "box_tips"])
def test_order_of_events(name):
    """Errors at 10 ms are at most 1e-7, and fall with the fourth power of the step."""
    case = CASES[name]
    errors = [error_of(case, case.found(run_of(case, h, "events"))) for h in (0.02, 0.01)]
    assert errors[1] <= 1e-7
    assert errors[0] / errors[1] > 10.0


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.long) for n in BARS])
def test_by_steps(name):
    """One per cent at 1 ms."""
    case = CASES[name]
    run = run_of(case, 1e-3, "steps")
    require_laws(run)
    assert error_of(case, case.found(run)) <= 0.01


def test_order_of_steps():
    """A box that turns over its edge: second order, and an energy that is kept to the same order."""
    case = CASES["box_tips"]
    runs = [run_of(case, h, "steps") for h in (0.02, 0.01)]
    errors = [abs(case.found(run)["angle"] - case.expected["angle"]) for run in runs]
    assert 3.3 < errors[0] / errors[1] < 4.7
    left = [np.abs(run.imbalance).max() for run in runs]
    assert 3.3 < left[0] / left[1] < 5.0


def thrown_box(seed):
    """Return a box thrown onto a table beside a wall."""
    rng = np.random.default_rng(seed)
    edges = rng.uniform(0.05, 0.3, 3)
    shapes = {"friction": rng.uniform(0.0, 0.8), "restitution": rng.uniform(0.0, 0.8)}
    world = {"table": HalfSpace(**shapes), "wall": HalfSpace(normal=[1.0, 0.0, 0.0], offset=-0.3, **shapes)}
    chain = hf.ClosedChain({}, hf.HeldObject.box(2.0, *edges), {}, touching=Touching(corners(*edges), world))
    q = rng.normal(size=4)
    q /= np.linalg.norm(q)
    return chain, hf.State([], [], [*q, 0.1, 0.0, 0.3], rng.normal(size=6) * [2, 2, 2, 1, 1, 1])


def none(t, state, memory):
    """No torques."""
    return np.zeros(0), memory


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed",
    [0, pytest.param(1, marks=pytest.mark.slow), *(pytest.param(k, marks=pytest.mark.long) for k in range(2, 60))],
)
def test_thrown_boxes_never_gain_energy(seed):
    """Contacts of a tumbling box only take energy, in every step in which they press; gaps stay."""
    chain, state = thrown_box(seed)
    run = hf.simulate(chain, state, none, 0.3, 0.005, contacts="steps")
    require_laws(run)
    energy = run.kinetic + run.potential
    smooth = 2.0 * np.abs(run.object_twist[:, :3]).max() ** 3 * 0.005**3  # of the midpoint rule, a step
    pressed = run.touch_force[1:].any(axis=(1, 2))
    assert np.diff(energy)[pressed].max(initial=0.0) <= 1e-12 + smooth * float(run.kinetic.max())


def test_refusals():
    """Whatever contacts are not built for is refused by name."""
    chain, state = thrown_box(0)
    plain = hf.ClosedChain({}, chain.held_object, {})
    refused = [
        (lambda: hf.simulate(chain, state, none, 0.1, 0.01, contacts="event"), "Did you mean 'events'"),
        (lambda: hf.simulate(plain, state, none, 0.1, 0.01, contacts="events"), "expected a chain with touching"),
        (lambda: hf.simulate(chain, state, none, 0.1, 0.01, scheme="dop853"), "expected fixed steps with contacts"),
        (lambda: hf.simulate(chain, state, none, 0.1, 0.01, on_singular="continue"), "on_singular"),
        (lambda: hf.linearise(chain, state, np.zeros(0)), "linearise: expected a chain without touching"),
    ]
    for call, says in refused:
        with pytest.raises(hf.HoldfastError, match=says):
            call()


@pytest.mark.parametrize("contacts", ["events", "steps"])
def test_a_start_inside_a_shape_is_refused(contacts):
    """The message has the gap, point and shape, and the displacement that frees the object."""
    ball = Sphere([0.0, 0.0, 0.0], 0.1)
    wall = HalfSpace(normal=[1.0, 0.0, 0.0])
    chain = hf.ClosedChain({}, hf.HeldObject.sphere(1.0, 0.1), {}, touching=Touching({"ball": ball}, {"wall": wall}))
    inside, outside = (hf.State([], [], [1, 0, 0, 0, x, 0, 0], np.zeros(6)) for x in (0.07, 0.1 - 1e-12))
    says = r"'ball' is 0.03 m inside of 'wall' \(HalfSpace; gap -0.03 m\).*move the object by 0.03 m along \(1, 0, 0\)"
    with pytest.raises(hf.HoldfastError, match=says):
        hf.simulate(chain, inside, none, 0.02, 0.01, contacts=contacts)
    assert hf.simulate(chain, outside, none, 0.02, 0.01, contacts=contacts).stopped is None


def test_folder_keeps_contacts(tmp_path):
    """A saved run has the same chain, contacts and log."""
    case = CASES["ball_slides_then_rolls"]
    run = run_of(case, 0.01, "steps", 0.05)
    run.save(tmp_path / "run")
    read = hf.load_result(tmp_path / "run").trajectory
    assert read.setting.chain.touching.names == ("sphere/floor",)
    np.testing.assert_array_equal(read.touch_force, run.touch_force)
    assert read.occurrences == run.occurrences
    head = run.to_csv(tmp_path / "run.csv")[0].read_text().splitlines()[0]
    assert "touch_force sphere/floor z [N]" in head
    reader = pytest.importorskip("mcap_ros2.reader")
    run.to_mcap(tmp_path / "run.mcap")
    found = [
        one.ros_msg.wrench.force.z for one in reader.read_ros2_messages(tmp_path / "run.mcap", "/touch/sphere_floor")
    ]
    np.testing.assert_array_equal(found, run.touch_force[:, 0, 2])


def require_resumed(chain, state, duration, step, contacts):
    """Check that from checkpoints, written and read, a run goes on with the same bits."""
    law, kept = (lambda t, state, memory: (np.zeros(0), memory)), []
    given = (chain, state, law, duration, step)
    whole = hf.simulate(*given, contacts=contacts, on_checkpoint=kept.append)
    assert whole.stopped is None and (whole.touch_mode != 0).any()
    for saved in kept[2::12]:
        again = Checkpoint.from_data(*saved.to_data())
        rest = hf.simulate(*given, contacts=contacts, start=again)
        first = len(whole) - len(rest)
        for name in ("t", "object_pose", "object_twist", "touch_force", "touch_mode", "work", "impact"):
            np.testing.assert_array_equal(getattr(rest, name), getattr(whole, name)[first:], err_msg=name)


@pytest.mark.slow
def test_resumes_steps_to_the_bit():
    """A tilted box lands on one corner and slides, by steps."""
    edges, turn = (0.2, 0.2, 0.1), np.array([0.98, 0.1, 0.15, 0.02])
    touching = Touching(points=corners(*edges), world={"table": HalfSpace(normal=[0, 0, 1], friction=0.3)})
    chain = hf.ClosedChain({}, hf.HeldObject.box(2.0, *edges), {}, touching=touching)
    state = hf.State([], [], [*(turn / np.linalg.norm(turn)), 0, 0, 0.1], [0, 0, 0.5, 0.6, 0.2, -0.3])
    require_resumed(chain, state, 0.1, 0.01, "steps")


@pytest.mark.long
def test_resumes_events_to_the_bit():
    """A ball slides, then rolls, by events."""
    case = CASES["ball_slides_then_rolls"]
    require_resumed(case.chain(), case.state(), case.duration, case.step, "events")
