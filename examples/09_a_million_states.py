"""A million states of two arms with a box: what can they do with a tenth of their torque limits in reserve?"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.robots import iiwa14
from holdfast.view.figure_style import DPI, STYLE

OUT = Path(__file__).parent / "out"
EACH = 16_384  # states in a batch: one configuration, its own velocity and torques for each


def main(out: Path = OUT, batches: int = 62) -> dict[str, float]:
    """Return the numbers that this example prints."""
    arms = {"left": iiwa14([1, 0, 0, 0, -0.7, 0, 0]), "right": iiwa14([0, 0, 0, 1, 0.7, 0, 0])}
    box = hf.HeldObject.box(mass=5.0, x=0.3, y=0.3, z=0.2)
    grasps = {
        "left": hf.Grasp("rigid", hf.contact_frame([-0.15, 0, 0], into=[1, 0, 0])),
        "right": hf.Grasp("rigid", hf.contact_frame([0.15, 0, 0], into=[-1, 0, 0])),
    }
    chain, middle = hf.assemble(arms, box, grasps, object_pose=[1, 0, 0, 0, 0, 0, 0.6])
    fast = hf.compile(chain)
    random = np.random.default_rng(1)
    strength = np.array([joint.effort_limit for arm in chain.arms.values() for joint in arm.joints])

    up, hand, seconds, valid, error, differs = [], [], 0.0, 0, 0.0, 0.0
    for _ in range(batches):
        # A configuration: the box somewhere near the middle. Velocities that keep the grasps closed, 0.3 rad/s or so.
        pose = middle.object_pose + np.r_[np.zeros(4), random.uniform(-0.05, 0.05, 3)]
        state = hf.close(chain, hf.State(middle.q, middle.qd, pose), hold_object=True)
        basis = hf.dynamics.motion_basis(chain, state)
        velocity = 0.3 * random.normal(size=(EACH, basis.shape[1])) @ basis.T
        tau = hf.holding_torques(chain, state) + 0.1 * strength * random.uniform(-1, 1, (EACH, len(strength)))

        begin = time.perf_counter()
        found = fast.forward_dynamics(state.q, velocity[:, :14], tau, state.object_pose, velocity[:, 14:])
        seconds += time.perf_counter() - begin

        force = found.grasp_wrench[..., 3:]
        newton = box.mass * (found.object_acceleration[:, 3:] - chain.gravity)
        error = max(error, float(np.abs(force.sum(axis=1) - newton).max()))
        last = hf.State(state.q, velocity[-1, :14], state.object_pose, velocity[-1, 14:])
        reference = hf.forward_dynamics(chain, last, tau[-1])
        differs = max(differs, float(np.abs(found.qdd[-1] / reference.qdd - 1.0).max()))
        valid += int((found.status == hf.dynamics.Status.OK).sum())
        up.append(found.object_acceleration[:, 5])
        hand.append(np.linalg.norm(force[:, 0], axis=1))

    states, upward, felt = batches * EACH, np.concatenate(up), np.concatenate(hand)
    draw(out, upward, felt)
    print(f"{states:,} states, {valid:,} of them valid: {seconds:.2f} s, {states / seconds / 1e6:.2f} million a second")
    print(f"the box accelerates upward by {np.quantile(upward, 0.99):.2f} m/s^2 or more in 1 % of them")
    print(f"and the left hand carries {np.quantile(felt, 0.99):.0f} N or more; |sum f - m (a - g)| <= {error:.1e} N")
    return {
        "states": states,
        "valid": valid,
        "per_second": states / seconds,
        "newton_error": error,
        "largest_force": float(felt.max()),
        "reference_error": differs,
    }


def draw(out: Path, up: np.ndarray, hand: np.ndarray) -> None:
    """Draw how often which acceleration goes with which force."""
    with rc_context(STYLE):
        figure = Figure(figsize=(4.5, 3.2), layout="constrained")
        axes = figure.subplots()
        shown = np.array([np.quantile(up, [0.001, 0.999]), [0, np.quantile(hand, 0.999)]])
        *_, image = axes.hist2d(up, hand, bins=80, range=shown, cmap="cividis")
        figure.colorbar(image, label="states")
        axes.grid(False)
        axes.set(xlabel="upward acceleration of the box [m/s²]", ylabel="force at the left hand [N]")
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(out / "09_a_million_states.png", dpi=DPI)


if __name__ == "__main__":
    main()
