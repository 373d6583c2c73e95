"""Every question that is asked of chains: each returns numbers, or raises the error that refuses the chain by name."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import control, dynamics, forces
from holdfast.interop import to_mjcf
from holdfast.interop.mcap_writer import write_mcap
from holdfast.questions.arrays import FLOATING, FLOATING_RESULT, STATE
from holdfast.questions.question import QUESTIONS
from holdfast.view.page import page
from holdfast.view.playback import playback_of_run
from tests.capabilities.chains import Case
from tests.questions.every import FUNCTIONS, asked

STEP = 1e-4
ANSWERED = {dynamics.Status.OK, dynamics.Status.INDETERMINATE_FORCES}
BY = ("q", "qd", "tau", "object_pose", "object_twist", "object_mass")


@dataclass(frozen=True)
class Question:
    """A question.

    Attributes:
        name: what the page calls it.
        ask: returns numbers, of a case.
        quick: whether it is answered in milliseconds.
    """

    name: str
    ask: Callable[[Case], Any]
    quick: bool = True


def inverse(c: Case) -> Any:
    """Return the torques of the accelerations and wrenches that forward dynamics finds."""
    found = c.solved()
    given = {"inputs": c.inputs, "base_acceleration": found.base_acceleration if c.chain.floats else None}
    if not c.chain.beyond_serial:
        return hf.inverse_dynamics(c.chain, c.state, found.qdd, found.grasp_wrench, **given)
    given["object_acceleration"] = found.object_acceleration
    return hf.inverse_dynamics(c.chain, c.state, found.qdd, found.grasp_wrench, **given).tau


def run(c: Case, **options: Any) -> hf.simulation.Trajectory:
    """Return a run of three steps under constant torques."""
    how = {"inputs": c.wrenches, "base_motion": c.base_motion} | options
    return hf.simulate(c.chain, c.state, lambda t, state, memory: (c.tau, memory), 3 * STEP, STEP, **how)


def momenta(c: Case) -> Any:
    """Return energies, momentum, power, and how fast momentum changes."""
    found = c.solved()
    power = dynamics.power(c.chain, c.state, c.tau, found, c.inputs)
    return [
        dynamics.kinetic_energy(c.chain, c.state, c.inputs),
        dynamics.potential_energy(c.chain, c.state),
        *dynamics.momentum(c.chain, c.state),
        *dynamics.momentum_rate(c.chain, c.state, found, inputs=c.inputs),
        power.drives,
    ]


def let_go(c: Case) -> Any:
    """Return the chain after one grasp has opened and closed again."""
    name = list(c.chain.grasps)[-1]
    free = dynamics.release(c.chain, name)
    return dynamics.attach(free, c.state, name, c.chain.grasps[name], inputs=c.inputs).state.qd


def as_batch(c: Case) -> dict[str, Any]:
    """Return what machine code takes, for two systems."""
    return {name: np.tile(x, (2,) + (1,) * np.ndim(x)) for name, x in c.arguments.items()}


def compiled(c: Case) -> hf.compiled.CompiledChain:
    """Return machine code, external wrenches on links being parameters where there are any."""
    return hf.compile(c.chain, parameters=["link_wrench"] if c.inputs.link_wrenches is not None else [])


def by_machine_code(c: Case) -> Any:
    """Return qdd of a batch."""
    found = compiled(c).forward_dynamics(**as_batch(c))
    assert set(found.status) <= ANSWERED, found.status
    return found.qdd


def inverse_by_machine_code(c: Case) -> Any:
    """Return the torques of a batch for the accelerations and wrenches that forward dynamics finds."""
    found, made = c.solved(), compiled(c).inverse_dynamics
    given = {name: x for name, x in as_batch(c).items() if name != "tau"}
    given |= {"qdd": found.qdd, "grasp_wrench": found.grasp_wrench}
    given |= {FLOATING_RESULT: found.base_acceleration} if c.chain.floats else {}
    if not c.chain.beyond_serial:  # the wrenches say what the object does, and only springs are fixed to it
        kept = {"object_pose", "object_twist"} if c.chain.springs or c.chain.bushings else set()
        return made(**{name: x for name, x in given.items() if not name.startswith("object_") or name in kept})
    return made(**given, object_acceleration=found.object_acceleration).tau


def gradients_by_machine_code(c: Case) -> Any:
    """Return gradients of sum(qdd) of a batch."""
    cotangent = np.ones((2, c.chain.joint_count))
    return compiled(c).forward_dynamics_vjp(**as_batch(c), qdd=cotangent, by=BY).q


def started(c: Case) -> tuple[Any, Any]:
    """Return a rollout, and two systems at the state."""
    law = hf.ControlLaw(lambda t, state, memory, given: (given["tau"], memory), parameters={"tau": c.tau.shape})
    made = hf.compile_rollout(c.chain, law, inputs=c.wrenches, base_motion=c.base_motion)
    given = as_batch(c)
    state = {name: given[name] for name in (*STATE, *FLOATING) if name in given}
    return made, made.start(**state, tau=c.tau)


def rollout(c: Case) -> Any:
    """Return joint positions of two systems after three steps."""
    made, systems = started(c)
    made.step(systems, STEP, steps=3)
    assert set(systems.status) == {hf.simulation.RolloutStatus.RUNNING}, systems.status
    return systems.q


def gradients(c: Case) -> Any:
    """Return gradients, rates and a Jacobian of the reference."""
    cotangent = np.ones(c.chain.joint_count)
    back = hf.forward_dynamics_vjp(c.chain, c.state, c.tau, inputs=c.inputs, by=BY, qdd=cotangent)
    rates = hf.forward_dynamics_jvp(c.chain, c.state, c.tau, inputs=c.inputs, along={"qd": cotangent})
    matrix = hf.forward_dynamics_jacobian(c.chain, c.state, c.tau, inputs=c.inputs, by=("tau",))
    return [back.q, rates.qdd, matrix["qdd", "tau"]]


def a_step(c: Case) -> Any:
    """Return a time step made linear, on bases that move as those of runs do."""
    return hf.linearise(c.chain, c.state, c.tau, inputs=c.wrenches, base_motion=c.base_motion, step=STEP).A


def through_steps(c: Case) -> Any:
    """Return gradients of joint positions after two steps by what they were and by torques."""
    made, systems = started(c)
    tape = made.tape(systems, STEP, steps=2)
    found = tape.vjp({"q": np.ones_like(systems.qd)}, by=("q", "tau"))
    return [found.q, found.tau]


def of_questions(c: Case) -> list[Any]:
    """Return a gradient of every question that is answered without the equations of motion."""
    found = c.solved()
    given = {"tau": c.tau, "qdd": found.qdd, "grasp_wrench": found.grasp_wrench, "result": found}
    given |= {FLOATING_RESULT: found.base_acceleration} if c.chain.floats else {}
    gradients = []
    for name in FUNCTIONS:
        question = QUESTIONS[name]
        ones = {of: np.ones(question.shape(c.chain, of)) for of in question.names[:1]}
        made = asked(name, c.chain, c.state, c.inputs, given, "vjp", by=question.by[-1:], **ones)
        gradients += made.parts.values()
    return gradients


def exported(c: Case) -> Any:
    """Return the sizes of exported forward and inverse dynamics."""
    with tempfile.TemporaryDirectory() as folder:
        made = hf.codegen.export_c(c.chain, folder, state=c.state, overwrite=True)
    return [made.functions[f"chain_{way}_dynamics"].stack for way in ("forward", "inverse")]


def parameters_rows(c: Case) -> Any:
    """Return the wrenches of the payload's ten parameters."""
    found = c.solved()
    return hf.regressor(
        c.chain,
        c.state,
        found.qdd,
        found.object_acceleration,
        inputs=c.inputs,
        base_acceleration=found.base_acceleration if c.chain.floats else None,
    ).object


