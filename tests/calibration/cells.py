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
from holdfast.dynamics import tip_pose

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


def tips(arm: hf.Arm, q: Array) -> tuple[Array, Array, Array]:
    """Return attitudes (k, 3, 3), positions (k, 3) and Jacobians (k, 6, N) of an arm's tip in k postures."""
    R, p = np.tile(arm.base.R, (len(q), 1, 1)), np.tile(arm.base.p, (len(q), 1))
    axes, origins = [], []
    for k, joint in enumerate(arm.joints):
        p = p + R @ joint.placement.p
        turn = Rotation.from_rotvec(q[:, k, None] * joint.axis).as_matrix()
        R = R @ joint.placement.R @ turn
        axes.append(R @ joint.axis)
        origins.append(p)
    p, R = p + R @ arm.tip.p, R @ arm.tip.R
    a, o = np.stack(axes, 2), np.stack(origins, 2)
    return R, p, np.concatenate([a, np.cross(a, p[:, :, None] - o, axis=1)], axis=1)


def reached(arm: hf.Arm, start: Array, R: Array, p: Array) -> tuple[Array, Array]:
    """Return joint positions (k, N) with the tip at poses, by Newton's method, and which of them converged."""
    q, gap = np.array(start), np.full((len(start), 6), np.inf)
    for _ in range(15):
        at, here, J = tips(arm, q)
        turn = Rotation.from_matrix(R @ np.swapaxes(at, 1, 2)).as_rotvec()
        gap = np.concatenate([turn, p - here], axis=1)
        step = (np.linalg.pinv(J, rcond=1e-4) @ gap[:, :, None])[:, :, 0]
        q = q + step * np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
    return q, (np.abs(gap).max(axis=1) < 1e-10) & (np.abs(q - start).max(axis=1) < 3.0)


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
    n, tries = left.joint_count, 4 * count
    box = tip_pose(left, q[:n]) @ one.frame.inverse()
    draw = moves or (lambda g: np.r_[g.uniform(-0.6, 0.6, 3), g.uniform(-0.15, 0.15, 3)])
    at = [moved(box, draw(random)) for _ in range(tries)]
    start = q + random.normal(scale=0.3, size=(tries, len(q)))
    found, good = [], np.ones(tries, bool)
    for arm, grasp, part in ((left, one, slice(n)), (right, two, slice(n, None))):
        goals = [box @ grasp.frame for box in at]
        here, closed = reached(arm, start[:, part], np.array([g.R for g in goals]), np.array([g.p for g in goals]))
        found.append(here)
        good &= closed
    return np.hstack(found)[good][:count]


def noisy(random: np.random.Generator, chain: hf.ClosedChain, q: Array) -> Array:
    """Return joint readings of postures whose closures gape by their noise, which the joints' noise is added to."""
    read, start = np.array(q), 0
    for arm in chain.arms.values():
        part = slice(start, start + arm.joint_count)
        gape = np.hstack([TURN * random.normal(size=(len(q), 3)), SHIFT * random.normal(size=(len(q), 3))])
        J = tips(arm, read[:, part])[2]
        read[:, part] += (np.linalg.pinv(J, rcond=1e-9) @ gape[:, :, None])[:, :, 0]
        start = part.stop
    return read + JOINTS * random.normal(size=read.shape)


def with_truth(
    random: np.random.Generator, model: hf.ClosedChain, offsets: bool, size: float = 1.0
) -> tuple[hf.ClosedChain, dict[str, float]]:
    """Return a chain with another base and grasp on the right, and the corrections by name, offsets included."""
    x: dict[str, float] = {}
    axes = [f"{what} {axis}" for what in ("turn", "shift") for axis in "xyz"]
    base, grip = (size * random.normal(scale=np.repeat([0.02, 0.01], 3)) for _ in range(2))
    x |= {f"base right {name}": value for name, value in zip(axes, base.tolist(), strict=True)}
    x |= {f"grasp right {name}": value for name, value in zip(axes, grip.tolist(), strict=True)}
    right, held = model.arms["right"], model.grasps["right"]
    truth = replace(
        model,
        arms={**model.arms, "right": right.at(moved(right.base, base))},
        grasps={**model.grasps, "right": replace(held, frame=moved(held.frame, grip))},
    )
    names = model.joint_names()
    for k, name in enumerate(names):
        last = k + 1 == len(names) or names[k + 1].partition("/")[0] != name.partition("/")[0]
        if offsets and not last and not name.endswith("/joint1"):
            x[f"offset {name}"] = float(size * random.normal(scale=5e-3))
    return truth, x


