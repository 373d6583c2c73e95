"""Real robots with all their joints free, fingers and mimic joints included: accelerations beside Pinocchio's.

    make robots
    python -m benchmarks.free_robots [results/robots]

Every URDF file that Pinocchio reads is one arm with branches in a random state. Without mimic joints the accelerations
are compared with those of `aba`, and with mimic joints with a dense system of Pinocchio's mass matrix and bias and a
row for each coupling. Then robots with two arms and free grippers hold a tray, and are compared with the dense
equations of this library.
"""

from __future__ import annotations

import argparse
import os
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import holdfast as hf
from holdfast.dynamics.tree.forest_rows import forest_rows
from holdfast.dynamics.tree.mechanism_terms import mechanism_arguments
from holdfast.robots.urdf import read_urdf

pinocchio: Any = import_module("pinocchio")
FOLDER = Path(os.environ.get("HOLDFAST_ROBOTS", "results/robots"))
BAR = 1e-10
NO_JOINT = "expected a joint that moves"
CARRIERS = {
    "tiago_dual": ("hand_left_grasping_frame", "hand_right_grasping_frame"),
    "tiago_pro": ("gripper_left_base_link", "gripper_right_base_link"),
    "pr2": ("l_gripper_palm_link", "r_gripper_palm_link"),
    "baxter": ("left_gripper_base_link", "right_gripper_base_link"),
    "talos_reduced": ("gripper_left_base_link", "gripper_right_base_link"),
    "talos_full_v2": ("gripper_left_base_link", "gripper_right_base_link"),
    "g1_29dof_with_hand_rev_1_0": ("left_hand_palm_link", "right_hand_palm_link"),
}


class Compared(NamedTuple):
    """A robot beside Pinocchio.

    Attributes:
        name: of the file.
        joints: how many there are.
        mimic: how many of them mimic others.
        gap: max|qdd - qdd'| / max(1, max|qdd'|); NaN if it was refused.
        own: the same between `aba` and a dense system of Pinocchio's; 0 with mimic joints.
        refusal: why; empty if it was not.
    """

    name: str
    joints: int = 0
    mimic: int = 0
    gap: float = float("nan")
    own: float = 0.0
    refusal: str = ""


def files(folder: Path) -> list[Path]:
    """Return the URDF files in a folder, one of each content."""
    found: dict[bytes, Path] = {}
    for path in sorted(folder.rglob("*.urdf")):
        found.setdefault(path.read_bytes(), path)
    return list(found.values())


def coupled(arm: hf.Arm, x: np.ndarray, *, offsets: bool) -> np.ndarray:
    """Return positions or rates whose mimic joints follow the others."""
    place, x = {joint.name: k for k, joint in enumerate(arm.joints)}, x.copy()
    for _ in arm.couplings:  # as deep as joints that mimic mimic joints
        for coupling in arm.couplings:
            (own, _), *others = coupling.terms.items()
            offset = coupling.offset if offsets and coupling.offset else 0.0
            x[place[own]] = offset - sum(c * x[place[name]] for name, c in others)
    return x


