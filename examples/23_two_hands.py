"""Two hands of three fingers hold a ball at six points: which forces are unique, and what each finger presses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.patches import Circle

import holdfast as hf
from holdfast.view.figure_style import DPI, STYLE, arm_style

OUT = Path(__file__).parent / "out"
RADIUS, BALL = 0.12, hf.HeldObject(2.0, 2 / 5 * 2.0 * 0.12**2 * np.eye(3))  # m
PALM, ROOT, BONE = 0.20, 0.05, 0.08  # palm from the ball's middle, root from the palm's middle, a finger's links [m]
CASES, SQUEEZE = {"points": "ball", "soft fingertips": "softfinger", "left brakes closed": "ball"}, 20.0  # N
BESIDE = np.radians(60)  # of the contacts from the line between the palms, seen from the ball's middle
BASES = {"left": [1, 0, 0, 0, -0.75, 0, 0], "right": [0, 0, 0, 1, 0.75, 0, 0]}
INWARD = {"left": np.array([1.0, 0, 0]), "right": np.array([-1.0, 0, 0])}  # of the palms


def finger_angles() -> tuple[float, float]:
    """Return how far a finger's two links turn outward, so that its tip touches the ball."""
    out, ahead = RADIUS * np.sin(BESIDE) - ROOT, PALM - RADIUS * np.cos(BESIDE)
    bend = np.arccos(np.hypot(out, ahead) / (2 * BONE))  # of both links off the line from root to tip
    return float(np.arctan2(out, ahead) + bend), float(-2 * bend)


def with_hand(arm: hf.Arm) -> hf.Arm:
    """Return an arm with three fingers on its palm, each of three joints."""
    joints, links, hand = [*arm.joints], [*arm.links], arm.joint_count - 1
    parents: list[int | str | None] = [None, *range(hand)]
    for k in range(3):
        root = arm.tip @ hf.Pose.from_rpy(0, 0, k * 2 * np.pi / 3) @ hf.Pose.translation(ROOT, 0, 0)
        bone = hf.Pose.translation(0, 0, BONE)
        spots = (((0, 0, 1), root, 0.03), ((0, 1, 0), hf.Pose.identity(), 0.06), ((0, 1, 0), bone, 0.04))
        for i, (axis, at, mass) in enumerate(spots):
            parents += [hand if i == 0 else len(links) - 1]
            joints += [hf.Joint("revolute", axis, at, f"finger{k + 1}.{i + 1}", armature=1e-3)]
            links += [hf.Link(mass, (0, 0, BONE / 2 * (i > 0)), mass * BONE**2 / 12 * np.eye(3), joints[-1].name)]
    return hf.Arm(joints, links, base=arm.base, parents=parents)


def held(kind: Any) -> tuple[hf.ClosedChain, hf.State]:
    """Return both hands at the ball, which they touch by contacts of a kind."""
    place, arms, grasps, q = hf.Pose.translation(0, 0, 0.5), {}, {}, []
    for name, base in BASES.items():
        bare, palm = hf.robots.panda(base), hf.contact_frame(-PALM * INWARD[name], into=INWARD[name])
        own = hf.assemble({name: bare}, BALL, {name: hf.Grasp("rigid", palm)}, object_pose=place).state.q
        arm = with_hand(bare)
        q.append(np.append(own, np.tile([0.0, *finger_angles()], 3)))
        poses, frames = hf.dynamics.link_poses(arm, q[-1]), {}
        for k in (1, 2, 3):
            link = [one.name for one in arm.links].index(f"finger{k}.3")
            tip = (poses[link] @ hf.Pose.translation(0, 0, BONE)).p - place.p
            contact = hf.contact_frame(tip, into=-tip)
            frames[f"tip{k}"] = (link, poses[link].inverse() @ place @ contact)
            grasps[name, f"tip{k}"] = hf.Grasp(kind, contact)
        arms[name] = replace(arm, frames=frames)
    return hf.ClosedChain(arms, BALL, grasps), hf.State(np.concatenate(q), np.zeros(32), place)


def main(out: Path = OUT) -> dict[str, Any]:
    """Return rank, forces and balance with pointed and soft fingertips, and with the left hand's brakes closed."""
    out.mkdir(parents=True, exist_ok=True)
    found: dict[str, Any] = {}
    with rc_context(STYLE):
        figure = Figure(figsize=(6, 2.2), layout="constrained")
        for axes, (name, kind) in zip(figure.subplots(1, 3, sharey=True), CASES.items(), strict=True):
            chain, state = held(kind)
            if name == "left brakes closed":
                at = {name: q for name, q in zip(chain.joint_names(), state.q, strict=True) if "left/f" in name}
                chain = replace(chain, couplings=[hf.Coupling({name: 1.0}, q) for name, q in at.items()])
            told: Any = hf.diagnose(chain, state)
            print(f"{name}: {told.parts[0].words}")
            result = hf.forward_dynamics(chain, state, hf.holding_torques(chain, state, internal_force=SQUEEZE))
            forces = result.grasp_wrench[:6, 3:]
            points = np.array([grasp.frame.p for grasp in chain.grasps.values()])
            pressing = -(forces * points).sum(axis=1) / RADIUS
            slips = np.linalg.norm(forces + pressing[:, None] * points / RADIUS, axis=1) / pressing
            print(f"  presses with {np.round(pressing, 2)} N, needs friction {slips.max():.2f}")
            axes.add_patch(Circle((0, 0), RADIUS, fill=False, color="0.6"))
            for k, (p, f) in enumerate(zip(points, forces, strict=True)):
                axes.arrow(*p[1:], *f[1:] / 200, color=arm_style(k // 3)[0], width=1e-3, head_width=8e-3)
            axes.set(title=name, xlabel="y [m]", aspect="equal", xlim=(-0.2, 0.2), ylim=(-0.15, 0.15))
            moment = result.grasp_wrench[:6, :3].sum(axis=0) + np.cross(points, forces).sum(axis=0)
            balance = np.append(forces.sum(axis=0) - [0, 0, BALL.mass * 9.81], moment)
            found[name] = {"rank": told.rank, "rows": told.rows, "balance": float(np.abs(balance).max()),
                           "moved": float(np.abs(result.qdd).max()), "pressing": pressing}  # fmt: skip
        figure.supylabel("z [m]", fontsize=8)
        figure.savefig(out / "23_two_hands.png", dpi=DPI)
    return found


if __name__ == "__main__":
    main()
