"""Sound calls of laws as machine code, runs and rollouts."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import control
from tests.fuzz.calls import Later, call, everything, fixed, inputs_of, numbers_of, rigid, shown, state_of, stay

# Laws and runs.


def law() -> hf.ControlLaw:
    """Return a law with two parameters and a memory."""
    return hf.ControlLaw(stay, np.zeros(2), {"gain": ()})


@cache
def compiled_law() -> Any:
    """Return its machine code."""
    return control.compile_law(law(), fixed().chain)


@call(
    "compile_law",
    t=0.1,
    q=Later(lambda: np.array(fixed().state.q)),
    qd=Later(lambda: np.array(fixed().state.qd)),
    object_pose=Later(lambda: np.array(fixed().state.object_pose)),
    object_twist=np.zeros(6),
    memory=np.zeros(2),
    gain=2.0,
    threads=1,
)
def _compiled_law(**given: Any) -> Any:
    return compiled_law().torques(**given)


call(
    "compile_law of",
    controller=Later(lambda: control.GravityCompensation(fixed().chain)),
    chain=Later(lambda: fixed().chain),
)(shown(control.compile_law))


@call("a law's memory", memory=np.zeros(2), returned=np.ones(2), wanted="gain", parameters={"gain": 2.0})
def _memory(memory: Any, returned: Any, wanted: Any, parameters: Any) -> Any:
    wrong = hf.ControlLaw(lambda t, state, _, given: (-given[wanted] * state.q, returned), memory, {"gain": ()})
    return hf.simulate(rigid().chain, rigid().state.at_rest(), wrong, 0.002, 1e-3, parameters=parameters).q


@call("a controller of so many arguments", count=3)
def _controller(count: Any) -> Any:
    taken = ", ".join(f"x{k}" for k in range(count if isinstance(count, int) and 0 <= count < 9 else 2))
    controller = eval(f"lambda {taken}: ([0.0] * 13, None)")
    return hf.simulate(rigid().chain, rigid().state.at_rest(), controller, 0.002, 1e-3).q


def still(p: Any) -> dict[str, Any]:
    """Return a state at rest, as numbers."""
    return numbers_of(p.state.at_rest())


RUN = {
    "duration": 0.02,
    "step": 0.01,
    "sample_time": 0.01,
    "delay": 0.005,
    "parameters": {"gain": 2.0},
    "breakpoints": [0.007],
    "on_slip": "stop",
    "on_limit": "record",
    "on_singular": "stop",
    "scheme": "rk4",
    "rtol": 1e-6,
    "atol": 1e-9,
    "largest_drift": 1e-6,
    "name": "run",
}


@call(
    "simulate",
    chain=Later(lambda: fixed().chain),
    state=Later(lambda: still(fixed())),
    **RUN,
    inputs={"object_wrench": np.ones(6)},
    memory=np.zeros(2),
    folder="result",
    overwrite=False,
)
def _simulate(chain: Any, state: Any, inputs: Any, memory: Any, folder: Any, **given: Any) -> Any:
    chosen = hf.ControlLaw(stay, memory, {"gain": ()})
    run = hf.simulate(chain, state_of(state), chosen, inputs=inputs_of(inputs), folder=folder, **given)
    if folder is not None:
        assert np.array_equal(hf.load_result(folder).trajectory.q, run.q)
    return run.q, run.tau, run.object_pose, run.grasp_wrench, repr(run)


@call(
    "simulate everything",
    state=Later(lambda: numbers_of(everything().state)),
    duration=0.004,
    step=0.002,
    scheme="imex",
    tau=Later(lambda: np.array(everything().tau)),
    on_limit="clip",
)
def _simulate_everything(state: Any, tau: Any, **given: Any) -> Any:
    run = hf.simulate(everything().chain, state_of(state), lambda t, state, memory: (tau, memory), **given)
    return run.q, run.tau, run.object_pose, run.grasp_wrench


@call(
    "simulate events",
    duration=0.01,
    step=0.005,
    t=0.004,
    arm="arm1",
    here=True,
    grasp=Later(lambda: fixed().chain.grasps["arm1"]),
    back=0.008,
)
def _events(t: Any, arm: Any, here: Any, grasp: Any, back: Any, **given: Any) -> Any:
    events = [hf.Release(t, arm), hf.Attach(back, arm, grasp, here)]
    run = hf.simulate(
        fixed().chain, fixed().state.at_rest(), control.GravityCompensation(fixed().chain), events=events, **given
    )
    return run.q


@call(
    "simulate base_motion",
    start=np.array([1.0, 0, 0, 0, 0, 0, 0]),
    displacement=np.array([0.01, 0.0, 0.0]),
    arm="arm1",
    duration=0.004,
    step=0.002,
)
def _base_motion(start: Any, displacement: Any, arm: Any, **given: Any) -> Any:
    p = fixed()
    path = control.RestToRest(start, displacement)
    carried = hf.simulation.CarriedBase(path, p.chain.arms["arm1"].base)
    motion = {arm: carried} if isinstance(arm, str) else arm
    law = control.GravityCompensation(p.chain)
    return hf.simulate(p.chain, p.state.at_rest(), law, base_motion=motion, **given).q


@cache
def run() -> Any:
    """Return a short run."""
    law = hf.ControlLaw(stay, np.zeros(2), {"gain": ()})
    return hf.simulate(fixed().chain, fixed().state.at_rest(), law, 0.04, 0.005, parameters={"gain": 2.0})


@call("state_at", t=0.011)
def _state_at(t: Any) -> Any:
    return run().state_at(t)


# Rollouts.


@cache
def rollout() -> Any:
    """Return steps of two arms under a law with a parameter."""
    return hf.compile_rollout(rigid().chain, hf.ControlLaw(stay, np.zeros(2), {"gain": ()}))


ROWS = {
    "q": Later(lambda: np.tile(rigid().state.q, (3, 1))),
    "qd": Later(lambda: 0 * np.array(rigid().state.q)),
    "object_pose": Later(lambda: np.array(rigid().state.object_pose)),
    "object_twist": np.zeros(6),
}


def started(**given: Any) -> Any:
    """Return three systems."""
    sound = {key: x.made() if isinstance(x, Later) else x for key, x in ROWS.items()}
    return rollout().start(**{**sound, "gain": 2.0, **given})


@call(
    "rollout start",
    **ROWS,
    gain=2.0,
    memory=np.zeros(2),
    t=0.0,
    threads=1,
    object_mass=np.array([1.0, 2.0, 3.0]),
    object_inertia="scale",
    gravity=np.array([0.0, 0.0, -9.81]),
)
def _start(**given: Any) -> Any:
    return rollout().start(**given)


@call(
    "rollout step",
    step=1e-3,
    steps=2,
    least_margin=-1.0,
    stop_at_limits=False,
    largest_drift=1e-6,
    threads=1,
    gain=np.array([1.0, 2.0, 3.0]),
    object_wrench=np.ones((3, 6)),
)
def _step(**given: Any) -> Any:
    return rollout().step(started(), **given)


@call(
    "rollout run",
    duration=0.004,
    step=1e-3,
    every=2,
    record=["q", "tau", "status"],
    largest_drift=1e-6,
    threads=1,
    folder="record",
    overwrite=False,
    gain=2.0,
)
def _run(folder: Any, **given: Any) -> Any:
    record = rollout().run(started(), folder=folder, **given)
    if folder is not None:
        assert np.array_equal(hf.io.load_record(folder, rollout()).t, record.t)
    return record.systems, repr(record)


@cache
def record() -> Any:
    """Return a record of three systems."""
    return rollout().run(started(), 0.004, 1e-3)


@call("record", system=1, every=2, overwrite=False, name="record")
def _record(system: Any, every: Any, overwrite: Any, name: Any) -> Any:
    hf.io.load_record(record().save(name, overwrite), rollout())
    return record().trajectory(system, every).q, record().to_pandas().shape, record().to_xarray().sizes


@call(
    "tape",
    step=1e-3,
    steps=4,
    every=2,
    record=["q"],
    schedule={"gain": np.ones(4)},
    along={"tau": np.ones((4, 3, 13))},
    final={"q": np.ones((3, 13)), "object_pose": np.ones((3, 6))},
    by=["q", "gain"],
    threads=1,
)
def _tape(step: Any, steps: Any, every: Any, record: Any, schedule: Any, **given: Any) -> Any:
    tape = rollout().tape(started(), step, steps=steps, every=every, record=record, schedule=schedule)
    return tape.vjp(**given).parts


@call("systems", rows=[0, 2], number=1)
def _systems(rows: Any, number: Any) -> Any:
    return started().copy(rows), started().state(number)


call(
    "compile_rollout",
    chain=Later(lambda: rigid().chain),
    law=Later(law),
    scheme="rk4",
    generic_rank=12,
    base_motion={},
    parameters=["link_wrench"],
)(shown(hf.compile_rollout))
