"""Sound calls of machine code, runs, rollouts, sweeps, files and environments, for the fuzz."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import jax
import numpy as np

import holdfast as hf
from holdfast import control
from holdfast.identification import Recording, base_parameters, load_recording
from holdfast.interop import jacobian_operator, load_mjcf_trunk, to_jax, to_mjcf
from holdfast.robots import load_urdf_trunk
from holdfast.sweeps import NearPose, Normal, Uniform
from tests.fuzz.calls import Later, call, everything, fixed, inputs_of, numbers_of, rigid, state_of, stay
from tests.gym.problems import short_carry
from tests.robots.test_urdf_trunk import FREE_FINGERS, HANDS, HEAVY_BASE

# Machine code.


@cache
def compiled() -> Any:
    """Return the machine code of the floating chain with everything."""
    return hf.compile(everything().chain)


def given_compiled(**more: Any) -> dict[str, Any]:
    """Return sound arguments of the machine code, and more of them."""
    found = {}
    for name, field in (("q", "q"), ("qd", "qd"), ("object_pose", "object_pose"), ("object_twist", "object_twist"),
                        ("floating_pose", "base_pose"), ("floating_twist", "base_twist")):
        found[name] = Later(lambda field=field: np.array(getattr(everything().state, field)))
    return {**found, "tau": Later(lambda: np.array(everything().tau)), **more}


ACTING = {"object_wrench": np.ones(6), "gravity": np.array([0.0, 0.0, -9.81]), "object_mass": 2.0,
          "object_inertia": "scale", "threads": 1}


@call("compiled forward_dynamics", **given_compiled(**ACTING))
def _forward(**given: Any) -> Any:
    return compiled().forward_dynamics(**given)


@call("compiled batch", **{**given_compiled(**ACTING), "q": Later(lambda: np.tile(everything().state.q, (4, 1))),
                           "gravity": np.tile([0.0, 0.0, -9.81], (4, 1)), "threads": 2})
def _batch(**given: Any) -> Any:
    return compiled().forward_dynamics(**given)


@call("bind", **given_compiled(object_wrench=np.ones(6)))
def _bind(**given: Any) -> Any:
    compiled().bind(**given)  # a call checks nothing: see `BoundDynamics`


@cache
def plain() -> Any:
    """Return the machine code of two arms on bases that stand."""
    return hf.compile(fixed().chain)


GIVEN = {"q": Later(lambda: np.array(fixed().state.q)), "qd": Later(lambda: np.array(fixed().state.qd)),
         "tau": Later(lambda: np.array(fixed().tau)), "object_pose": Later(lambda: np.array(fixed().state.object_pose)),
         "object_twist": np.zeros(6)}


@call("compiled vjp", **GIVEN, **dict(by=["q", "tau"], qdd=Later(lambda: np.array(fixed().tau))))
def _compiled_vjp(**given: Any) -> Any:
    found = plain().forward_dynamics_vjp(**given)
    return [found[name] for name in given["by"]]


@call("compiled jacobian", **GIVEN, of=["qdd"], by=["q"])
def _compiled_jacobian(**given: Any) -> Any:
    found = plain().forward_dynamics_jacobian(**given)
    return [found[one] for one in product(given["of"], given["by"])]


for _name in ("mass_matrix", "jacobian", "tip_poses", "link_poses"):

    def _of_q(_name: str = _name, **given: Any) -> Any:
        return getattr(plain(), _name)(**given)

    call(f"compiled {_name} of q", q=Later(lambda: np.array(fixed().state.q)), threads=1)(_of_q)


@call("compiled closure", **{key: x for key, x in given_compiled().items() if key != "tau"})
def _compiled_closure(**given: Any) -> Any:
    return compiled().closure(**given), compiled().kinetic_energy(**given)


@call("compile", chain=Later(lambda: fixed().chain), dtype="float64", method="auto", parameters=["link_inertia"], generic_rank=9)
def _compile(**given: Any) -> Any:
    return repr(hf.compile(**given))


@call("jacobian_operator", **GIVEN, of="qdd", by=["tau"])
def _operator(**given: Any) -> Any:
    return jacobian_operator(plain(), **given).shape


@call("to_jax", of=["qdd"], parameters=[], forward_mode=False)
def _jax(**given: Any) -> Any:
    with jax.enable_x64(True):
        return repr(to_jax(plain(), **given))


# Laws and runs.


def law() -> hf.ControlLaw:
    """Return a law with two parameters and a memory."""
    return hf.ControlLaw(stay, np.zeros(2), {"gain": ()})


@cache
def compiled_law() -> Any:
    """Return its machine code."""
    return control.compile_law(law(), fixed().chain)


@call("compile_law", t=0.1, q=Later(lambda: np.array(fixed().state.q)), qd=Later(lambda: np.array(fixed().state.qd)),
      object_pose=Later(lambda: np.array(fixed().state.object_pose)), object_twist=np.zeros(6), memory=np.zeros(2), gain=2.0,
      threads=1)
def _compiled_law(**given: Any) -> Any:
    return compiled_law().torques(**given)


@call("compile_law of", controller=Later(lambda: control.GravityCompensation(fixed().chain)), chain=Later(lambda: fixed().chain))
def _law_of(**given: Any) -> Any:
    return repr(control.compile_law(**given))


def still(p: Any) -> dict[str, Any]:
    """Return a state at rest, as numbers."""
    return numbers_of(p.state.at_rest())


RUN = {"duration": 0.02, "step": 0.01, "sample_time": 0.01, "delay": 0.005, "parameters": {"gain": 2.0}, "breakpoints": [0.007],
       "on_slip": "stop", "on_limit": "record", "on_singular": "stop", "scheme": "rk4", "rtol": 1e-6, "atol": 1e-9,
       "largest_drift": 1e-6, "name": "run"}


@call("simulate", chain=Later(lambda: fixed().chain), state=Later(lambda: still(fixed())), **RUN,
      inputs={"object_wrench": np.ones(6)}, memory=np.zeros(2))
def _simulate(chain: Any, state: Any, inputs: Any, memory: Any, **given: Any) -> Any:
    chosen = hf.ControlLaw(stay, memory, {"gain": ()})
    run = hf.simulate(chain, state_of(state), chosen, inputs=inputs_of(inputs), **given)
    return run.q, run.tau, run.object_pose, run.grasp_wrench, repr(run)


@call("simulate everything", state=Later(lambda: numbers_of(everything().state)), duration=0.004, step=0.002, scheme="imex",
      tau=Later(lambda: np.array(everything().tau)), on_limit="clip")
def _simulate_everything(state: Any, tau: Any, **given: Any) -> Any:
    run = hf.simulate(everything().chain, state_of(state), lambda t, state, memory: (tau, memory), **given)
    return run.q, run.tau, run.object_pose, run.grasp_wrench


@call("simulate events", duration=0.01, step=0.005, t=0.004, arm="arm1", here=True,
      grasp=Later(lambda: fixed().chain.grasps["arm1"]), back=0.008)
def _events(t: Any, arm: Any, here: Any, grasp: Any, back: Any, **given: Any) -> Any:
    events = [hf.Release(t, arm), hf.Attach(back, arm, grasp, here)]
    run = hf.simulate(fixed().chain, fixed().state.at_rest(), control.GravityCompensation(fixed().chain), events=events, **given)
    return run.q


@call("simulate base_motion", start=np.array([1.0, 0, 0, 0, 0, 0, 0]), displacement=np.array([0.01, 0.0, 0.0]), arm="arm1",
      duration=0.004, step=0.002)
def _base_motion(start: Any, displacement: Any, arm: Any, **given: Any) -> Any:
    p = fixed()
    path = control.RestToRest(start, displacement)
    motion = {arm: hf.simulation.CarriedBase(path, p.chain.arms["arm1"].base)}
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


ROWS = {"q": Later(lambda: np.tile(rigid().state.q, (3, 1))), "qd": Later(lambda: 0 * np.array(rigid().state.q)),
        "object_pose": Later(lambda: np.array(rigid().state.object_pose)), "object_twist": np.zeros(6)}


def started(**given: Any) -> Any:
    """Return three systems."""
    sound = {key: x.made() if isinstance(x, Later) else x for key, x in ROWS.items()}
    return rollout().start(**{**sound, "gain": 2.0, **given})


@call("rollout start", **ROWS, gain=2.0, memory=np.zeros(2), t=0.0, threads=1, object_mass=np.array([1.0, 2.0, 3.0]),
      object_inertia="scale", gravity=np.array([0.0, 0.0, -9.81]))
def _start(**given: Any) -> Any:
    return rollout().start(**given)


@call("rollout step", step=1e-3, steps=2, least_margin=-1.0, stop_at_limits=False, largest_drift=1e-6, threads=1,
      gain=np.array([1.0, 2.0, 3.0]), object_wrench=np.ones((3, 6)))
def _step(**given: Any) -> Any:
    return rollout().step(started(), **given)


@call("rollout run", duration=0.004, step=1e-3, every=2, record=["q", "tau", "status"], largest_drift=1e-6, threads=1, gain=2.0)
def _run(**given: Any) -> Any:
    record = rollout().run(started(), **given)
    return record.systems, repr(record)


@cache
def record() -> Any:
    """Return a record of three systems."""
    return rollout().run(started(), 0.004, 1e-3)


@call("record", system=1, every=2, overwrite=False, name="record")
def _record(system: Any, every: Any, overwrite: Any, name: Any) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        place = record().save(Path(folder) / name if isinstance(name, str) else name, overwrite)
        hf.io.load_record(place, rollout())
    return record().trajectory(system, every).q, record().to_pandas().shape, record().to_xarray().sizes


@call("tape", step=1e-3, steps=4, every=2, record=["q"], schedule={"gain": np.ones(4)}, along={"tau": np.ones((4, 3, 13))},
      final={"q": np.ones((3, 13)), "object_pose": np.ones((3, 6))}, by=["q", "gain"], threads=1)
def _tape(step: Any, steps: Any, every: Any, record: Any, schedule: Any, **given: Any) -> Any:
    tape = rollout().tape(started(), step, steps=steps, every=every, record=record, schedule=schedule)
    return tape.vjp(**given).parts


@call("systems", rows=[0, 2], number=1)
def _systems(rows: Any, number: Any) -> Any:
    return started().copy(rows), started().state(number)


@call("compile_rollout", chain=Later(lambda: rigid().chain), law=Later(law), scheme="rk4", generic_rank=12, base_motion={},
      parameters=["link_wrench"])
def _compile_rollout(**given: Any) -> Any:
    return repr(hf.compile_rollout(**given))


# Sweeps.

PLAN = {"parameters": {"gain": 2.0, "object_mass": np.array([1.0, 2.0, 3.0]), "object_inertia": "scale", "object_wrench": np.ones(6)},
        "count": 3, "duration": 2e-3, "step": 1e-3, "outputs": ["object_pose"], "seed": 3, "chunk": 2, "workers": 1, "ahead": 2,
        "scheme": "rk4", "least_margin": -1.0, "stop_at_limits": False, "largest_drift": 1e-6}


def swept(state: Any, low: Any, high: Any, deviation: Any, turn: Any, parameters: Any, store: Any, **given: Any) -> Any:
    """Return the sweep of a plan in a folder."""
    if isinstance(parameters, dict):
        frames = np.array([grasp.frame.wxyz_xyz for grasp in rigid().chain.grasps.values()])
        parameters = {**parameters, "gravity": Uniform(low, high), "object_com": Normal(np.zeros(3), deviation),
                      "grasp_pose": NearPose(frames, turn, 1e-4)}
    return hf.sweep(rigid().chain, law(), state=state_of(state), parameters=parameters, store=store, **given)


@call("sweep", **PLAN, state=Later(lambda: still(rigid())), low=np.array([0.0, 0.0, -10.0]), high=np.array([0.0, 0.0, -9.0]),
      deviation=1e-3, turn=1e-4, name="store", title="object_pose z [m]", levels=[0.5], run=1)
def _sweep(name: Any, title: Any, levels: Any, run: Any, **given: Any) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / name if isinstance(name, str) and "\0" not in name else name
        try:
            made = swept(store=store, **given)
            list(made.batches([title]))
            return made.fates, made.quantiles(title, levels), made.run(run).q, repr(made)
        finally:
            left = [path for path in Path(folder).rglob("*") if path.suffix == ".part"]
            assert not left, left


# Identification.


@cache
def recording() -> dict[str, Any]:
    """Return a recording's arrays."""
    found = run()
    names = ("t", "q", "qd", "qdd", "tau", "object_pose", "object_twist", "object_acceleration")
    return {name: np.array(getattr(found, name)) for name in names} | {"wrist_wrench": np.array(found.wrist_wrench)}


