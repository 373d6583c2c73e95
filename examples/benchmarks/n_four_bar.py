"""IFToMM's N-four-bar mechanism, N = 2: two windows side by side, which fold flat again and again.

Three cranks stand on the ground, two rods join their ends; all five are 1 m and 1 kg. Upright at first, they fall to
the right at 1 m/s. Whenever all lie along the ground line the mechanism has three freedoms instead of one, and a method
must find its way through.

Published: IFToMM benchmark A02 (M. Gonzalez et al.); the place of B0 after 10 s as Exudyn found it with four steps
(jgerstmayr/EXUDYN, fourBarMechanismIftomm.py), each half of the one before.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import holdfast as hf

# place of the left crank's end after 10 s [m], by the step [s]
PUBLISHED = {
    1e-3: (0.3284112372, 0.9445348375),
    5e-4: (0.3284465114, 0.9445225721),
    2.5e-4: (0.3284552113, 0.9445195467),
    1.25e-4: (0.3284573768, 0.9445187937),
}
SPEED = 1.0  # of the upper ends at first [m/s]
HINGE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # a frame whose x axis is the world's z
FLAT = np.eye(3) / 12  # of a rod; in the plane it is felt about z alone [kg m^2]
ROD = hf.Link(1.0, (0.5, 0, 0), FLAT)
END = hf.Pose(HINGE, (1.0, 0, 0))


def n_four_bar() -> tuple[hf.ClosedChain, hf.State]:
    """Return the mechanism: the left rod is the object, the right one the last crank's second link."""
    crank = hf.Joint("revolute", (0, 0, 1))
    elbow = hf.Joint("revolute", (0, 0, 1), hf.Pose.translation(1.0, 0, 0))
    arms = {
        "A0": hf.Arm([crank], [ROD], tip=END),
        "A1": hf.Arm([crank], [ROD], tip=END, base=hf.Pose.translation(1.0, 0, 0)),
        "A2": hf.Arm([crank, elbow], [ROD, ROD], tip=END, base=hf.Pose.translation(2.0, 0, 0)),
    }
    left, right = hf.Pose(HINGE, (-0.5, 0, 0)), hf.Pose(HINGE, (0.5, 0, 0))
    grasps = {"A0": hf.Grasp("hinge", left), "A1": hf.Grasp("hinge", right), "A2": hf.Grasp("hinge", right)}
    chain = hf.ClosedChain(arms, hf.HeldObject(1.0, FLAT), grasps, gravity=(0, -9.81, 0))
    q, qd = np.array([0.5, 0.5, 0.5, 0.5]) * np.pi, np.array([-1.0, -1.0, -1.0, 1.0]) * SPEED
    return chain, hf.State(q, qd, hf.Pose.translation(0.5, 1.0, 0), [0, 0, 0, SPEED, 0, 0])


def free(t: float, state: hf.State, memory: Any) -> tuple[np.ndarray, Any]:
    """Return no torques."""
    return 0.0 * state.qd, memory


def limit() -> np.ndarray:
    """Return what the published places tend to: their error falls with the square of the step."""
    finer, finest = (np.array(PUBLISHED[step]) for step in (2.5e-4, 1.25e-4))
    return finest + (finest - finer) / 3


def main(duration: float = 10.0) -> hf.simulation.Trajectory:
    """Print the place of B0 beside the published ones, and return the run."""
    chain, state = n_four_bar()
    run = hf.simulate(chain, state, free, duration, 0.1, scheme="dop853", rtol=1e-12, on_singular="continue")
    energy = run.kinetic + run.potential
    print(f"{len(run.occurrences)} times flat, {chain.joint_count} joints; energy within {np.ptp(energy):.0e} J")
    for step, (x, y) in PUBLISHED.items():
        print(f"published, {step:.2e} s: {x:.10f} {y:.10f}")
    print("their limit:            {:.10f} {:.10f}".format(*limit()))
    print(f"found after {run.t[-1]:g} s:       {np.cos(run.q[-1, 0]):.10f} {np.sin(run.q[-1, 0]):.10f}")
    return run


if __name__ == "__main__":
    main()
