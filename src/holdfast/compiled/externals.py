"""The arrays that computations of a chain read and write."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import accumulate

from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External, Role
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
    by_shape: list[tuple[Shape, tuple[str, ...]]] = [
        ((), ("object_mass",)),
        ((3,), ("gravity", "about", "object_com")),
        ((3, 3), ("object_inertia",)),
        ((6,), ("object_twist", "object_acceleration", "object_wrench")),
        ((6,), ("floating_twist", "floating_acceleration", *TRUNK_BASE_MOTION, "trunk_base_wrench")),
        ((7,), ("object_pose", "floating_pose")),
        ((n,), ("q", "qd", "qdd", "tau")),
        ((4, n), ("joint_limits",)),
        ((chain.contact_freedom_count,), ("contact_acceleration",)),
        ((l, 6), ("grasp_wrench", "base_wrench", *BASE_MOTION)),
        ((g, 6), ("contact",)),
        ((of_arms, 6), ("link_wrench",)),
        ((bodies, 6), ("trunk_link_wrench",)),
    ]
    found = {name: shape for shape, names in by_shape for name in names}
    for prefix, count in (("base", l), ("grasp", g)):
        found |= {f"{prefix}_R": (count, 3, 3), f"{prefix}_p": (count, 3)}
    for names, count in ((LINKS, of_arms), (TRUNK_LINKS, bodies)):
        found |= zip(names, ((count,), (count, 3), (count, 3, 3)), strict=True)
    return found


def link_rows(chain: ClosedChain) -> dict[str, slice]:
    """Return the rows of each arm's links in arrays of all arms' links."""
    ends = starts(arm.joint_count for arm in chain.arms.values())
    return {name: slice(a, b) for name, a, b in zip(chain.arms, ends[:-1], ends[1:], strict=True)}


def externals(
    inputs: Iterable[str], parameters: Iterable[str], outputs: Iterable[str], shape: Mapping[str, Shape]
) -> dict[str, External]:
    """Return a computation's arrays: inputs, then parameters, then outputs."""
    roles: tuple[tuple[Role, Iterable[str]], ...] = (("input", inputs), ("parameter", parameters), ("output", outputs))
    return {name: External(shape[name], role) for role, names in roles for name in names}


def starts(sizes: Iterable[int]) -> list[int]:
    """Return the offsets of consecutive parts of the given sizes, and the end of the last part."""
    return list(accumulate(sizes, initial=0))
