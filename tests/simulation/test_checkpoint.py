"""Runs that are left and go on: every bit the same as if they had not been."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest

from holdfast import Friction, Grasp
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.errors import ResultError
from holdfast.simulation.checkpoint import Checkpoint, packed, unpacked
from holdfast.simulation.events import Attach, Release
from holdfast.simulation.simulate import simulate
from holdfast.simulation.stepper import ReferenceStepper
from tests.longer import mostly_long
from tests.simulation.gantries import contact_frame, squeezed
from tests.simulation.runs import limp
from tests.simulation.test_external_inputs import sprung
from tests.systems.branched import two_arms_with_grippers
from tests.systems.bricard import bricard
from tests.systems.n_four_bar import n_four_bar
from tests.systems.sprung import by_hand
from tests.systems.trunk_runs import still_base


def on_disk(checkpoint):
    """Return the checkpoint after its way through an .npz file and a JSON text."""
    arrays, data = checkpoint.to_data()
    file = io.BytesIO()
    np.savez(file, **arrays)
    file.seek(0)
    with np.load(file, allow_pickle=False) as saved:
        return Checkpoint.from_data(dict(saved), json.loads(json.dumps(data)))


def swaying(t):
    """A base that moves."""
    x = np.array([1e-3 * t**3, 0.0, 0.0])
    base = contact_frame(-1.0).p
    return (
        np.r_[1.0, 0, 0, 0, base + x],
        np.r_[np.zeros(3), 3e-3 * t**2, 0, 0],
        np.r_[np.zeros(3), 6e-3 * t, 0, 0],
    )


def eventful(**options):
    """A run in which everything happens: knots, memory, a moving base, gripping, letting go, a dip, a slip."""
    contact = Friction(0.5, torsion_radius=0.02), Friction(0.5)
    chain, state = squeezed(("softfinger", "ball"), contact, ("x", ""), effort_limit=33.0)
    inner = TorqueSchedule.linear(
        [0.0, 0.02, 0.047, 0.09], [[N, 0, 0, 0.01, -N, 0, 0.1] for N in (30.0, 35.0, 20.0, -5.0)]
    )

    class Remembering:
        breakpoints = inner.breakpoints

        def __call__(self, t, state, memory):
            count, filtered = memory or (0, np.zeros(len(state.qd)))
            filtered = 0.9 * filtered + 0.1 * state.qd
            return inner(t, state, None)[0] - 0.5 * filtered, (count + 1, filtered)

    grasp = Grasp("ball", contact_frame(1.0), contact[1])
    options |= {"base_motion": {"left": swaying}, "on_slip": "release"}
    options["events"] = [Release(0.033, "right"), Attach(0.041, "right", grasp, here=True)]
    return (chain, state, Remembering(), 0.09, 0.01), options


def on_trunk():
    """A run of arms on a trunk whose base floats."""
    p = still_base(3, 6, floating=True)
    return (p.chain, p.state, lambda t, state, memory: (p.tau, memory), 0.01, 2e-3), {"inputs": p.inputs}


def sprung_by_hand(**options):
    """A run under wrenches that depend on the state."""
    chain, state = sprung()
    return (replace(chain, springs=()), state, limp, 0.05, 1e-3), {"inputs": by_hand(chain)} | options


def with_branches(**options):
    """A run of arms with grippers under a law with memory: a finger opens and closes, a palm lets go or slips."""
    p = two_arms_with_grippers()
    pad, palm = ("arm1", "pad1"), ("arm2", "link6")
    weak = replace(p.chain.grasps[palm], contact=Friction(0.5, torsion_radius=0.02))
    chain = replace(p.chain, grasps=p.chain.grasps | {palm: weak})

    def filtered(t, state, memory):
        count, past = memory or (0, np.zeros(len(state.qd)))
        past = 0.9 * past + 0.1 * state.qd
        return p.tau - 0.05 * past, (count + 1, past)

    options |= {"events": [Release(4e-3, pad), Attach(0.013, pad, p.chain.grasps[pad], here=True)]}
    return (chain, p.state, filtered, 0.02, 2e-3), options | {"on_slip": "release"}


SINGULAR = {"scheme": "dop853", "rtol": 1e-9, "on_singular": "continue"}
RUNS = {
    "rk4": lambda: eventful(scheme="rk4", rtol=1e-4),
    "dop853": lambda: eventful(scheme="dop853", rtol=1e-4),
    "a row too many": lambda: ((*bricard(), limp, 0.1, 1e-2), {}),
    "trunk": on_trunk,
    "through a singular configuration": lambda: ((*n_four_bar(2), limp, 0.8, 2e-2), SINGULAR),
    "wrenches of the state": sprung_by_hand,
    "with branches": lambda: with_branches(sample_time=3e-3, delay=1e-3),
    "with branches by machine code": lambda: with_branches(scheme="dop853", rtol=1e-6),
    "by the reference": lambda: sprung_by_hand(make_stepper=ReferenceStepper),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", mostly_long([*RUNS], RUNS.keys() - {"dop853", "with branches by machine code"}))
def test_going_on_changes_no_bit(name):
    """From any checkpoint, through disk, the rest of the run is bit for bit what it was."""
    given, options = RUNS[name]()
    checkpoints = []
    whole = simulate(*given, **options, on_checkpoint=checkpoints.append)
    assert whole.stopped is None and len(checkpoints) == len(whole)
    if name in ("rk4", "dop853"):
        assert {one.kind for one in whole.occurrences} == {"attach", "release", "violation", "recovery"}
    first = next((k for k, t in enumerate(whole.t) if whole.occurrences and t >= whole.occurrences[0].t), 2)
    for k in {max(first - 1, 1), 2 * len(whole) // 3, len(whole) - 3}:
        rest = simulate(*given, **options, start=on_disk(checkpoints[k]))
        for array in whole.recorded:
            mine, theirs = getattr(rest, array), getattr(whole, array)[k + 1 :]
            assert mine.dtype == theirs.dtype
            assert mine.tobytes() == theirs.tobytes(), (k, array)
        assert checkpoints[k].occurrences + rest.occurrences == whole.occurrences


@pytest.mark.slow
def test_going_on_from_the_end():
    """There is nothing left: no samples, of the right shapes."""
    given, _ = eventful()
    last = []
    run = simulate(*given[:3], 0.02, 0.01, on_checkpoint=last.append)
    rest = simulate(*given[:3], 0.02, 0.01, start=on_disk(last[-1]))
    assert len(rest) == 0
    assert rest.q.shape == (0, *run.q.shape[1:])


def test_memories():
    """Everything a memory may hold comes back as it was, types and bits."""
    value = {
        "a.b": (None, True, -3, 0.1 + 0.2, np.inf, "text", [np.float64(0.3), np.arange(3), ()]),
        "a": {"b": np.array([[np.nan, -0.0]]), "c": np.bool_(False)},
    }
    arrays = {}
    data = json.loads(json.dumps(packed(value, "memory", arrays)))
    back = unpacked(data, arrays)
    assert repr(back) == repr(value)
    assert [type(x) for x in back["a.b"]] == [type(x) for x in value["a.b"]]


@pytest.mark.parametrize(
    ("memory", "message"),
    [
        (object(), "now.memory: expected None, numbers"),
        ((1.0, {2: 3}), "now.memory[1]: expected"),
        ([{"inner": {1, 2}}], "now.memory[0].inner: expected"),
        (np.array([object()]), "got ndarray"),
        (2**70, "numbers (of 64 bits)"),
    ],
)
def test_memories_that_cannot_be_saved(memory, message):
    """Such a run goes on; only its checkpoint cannot be written, and says where the fault is."""
    chain, state = squeezed(("ball", "ball"))
    checkpoints = []
    simulate(chain, state, lambda t, s, m: (np.zeros(6), memory), 0.02, 0.01, on_checkpoint=checkpoints.append)
    with pytest.raises(ResultError) as caught:
        checkpoints[-1].to_data()
    assert message in str(caught.value)


@pytest.mark.parametrize("lacking", ["now.q", "ledger.lowest", "tail_time"])
def test_damaged_checkpoints(lacking):
    """Something missing is refused, not guessed."""
    chain, state = squeezed(("ball", "ball"))
    checkpoints = []
    simulate(chain, state, lambda t, s, m: (np.zeros(6), m), 0.01, 0.01, on_checkpoint=checkpoints.append)
    arrays, data = checkpoints[0].to_data()
    del arrays[lacking]
    with pytest.raises(ResultError, match="checkpoint: cannot be read"):
        Checkpoint.from_data(arrays, data)
