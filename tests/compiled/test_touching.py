"""Machine code of chains whose object touches the world: the reference's answers, one system as a batch, refusals."""

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.codegen.export import files_of
from holdfast.codegen.functions import exported_function
from holdfast.compiled import forward_schedule
from holdfast.compiler.targets import OBJECT_TARGETS, cpu
from holdfast.dynamics import ContactMode, ContactStatus, Status
from holdfast.errors import ContactError, MethodNotApplicable, StateError
from holdfast.world import HalfSpace, Touching, corners
from tests.codegen.exported import built, outputs, require
from tests.control.two_pandas import two_pandas
from tests.longer import mostly_slow
from tests.systems.stored_cases import stored_cases

CASES = stored_cases("cases_contact.json")
RESTING = [name for name, of in CASES.raw.items() if of["kind"] in ("rest", "sliding") and of["arms"]]
ARRAYS = ("qdd", "grasp_wrench", "object_acceleration", "base_wrench", "touch_force", "touch_gap", "touch_mode")


def on_a_table(friction=0.5, more=()):
    """Return two Pandas with a box on a table, at rest there, and torques that leave 1 kg of it to the table."""
    chain, state = two_pandas()
    below = {name: x for name, x in corners(0.3, 0.2, 0.2).items() if name[2] == "-"} | dict(more)
    lowest = min((state.object_frame.R @ x + state.object_frame.p)[2] for x in below.values())
    touching = Touching(below, {"table": HalfSpace(offset=lowest, friction=friction)})
    lighter = replace(chain, held_object=hf.HeldObject.box(2.0, 0.3, 0.2, 0.2))
    return replace(chain, touching=touching), state, hf.holding_torques(lighter, state)


def arguments(state, tau):
    """Return the arguments of a call."""
    return state.q, state.qd, tau, state.object_pose, state.object_twist


@pytest.mark.parametrize("name", mostly_slow(RESTING, RESTING[:1]))
def test_stored_instants(name):
    """Accelerations and modes are those of the reference, and forces where they are unique."""
    case = CASES[name]
    given = {"object_wrench": case.inputs.object_wrench, "base_twist": case.inputs.base_twists}
    given = {n: x for n, x in (given | {"base_acceleration": case.inputs.base_accelerations}).items() if x is not None}
    found = hf.compile(case.chain).forward_dynamics(*arguments(case.state, case.tau), **given)
    true = hf.forward_dynamics(case.chain, case.state, case.tau, inputs=case.inputs)
    size = np.abs(np.concatenate([true.qdd, true.object_acceleration])).max()
    assert np.abs(found.qdd - true.qdd).max() < 1e-9 * size
    assert np.abs(found.object_acceleration - true.object_acceleration).max() < 1e-9 * size
    assert found.touch_status is ContactStatus.OK and found.touch_residual < 1e-9
    if true.touch_status is ContactStatus.OK:
        assert np.abs(found.touch_force - true.touch_force).max() < 1e-8 * np.abs(true.touch_force).max()
        assert np.array_equal(found.touch_mode, true.touch_mode)


@pytest.mark.slow
def test_one_system_is_as_a_batch_and_as_bound():
    """Bits do not depend on the call: pressed, pulled off, and with corners that are far away."""
    chain, state, tau = on_a_table(more={"above": [0.0, 0.0, 0.1]})
    compiled = hf.compile(chain)
    many = np.array([tau, 0.0 * tau, 1.2 * tau, -tau])
    batch = compiled.forward_dynamics(*arguments(state, many))
    bound = compiled.bind()
    for name in ("q", "qd", "object_pose", "object_twist"):
        bound.arrays[name][...] = getattr(state, name)
    for k, one in enumerate(many):
        single = compiled.forward_dynamics(*arguments(state, one))
        bound.arrays["tau"][...] = one
        assert bound() is Status.OK
        for name in ARRAYS:
            assert np.array_equal(getattr(single, name), getattr(batch, name)[k])
            assert np.array_equal(getattr(single, name), getattr(bound.result, name))
        true = hf.forward_dynamics(chain, state, one)
        assert np.abs(single.qdd - true.qdd).max() < 1e-8
        assert single.touch_mode[4] == ContactMode.OPEN and not single.touch_force[4].any()
    assert (batch.touch_status == ContactStatus.OK).all() and batch.touch_residual.max() < 1e-9
    assert batch.touch_mode.dtype == np.int64


@pytest.mark.slow
def test_nothing_touches_without_friction():
    """Contacts without friction that are all far away have no forces, and change nothing."""
    chain, state, tau = on_a_table(friction=0.0)
    table = chain.touching.world["table"]
    lower = Touching(chain.touching.points, {"table": replace(table, offset=table.offset - 0.1)})
    found = hf.compile(replace(chain, touching=lower)).forward_dynamics(*arguments(state, tau))
    assert found.touch_status is ContactStatus.OK and not found.touch_residual and not found.touch_force.any()
    true = hf.forward_dynamics(replace(chain, touching=None), state, tau)
    assert np.abs(found.qdd - true.qdd).max() < 1e-10


@pytest.mark.slow
def test_from_given_forces():
    """Three of Newton's steps from the forces of a similar instant lead to the same motion."""
    chain, state, tau = on_a_table()
    cold, warm = hf.compile(chain), hf.compile(chain, parameters=["touch_start"])
    assert warm.operation_count < 0.3 * cold.operation_count
    for near in (tau, 1.0001 * tau):
        before = cold.forward_dynamics(*arguments(state, tau)).touch_force
        found = warm.forward_dynamics(*arguments(state, near), touch_start=before)
        true = hf.forward_dynamics(chain, state, near)
        assert np.abs(found.qdd - true.qdd).max() < 1e-9
    with pytest.raises(StateError, match="touch_start"):
        warm.forward_dynamics(*arguments(state, tau))
    with pytest.raises(StateError, match="touch_start"):
        hf.compile(replace(chain, touching=None), parameters=["touch_start"])


