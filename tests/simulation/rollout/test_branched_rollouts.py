"""Rollouts of chains with branches take the steps of `simulate`, for one system and for each of many to the bit."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.interop.jax_rollout import JaxRollout
from holdfast.questions.arrays import shapes, state_fields
from holdfast.simulation import Rollout, RolloutStatus, RolloutSystems
from tests.dynamics.tree.as_branched import AWAY, STRAY, gap
from tests.longer import mostly_long
from tests.simulation.gantries import squeezed
from tests.simulation.rollout.problems import same
from tests.simulation.rollout.test_statuses import MU, RADIUS, SQUEEZE, TWIST
from tests.simulation.test_mechanism_limits import pendulum, swing_through
from tests.systems.branched import branched_problems, palletiser

STEP = 1e-3
SAMPLED = ("t", "q", "qd", "object_pose", "object_twist", "qdd", "tau", "grasp_wrench", "coupling_force")
ACCOUNTED = ("kinetic", "potential", "work", "condition", "position_gap", "velocity_gap")


@cache
def lifting() -> Rollout:
    """Return the rollout of the palletiser under given torques."""
    return hf.compile_rollout(palletiser().chain, scheme="midpoint")


def given(chain: hf.ClosedChain, state: hf.State, count: int = 1, spread: float = 0.0) -> dict[str, Any]:
    """Return states for many systems, of which the rates of all but the first are elsewhere."""
    fields = state_fields(chain).items()
    one = {name: np.reshape(getattr(state, field), shapes(chain)[name]) for name, field in fields}
    found = {name: np.repeat(x[None], count, axis=0) for name, x in one.items()}
    found["qd"][1:] += spread * np.random.default_rng(0).normal(size=found["qd"][1:].shape)
    return found


def lifted(count: int = 1, spread: float = 1e-2, **further: Any) -> RolloutSystems:
    """Return systems of `lifting` at their start."""
    p = palletiser()
    return lifting().start(**given(p.chain, p.state, count, spread), **{"tau": p.tau, **further})


def assert_same_run(rolled: Any, run: Any, within: float = 1e-11) -> None:
    """Assert that two runs have the same samples."""
    assert rolled.stopped is None and run.stopped is None and rolled.rows == run.rows
    for name in (*SAMPLED, *ACCOUNTED):
        assert gap(getattr(rolled, name), getattr(run, name)) < within, name
    a, b = rolled.margin, run.margin
    assert (np.isinf(a) == np.isinf(b)).all() and gap(a[np.isfinite(a)], b[np.isfinite(b)]) < within


@pytest.mark.parametrize("name", mostly_long(branched_problems(), ("palletiser",)))
def test_the_run_of_simulate(name):
    """Twenty steps: the motion, forces and accounts of `simulate`, and works that explain the energy."""
    chain, state, tau = branched_problems()[name]
    scheme = "midpoint" if name == "palletiser" else "rk4"
    rollout = lifting() if name == "palletiser" else hf.compile_rollout(chain)
    systems = rollout.start(**given(chain, state), tau=tau)
    record = rollout.run(systems, 20 * STEP, STEP)
    assert rollout.generic_rank == hf.forward_dynamics(chain, state, tau).rank
    law = lambda t, state, memory: (tau, memory)  # noqa: E731
    run = hf.simulate(chain, state, law, 20 * STEP, STEP, scheme=scheme)
    assert_same_run(record.trajectory(0), run)
    after = record.systems
    assert gap(after.q[0], run.q[-1]) < 1e-13 and gap(after.work[0], run.work[-1]) < 1e-13
    assert np.abs(record.trajectory(0).imbalance).max() < (1e-5 if scheme == "midpoint" else 1e-8)
    assert after.gap.max() < 1e-12 and after.coupling_force.shape == (1, len(chain.all_couplings))


@pytest.mark.parametrize("count", [1, 9])
def test_bits(count):
    """Every system of a batch is as alone, on one thread or two, whether in one call or in several; so is a copy."""
    rollout, systems = lifting(), lifted(count)
    at = rollout.step(systems.copy(), STEP, steps=10, threads=2)
    assert same(at, rollout.step(systems.copy(), STEP, steps=10, threads=1))
    parts = systems.copy()
    for steps in (3, 6, 1):
        rollout.step(parts, STEP, steps=steps)
    assert same(at, parts)
    alone = systems.copy([count - 1])
    assert same(rollout.step(alone, STEP, steps=10), at.copy([count - 1]))
    assert same(pickle.loads(pickle.dumps(rollout)).step(systems.copy(), STEP, steps=10), at)


def test_records(tmp_path):
    """A record in a folder is the same when it is read again, and one of its systems is a run."""
    rollout, systems = lifting(), lifted(3)
    record = rollout.run(systems, 0.01, STEP, every=5, record=("q", "coupling_force", "object_pose", "joint_margin"))
    rollout.run(systems, 0.01, STEP, every=5, record=tuple(record.arrays), folder=tmp_path / "record")
    read = hf.io.load_record(tmp_path / "record", rollout=rollout)
    assert all((read[name] == record[name]).all() for name in record.arrays)
    run = read.trajectory(2)
    assert len(run) == 3 and (run.q == record["q"][:, 2]).all() and run.object_pose.shape == (3, 0, 7)


def test_sweeps(tmp_path):
    """Runs of a sweep are rollouts with initial states and torques of their own; frames of the chain cannot differ."""
    p, duration = palletiser(), 0.01
    tau = p.tau * np.linspace(0.0, 1.0, 5)[:, None]
    options: dict[str, Any] = {"count": 5, "duration": duration, "step": STEP, "chunk": 2, "scheme": "midpoint"}
    swept = hf.sweep(
        p.chain, state=p.state, parameters={"tau": tau}, store=tmp_path / "runs", outputs=("q",), **options
    )
    systems = lifting().start(**given(p.chain, p.state, 5), tau=tau)
    lifting().step(systems, STEP, steps=10)
    assert (np.stack([swept.column(f"q {name} [rad]") for name in p.chain.joint_names()], axis=1) == systems.q).all()
    with pytest.raises(StateError, match="base_pose"):
        hf.sweep(p.chain, state=p.state, parameters={"base_pose": np.eye(7)[:1]}, store=tmp_path / "no", **options)


def test_statuses():
    """Each system says why it has stopped, and the others go on."""
    p, rollout = palletiser(), lifting()
    start = given(p.chain, p.state, 4)
    start["q"][1, 0] = np.nan
    start["q"][2, 2] += 0.5
    tau = np.repeat(p.tau[None], 4, axis=0)
    systems = rollout.start(**start, tau=tau)
    tau[3, 0] = 1e308
    rollout.step(systems, STEP, tau=tau)
    running, broken, opened, overflowing = systems.status
    assert running is RolloutStatus.RUNNING and opened is RolloutStatus.OPEN
    assert broken is overflowing is RolloutStatus.BROKEN
    assert (systems.q[3] == p.state.q).all() or gap(systems.q[3], p.state.q) < 1e-12


def test_refusals():
    """What is for serial arms alone, and what is a constant of the code, is refused by name."""
    p, rollout = palletiser(), lifting()
    systems = lifted()
    for options in ({"scheme": "imex"}, {"base_motion": {"robot": lambda t: None}}, {"parameters": ["link_inertia"]}):
        with pytest.raises(MethodNotApplicable, match=f"{next(iter(options))}: expected"):
            hf.compile_rollout(p.chain, **options)
    with pytest.raises(ModelError, match="scheme"):
        hf.compile_rollout(p.chain, scheme="dop853")
    with pytest.raises(StateError, match="generic_rank: expected an integer from 0 to 3"):
        hf.compile_rollout(p.chain, generic_rank=4)
    with pytest.raises(MethodNotApplicable, match="to_jax: rollout: chain: expected serial arms"):
        JaxRollout(rollout, None, (), STEP, 1, ())
    with pytest.raises(StateError, match="qd"):
        rollout.start(p.state.q, None)
    for name in ("base_pose", "object_mass", "link_mass"):
        with pytest.raises(StateError, match=f"{name}: expected none"):
            rollout.step(systems, STEP, **{name: np.zeros(3)})
    with pytest.raises(StateError, match="joint 'robot/wrist' is passive"):
        rollout.step(systems, STEP, tau=np.ones(4))


@pytest.mark.slow
def test_grasps_that_close_and_open():
    """A rollout with another grasp takes systems over with the impulses of `attach`, and gives them back."""
    chain, state = squeezed(("softfinger", "ball"))
    chain = replace(chain, objects={"stray": STRAY})
    qd = np.array([0.0, 0.0, 0.0, -0.3, 0.2, 0.1])
    apart = replace(state, qd=qd, object_pose=[state.object_pose, AWAY], object_twist=np.zeros((2, 6)))
    free = replace(chain, grasps={"left": chain.grasps["left"]})
    before, after = (hf.compile_rollout(one, scheme="midpoint") for one in (free, chain))
    systems = before.start(**given(free, apart, 2), tau=np.zeros(6))
    joined = after.take_over(systems)
    wanted = hf.dynamics.attach(free, apart, "right", chain.grasps["right"]).state
    assert gap(joined.qd[0], wanted.qd) < 1e-14 and gap(joined.object_twist[0], wanted.object_twist) < 1e-14
    after.step(joined, STEP, steps=3)
    parted = before.take_over(joined)
    assert set(before.step(parted, STEP, steps=3).status) == {RolloutStatus.RUNNING}
    before.step(systems, STEP)  # the hands are no longer at the block
    assert set(after.take_over(systems).status) == {RolloutStatus.OPEN}


@pytest.mark.slow
def test_another_rank_is_singular():
    """Systems whose rank is not that of the rollout do not start."""
    p = palletiser()
    rollout = hf.compile_rollout(p.chain, scheme="midpoint", generic_rank=3)
    assert set(rollout.start(**given(p.chain, p.state), tau=p.tau).status) == {RolloutStatus.SINGULAR}


@pytest.mark.slow
def test_a_law_that_drives_a_passive_joint():
    """Its torque is no number."""
    p = palletiser()
    rollout = hf.compile_rollout(
        p.chain, hf.ControlLaw(lambda t, x, m, g: (g["gain"] * x.qd, m), parameters={"gain": ()})
    )
    assert set(rollout.start(**given(p.chain, p.state), gain=1.0).status) == {RolloutStatus.BROKEN}
    assert set(rollout.start(**given(p.chain, p.state), gain=0.0).status) == {RolloutStatus.RUNNING}


def test_the_instant_of_a_limit():
    """A pendulum is stopped at the end of its range when its energy integral says; the others swing on."""
    p = pendulum(position_limits=(-0.1, 1.0))
    rollout = hf.compile_rollout(p.chain)
    start = given(p.chain, p.state, 2)
    start["q"][1] = 0.05
    systems = rollout.start(**start, tau=p.tau)
    record = rollout.run(systems, 0.8, STEP, every=100, stop_at_limits=True)
    assert [*record.systems.status] == [RolloutStatus.LIMITED, RolloutStatus.RUNNING]
    assert record.stopped[0] == pytest.approx(swing_through(-0.1), abs=1e-9)
    assert record.stopped[1] == np.inf


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [("softfinger", "ball"), ("softfinger", "softfinger")])
def test_the_instant_of_a_slip(kinds):
    """A block between two gantries slips when it does on paper; moments that both could carry are shared equally."""
    friction = tuple(
        hf.Friction(MU, torsion_radius=RADIUS) if kind == "softfinger" else hf.Friction(2.0) for kind in kinds
    )
    chain, state = squeezed(kinds, friction)
    chain = replace(chain, objects={"stray": STRAY})
    apart = replace(state, object_pose=[state.object_pose, AWAY], object_twist=np.zeros((2, 6)))

    def torque(t, state, memory, given):
        up = given["rate"][()] * t
        return np.array([SQUEEZE, 0.0, up, -SQUEEZE, 0.0, up]), memory

    rollout = hf.compile_rollout(chain, hf.ControlLaw(torque, parameters={"rate": ()}), scheme="midpoint")
    rates = np.array([400.0, 0.0, 600.0])
    twist = np.array([[TWIST, 0, 0, 0, 0, 0], np.zeros(6)])
    systems = rollout.start(**given(chain, apart, 3), rate=rates, object_wrench=twist)
    assert (rollout.generic_rank == chain.forest.constraint_row_count) == ("ball" in kinds)
    record = rollout.run(systems, 0.1, STEP, least_margin=0.0)
    carried = TWIST / kinds.count("softfinger")
    slip = 2.0 * np.sqrt((MU * SQUEEZE) ** 2 - (carried / RADIUS) ** 2) / rates[[0, 2]]
    assert [*record.systems.status] == [RolloutStatus.SLIPPED, RolloutStatus.RUNNING, RolloutStatus.SLIPPED]
    assert gap(record.stopped[[0, 2]], slip) < 1e-9
    run = record.trajectory(1)
    assert gap(run.margin[:, :2].min(axis=1), np.full(len(run), record.systems.margin[1].min())) < 1e-9


@pytest.mark.long
@pytest.mark.parametrize("name", ["palletiser", "on a shoulder"])
def test_parameters(name):
    """Gravity and an only object of each system, as in runs of other chains."""
    p = branched_problems()[name]
    held, gravity, chains = p.chain.held_object, np.array([1.0, -2.0, -3.0]), [p.chain]
    own: dict[str, Any] = {"gravity": np.array([p.chain.gravity, gravity])}
    chains.append(replace(p.chain, gravity=gravity))
    if held is not None:
        other = replace(held, mass=2.0 * held.mass, com=np.array([0.01, 0.02, -0.01]), inertia=3.0 * held.inertia)
        own |= {f"object_{what}": [getattr(x, what) for x in (held, other)] for what in ("mass", "com", "inertia")}
        chains[1] = replace(chains[1], held_object=other)
    rollout = hf.compile_rollout(p.chain, scheme="midpoint")
    record = rollout.run(rollout.start(**given(p.chain, p.state, 2), tau=p.tau, **own), 10 * STEP, STEP)
    law = lambda t, state, memory: (p.tau, memory)  # noqa: E731
    for row, chain in enumerate(chains):
        assert_same_run(record.trajectory(row), hf.simulate(chain, p.state, law, 10 * STEP, STEP, scheme="midpoint"))
    assert gap(record["q"][-1, 0], record["q"][-1, 1]) > 1e-5


@pytest.mark.long
def test_laws():
    """Laws with memory and parameters, and gravity compensation, move as in `simulate`."""
    chain, state, tau = branched_problems()["on a shoulder"]
    law = hf.ControlLaw(
        lambda t, x, m, g: (-2.0 * (1.0 + t) * x.qd + g["size"] * m[0] * tau, 1.1 * m), [0.3], {"size": ()}
    )
    rollout = hf.compile_rollout(chain, law, parameters=["link_wrench"])
    push = np.random.default_rng(0).normal(size=6)
    systems = rollout.start(**given(chain, state, 2), size=[1.0, 2.0], object_wrench=push)
    record = rollout.run(systems, 0.02, STEP, every=2)
    inputs = hf.Inputs(object_wrench=push)
    for row, size in enumerate((1.0, 2.0)):
        run = hf.simulate(chain, state, law, 0.02, STEP, inputs=inputs, parameters={"size": size}, every=2)
        assert_same_run(record.trajectory(row), run)
    assert gap(record["q"][-1, 0], record["q"][-1, 1]) > 1e-6

    p = palletiser()
    holding = hf.control.GravityCompensation(p.chain, joint_damping=1.0)
    pulling = hf.ControlLaw(lambda t, x, m, g: (holding(t, x, None)[0] + np.array([1.0, t, 0.0, 0.0]), m))
    for law in (holding, pulling):
        rollout = hf.compile_rollout(p.chain, law)
        record = rollout.run(rollout.start(**given(p.chain, p.state)), 0.02, STEP)
        assert_same_run(record.trajectory(0), hf.simulate(p.chain, p.state, law, 0.02, STEP))


@pytest.mark.long
def test_a_spherical_joint(tmp_path):
    """Its quaternion is scaled to unit length at the start, or refused; records in folders have all four numbers."""
    chain, state, tau = branched_problems()["on a shoulder"]
    rollout = hf.compile_rollout(chain, scheme="midpoint")
    start = given(chain, state, 3)
    start["q"][1, 1:5] *= 1.1
    start["q"][2, 1:5] *= 1.0 + 1e-8
    systems = rollout.start(**start, tau=tau)
    assert [*systems.status] == [RolloutStatus.RUNNING, RolloutStatus.BROKEN, RolloutStatus.RUNNING]
    record = rollout.run(systems, 3 * STEP, STEP, record=("q", "floating_pose"), folder=tmp_path / "record")
    assert np.abs(np.linalg.norm(record["q"][:, 2, 1:5], axis=1) - 1.0).max() < 1e-14
    read = hf.io.load_record(tmp_path / "record", rollout=rollout)
    assert read["q"].shape == (4, 3, 10) and (read["q"] == record["q"]).all()
    assert gap(read.trajectory(2).q, record["q"][:, 2]) == 0.0


@pytest.mark.long
def test_tracking():
    """A pot and its lid along paths, by a rollout and by `simulate`."""
    chain, state, _ = branched_problems()["grippers"]
    path = hf.control.RestToRest(state.object_frame, displacement=[0.0, 0.0, 0.01], duration=0.5)
    law = hf.control.ObjectTracking(chain, path, internal_force=5.0)
    rollout = hf.compile_rollout(chain, law, scheme="midpoint")
    record = rollout.run(rollout.start(**given(chain, state)), 0.01, STEP)
    assert_same_run(record.trajectory(0), hf.simulate(chain, state, law, 0.01, STEP, scheme="midpoint"), 1e-9)
