"""Everything public that takes a chain or an arm answers one with branches, or refuses it by name."""

from __future__ import annotations

import inspect
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import holdfast as hf
from tests.longer import mostly_slow
from tests.surface import PUBLIC
from tests.systems.branched import Branched, two_arms_with_grippers

ANSWERED = {
    "ClosedChain", "calibrate", "calibration.load_postures", "close", "codegen.export_c", "compile",
    "compile_rollout",
    "control.GravityCompensation",
    "control.ObjectTracking", "control.clipped", "diagnose", "dynamics.attach", "dynamics.centre_of_mass",
    "dynamics.closure", "dynamics.kinetic_energy", "dynamics.link_poses", "dynamics.momentum",
    "dynamics.momentum_rate", "dynamics.potential_energy", "dynamics.power", "dynamics.release",
    "forces.distribute", "forces.grasp_margins", "forces.joint_margins", "forces.least_peak",
    "forces.lift_margin", "forces.split", "forward_dynamics", "forward_dynamics_jacobian", "forward_dynamics_jvp",
    "forward_dynamics_vjp", "holding_torques", "inverse_dynamics", "linearise", "plot.playback_of_run",
    "plot.save_plots", "project", "simulate", "sweep",
}  # fmt: skip


def short_run() -> Any:
    """Return a run of one step."""
    p = two_arms_with_grippers()
    return hf.simulate(p.chain, p.state, lambda t, state, memory: (p.tau, memory), 1e-3, 1e-3)


def branched_recording() -> Any:
    """Return a recording of joints at rest."""
    p = two_arms_with_grippers()
    q = np.tile(p.state.q, (3, 1))
    return hf.identification.Recording(range(3), q, qd=0 * q, qdd=0 * q, tau=0 * q)


def table_of_postures() -> str:
    """Return the path of a table with one posture."""
    names = two_arms_with_grippers().chain.joint_names()
    path = Path(tempfile.mkdtemp()) / "postures.csv"
    path.write_text(f"{','.join(names)}\n{','.join('0' for _ in names)}\n")
    return str(path)


# results, which functions of this register make
RESULTS = {
    "calibration.Calibration",
    "compiled.CompiledChain", "compiled.CompiledMechanism", "control.TimedPath", "dynamics.ForwardResult",
    "dynamics.MechanismResult",
    "dynamics.MechanismAttachment", "dynamics.MechanismLinearisation", "dynamics.MechanismTorques",
       "identification.Identification",
    "planning.JointPath", "simulation.Rollout", "simulation.RolloutSystems",
}  # fmt: skip
# of arguments with defaults, those that only chains with branches need
BESIDE = {
    "calibration.load_postures": {"path": table_of_postures()},
    "calibrate": {
        "postures": np.tile(two_arms_with_grippers().state.q[:16], (3, 1)),
        "seek": ["bases:arm2"],
        "noise": hf.calibration.ClosureNoise(1e-3, 1e-3),
    },
    "identification.assess": {"recordings": branched_recording(), "by": "tau", "unknowns": ["friction"]},
    "codegen.export_c": {"folder": Path(tempfile.mkdtemp()) / "code"},
    "control.ObjectTracking": {"path": hf.control.RestToRest(hf.Pose.identity())},
    "dynamics.attach": {"name": ("arm2", "pad1"), "grasp": hf.Grasp("ball"), "here": True},
    "dynamics.momentum_rate": {"result": hf.forward_dynamics(*two_arms_with_grippers())},
    "dynamics.power": {"result": hf.forward_dynamics(*two_arms_with_grippers())},
    "dynamics.release": {"name": ("arm1", "pad1")},
    "forward_dynamics_jvp": {"along": {"tau": np.ones(16)}},
    "forward_dynamics_vjp": {"qdd": np.ones(16)},
    "forces.grasp_margins": {"grasp_wrench": np.zeros((3, 6))},
    "forces.split": {"grasp_wrench": np.zeros((3, 6))},
    "plot.playback_of_run": {"run": short_run()},
    "plot.save_plots": {"run": short_run(), "folder": tempfile.mkdtemp()},
    "simulate": {"duration": 2e-3, "step": 1e-3, "controller": lambda t, state, memory: (np.zeros(16), memory)},
    "sweep": {
        "parameters": {"tau": two_arms_with_grippers().tau},
        "count": 2,
        "duration": 2e-3,
        "step": 1e-3,
        "store": Path(tempfile.mkdtemp()) / "runs",
        "scheme": "midpoint",
    },
    "inverse_dynamics": {"qdd": np.zeros(16), "object_acceleration": np.zeros(6)},
}
EXPECTED = "expected (serial arms that hold one object|a serial arm), got"


def taken(of: Any, part: str) -> list[str]:
    """Return the parameters of a call that are of a type."""
    try:
        parameters = inspect.signature(of).parameters.values()
    except (TypeError, ValueError):
        return []
    return [one.name for one in parameters if part in str(one.annotation).replace("'", "").split(" | ")]


def calls() -> dict[str, dict[str, Any]]:
    """Return arguments of every public call that takes a chain or an arm, or a mapping of arms."""
    p = two_arms_with_grippers()
    arm, arms = p.chain.arms["arm1"], {**p.chain.arms}
    found = {}
    for path, of in PUBLIC.items():
        if not callable(of) or path in RESULTS:
            continue
        given = dict.fromkeys(taken(of, "ClosedChain"), p.chain) | dict.fromkeys(taken(of, "Arm"), arm)
        given |= dict.fromkeys(taken(of, "Mapping[str, Arm]"), arms)
        if given:
            found[path] = given | arguments(of, given, p) | BESIDE.get(path, {})
    return found


def arguments(of: Any, given: dict[str, Any], p: Branched) -> dict[str, Any]:
    """Return what else a call needs: sound where the chain decides its shape, else something that is never read."""
    q = p.state.q[:8] if "arm" in given else p.state.q
    known: dict[str, Any] = {"guess": p.state}
    known |= {"state": p.state, "tau": p.tau, "q": q, "held_object": p.chain.held_object, "gain": 1.0, "payload": True}
    known |= {
        "grasps": {("arm2", "link6"): hf.Grasp("rigid")},
        "sample_time": 1e-3,
        "controller": lambda t, state, memory: (p.tau, memory),
    }
    needed = [
        one
        for one in inspect.signature(of).parameters.values()
        if one.default is one.empty and one.kind not in (one.VAR_KEYWORD, one.VAR_POSITIONAL) and one.name not in given
    ]
    needed += [one for one in inspect.signature(of).parameters.values() if one.name == "payload"]
    return {one.name: known.get(one.name, np.ones(3)) for one in needed}


CALLS = calls()


@pytest.mark.parametrize("path", mostly_slow(CALLS, {*CALLS} - {"codegen.export_c", "sweep"}))
def test_answered_or_refused_by_name(path):
    """No traceback, and no number that belongs to another chain."""
    of, given = PUBLIC[path], CALLS[path]
    if path in ANSWERED:
        assert of(**given) is not None
        return
    with pytest.raises((hf.errors.MethodNotApplicable, hf.errors.ModelError), match=EXPECTED):
        of(**given)


def test_the_register_sees_what_takes_chains():
    """Most of what is public takes a chain."""
    assert {"compile", "simulate", "diagnose", "assemble", "close"} <= set(CALLS)
    assert len(CALLS) > 60