@call("identify", recording=Later(recording), by="tau", sensor_bias=False, gravity=False, grasp_frames=False, noise=1e-3,
      largest_deviation=0.3)
def _identify(recording: Any, **given: Any) -> Any:
    recorded = Recording(**recording) if isinstance(recording, dict) and set(recording) <= set(globals()["recording"]()) and {
        "t", "q"} <= set(recording) else recording
    found = hf.identify(fixed().chain, recorded, **given)
    return found.values, str(found)


@call("identify by wrists", recording=Later(recording), by="wrist_wrench", sensor_bias=True)
def _identify_wrists(**given: Any) -> Any:
    return _identify(**given)


@call("base_parameters", matrix=np.vander(np.arange(1.0, 8.0), 3), names=["a", "b", "c"], tolerance=1e-9)
def _base_parameters(**given: Any) -> Any:
    return base_parameters(**given)


# Files.


def of_text(suffix: str, text: Any, read: Callable[[Any], Any]) -> Any:
    """Return what is read from a file of a text, or from what is no text."""
    if not isinstance(text, str | bytes):
        return read(text)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"file{suffix}"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read(path)


@call("load_urdf_trunk", text=HEAVY_BASE, tips=HANDS, base=None, floating=False, locked={"lift": 0.2}, lock_others=True)
def _urdf_trunk(text: Any, **given: Any) -> Any:
    return repr(of_text(".urdf", text, lambda path: load_urdf_trunk(path, **given)))