@pytest.mark.slow
def test_what_has_no_forces():
    """A closed contact that approaches needs an impulse: an error, or NaN in a batch."""
    chain, state, tau = on_a_table()
    compiled = hf.compile(chain)
    down = replace(state, object_twist=np.array([0.0, 0.0, 0.0, 0.0, 0.0, -0.1]))
    with pytest.raises(StateError, match=r"is closed and approaches with 0\.1 m/s"):
        compiled.forward_dynamics(*arguments(down, tau))
    twists = np.array([state.object_twist, down.object_twist])
    found = compiled.forward_dynamics(state.q, state.qd, tau, state.object_pose, twists)
    assert [*found.status] == [Status.OK, Status.INVALID]
    assert np.isfinite(found.qdd[0]).all() and np.isnan(found.qdd[1]).all()


@pytest.mark.slow
def test_forces_that_are_not_found():
    """A bad start is not accepted: the call says what to try instead."""
    chain, state, tau = on_a_table()
    warm = hf.compile(chain, parameters=["touch_start"])
    with pytest.raises(ContactError, match="without touch_start tries more steps"):
        warm.forward_dynamics(*arguments(state, -10.0 * tau), touch_start=1e3 * np.eye(4, 3))


@pytest.mark.slow
def test_refusals():
    """What contacts with the world are not built in says so."""
    chain, state, tau = on_a_table()
    compiled = hf.compile(chain)
    with pytest.raises(MethodNotApplicable, match=r"forward_dynamics\.vjp"):
        compiled.forward_dynamics.vjp(*arguments(state, tau), qdd=np.ones(14))
    with pytest.raises(MethodNotApplicable, match="distribute"):
        compiled.distribute  # noqa: B018
    free = compiled.inverse_dynamics(state.q, state.qd, np.zeros(14), np.zeros((2, 6)))
    assert np.array_equal(free[0], hf.compile(two_pandas()[0]).inverse_dynamics(
        state.q, state.qd, np.zeros(14), np.zeros((2, 6)))[0])  # fmt: skip


def test_nothing_changes_without_touching(monkeypatch):
    """A chain without touching is never asked for contacts, and its key and operations are those of before."""
    chain = two_pandas()[0]
    for name in ("touched", "pressing"):
        monkeypatch.setattr(forward_schedule, name, None)
    made = forward_schedule.forward_computation(chain, hf.compile(chain).options)
    assert made.schedule().operation_count == hf.compile(chain).operation_count
    assert not [name for name in made.externals if "touch" in name]


@pytest.mark.slow
def test_c_has_the_same_bits(tmp_path):
    """Exported C returns the bits of the library's own call."""
    require("gcc")
    chain, state, tau = on_a_table()
    compiled = hf.compile(chain, generic_rank=12)
    function = exported_function("forward_dynamics", compiled, state)
    target = OBJECT_TARGETS[cpu.target().name if cpu.target().name in OBJECT_TARGETS else "x86-64-v3"]
    written = files_of("table", [function], target, True)
    for file, content in written.files.items():
        (tmp_path / file).write_bytes(content)
    program = built(tmp_path, "table", written.functions, "gcc", cpu.target().name, "-march=native")
    names = ("q", "qd", "object_pose", "object_twist")
    given = {name: getattr(state, name) for name in names} | {"tau": tau}
    (found,) = outputs(program, [function], {"forward_dynamics": [given]})["forward_dynamics"]
    true = compiled.forward_dynamics(*arguments(state, tau))
    assert not found["returned"].any()
    for name in ARRAYS:
        assert np.array_equal(found[name], true.array(name)), name


@pytest.mark.parametrize("touching", mostly_slow([False, True], [False]))
def test_a_free_object(touching):
    """Without arms: one system, a batch and the reference agree, and a run by steps takes whole steps of it."""
    box = hf.HeldObject.box(2.0, 0.3, 0.2, 0.1)
    floor = Touching(corners(0.3, 0.2, 0.1), {"floor": HalfSpace(friction=0.5)}) if touching else None
    chain = hf.ClosedChain({}, box, {}, touching=floor)
    state = hf.State([], [], hf.Pose.translation(0, 0, 0.05), [0.0, 0.0, 0.0, 0.4, 0.1, 0.0])
    expected = hf.forward_dynamics(chain, state, []).object_acceleration
    forward = hf.compile(chain).forward_dynamics
    given = state.q, state.qd, np.zeros(0), state.object_pose, state.object_twist
    np.testing.assert_allclose(forward(*given).object_acceleration, expected, atol=1e-9)
    many = forward(*(np.tile(x, (3, 1)) for x in given))
    np.testing.assert_array_equal(many.object_acceleration, np.tile(forward(*given).object_acceleration, (3, 1)))
    if touching:
        runs = [hf.simulate(chain, state, law, 0.1, 1e-3, contacts="steps") for law in (None, held_by_nothing)]
        np.testing.assert_allclose(runs[0].object_pose, runs[1].object_pose, atol=1e-9)


def held_by_nothing(t, state, memory):
    """Return the torques of no joint, in Python."""
    return np.zeros(0), memory
