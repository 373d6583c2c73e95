"""Random cells of two arms that hold one part: a model, a truth that differs from it, and noisy postures of the truth.

The truth is made by hand: bases and grasps by SciPy's rotations, offsets by other readings of the joints. Postures of
the truth are closed by Newton's method on the arms' tip poses, which the calibration does not use.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import holdfast as hf
from holdfast.dynamics import tip_jacobian, tip_pose

Array = Any
TURN, SHIFT, JOINTS = 1e-4, 5e-5, 1e-4  # standard deviations of the noise: 0.1 mrad, 0.05 mm, 0.1 mrad


@dataclass
class Cell:
    """A model, and postures of a truth whose corrections of the model are `x` by name."""

    model: hf.ClosedChain
    truth: hf.ClosedChain
    q: Array
    x: dict[str, float]


def random_arm(random: np.random.Generator, count: int, base: hf.Pose) -> hf.Arm:
    """Return an arm with `count` turning joints about random axes."""
    joints, links = [], []
    for k in range(count):
        axis = random.normal(size=3)
        p = random.normal(size=3)
        p *= (0.1 if k == 0 else random.uniform(0.15, 0.35)) / np.linalg.norm(p)
        R = Rotation.random(rng=random).as_matrix()
        joints.append(hf.Joint("revolute", axis / np.linalg.norm(axis), hf.Pose(R, p), f"joint{k + 1}"))
        links.append(hf.Link(1.0, np.zeros(3), 0.01 * np.eye(3)))
    tip = hf.Pose(Rotation.random(rng=random).as_matrix(), 0.1 * random.normal(size=3))
    return hf.Arm(joints, links, tip, base)


def moved(pose: hf.Pose, x: Array) -> hf.Pose:
    """Return a pose turned by x[:3] and shifted by x[3:], along the axes of what it stands on."""
    return hf.Pose(Rotation.from_rotvec(x[:3]).as_matrix() @ pose.R, pose.p + x[3:])


def reached(arm: hf.Arm, start: Array, target: hf.Pose) -> Array | None:
    """Return joint positions with the tip at a pose, by Newton's method; None if it does not converge."""
    q = np.array(start)
    for _ in range(25):
        tip = tip_pose(arm, q)
        gap = np.r_[Rotation.from_matrix(target.R @ tip.R.T).as_rotvec(), target.p - tip.p]
        if np.abs(gap).max() < 1e-13:
            return q
        J = tip_jacobian(arm, q)
        step = np.linalg.lstsq(J, gap, rcond=1e-6)[0]
        q = q + step * min(1.0, 0.5 / max(np.abs(step).max(), 1e-12))
        if np.abs(q - start).max() > 3.0:
            return None
    return q if np.abs(gap).max() < 1e-11 else None


def two_arms(random: np.random.Generator, counts: tuple[int, int] | None = None) -> tuple[hf.ClosedChain, Array]:
    """Return a chain of two random arms that hold a box, and joint positions that close it."""
    counts = counts or tuple(random.integers(6, 8, 2))  # type: ignore[assignment]
    assert counts is not None
    yaw = Rotation.from_euler("z", random.uniform(-np.pi, np.pi)).as_matrix()
    bases = hf.Pose.identity(), hf.Pose(yaw, random.uniform(-0.6, 0.6, 3))
    arms = [random_arm(random, int(n), base) for n, base in zip(counts, bases, strict=True)]
    q = [random.uniform(-1.5, 1.5, arm.joint_count) for arm in arms]
    grip = hf.Pose(Rotation.random(rng=random).as_matrix(), 0.1 * random.normal(size=3))
    box = tip_pose(arms[0], q[0]) @ grip.inverse()
    other = box.inverse() @ tip_pose(arms[1], q[1])
    grasps = {"left": hf.Grasp("rigid", grip), "right": hf.Grasp("rigid", other)}
    chain = hf.ClosedChain(dict(zip(grasps, arms, strict=True)), hf.HeldObject.box(1.0, 0.2, 0.2, 0.2), grasps)
    return chain, np.concatenate(q)