def mcap(c: Case) -> int:
    """Return the size of a run's MCAP file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        write_mcap(c.chain, run(c), path, base_motion=c.base_motion)
        return path.stat().st_size


def at_rest(c: Case) -> hf.State:
    """Return the state with no joint and no body moving."""
    still = None if c.state.base_twist is None else np.zeros(6)
    return replace(c.state, qd=np.zeros(c.chain.joint_count), object_twist=np.zeros(6), base_twist=still)


def tracking(c: Case) -> Any:
    """Return the torques that keep the object where it is."""
    path = hf.control.RestToRest(c.state.object_frame).at
    return hf.control.ObjectTracking(c.chain, path)(0.0, at_rest(c), None)[0]


def law_of(c: Case, forces: Any = None, **within: Any) -> hf.ControlLaw:
    """Return an impedance of the object where it is, with grasp forces and a posture."""
    motion = control.ObjectImpedance(control.RestToRest(c.state.object_frame), 100.0, 20.0)
    return control.cooperative_law(c.chain, motion, forces, control.PostureControl(at_rest(c).q), **within)


def torques_of(c: Case, law: hf.ControlLaw) -> Any:
    """Return the torques of a law at rest."""
    given = {name: np.zeros(shape) for name, shape in law.parameters.items()}
    return law.given(given)(0.0, at_rest(c), None)[0]


def every_force(c: Case) -> Any:
    """Return torques of a hand-over, of springs between the grasps, and of an integral."""
    push = control.InternalForce(10.0)
    ramp = control.RampedForces(push, control.LoadShare(force=5.0))
    kinds = (ramp, control.InternalImpedance(50.0, 5.0, push), control.HybridForce(10.0, 1e-3, push))
    return [torques_of(c, law_of(c, forces)) for forces in kinds]


def rates(c: Case) -> Any:
    """Return the joint rates of an admittance."""
    path = control.RestToRest(c.state.object_frame)
    gains = {"stiffness": 100.0, "damping": 20.0, "inertia": 1.0, "internal_damping": 1e3}
    return torques_of(c, control.admittance_law(c.chain, path, contact_stiffness=1e4, sample_time=1e-3, **gains))


DYNAMICS = [
    Question("forward dynamics", lambda c: c.solved().qdd),
    Question("dense equations (`kkt`)", lambda c: c.solved(method="kkt").qdd),
    Question("RCCFD 1 .. 3 of the paper", lambda c: [c.solved(method=f"rccfd{k}").qdd for k in (1, 2, 3)]),
    Question("inverse dynamics", inverse),
    Question("`close`", lambda c: hf.close(c.chain, c.state, inputs=c.inputs).q),
    Question("`project`", lambda c: hf.project(c.chain, c.state, c.inputs)[0].q),
    Question("`diagnose`", lambda c: hf.diagnose(c.chain, c.state).rank),
    Question("energies, momentum, power", momenta),
    Question("object mobility and inertia", lambda c: dynamics.object_mobility(c.chain, c.state)),
    Question("basis of the motions", lambda c: dynamics.motion_basis(c.chain, c.state)),
    Question("`release`, `attach`", let_go),
]
FORCES = [
    Question("motion and internal forces", lambda c: forces.split(c.chain, c.state, c.solved().grasp_wrench).internal),
    Question("margins of the grasps", lambda c: forces.grasp_margins(c.chain, c.state, c.solved().grasp_wrench)),
    Question("largest margin", lambda c: forces.largest_margin(c.chain, c.state, c.solved(), inputs=c.inputs).margin),
    Question("wrenches at wrists", lambda c: forces.wrist_wrenches(c.chain, c.state, c.solved())),
    Question("holding torques", lambda c: hf.holding_torques(c.chain, at_rest(c))),
    Question("`ObjectTracking`", tracking),
]
LAWS = [
    Question("`distribute`", lambda c: forces.distribute(c.chain, at_rest(c)).tau),
    Question("`cooperative_law`", lambda c: torques_of(c, law_of(c, control.InternalForce(10.0)))),
    Question("all kinds of forces", every_force),
    Question("within limits", lambda c: torques_of(c, law_of(c, limits=forces.ForceLimits()))),
    Question("`observed`", lambda c: torques_of(c, control.observed(law_of(c), c.chain, gain=50.0, sample_time=1e-3))),
    Question("`admittance_law`", rates),
]
RUNS = [
    Question("simulation, rk4", lambda c: run(c).q, quick=False),
    Question("simulation, dop853", lambda c: run(c, scheme="dop853").q, quick=False),
    Question("an arm lets go", lambda c: run(c, events=[hf.Release(STEP, list(c.chain.grasps)[-1])]).q, quick=False),
    Question(
        "the viewer's page",
        lambda c: len(page(playback_of_run(c.chain, run(c), base_motion=c.base_motion))),
        quick=False,
    ),
    Question("MCAP", mcap, quick=False),
    Question("MJCF", lambda c: len(to_mjcf(c.chain, c.state))),
]
MACHINE_CODE = [
    Question("compiled forward dynamics", by_machine_code, quick=False),
    Question("compiled inverse dynamics", inverse_by_machine_code, quick=False),
    Question("rollouts", rollout, quick=False),
    Question("`export_c`", exported, quick=False),
]
DERIVATIVES = [
    Question("derivatives of forward dynamics", gradients, quick=False),
    Question("`linearise`", lambda c: hf.linearise(c.chain, c.state, c.tau, inputs=c.inputs).A, quick=False),
    Question("compiled derivatives", gradients_by_machine_code, quick=False),
    Question("of all other questions", of_questions, quick=False),
    Question("a time step", a_step, quick=False),
    Question("through rollouts", through_steps, quick=False),
    Question("`regressor`", parameters_rows, quick=False),
]
TABLES = {
    "Dynamics": DYNAMICS,
    "Forces and control": FORCES,
    "Laws": LAWS,
    "Runs and files": RUNS,
    "Compiled code": MACHINE_CODE,
    "Derivatives": DERIVATIVES,
}


@dataclass(frozen=True)
class Answer:
    """How a question is answered for a chain.

    Attributes:
        refused_by: name of the error that refuses; empty if nothing does.
        message: its first sentence.
    """

    refused_by: str = ""
    message: str = ""


def answer(question: Question, c: Case) -> Answer:
    """Return whether a question is answered with finite numbers; an error that is not ours passes through."""
    try:
        found = question.ask(c)
    except hf.HoldfastError as refusal:
        return Answer(type(refusal).__name__, str(refusal).split(";")[0])
    for part in found if isinstance(found, list) else [found]:
        assert not np.isnan(np.asarray(part, dtype=float)).any(), (question.name, part)
    return Answer()
