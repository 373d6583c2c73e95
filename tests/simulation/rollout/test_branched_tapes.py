"""Gradients through rollouts of chains with branches, against five-point differences of the discrete map."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.tree.mechanism_terms import chain_arguments, chain_arrays_of, flat_state
from holdfast.dynamics.tree.varied_forest import displaced, displacement
from holdfast.questions.arrays import state_fields, value_of
from holdfast.simulation import Rollout
from holdfast.simulation.rollout.traced_mechanism import given_numbers
from holdfast.simulation.rollout.varied_step import VariedStep
from holdfast.simulation.runge_kutta import MIDPOINT
from holdfast.spatial.symmetric import symmetric_part
from tests.dynamics.tree.as_branched import AWAY, STRAY
from tests.simulation.gantries import squeezed
from tests.simulation.rollout.test_branched_rollouts import given
from tests.simulation.rollout.test_tape import five_points
from tests.systems.branched import Branched, branched_problems

STEP, STEPS, SYSTEMS = 1e-3, 4, 2
TOLERANCE = 1e-8
POSITIONS = ("q", "object_pose", "floating_pose")
FORCES = ("grasp_wrench", "coupling_force")


def law(chain: hf.ClosedChain) -> hf.ControlLaw:
    """Return a law with two parameters and a memory, without torques of passive joints."""
    n, driven = chain.joint_count, np.array([joint.actuated for joint in chain.freedoms], dtype=float)
    return hf.ControlLaw(
        lambda t, x, m, g: (g["tau"] - driven * m * x.qd, 0.9 * m + 0.1 * g["gain"]),
        memory=np.full(n, 0.2),
        parameters={"tau": (n,), "gain": (n,)},
    )


class Rolled:
    """A rollout as a function of what gradients are by, and a scalar of its result for every system.

    Attributes:
        p: the chain, a state and torques.
        rollout: what steps.
        final, along: cotangents at the end, and along the steps.
        names: what gradients are by.
    """

    def __init__(self, p: Branched, scheme: str = "midpoint", wrong: float = 0.0, along: Any = ()) -> None:
        random, n = np.random.default_rng(0), p.chain.joint_count
        self.p, self.scheme = p, scheme
        self.rollout: Rollout = hf.compile_rollout(p.chain, law(p.chain), scheme=scheme)
        self.tau = p.tau * random.normal(size=(STEPS, SYSTEMS, n))
        self.places, fields = chain_arguments(p.chain), [*state_fields(p.chain)]
        self.start = given(p.chain, p.state, SYSTEMS)
        self.start["qd"] = self.start["qd"] + wrong * random.normal(size=n)  # `start` closes it
        self.tape(0.0)  # finds the rank
        unique = self.rollout.generic_rank == p.chain.as_forest.forest.constraint_row_count
        self.final = {name: random.normal(size=(SYSTEMS, *self.places[name].shape)) for name in fields}
        self.final["memory"] = random.normal(size=(SYSTEMS, n))
        along = along or [
            "qdd",
            "tau",
            "work",
            *(FORCES if unique else ()),
            *(["object_acceleration"] * bool(p.chain.objects)),
        ]
        records = self.tape(0.0, record=along).records
        self.along = {name: 1e-2 * random.normal(size=x.shape) for name, x in records.items()}
        self.names = [*fields, "memory", "gain", "tau", "step", *given_numbers(p.chain)]
        self.names += ["object_wrench"] * bool(p.chain.free_objects)

    def tape(self, far: float, changed: Any = None, record: Any = (), **options: Any) -> Any:
        """Return the steps with something changed."""
        d = {name: far * x for name, x in (changed or {}).items()}
        chain, n, forest = self.p.chain, self.p.chain.joint_count, self.p.chain.as_forest.forest
        start, fields = {name: x.copy() for name, x in self.start.items()}, state_fields(chain)
        for row in range(SYSTEMS):
            state = hf.State(**{field: start[name][row] for name, field in fields.items()})
            q, turned = flat_state(chain, state)[0], np.zeros(forest.velocity_count)
            for name in {*POSITIONS} & {*d}:
                turned[self.places[name].rows] = d[name][row].ravel()
            moved = chain_arrays_of(chain, displaced(forest, q, turned), turned)
            for name, field in fields.items():
                start[name][row] = moved[field] if name in POSITIONS else start[name][row] + d.get(name, [0.0] * 2)[row]
        tau = self.tau + d.get("tau", 0.0)
        further = {name: np.array(value_of(name, chain)) + d.get(name, 0.0) for name in given_numbers(chain)}
        further |= {"gain": 0.5 + d.get("gain", np.zeros(n)), "memory": 0.2 + d.get("memory", np.zeros(n))}
        if chain.free_objects:
            further["object_wrench"] = np.full(self.places["object_wrench"].shape, 0.5) + d.get("object_wrench", 0.0)
        systems = self.rollout.start(**start, tau=tau[0], **further)
        step = STEP + d.get("step", 0.0)
        return self.rollout.tape(systems, step, steps=STEPS, schedule={"tau": tau}, record=record, **options)

    def value(self, tape: Any, beside: Any) -> np.ndarray:
        """Return the scalar of every system; positions at the end count as displacements from those of a tape."""
        chain, found = self.p.chain, np.zeros(SYSTEMS)
        for row in range(SYSTEMS):
            here, there = (flat_state(chain, one.systems.state(row)) for one in (beside, tape))
            arrays = {"q": displacement(chain.as_forest.forest, here[0], there[0]), "qd": there[1]}
            for name in state_fields(chain):
                found[row] += (self.final[name][row] * self.places[name].of(arrays)).sum()
            found[row] += (self.final["memory"][row] * tape.systems.memory[row]).sum()
            found[row] += sum((x[:, row] * tape.records[name][:, row]).sum() for name, x in self.along.items())
        return found

    def gradients(self, tape: Any, **options: Any) -> Any:
        """Return the gradients of the scalar."""
        return tape.vjp(self.final, self.along, by=self.names, **options)

    def worst(self, far: float = 1e-4) -> float:
        """Return how far gradients are from differences, relative to the largest part of a slope."""
        tape, random, off = self.tape(0.0, record=[*self.along]), np.random.default_rng(2), [0.0]
        found = self.gradients(tape)
        for name in (name for name in self.names if found[name].size):
            x = found[name]
            direction = random.normal(size=x.shape) * (self.tau != 0.0 if name == "tau" else 1.0)
            direction = symmetric_part(direction) if name == "object_inertia" else direction
            axes = (0, 2) if name == "tau" else tuple(range(1, x.ndim))
            direction /= np.abs(direction).max() * (100.0 if name == "step" else 1.0)

            def at(x: float, name: str = name, direction: Any = direction) -> np.ndarray:
                return self.value(self.tape(x, {name: direction}, record=[*self.along]), tape)

            expected = five_points(at, far)
            slope = (x * direction).sum(axis=axes)
            size = np.abs(x * direction).max(axis=axes)
            off.append(float((np.abs(slope - expected) / np.maximum(size, 1e-3)).max()))
            print(f"\n{name}: {off[-1]:.1e}")
        return max(off)


@cache
def palletiser() -> Rolled:
    """Return the palletiser, whose first velocities do not fit its loop."""
    return Rolled(branched_problems()["palletiser"], wrong=0.1)


@pytest.mark.long
@pytest.mark.parametrize("name", branched_problems())
def test_gradients(name):
    """Everything that a rollout is given, the state that `start` closes included."""
    rolled = palletiser() if name == "palletiser" else Rolled(branched_problems()[name], wrong=0.1)
    assert rolled.worst() < TOLERANCE


@pytest.mark.slow
def test_bits():
    """The same bits whether states are kept or steps taken again, on threads, and for one system of several."""
    rolled = palletiser()
    tape = rolled.tape(0.0)
    found = rolled.gradients(tape)
    again = rolled.gradients(rolled.tape(0.0, every=3), threads=2)
    assert all(np.array_equal(again[name], found[name]) for name in rolled.names)
    systems = rolled.rollout.start(
        **{name: x[1:] for name, x in rolled.start.items()}, tau=rolled.tau[0, 1:], gain=np.full(4, 0.5)
    )
    alone = rolled.rollout.tape(systems, STEP, steps=STEPS, schedule={"tau": rolled.tau[:, 1:]})
    one = alone.vjp(
        {name: x[1:] for name, x in rolled.final.items()},
        {name: x[:, 1:] for name, x in rolled.along.items()},
        by=rolled.names,
    )
    for name in rolled.names:
        assert np.array_equal(one[name], found[name][:, 1:] if name == "tau" else found[name][1:]), name


@pytest.mark.slow
def test_reverse_and_forward():
    """One step on floats: rates along tangents, gradients of cotangents, and those of the machine code."""
    rolled, random = palletiser(), np.random.default_rng(3)
    chain, systems = rolled.p.chain, rolled.tape(0.0).systems
    n, driven = chain.joint_count, rolled.tau[0, 0] != 0.0
    tau, gain = rolled.tau[0, 0], np.full(n, 0.5)
    tape = rolled.rollout.tape(systems, STEP, steps=1, tau=tau, gain=gain)
    kernel = rolled.rollout.kernel
    at = {f"last.{name}": x[0] for name, x in systems.arrays.items()}
    at |= kernel.parameters | {"begin": np.array(0.0), "step": np.array(STEP), "control.tau": tau, "control.gain": gain}
    by = {"q": "q", "qd": "qd", "tau": "control.tau", "step": "step", "gravity": "gravity"}
    linear = VariedStep(kernel.model, MIDPOINT, kind=kernel.code.varied).linear(at, [*by.values()], ("qdd", "work"))
    tangents = {key: random.normal(size={"step": (), "gravity": (3,)}.get(name, (n,))) for name, key in by.items()}
    tangents["control.tau"] *= driven
    cotangents = {name: random.normal(size=np.shape(x)) for name, x in linear.found.items() if np.size(x)}
    rates, gradient = (
        {name: np.asarray(x, dtype=float) for name, x in found.items()}
        for found in (linear.rates(tangents), linear.gradient(cotangents))
    )
    forward = sum((cotangents[name] * rates[name]).sum() for name in cotangents)
    backward = sum((x * gradient[key]).sum() for key, x in tangents.items())
    assert abs(forward - backward) < 1e-10 * max(abs(forward), 1.0)
    final = {name: np.repeat(cotangents[name][None], SYSTEMS, 0) for name in ("q", "qd", "work")}
    final["memory"] = np.repeat(cotangents["before"][None], SYSTEMS, 0)
    code = tape.vjp(final, {"qdd": np.repeat(cotangents["qdd"][None], SYSTEMS, 0)[None]}, by=[*by])
    for name, key in by.items():
        assert np.abs(code[name][0] - gradient[key]).max() < 1e-10 * max(np.abs(gradient[key]).max(), 1.0), name


@pytest.mark.slow
def test_refusals():
    """Forces that are not unique, and numbers of the chain, which are constants of the code."""
    rolled = palletiser()
    tape = rolled.tape(0.0)
    for name in ("grasp_wrench", "margin"):
        with pytest.raises(hf.errors.MethodNotApplicable, match=f"{name}: expected forces that are unique"):
            tape.vjp(along={name: np.zeros(3)})
    for name in ("link_mass", "grasp_pose", "base_pose", "object_mass"):
        with pytest.raises(hf.errors.StateError, match=f"tape: by: no '{name}'"):
            tape.vjp(rolled.final, by=[name])


@pytest.mark.long
def test_margins():
    """Those of a softfinger and a ball with friction, which hold a block."""
    friction = hf.Friction(0.5, torsion_radius=0.02), hf.Friction(2.0)
    chain, state = squeezed(("softfinger", "ball"), friction, gravity=9.81)
    chain = replace(chain, objects={"stray": STRAY})
    apart = replace(state, object_pose=[state.object_pose, AWAY], object_twist=np.zeros((2, 6)))
    tau = np.array([20.0, 1.0, 2.0, -20.0, 1.0, 3.0])
    rolled = Rolled(Branched(chain, apart, tau), along=("margin", "grasp_wrench"))
    assert np.isfinite(rolled.tape(0.0, record=["margin"]).records["margin"]).all()
    assert rolled.worst() < TOLERANCE
