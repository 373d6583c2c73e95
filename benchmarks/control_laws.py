"""What the laws of the kit cost, and how they carry a part whose grasps are not where the controller believes.

Run it with HOLDFAST_COMPILE unset, on a quiet machine: `python benchmarks/control_laws.py`. The second part takes a
minute: two Pandas move a box of 3 kg by friction along a line of 0.3 m in 2 s, with a push of 20 N for 50 ms; the
controller assumes grasps that are off by up to 3 cm along the faces, in each of 100 draws. `--carry` prints this alone.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import holdfast as hf
from benchmarks.bench.systems import facing_pandas
from holdfast.control import (
    HybridForce,
    InternalForce,
    InternalImpedance,
    LoadShare,
    ObjectImpedance,
    PostureControl,
    RampedForces,
    RestToRest,
    admittance_law,
    compile_law,
    cooperative_law,
    observed,
    sampled,
)
from holdfast.forces import ForceLimits
from holdfast.spatial.scalar import Array

ROUNDS, CALLS, MANY = 15, 2000, 4096
SQUEEZE, T, STEPS, DRAWS, FARTHEST = 60.0, 1e-3, 2000, 100, 0.03
SPRING, DAMPER = np.repeat([60.0, 1200.0], 3), np.repeat([12.0, 240.0], 3)


def spent(call: Callable[[], Any], calls: int) -> float:
    """Return the processor time of a call [us]."""
    begin = time.process_time()
    for _ in range(calls):
        call()
    return (time.process_time() - begin) / calls * 1e6


def costs() -> None:
    """Print the time of each law, bound and in a batch, in units of bound forward dynamics beside it."""
    chain, state = facing_pandas()
    path = RestToRest(state.object_frame, displacement=[0, 0, 0.2], duration=1.5)
    motion, push = ObjectImpedance(path, SPRING, DAMPER), InternalForce(20.0)
    tracking = hf.control.ObjectTracking(chain, path, 20.0)
    chosen = ObjectImpedance(path, SPRING, DAMPER, np.repeat([0.1, 5.0], 3))
    w, f = {"external_wrench": np.zeros(6)}, {"measured_wrenches": np.zeros((2, 6))}
    laws = {
        "ObjectTracking": (tracking, {}),
        "ObjectImpedance": (cooperative_law(chain, motion, push), {}),
        "ObjectImpedance, chosen inertia": (cooperative_law(chain, chosen, push), w),
        "PostureControl": (cooperative_law(chain, motion, push, PostureControl(state.q, 5.0, clearance=0.1)), {}),
        "LoadShare": (cooperative_law(chain, motion, LoadShare({"left": 0.7, "right": 0.3}, 20.0)), {}),
        "LoadShare by reserve": (cooperative_law(chain, motion, LoadShare(force=20.0)), {}),
        "RampedForces": (cooperative_law(chain, motion, RampedForces(push, LoadShare({"left": 1.0}))), {}),
        "InternalImpedance": (cooperative_law(chain, motion, InternalImpedance(500.0, 20.0, push)), {}),
        "HybridForce": (cooperative_law(chain, motion, HybridForce(100.0, T, push, limit=30.0)), f),
        "within limits": (cooperative_law(chain, motion, push, limits=ForceLimits(0.8)), {}),
        "within limits, sampled": (cooperative_law(chain, motion, push, limits=ForceLimits(0.8, sample_time=T)), {}),
        "admittance_law": (
            admittance_law(
                chain,
                path,
                stiffness=400.0,
                damping=100.0,
                inertia=5.0,
                internal_damping=1000.0,
                contact_stiffness=1e5,
                sample_time=T,
            ),
            f,
        ),
        "observed": (observed(tracking, chain, gain=50.0, sample_time=T), {}),
        "observed, wrist sensors": (observed(tracking, chain, gain=50.0, sample_time=T, measured=True), f),
    }
    forward = hf.compile(chain).bind(q=np.array(state.q), object_pose=np.array(state.object_pose))
    q = np.repeat(np.array(state.q)[None], MANY, axis=0)
    rest = state.qd, state.object_pose, state.object_twist
    print(f"{'law':34} {'bound us':>9} {'F':>6} {'batch us':>9} {'F':>6}")
    for name, (law, given) in laws.items():
        fast = compile_law(law, chain)
        bound = fast.bind(q=state.q, object_pose=state.object_pose, **given)
        rows = []
        for _ in range(ROUNDS):
            one, F = spent(bound, CALLS), spent(forward, CALLS)
            many = spent(lambda fast=fast, given=given: fast.torques(0.3, q, *rest, threads=1, **given), 1) / MANY
            rows.append((one, one / F, many, many / F))
        one, of_F, many, of_many = (statistics.median(column) for column in zip(*rows, strict=True))
        print(f"{name:34} {one:9.2f} {of_F:6.2f} {many:9.3f} {of_many:6.2f}")


def carried() -> None:
    """Print the internal force's error and the least margin of all draws, for a constant and for a measured force."""
    rubber = hf.Friction(mu=0.8, torsion_radius=0.02)
    chain, state = facing_pandas("softfinger", rubber, armature=0.3)
    path = RestToRest(state.object_frame, displacement=[0.0, 0.18, 0.24], duration=STEPS * T)
    plants, starts = drawn(chain, state)
    poses = np.array([[grasp.frame.wxyz_xyz for grasp in plant.grasps.values()] for plant in plants])
    for name, forces in (
        ("InternalForce", InternalForce(SQUEEZE)),
        ("HybridForce", HybridForce(100.0, T, InternalForce(SQUEEZE))),
    ):
        law = cooperative_law(chain, ObjectImpedance(path, SPRING, DAMPER), forces)
        rollout = hf.compile_rollout(chain, sampled(law, chain, sample_time=T))
        measured = np.array([first(plant, start) for plant, start in zip(plants, starts, strict=True)])
        fields = [np.array([getattr(x, field) for x in starts]) for field in ("q", "qd", "object_pose", "object_twist")]
        given = {"measured_wrenches": measured} if law.parameters else {}
        systems = rollout.start(*fields, grasp_pose=poses, object_wrench=np.zeros(6), **given)
        errors, margins = [], []
        for k in range(STEPS):
            push = np.r_[0.0, 0.0, 0.0, 12.0, 16.0, 0.0] * (1000 <= k < 1050)
            given: dict[str, Any] = {"object_wrench": push}
            given |= {"measured_wrenches": measured} if law.parameters else {}
            record = rollout.run(systems, T, T, record=["grasp_wrench", "margin"], least_margin=0.0, **given)
            systems, measured = record.systems, record["grasp_wrench"][-1]
            margins.append(record["margin"][-1].min())
            if k % 20 == 19:
                errors.append([off(*one) for one in zip(plants, systems.object_pose, measured, strict=True)])
        errors = np.array(errors)
        stopped = sum(status.name not in ("RUNNING", "UNRESOLVED") for status in systems.status)
        print(
            f"{name:14} internal force off by at most {errors[10:].max():.3f} N after 0.2 s (median of the draws"
            f" {np.median(errors[10:].max(axis=0)):.3f} N), least margin {min(margins):.2f} N, {stopped} slipped;"
            f" error at the end {np.linalg.norm(systems.object_pose[:, 4:] - path.at(9.0).pose.p, axis=1).max():.4f} m"
        )


