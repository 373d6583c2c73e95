"""A humanoid of 29 joints, feet on the ground and a box in its hands: machine code beside two Pandas and Pinocchio.

    python -m benchmarks.humanoid [--rounds 30]

It prints operations (also of further legs and arms), the time to compile, the ratio of a bound call to that of two
Pandas with a box and to Pinocchio's `constraintDynamics`, and how far the accelerations of both differ. Ratios are
medians of alternating rounds on one thread.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from tests.oracles.pinocchio_model import inertia, pin, se3
from tests.systems.humanoid import humanoid
from tests.systems.random_forests import ForestProblem

import holdfast as hf
from benchmarks.operation_counts import two_pandas
from holdfast.compiled.forest import CompiledForest
from holdfast.spatial import rotation

CALLS = 300


class PinocchioForest:
    """A forest of revolute joints, free bodies and rigid closures as a Pinocchio model, in its fastest settings."""

    def __init__(self, p: ForestProblem) -> None:
        model, forest, ids, trees = pin.Model(), p.forest, dict[int, int](), list[int]()
        for k, body in enumerate(forest.bodies):
            trees.append(k if body.parent is None else trees[body.parent])
        for k in sorted(range(len(trees)), key=lambda k: trees[k]):  # it needs one tree after the other
            body = forest.bodies[k]
            parent = 0 if body.parent is None else ids[body.parent]
            free = body.joint.of_kind.floats
            kind = pin.JointModelFreeFlyer() if free else pin.JointModelRevoluteUnaligned(np.array(body.joint.axis))
            ids[k] = model.addJoint(parent, kind, se3(body.joint.placement), str(k))
            model.appendBodyToJoint(ids[k], inertia(body.link), pin.SE3.Identity())
        model.armature = self.in_its_order(model, ids, [body.joint.armature for body in forest.bodies])
        welds = pin.StdVec_RigidConstraintModel()
        for c in forest.closures:
            ends = (ids[c.b], se3(c.grasp.frame), 0 if c.a is None else ids[c.a], se3(c.tip))
            welds.append(pin.RigidConstraintModel(pin.ContactType.CONTACT_6D, model, *ends, pin.LOCAL))
        self.p, self.model, self.ids, self.welds, self.data = p, model, ids, welds, model.createData()
        self.weld_data = pin.StdVec_RigidConstraintData()
        for weld in welds:
            self.weld_data.append(weld.createData())
        pin.initConstraintDynamics(model, self.data, welds, self.weld_data)
        self.q, self.v, self.tau = self.inputs()

    @staticmethod
    def in_its_order(model: Any, ids: dict[int, int], numbers: list[float]) -> np.ndarray:
        """Return one number per body in the order of Pinocchio's velocities."""
        found = np.zeros(model.nv)
        for body, x in enumerate(numbers):
            k = ids[body]
            found[model.joints[k].idx_v : model.joints[k].idx_v + model.joints[k].nv] = x
        return found

    def inputs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return its q, v and tau; those of free bodies are [linear; angular] in their own axes."""
        p, q, v, tau = self.p, np.zeros(self.model.nq), np.zeros(self.model.nv), np.zeros(self.model.nv)
        for k, (at, of) in enumerate(zip(p.forest.positions, p.forest.velocities, strict=True)):
            joint = self.model.joints[self.ids[k]]
            into = slice(joint.idx_v, joint.idx_v + joint.nv)
            if joint.nv == 1:
                q[joint.idx_q], v[into], tau[into] = p.q[at][0], p.qd[of], p.tau[of]
                continue
            (w, x, y, z), origin = p.q[at][:4], p.q[at][4:]
            R = rotation.from_quaternion(p.q[at][:4])
            q[joint.idx_q : joint.idx_q + 7] = [*origin, x, y, z, w]
            v[into], tau[into] = (np.concatenate([R.T @ part[3:], R.T @ part[:3]]) for part in (p.qd[of], p.tau[of]))
        return q, v, tau

    def __call__(self) -> Any:
        """Return its accelerations."""
        given = self.model, self.data, self.q, self.v, self.tau, self.welds, self.weld_data
        return pin.constraintDynamics(*given)

    def qdd(self) -> np.ndarray:
        """Return the accelerations in our order and coordinates."""
        a, found = np.array(self()), []
        for k, at in enumerate(self.p.forest.positions):
            joint = self.model.joints[self.ids[k]]
            own, rates = a[joint.idx_v : joint.idx_v + joint.nv], self.v[joint.idx_v : joint.idx_v + joint.nv]
            if joint.nv == 6:
                R, linear = rotation.from_quaternion(self.p.q[at][:4]), own[:3] + np.cross(rates[3:], rates[:3])
                own = np.concatenate([R @ own[3:], R @ linear])
            found.append(own)
        return np.concatenate(found)


def time_of(call: Callable[[], Any]) -> float:
    """Return the time of a call [s]."""
    start = time.perf_counter()
    for _ in range(CALLS):
        call()
    return (time.perf_counter() - start) / CALLS


def main() -> None:
    """Print what the module says."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rounds", type=int, default=30)
    rounds = parser.parse_args().rounds
    p = humanoid()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["HOLDFAST_CACHE"] = folder
        start = time.perf_counter()
        compiled = hf.compile(p.forest)
        print(f"operations: {compiled.operation_count:,} (bar 27,000)")
        print(f"time to compile: {time.perf_counter() - start:.1f} s (bar 3)")
        pair = two_pandas()
        both = hf.compile(pair)
        print(f"two Pandas and a box: {both.operation_count:,} operations")
        bound, of_pair = compiled.bind(q=p.q.copy(), qd=p.qd.copy(), tau=p.tau.copy()), both.bind()
        of_pair.arrays["q"][...] = np.linspace(0.1, 0.9, 14)
        peer = PinocchioForest(p)
        found = compiled.forward_dynamics(p.q, p.qd, p.tau)
        gap = np.abs(peer.qdd() - found.qdd).max() / np.abs(found.qdd).max()
        times = np.array([[time_of(call) for call in (bound.run, of_pair.run, peer)] for _ in range(rounds)])
    ours, theirs = np.median(times[:, 0] / times[:, 1]), np.median(times[:, 2] / times[:, 0])
    print(f"bound call beside that of two Pandas: {ours:.2f} times the time (bar 4.5)")
    print(
        f"Pinocchio {pin.__version__}, constraintDynamics: {theirs:.1f} times the time (bar 6), differing by {gap:.1e}"
    )
    for what in ("legs", "arms"):
        counts = [
            CompiledForest(humanoid(**{"legs": 2, "arms": 2, what: n}).forest).function.schedule().operation_count
            for n in (2, 3, 4, 5)
        ]
        print(f"{what} 2 to 5: {', '.join(f'{n:,}' for n in counts)}; increments {np.diff(counts).tolist()}")


if __name__ == "__main__":
    main()