@call("load_urdf_trunk fingers", text=FREE_FINGERS, tips=["left_finger1_link", "left_finger2_link"], lock_others=True)
def _urdf_fingers(text: Any, **given: Any) -> Any:
    return repr(load_urdf_trunk(text, **given))


@cache
def mjcf() -> str:
    """Return a chain on a trunk as MJCF."""
    p = everything()
    chain = replace(p.chain, springs=[], grasps={}, arms={name: a for name, a in p.chain.arms.items() if a.joint_count},
                    mounts={name: m for name, m in p.chain.mounts.items() if name != "pin"})
    return to_mjcf(chain, p.state)


@call("load_mjcf_trunk", text=Later(mjcf), tips={"arm1": "arm1/tip", "arm2": "arm2/tip"}, base=None, floating=False, locked={},
      lock_others=True)
def _mjcf_trunk(text: Any, **given: Any) -> Any:
    return repr(load_mjcf_trunk(text, **given))


def csv() -> str:
    """Return a run as a table."""
    with tempfile.TemporaryDirectory() as folder:
        (path,) = hf.io.export_csv(run(), Path(folder) / "run.csv")
        return path.read_text()


@call("load_recording", text=Later(lambda: csv()))
def _load_recording(text: Any) -> Any:
    return of_text(".csv", text, lambda path: load_recording(path, fixed().chain))


