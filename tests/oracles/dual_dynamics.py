"""The library's own functions on dual numbers: forward derivatives of every function, through the filter and all.

They agree with those of the dense equations for objects of usual mass; with light ones the filter's differences lose
digits that its results keep. Where a row sees a factor of the object's mobility at exactly zero, as rows along the
object's own axes do, the filter leaves the factor out, value and slope: contact frames must be turned out of that.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast import ClosedChain, HeldObject, Inputs, Link, Pose, State
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.chain_solution import chain_solution
from holdfast.dynamics.closed.sequential import sequential
from holdfast.model.trunk import TRUNK, Trunk
from tests.oracles.arithmetic import arithmetic
from tests.oracles.chain_derivatives import OUTPUTS, Along, Derivatives, Equations, Seeded, names_of, numbers_of
from tests.spatial.dual import tangents_of, values_of
from tests.systems.as_chain import Problem

OF_BODY = ("mass", "com", "inertia")


def dynamics_derivatives(p: Problem, by: Iterable[str] | None = None) -> Derivatives:
    """Return forward dynamics by `sequential` and its partial derivatives, as `chain_derivatives` does."""
    seeded = Seeded(numbers_of(p, arithmetic(None)), names_of(p.chain) if by is None else by)
    chain = _chain(p.chain, seeded.given)
    motion = chain_motion(chain, _state(p.state, seeded.given), seeded.given["tau"], _inputs(chain, seeded.given))
    whole = chain_solution(motion, sequential(motion), "recursive")
    found = {name: np.ravel(getattr(whole, name)) for name in OUTPUTS}
    if TRUNK in chain.joints:
        base = np.zeros(0) if whole.base_acceleration is None else whole.base_acceleration
        found |= {"floating_acceleration": base, "trunk_base_wrench": np.asarray(whole.trunk_base_wrench)}
    values = {name: values_of(x).astype(float) for name, x in found.items()}
    matrices = {name: tangents_of(x, seeded.count).astype(float) for name, x in found.items()}
    return Derivatives(values, matrices, seeded.at)


def _chain(chain: ClosedChain, given: Mapping[str, Any]) -> ClosedChain:
    """Return the chain with dual numbers in it."""
    first = chain.arm_joints[0].start
    arms = {}
    for i, (name, arm) in enumerate(chain.arms.items()):
        part = chain.joints[name]
        rows = slice(part.start - first, part.stop - first)
        links = _links(*(given[f"link_{what}"][rows] for what in OF_BODY))
        base = Pose.unchecked(given["base_R"][i], given["base_p"][i])
        arms[name] = replace(arm, joints=_joints(arm.joints, part, given), links=links, base=base, name="")
    grasps = {
        name: replace(grasp, frame=Pose.unchecked(given["grasp_R"][i], given["grasp_p"][i]))
        for i, (name, grasp) in enumerate(chain.grasps.items())
    }
    mass = given["object_mass"][()]
    body = HeldObject(mass, given["object_inertia"], given["object_com"], physical=False)
    trunk = chain.trunk
    if trunk is not None:
        trunk = object.__new__(Trunk)
        trunk.__dict__.update(vars(chain.trunk))
        trunk.__dict__["joints"] = _joints(chain.trunk.joints, chain.joints[TRUNK], given)
        trunk.__dict__.pop("serial", None)
        made = _links(*(given[f"trunk_link_{what}"] for what in OF_BODY))
        bodies = [replace(body, name=own.name) for body, own in zip(made, chain.trunk.bodies, strict=True)]
        first = len(bodies) - len(chain.trunk.links)
        trunk.__dict__.update(links=tuple(bodies[first:]), floating=bodies[0] if first else None)
    made = object.__new__(ClosedChain)
    own = {"arms": arms, "held_object": body, "grasps": grasps, "gravity": given["gravity"]}
    made.__dict__.update(own | {"mounts": chain.mounts, "trunk": trunk, "springs": chain.springs})
    return made


def _links(masses, coms, inertias) -> list[Link]:
    """Return links with inertias of dual numbers."""
    rows = zip(masses, coms, inertias, strict=True)
    return [replace(Link(0.0, com, inertia, physical=False), mass=mass) for mass, com, inertia in rows]


def _joints(joints, part: slice, given: Mapping[str, Any]) -> tuple:
    """Return joints with the drives' numbers."""
    drives = zip(given["armature"][part], given["damping"][part], strict=True)
    return tuple(
        replace(joint, armature=armature, damping=damping)
        for joint, (armature, damping) in zip(joints, drives, strict=True)
    )