def by_pinocchio(model: Any, arm: hf.Arm, q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> list[np.ndarray]:
    """Return Pinocchio's accelerations in the order of the arm's joints: of dense equations, and first those of aba."""
    data, place = model.createData(), [model.joints[model.getJointId(joint.name)] for joint in arm.joints]
    model.armature, model.damping, at = np.zeros(model.nv), np.zeros(model.nv), np.array([one.idx_v for one in place])
    positions, rates, torques = pinocchio.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    for one, x in zip(place, q, strict=True):
        positions[one.idx_q : one.idx_q + one.nq] = [np.cos(x), np.sin(x)] if one.nq == 2 else x
    model.armature[at] = arm.armature
    rates[at], torques[at] = qd, tau - arm.damping * qd - arm.stiffness * (q - arm.rest)
    M = np.triu(pinocchio.crba(model, data, positions))
    own = {joint.name: k for joint, k in zip(arm.joints, at, strict=True)}
    G = np.zeros((len(arm.couplings), model.nv))
    for row, coupling in zip(G, arm.couplings, strict=True):
        row[[own[name] for name in coupling.terms]] = [*coupling.terms.values()]
    system = np.block([[M + np.triu(M, 1).T, G.T], [G, np.zeros((len(G), len(G)))]])
    bias = pinocchio.nonLinearEffects(model, data, positions, rates)
    right = np.concatenate([torques - bias, np.zeros(len(G))])
    found = np.linalg.solve(system, right)
    dense = (found + np.linalg.solve(system, right - system @ found))[at]
    return [dense] if len(G) else [pinocchio.aba(model, data, positions, rates, torques)[at], dense]


def gap(x: np.ndarray, e: np.ndarray) -> float:
    """Return max|x - e| / max(1, max|e|)."""
    return float(np.abs(x - e).max()) / max(1.0, float(np.abs(e).max()))


def compare(path: Path, seed: int = 0) -> Compared | None:
    """Return a robot beside Pinocchio; None if Pinocchio does not read it."""
    try:
        model = pinocchio.buildModelFromXML(path.read_text(encoding="utf-8"))
    except ValueError:
        return None
    try:
        arm = hf.load_urdf(path, branches=True, physical=False)
    except hf.HoldfastError as refusal:
        return Compared(path.stem, refusal=str(refusal).replace(f"{path.parent}/", ""))
    random, n = np.random.default_rng(seed), arm.joint_count
    q, qd = coupled(arm, random.uniform(-1.0, 1.0, n), offsets=True), coupled(arm, random.normal(size=n), offsets=False)
    tau, chain = random.normal(size=n), hf.ClosedChain({"robot": arm})
    if {joint.name for joint in arm.joints} != {*list(model.names)[1:]}:
        return Compared(path.stem, n, refusal="other joints than Pinocchio's")
    try:
        found = hf.forward_dynamics(chain, hf.State(q, qd), tau)
    except hf.HoldfastError as refusal:
        return Compared(path.stem, n, len(arm.couplings), refusal=str(refusal))
    expected = by_pinocchio(model, arm, q, qd, tau)
    between = gap(expected[0], expected[-1])
    return Compared(path.stem, n, len(arm.couplings), gap(found.qdd, expected[0]), between)


def at_rest(chain: hf.ClosedChain, q: np.ndarray) -> hf.State:
    """Return a state with all free bodies at the origin."""
    free = [hf.Pose.identity().wxyz_xyz] * len(chain.free_objects)
    return hf.State(q, np.zeros(chain.joint_count), free)


def carrying(path: Path, hands: tuple[str, str], seed: int = 0) -> tuple[hf.ClosedChain, hf.State]:
    """Return a robot whose two hands hold a tray rigidly, its grippers free, moving in a random way."""
    tips: dict[str, str] = dict(zip(("left", "right"), hands, strict=True))
    given: dict[str, Any] = {"branches": True, "lock_others": True, "physical": False}
    try:
        found = hf.load_urdf_trunk(path, tips, **given)
        parts: dict[str, Any] = {"arms": found.arms, "trunk": found.trunk, "mounts": found.mounts}
    except hf.errors.SceneError:  # no joint moves both arms
        root = read_urdf(path).root
        parts = {"arms": hf.load_urdf_arms(path, {name: (root, tip) for name, tip in tips.items()}, **given)}
    alone, random = hf.ClosedChain(**parts), np.random.default_rng(seed)
    q = random.uniform(-0.5, 0.5, alone.joint_count)
    for name, arm in alone.arms.items():
        q[alone.joints[name]] = coupled(arm, q[alone.joints[name]], offsets=True)
    frames, grasps = alone.as_forest.forest.poses(q), {}
    for name, arm in alone.arms.items():
        link, at = arm.frame(tips[name], "tray")
        grasps[name, tips[name]] = hf.Grasp("rigid", frames[alone.as_forest.arms[name][link]] @ at)
    chain = hf.ClosedChain(**parts, held_object=hf.HeldObject.box(2.0, 0.4, 0.3, 0.02), grasps=grasps)
    G = forest_rows(mechanism_arguments(chain, at_rest(chain, q)).motion({})).G
    free = random.normal(size=G.shape[1])
    rates = free - np.linalg.pinv(G, rcond=1e-9) @ (G @ free)
    return chain, hf.State(q, rates[:-6], hf.Pose.identity(), rates[-6:])


def tray_gap(path: Path, hands: tuple[str, str]) -> tuple[float, hf.ClosedChain, str]:
    """Return by how much the elimination and the dense equations differ with a tray, the chain, and the status."""
    chain, state = carrying(path, hands)
    tau = np.random.default_rng(1).normal(size=chain.joint_count)
    one, other = (hf.forward_dynamics(chain, state, tau, method=method) for method in ("tree", "kkt"))
    differs = [gap(getattr(one, x), getattr(other, x)) for x in ("qdd", "grasp_wrench", "object_acceleration")]
    return max(differs), chain, one.status.name


def main() -> None:
    """Print every robot, the reasons of refusals, and robots with trays."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=FOLDER)
    folder = parser.parse_args().folder
    warnings.simplefilter("ignore", hf.errors.ModelWarning)
    found = [one for path in files(folder) if (one := compare(path)) is not None]
    for one in found:
        facts = one.refusal or f"{one.joints} joints, {one.mimic} mimic, gap {one.gap:.1e}"
        apart = f" (aba and its dense equations: {one.own:.1e})" if one.own > BAR / 10 else ""
        print(f"{one.name:40s} {facts[:200]}{apart}")
    loaded, still = [one for one in found if not one.refusal], [one for one in found if NO_JOINT in one.refusal]
    within = sum(one.gap <= BAR for one in loaded)
    print(
        f"{len(found)} files that Pinocchio reads: {len(still)} without joints, {len(loaded)} loaded with all joints"
        f" free, {sum(one.mimic > 0 for one in loaded)} of them with mimic joints, {within} within {BAR:g};"
        f" {len(found) - len(loaded) - len(still)} refused"
    )
    for name, hands in CARRIERS.items():
        paths = [path for path in sorted(folder.rglob(f"{name}.urdf")) if "example-robot-data" in str(path)]
        for path in paths[:1]:
            differs, chain, status = tray_gap(path, hands)
            couplings = len(chain.all_couplings)
            print(f"{name:30s} with a tray: {chain.joint_count} joints, {couplings} mimic, {status}, gap {differs:.1e}")


if __name__ == "__main__":
    main()