def cell(seed: int, *, offsets: bool = True, count: int = 30, moves: Any = None, size: float = 1.0) -> Cell:
    """Return a random cell whose postures can be closed; `size` is that of the truth's corrections."""
    random = np.random.default_rng(seed)
    while True:
        model, q = two_arms(random)
        truth, x = with_truth(random, model, offsets, size)
        (left, right), (one, two) = truth.arms.values(), truth.grasps.values()
        n = left.joint_count
        goal = tip_pose(left, q[:n]) @ one.frame.inverse() @ two.frame
        closed, good = reached(right, q[None, n:], goal.R[None], goal.p[None])
        found = postures(random, truth, np.r_[q[:n], closed[0]], count, moves) if good[0] else []
        if len(found) == count:
            read = noisy(random, truth, np.array(found))
            read -= [x.get(f"offset {name}", 0.0) for name in model.joint_names()]
            return Cell(model, truth, read, x)


def sought(cell: Cell) -> list[str]:
    """Return what to seek in a cell: the base and grasp of the right arm, and the offsets that its truth has."""
    return ["bases", "grasps", *(name.replace("offset ", "offsets:") for name in cell.x if name.startswith("offset"))]


def distance(cell: Cell, found: hf.calibration.Calibration) -> tuple[float, int]:
    """Return the squared error of what was determined, in its covariance, and its number of dimensions."""
    error = found.values - [cell.x.get(name, 0.0) for name in found.names]
    size = np.sqrt(np.diag(found.covariance)).max()
    values, vectors = np.linalg.eigh(found.covariance / size**2)
    told = values > 1e-14
    along = vectors.T[told] @ error / size
    return float((along**2 / values[told]).sum()), int(told.sum())


# ---- directions that postures cannot determine, by geometry


def box_at(chain: hf.ClosedChain, q: Array) -> hf.Pose:
    """Return where the part is, from the left arm."""
    left = chain.arms["left"]
    return tip_pose(left, q[: left.joint_count]) @ chain.grasps["left"].frame.inverse()


def base_with_grasp(chain: hf.ClosedChain, q: Array, twist: Array) -> dict[str, float]:
    """Return a world twist [w; v of the origin] of the right base, and how its grasp makes it good, by name."""
    box, base = box_at(chain, q), chain.arms["right"].base
    w, v = np.split(np.asarray(twist, float), 2)
    tip = (box @ chain.grasps["right"].frame).p
    grip = np.r_[box.R.T @ w, box.R.T @ (v + np.cross(w, tip))]
    return named("base right", np.r_[w, v + np.cross(w, base.p)]) | named("grasp right", grip)


def named(of: str, x: Array) -> dict[str, float]:
    """Return six corrections by name."""
    return {
        f"{of} {what} {'xyz'[i]}": float(x[3 * k + i]) for k, what in enumerate(("turn", "shift")) for i in range(3)
    }


def screw_between(a: hf.Pose, b: hf.Pose) -> list[Array]:
    """Return the turn about and the shift along the axis of the motion from one pose to another, as world twists."""
    R = b.R @ a.R.T
    n = Rotation.from_matrix(R).as_rotvec()
    n /= np.linalg.norm(n)
    t = b.p - R @ a.p
    o = np.linalg.lstsq(np.eye(3) - R, t - (t @ n) * n, rcond=None)[0]
    return [np.r_[n, np.cross(o, n)], np.r_[np.zeros(3), n]]


def share_found(found: hf.calibration.Calibration, planted: list[dict[str, float]]) -> float:
    """Return the smallest cosine between planted directions and the space that was found undetermined."""
    null, sizes = found.fitted.null, found.problem.sizes
    worst = 1.0
    for direction in planted:
        u = np.array([direction.get(name, 0.0) for name in found.names]) / sizes
        worst = min(worst, float(np.linalg.norm(null.T @ u) / np.linalg.norm(u)))
    return worst