def drawn(chain: hf.ClosedChain, state: hf.State) -> tuple[list[hf.ClosedChain], list[hf.State]]:
    """Return the true chains, whose contacts lie elsewhere on the faces, and their closed states."""
    random, chains, states = np.random.default_rng(0), [], []
    for _ in range(DRAWS):
        grasps = {}
        for name, grasp in chain.grasps.items():
            angle, radius = random.uniform(0.0, 2 * np.pi), FARTHEST * np.sqrt(random.uniform())
            shift = [0.0, radius * np.cos(angle), radius * np.sin(angle)]
            grasps[name] = replace(grasp, frame=hf.Pose.translation(*shift) @ grasp.frame)
        chains.append(replace(chain, grasps=grasps))
        states.append(hf.close(chains[-1], state, hold_object=True))
    return chains, states


def first(plant: hf.ClosedChain, start: hf.State) -> Array:
    """Return the wrenches before the first sample, when the box is held."""
    tau = hf.holding_torques(plant, start, None, SQUEEZE)
    return hf.forward_dynamics(plant, start, tau).grasp_wrench


def off(plant: hf.ClosedChain, object_pose: Array, f: Array) -> float:
    """Return by how much the push of the hands against each other differs from the command [N]."""
    R = hf.Pose.from_wxyz_xyz(object_pose).R
    left, right = (f[i, 3:] @ (R @ grasp.frame.R[:, 2]) for i, grasp in enumerate(plant.grasps.values()))
    return abs(float(0.5 * (left + right) - SQUEEZE))


if __name__ == "__main__":
    if "--carry" not in sys.argv:
        costs()
    carried()