@call("export_c", functions=["kinetic_energy"], name="chain", target="x86-64-v3", source=True, of=["qdd"], by=["q"], scheme="rk4",
      overwrite=False, place="code")
def _export(place: Any, **given: Any) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder) / place if isinstance(place, str) else place
        found = repr(hf.codegen.export_c(rigid().chain, where, **given))
        assert not [path for path in Path(folder).rglob("*.part")]
        return found


@call("run to files", name="run", rate=30.0)
def _files(name: Any, rate: Any) -> Any:
    found = run()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / name if isinstance(name, str) else name
        found.save(place)
        again = hf.load_result(place)
        hf.io.export_csv(again, Path(folder) / "t.csv")
        hf.plot.playback_of_run(found.require_setting().chain, found, rate=rate)
    return found.to_pandas().shape, found.to_xarray().sizes


# Environments.


@call("gym setting", duration=0.3, settle=0.1, step=0.002, steps_per_action=5, mass_spread=0.2, push=np.ones(6), commands="object",
      displacement=np.zeros(3), turn=np.zeros(3))
def _gym_setting(**given: Any) -> Any:
    return repr(type(hf.gym.CarryTask(**given)))


@cache
def environments() -> Any:
    """Return three environments."""
    return hf.gym.CarryVector(3, short_carry())


@call("gym vector", seed=3, options={"mass_factor": np.array([0.9, 1.0, 1.1]), "turn": np.zeros(3)}, actions=np.zeros((3, 7)))
def _gym_vector(seed: Any, options: Any, actions: Any) -> Any:
    envs = environments()
    return envs.reset(seed=seed, options=options)[0], envs.step(actions)[:4]
