"""Sound calls of sweeps, identification, files and environments."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import load_urdf_trunk
from holdfast.identification import Recording, assess, base_parameters, load_recording
from holdfast.interop import load_mjcf_trunk, to_mjcf
from holdfast.sweeps import NearPose, Normal, Uniform
from tests.fuzz.calls import Later, call, everything, fixed, rigid, state_of
from tests.fuzz.run_calls import law, run, still
from tests.gym.problems import short_carry
from tests.robots.test_urdf_trunk import FREE_FINGERS, HANDS, HEAVY_BASE

# Sweeps.

PLAN = {
    "parameters": {
        "gain": 2.0,
        "object_mass": np.array([1.0, 2.0, 3.0]),
        "object_inertia": "scale",
        "object_wrench": np.ones(6),
    },
    "count": 3,
    "duration": 2e-3,
    "step": 1e-3,
    "outputs": ["object_pose"],
    "seed": 3,
    "chunk": 2,
    "ahead": 2,
    "scheme": "rk4",
    "least_margin": -1.0,
    "stop_at_limits": False,
    "largest_drift": 1e-6,
}


def swept(state: Any, low: Any, high: Any, deviation: Any, turn: Any, parameters: Any, store: Any, **given: Any) -> Any:
    """Return the sweep of a plan in a folder."""
    if isinstance(parameters, dict):
        frames = np.array([grasp.frame.wxyz_xyz for grasp in rigid().chain.grasps.values()])
        parameters = {
            **parameters,
            "gravity": Uniform(low, high),
            "object_com": Normal(np.zeros(3), deviation),
            "grasp_pose": NearPose(frames, turn, 1e-4),
        }
    return hf.sweep(rigid().chain, law(), state=state_of(state), parameters=parameters, store=store, **given)


@call(
    "sweep",
    **PLAN,
    state=Later(lambda: still(rigid())),
    low=np.array([0.0, 0.0, -10.0]),
    high=np.array([0.0, 0.0, -9.0]),
    deviation=1e-3,
    turn=1e-4,
    name="store",
    title="object_pose z [m]",
    levels=[0.5],
    run=1,
)
def _sweep(
    state: Any,
    low: Any,
    high: Any,
    deviation: Any,
    turn: Any,
    name: Any,
    title: Any,
    levels: Any,
    run: Any,
    parameters: Any,
    **given: Any,
) -> Any:
    made = swept(state, low, high, deviation, turn, parameters, name, **given)
    list(made.batches([title]))
    return made.status_counts, made.quantiles(title, levels), made.run(run).q, repr(made)


# Identification.


@cache
def recording() -> dict[str, Any]:
    """Return a recording's arrays."""
    found = run()
    names = ("t", "q", "qd", "qdd", "tau", "object_pose", "object_twist", "object_acceleration")
    return {name: np.array(getattr(found, name)) for name in names} | {"wrist_wrench": np.array(found.wrist_wrench)}


@call(
    "identify",
    recording=Later(recording),
    by="tau",
    sensor_bias=False,
    gravity=False,
    grasp_frames=False,
    noise=1e-3,
    largest_deviation=0.3,
)
def _identify(recording: Any, **given: Any) -> Any:
    recorded = (
        Recording(**recording)
        if isinstance(recording, dict)
        and set(recording) <= set(globals()["recording"]())
        and {"t", "q"} <= set(recording)
        else recording
    )
    found = hf.identify(fixed().chain, recorded, **given)
    return found.values, str(found)


@call("identify by wrists", recording=Later(recording), by="wrist_wrench", sensor_bias=True)
def _identify_wrists(recording: Any, **given: Any) -> Any:
    return _identify(recording, **given)


@call("identify a machine", recording=Later(recording), by="tau", unknowns=["payload", "friction"], loss="huber")
def _identify_machine(recording: Any, **given: Any) -> Any:
    return _identify(recording, **given)


call("base_parameters", matrix=np.vander(np.arange(1.0, 8.0), 3), names=["a", "b", "c"], tolerance=1e-9)(
    base_parameters
)


# Files.


