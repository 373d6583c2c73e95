"""Gantries of sliding joints that squeeze a block: whatever their torques do, the grasp forces follow on paper.

Each gantry slides along world x, y, z in turn; only its last sliding link has mass (LINK), and wrist joints may
follow. The block's centre, the contact points and the slides lie on the world's x axis; `left` pushes towards +x.
"""

import numpy as np

from holdfast import Arm, ClosedChain, Friction, Grasp, HeldObject, Joint, Link, Pose, State

LINK = 1.0  # kg
BLOCK = 2.0  # kg
REACH = 0.1  # m from the block's centre to each contact
SIDES = {"left": -1.0, "right": 1.0}
SMALL = 1e-3 * np.eye(3)  # kg m^2
WRIST_INERTIA = 4e-3  # kg m^2, of every wrist link about every axis


def contact_frame(side: float) -> Pose:
    """Return the contact frame on a side of the block: z into it, x along world y."""
    z, x = np.array([-side, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    return Pose(np.array([x, np.cross(z, x), z]).T, np.array([side * REACH, 0.0, 0.0]))


def gantry(side: float, wrist: str = "", *, moving: float = LINK, **limits) -> Arm:
    """Return a gantry on a side; `wrist` names revolute joints about world axes, e.g. "xy"."""
    slides = [Joint("prismatic", axis, name=name, **limits) for axis, name in zip(np.eye(3), "xyz", strict=True)]
    turns = [Joint("revolute", np.eye(3)["xyz".index(axis)], name=f"turn_{axis}") for axis in wrist]
    links = [Link(0.0, np.zeros(3), np.zeros((3, 3))), Link(0.0), Link(moving, np.zeros(3), SMALL)]
    links += [Link(0.0, np.zeros(3), WRIST_INERTIA * np.eye(3)) for _ in wrist]
    frame = contact_frame(side)
    return Arm(slides + turns, links, tip=Pose(frame.R, np.zeros(3)), base=Pose(np.eye(3), frame.p))


def block(mass: float = BLOCK) -> HeldObject:
    """Return the block, a cube of 0.2 m."""
    return HeldObject.box(mass, 2 * REACH, 2 * REACH, 2 * REACH)


def squeezed(kinds, contact=None, wrists=("", ""), gravity=0.0, **limits) -> tuple[ClosedChain, State]:
    """Return a block between two gantries, at rest.

    Args:
        kinds: grasp kinds of left and right; None leaves an arm without a grasp.
        contact: friction by side, or one for both.
        wrists: wrist joints of left and right.
        gravity: along -z [m/s^2].
        limits: of all sliding joints.
    """
    contacts = contact if isinstance(contact, tuple) else (contact, contact)
    arms, grasps = {}, {}
    for (name, side), kind, friction, wrist in zip(SIDES.items(), kinds, contacts, wrists, strict=True):
        arms[name] = gantry(side, wrist, **limits)
        if kind is not None:
            grasps[name] = Grasp(kind, contact_frame(side), friction)
    chain = ClosedChain(arms, block(), grasps, np.array([0.0, 0.0, -gravity]))
    return chain, State(np.zeros(chain.joint_count), np.zeros(chain.joint_count), [1, 0, 0, 0, 0, 0, 0])


def pressed(mu=0.5, **limits) -> tuple[ClosedChain, State]:
    """Return a block in front of one slide along z that pushes its centre: f_n = tau BLOCK / (BLOCK + LINK)."""
    arm = Arm([Joint("prismatic", name="z", **limits)], [Link(LINK, np.zeros(3), SMALL)])
    chain = ClosedChain({"pusher": arm}, block(), {"pusher": Grasp("ball", Pose.identity(), Friction(mu))}, np.zeros(3))
    return chain, State([0.0], [0.0], [1, 0, 0, 0, 0, 0, 0])


PUSHED = BLOCK / (BLOCK + LINK)  # part of the pusher's force that reaches the block
