"""Three arms around a ball."""

from __future__ import annotations

import functools

import numpy as np

import holdfast as hf


@functools.cache
def three_pandas() -> tuple[hf.ClosedChain, hf.State]:
    """Return three arms around a ball, which they hold with soft fingers."""
    rubber = hf.Friction(mu=0.7, torsion_radius=0.01)
    arms, grasps = {}, {}
    for k, angle in enumerate(np.radians([0, 120, 240])):
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        arms[f"arm{k}"] = hf.robots.panda(hf.Pose.from_rpy(0, 0, angle + np.pi, 0.6 * out))
        grasps[f"arm{k}"] = hf.Grasp("softfinger", hf.contact_frame(0.12 * out, into=-out), contact=rubber)
    ball = hf.HeldObject.sphere(2.0, 0.12)
    chain, state = hf.assemble(arms, ball, grasps, object_pose=hf.Pose.translation(0, 0, 0.6))
    return chain, state