def of_text(suffix: str, text: Any, read: Callable[[Any], Any]) -> Any:
    """Return what is read from a file of a text, or from what is no text."""
    if not isinstance(text, str | bytes):
        return read(text)
    path = Path(f"file{suffix}")
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
    chain = replace(
        p.chain,
        springs=[],
        grasps={},
        arms={name: a for name, a in p.chain.arms.items() if a.joint_count},
        mounts={name: m for name, m in p.chain.mounts.items() if name != "pin"},
    )
    return to_mjcf(chain, p.state)


@call(
    "load_mjcf_trunk",
    text=Later(mjcf),
    tips={"arm1": "arm1/tip", "arm2": "arm2/tip"},
    base=None,
    floating=False,
    locked={},
    lock_others=True,
)
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


MAPPED = {
    "time": "t",
    "time_unit": "s",
    "bad_rows": "drop",
    "begin": 0.0,
    "arms": {
        "arm1": {"position": {"columns": "a{1}", "sign": -1, "offset": 1.0, "scale": 2.0}},
        "arm2": {"position": {"columns": ["b1", "b2", "b3", "b4", "b5", "b6"]}},
    },
}


def mapped_csv() -> str:
    """Return a table with columns of its own."""
    names = [*(f"a{k}" for k in range(1, 5)), *(f"b{k}" for k in range(1, 7))]
    lines = [f"{0.1 * k},{','.join(str(0.1 * k * j) for j in range(10))}" for k in range(12)]
    return "\n".join([",".join(["t", *names]), *lines])


@call("load_recording by a map", text=Later(mapped_csv), columns=MAPPED)
def _load_mapped(text: Any, columns: Any) -> Any:
    return of_text(".csv", text, lambda path: load_recording(path, fixed().chain, columns=columns))


@call("assess", recording=Later(recording), by="tau", unknowns=["payload", "friction"], loss="huber", noise=1e-3)
def _assess(recording: Any, **given: Any) -> Any:
    sound = isinstance(recording, dict) and {"t", "q"} <= set(recording) <= set(globals()["recording"]())
    given["recordings"] = Recording(**recording) if sound else recording
    return str(assess(fixed().chain, **given))


@cache
def postures() -> np.ndarray:
    """Return joint positions of closed postures."""
    return np.array(run().q[::4])


@call(
    "calibrate",
    postures=Later(postures),
    seek=["bases", "offsets:arm1"],
    prior={"offsets": (0.01, 0.001)},
    held_out=Later(postures),
    robust=True,
    largest_deviation=0.01,
)
def _calibrate(postures: Any, **given: Any) -> Any:
    noise = hf.calibration.ClosureNoise(1e-3, 1e-3, 1e-3)
    return str(hf.calibrate(fixed().chain, postures, noise=noise, **given))


@call(
    "export_c",
    functions=["kinetic_energy"],
    name="chain",
    target="x86-64-v3",
    source=True,
    of=["qdd"],
    by=["q"],
    scheme="rk4",
    overwrite=False,
    place="code",
)
def _export(place: Any, **given: Any) -> Any:
    return repr(hf.codegen.export_c(rigid().chain, place, **given))


@call("run to files", name="run", rate=30.0)
def _files(name: Any, rate: Any) -> Any:
    found = run()
    found.save(name)
    hf.io.export_csv(hf.load_result(name), "t.csv")
    hf.plot.playback_of_run(found.require_setting().chain, found, rate=rate)
    return found.to_pandas().shape, found.to_xarray().sizes


# Environments.


@call(
    "gym setting",
    duration=0.3,
    settle=0.1,
    step=0.002,
    steps_per_action=5,
    mass_spread=0.2,
    push=np.ones(6),
    commands="object",
    displacement=np.zeros(3),
    turn=np.zeros(3),
)
def _gym_setting(**given: Any) -> Any:
    return repr(type(hf.gym.CarryTask(**given)))


@cache
def environments() -> Any:
    """Return three environments."""
    return hf.gym.CarryVector(3, short_carry())


@call(
    "gym vector",
    seed=3,
    options={"mass_factor": np.array([0.9, 1.0, 1.1]), "turn": np.zeros(3)},
    actions=np.zeros((3, 7)),
)
def _gym_vector(seed: Any, options: Any, actions: Any) -> Any:
    envs = environments()
    return envs.reset(seed=seed, options=options)[0], envs.step(actions)[:4]
