"""The arrays that computations of a chain read and write."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import accumulate

from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External
from holdfast.model.closed_chain import ClosedChain

# The fields of a state by the names of its arrays. The array names of a trunk's floating base begin with "floating",
# because "base" alone means the base of an arm.
STATE_FIELDS = {name: name for name in ("q", "qd", "object_pose", "object_twist")}
FLOATING_FIELDS = {"floating_pose": "base_pose", "floating_twist": "base_twist"}
STATE, FLOATING = tuple(STATE_FIELDS), tuple(FLOATING_FIELDS)
BASE_MOTION = ("base_twist", "base_acceleration")  # parameters if bases move
TRUNK_BASE_MOTION = ("trunk_base_twist", "trunk_base_acceleration")
MOVING = (*BASE_MOTION, *TRUNK_BASE_MOTION)
# Parameters if the option `link_inertia` is set: of the arms' links, and of a trunk's bodies.
LINKS = ("link_mass", "link_com", "link_inertia")
TRUNK_LINKS = tuple(f"trunk_{name}" for name in LINKS)


def state_fields(chain: ClosedChain) -> dict[str, str]:
    """Return the fields of a chain's state by the names of its arrays."""
    return STATE_FIELDS | (FLOATING_FIELDS if chain.floats else {})


def link_parameters(chain: ClosedChain) -> tuple[str, ...]:
    """Return the parameters of a chain if the option `link_inertia` is set."""
    return LINKS if chain.trunk is None else (*LINKS, *TRUNK_LINKS)


def shapes(chain: ClosedChain) -> dict[str, Shape]:
    """Return the shape of every array that computations of a chain may read or write, by name."""
    n, l, g = chain.joint_count, len(chain.arms), len(chain.grasps)
    of_arms = sum(arm.joint_count for arm in chain.arms.values())
    bodies = 0 if chain.trunk is None else len(chain.trunk.bodies)
    return {
        "q": (n,),
        "qd": (n,),
        "qdd": (n,),
        "tau": (n,),
        "object_pose": (7,),
        "object_twist": (6,),
        "object_acceleration": (6,),
        "object_wrench": (6,),
        "link_wrench": (of_arms, 6),
        "grasp_wrench": (l, 6),
        "base_wrench": (l, 6),
        "contact_acceleration": (chain.contact_freedom_count,),
        "gravity": (3,),
        "about": (3,),
        "joint_limits": (4, n),
        "contact": (g, 6),
        "object_mass": (),
        "object_com": (3,),
        "object_inertia": (3, 3),
        "link_mass": (of_arms,),
        "link_com": (of_arms, 3),
        "link_inertia": (of_arms, 3, 3),
        "base_R": (l, 3, 3),
        "base_p": (l, 3),
        "base_twist": (l, 6),
        "base_acceleration": (l, 6),
        "grasp_R": (g, 3, 3),
        "grasp_p": (g, 3),
        "floating_pose": (7,),
        "floating_twist": (6,),
        "trunk_base_twist": (6,),
        "trunk_base_acceleration": (6,),
        "trunk_link_wrench": (bodies, 6),
        "trunk_link_mass": (bodies,),
        "trunk_link_com": (bodies, 3),
        "trunk_link_inertia": (bodies, 3, 3),
        "trunk_base_wrench": (6,),
        "floating_acceleration": (6,),
    }


def link_rows(chain: ClosedChain) -> dict[str, slice]:
    """Return the rows of each arm's links in arrays of all arms' links."""
    ends = starts(arm.joint_count for arm in chain.arms.values())
    return {name: slice(a, b) for name, a, b in zip(chain.arms, ends[:-1], ends[1:], strict=True)}


def externals(
    inputs: Iterable[str], parameters: Iterable[str], outputs: Iterable[str], shape: Mapping[str, Shape]
) -> dict[str, External]:
    """Return a computation's arrays: inputs, then parameters, then outputs."""
    return (
        {name: External(shape[name], "input") for name in inputs}
        | {name: External(shape[name], "parameter") for name in parameters}
        | {name: External(shape[name], "output") for name in outputs}
    )


def starts(sizes: Iterable[int]) -> list[int]:
    """Return the offsets of consecutive parts of the given sizes, and the end of the last part."""
    return list(accumulate(sizes, initial=0))