def postures(random: np.random.Generator, chain: hf.ClosedChain, q: Array, count: int, moves: Any = None) -> Array:
    """Return joint positions (count, n) in which the part was moved at random from where it is at q.

    Args:
        random: the random numbers.
        chain: a chain of two arms with rigid grasps.
        q: joint positions that close it.
        count: how many.
        moves: function of the random numbers that returns a move (6,) of the part in the world, [turn; shift].
    """
    (left, right), (one, two) = chain.arms.values(), chain.grasps.values()
    n = left.joint_count
    box = tip_pose(left, q[:n]) @ one.frame.inverse()
    found: list[Array] = []
    for _ in range(40 * count):
        x = moves(random) if moves else np.r_[random.uniform(-0.6, 0.6, 3), random.uniform(-0.15, 0.15, 3)]
        at = moved(box, x)
        start = q + random.normal(scale=0.3, size=len(q))
        a = reached(left, start[:n], at @ one.frame)
        b = None if a is None else reached(right, start[n:], at @ two.frame)
        if b is not None:
            found.append(np.r_[a, b])
        if len(found) == count:
            break
    return np.array(found)


def noisy(random: np.random.Generator, chain: hf.ClosedChain, q: Array) -> Array:
    """Return joint readings of postures whose closures gape by their noise, which the joints' noise is added to."""
    read, start = np.array(q), 0
    for arm in chain.arms.values():
        part = slice(start, start + arm.joint_count)
        for row in read:
            gape = np.r_[TURN * random.normal(size=3), SHIFT * random.normal(size=3)]
            row[part] += np.linalg.lstsq(tip_jacobian(arm, row[part]), gape, rcond=1e-9)[0]
        start = part.stop
    return read + JOINTS * random.normal(size=read.shape)


def with_truth(
    random: np.random.Generator, model: hf.ClosedChain, offsets: bool
) -> tuple[hf.ClosedChain, dict[str, float]]:
    """Return a chain with another base and grasp on the right, and the corrections by name, offsets included."""
    x: dict[str, float] = {}
    axes = [f"{what} {axis}" for what in ("turn", "shift") for axis in "xyz"]
    base, grip = (np.r_[random.normal(scale=0.02, size=3), random.normal(scale=0.01, size=3)] for _ in range(2))
    x |= {f"base right {name}": value for name, value in zip(axes, base.tolist(), strict=True)}
    x |= {f"grasp right {name}": value for name, value in zip(axes, grip.tolist(), strict=True)}
    right = model.arms["right"]
    truth = replace(
        model,
        arms={**model.arms, "right": right.at(moved(right.base, base))},
        grasps={**model.grasps, "right": hf.Grasp("rigid", moved(model.grasps["right"].frame, grip))},
    )
    names = model.joint_names()
    for k, name in enumerate(names):
        last = k + 1 == len(names) or names[k + 1].partition("/")[0] != name.partition("/")[0]
        if offsets and not last and not name.endswith("/joint1"):
            x[f"offset {name}"] = float(random.normal(scale=5e-3))
    return truth, x


def cell(seed: int, *, offsets: bool = True, count: int = 30, moves: Any = None) -> Cell | None:
    """Return a random cell; None if its postures cannot be closed."""
    random = np.random.default_rng(seed)
    model, q = two_arms(random)
    truth, x = with_truth(random, model, offsets)
    (left, _), (one, two) = truth.arms.values(), truth.grasps.values()
    n = left.joint_count
    box = tip_pose(left, q[:n]) @ one.frame.inverse()
    closed = reached(truth.arms["right"], q[n:], box @ two.frame)
    if closed is None:
        return None
    found = postures(random, truth, np.r_[q[:n], closed], count, moves)
    if len(found) < count:
        return None
    read = noisy(random, truth, found)
    read -= [x.get(f"offset {name}", 0.0) for name in model.joint_names()]
    return Cell(model, truth, read, x)
