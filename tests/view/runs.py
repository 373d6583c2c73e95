"""Short runs to look at: two Pandas lift a box, closed and in equilibrium at every sample."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from holdfast import ClosedChain, Friction, Grasp, State, close
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.simulation.accounts import accounts_of
from holdfast.simulation.balance import Sums
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import evaluate
from holdfast.simulation.sample import sample
from holdfast.simulation.stepper import NO_GAPS
from holdfast.simulation.trajectory import Trajectory, array_names, joined
from holdfast.view.playback import Playback, playback_of_run
from holdfast.view.scene_writer import Camera
from tests.control.two_pandas import two_pandas

FRICTION = {
    "softfinger": Friction(0.8, torsion_radius=0.02),
    "hinge": Friction(0.8, half_length=0.03),
    "ball": Friction(0.8),
}


@functools.cache
def lifted(left: str = "softfinger", right: str = "ball", samples: int = 6) -> tuple[ClosedChain, Trajectory]:
    """Return a chain with one-sided grasps and a run of 1 s: the box rises 0.1 m while the internal force drops."""
    two_sided, state = two_pandas(left, right)
    grasps = {
        name: Grasp(grasp.kind, grasp.frame, FRICTION.get(grasp.kind)) for name, grasp in two_sided.grasps.items()
    }
    chain = replace(two_sided, grasps=grasps)
    found = []
    for t in np.linspace(0.0, 1.0, samples):
        pose = state.object_pose + 0.1 * t * np.eye(7)[6]
        here = close(chain, State(state.q, np.zeros(14), pose), hold_object=True)
        now = evaluate(Environment(chain), GravityCompensation(chain, 40.0 - 30.0 * t), float(t), here, None)
        margins = np.full((1, 2 + 3 * 14), np.inf)
        sums, world = Sums(np.zeros(4), 0.0, np.zeros(6)), Environment(chain)
        accounting = functools.partial(accounts_of, world)
        found.append(sample(world, accounting, now, NO_GAPS, sums, np.array([t]), margins, array_names()))
    return chain, joined(found)


@functools.cache
def played(title: str = "lifted") -> Playback:
    """Return the playback of the run of `lifted`."""
    return playback_of_run(*lifted(), title)


def off_axis(view: Camera, points: np.ndarray) -> np.ndarray:
    """Return the tangents of the angles at which a camera sees points off its axis, (points,)."""
    ahead = (view.target - view.position) / np.linalg.norm(view.target - view.position)
    seen = points - view.position
    return np.linalg.norm(seen - np.outer(seen @ ahead, ahead), axis=1) / (seen @ ahead)