def _state(state: State, given: Mapping[str, Any]) -> State:
    """Return the state; its frames are those given."""
    base = (state.base_pose, given.get("floating_twist"))
    made = State(given["q"], given["qd"], state.object_pose, given["object_twist"], *base)
    vars(made)["object_frame"] = Pose.unchecked(given["object_R"], given["object_p"])
    if state.base_pose is not None:
        vars(made)["base_frame"] = Pose.unchecked(given["floating_R"], given["floating_p"])
    return made


def _inputs(chain: ClosedChain, given: Mapping[str, Any]) -> Inputs:
    """Return what acts on the chain."""
    of_trunk = {}
    if chain.trunk is not None:
        of_trunk["trunk_link_wrenches"] = given["trunk_link_wrench"]
        if not chain.floats:
            of_trunk["trunk_base_twist"] = given["trunk_base_twist"]
            of_trunk["trunk_base_acceleration"] = given["trunk_base_acceleration"]
    bases = given["base_twist"], given["base_acceleration"]
    return Inputs(given["object_wrench"], given["link_wrench"], *bases, **of_trunk)


STATE = ("q", "object_pose", "qd", "object_twist")
CUTOFF = 1e-10  # singular values below this share of the largest count as 0


def minimum_norm_derivatives(p: Problem, tangent: np.ndarray) -> Derivatives:
    """Return forward dynamics with the least sum of |m/L|^2 + |f|^2, and its derivatives along motions.

    Args:
        p: the problem; L is the contact points' rms distance from their centroid.
        tangent: (2n + 12, m) columns (dq, turn, shift, dqd, d omega, dv) that keep positions and rates closed.

    Returns:
        Its matrices are along the tangent, all of them one block by the name of "tangent".
    """
    equations = Equations(p, arithmetic(None), STATE)
    at, K = equations.at, equations.K
    others = np.setdiff1d(np.arange(at.size), np.arange(at.f.start, at.f.stop))
    B, w = K[others, at.f], metric(p)
    basis = null_space(B / np.sqrt(w)) / np.sqrt(w)[:, None]  # N^T W N = 1

    def least(f: np.ndarray) -> np.ndarray:
        return f - basis @ (basis.T @ (w * f.T).T)

    z = np.linalg.lstsq(K, equations.rhs, rcond=CUTOFF)[0]
    z[at.f] = least(z[at.f])
    mu = np.zeros(at.size)
    mu[others] = np.linalg.lstsq(B.T, w * z[at.f], rcond=CUTOFF)[0]
    of_z, none = equations.along(z), np.zeros(at.size)
    turned = (equations.along(mu).slopes - equations.along(none).slopes)[at.f] @ tangent
    dz = np.linalg.lstsq(K, -of_z.slopes @ tangent, rcond=CUTOFF)[0]
    dz[at.f] = least(dz[at.f]) + basis @ (basis.T @ turned)
    along = Along(of_z.slopes @ tangent, of_z.of_bases @ tangent, of_z.bases)
    equations.seeded.at.clear()
    equations.seeded.at["tangent"] = slice(0, tangent.shape[1])
    return equations.named(z, dz, along)


def metric(p: Problem) -> np.ndarray:
    """Return W, (6 g,): 1/L^2 of moments, 1 of forces."""
    points = np.array([p.state.object_frame.R @ grasp.frame.p for grasp in p.chain.grasps.values()])
    length = np.sqrt(((points - points.mean(0)) ** 2).sum(1).mean())
    return np.tile(np.repeat([length**-2.0, 1.0], 3), len(points))


def null_space(B: np.ndarray) -> np.ndarray:
    """Return orthonormal columns that a matrix takes to zero."""
    _, values, rows = np.linalg.svd(B)
    return rows[(values > CUTOFF * values[0]).sum() :].T
