"""Writing a closed chain as MJCF, so that MuJoCo can simulate the same mechanism.

A rigid grasp becomes a weld, a ball grasp a connect, a hinge two connects on its axis, and a soft finger one connect,
which does not transmit the moment about the normal. MuJoCo's equalities are soft; they are written with the largest
impedance.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from holdfast.errors import ModelError
from holdfast.io.files import one_line
from holdfast.model.arm import Arm
from holdfast.model.checks import INERTIA_TOLERANCE
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.force_element import WORLD, SpringEnd
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.model.serial_chain import serial_chain
from holdfast.model.spring import Spring
from holdfast.model.trunk import TRUNK
from holdfast.model.visuals import Cylinder, Sphere
from holdfast.robots.primitive import LINK_COLOURS, Primitive
from holdfast.robots.visuals import equal_box, visuals_of, visuals_of_trunk
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import State, require_fit

HARDEST = 0.9999  # the largest impedance MuJoCo accepts; its default, 0.95, is far softer
SMALLEST = 1e-15  # kg and kg m^2: MuJoCo's own bound on masses and principal moments of moving bodies
ENDLESS = 1e10  # rad or m: written for the missing end of a range with only one limit
HINGE_LENGTH = 0.1  # m: distance between the two connects of a hinge, along its axis


def to_mjcf(chain: ClosedChain, state: State | None = None, *, visuals: bool = True) -> str:
    """Return the chain as the text of an MJCF file.

    The body "left" is the base of the arm of that name. Its links and joints are "left/link1", "left/joint1" with their
    own names, and its tip is the site "left/tip". The object is the free body "object" with a site "object/left" at the
    contact of each arm. A trunk is the body "trunk", which has a free joint of that name if its base floats, and
    contains "trunk/link1", "trunk/joint1"; arms are inside the trunk body on which they are mounted. A spring between
    bodies is a tendon "spring1", numbered from 1, between the sites "spring1/a" and "spring1/b". Inertias, damping,
    springs, armature, Coulomb friction, position and effort limits are written exactly; MJCF has no rate limits. Every
    joint has a motor for its torque. A massless link shares the body of the next link. An anchor is a body without
    joints. No geom collides.

    MuJoCo's model differs in these points: equalities are soft; a hinge has a sixth, redundant row; a soft finger
    transmits no moment about its normal; friction cones are not written; Coulomb friction also acts at rest
    (`forward_dynamics` neglects it there); bases do not move.

    Args:
        chain: the chain.
        state: state to write as the keyframe "state"; None for no keyframe.
        visuals: whether to give the bodies visible solids, those of `holdfast.robots.visuals.visuals_of`.

    Raises:
        ModelError: MuJoCo does not support a link, because it has no rotational inertia or impossible principal
            moments, or is massless and the last of its arm or the end of a spring; or two bodies have the same name.
        StateError: the state does not belong to the chain.
    """
    serial_chain(chain, "to_mjcf: chain")
    root = document(chain, visuals=visuals)
    drives = _add(root, "actuator")
    for name in chain.joint_names():  # motors are in our joint order, whatever the order of bodies in MuJoCo
        _add(drives, "motor", name=name, joint=name)
    if state is not None:
        require_fit(chain, state)
        key = _add(_add(root, "keyframe"), "key", name="state")
        qpos, qvel = coordinates(chain, state)
        key.set("qpos", digits(qpos))
        key.set("qvel", digits(qvel))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def document(chain: ClosedChain, *, visuals: bool) -> Element:
    """Return the root element of the chain's MJCF.

    Raises:
        ModelError: as `to_mjcf`.
    """
    root = Element("mujoco", model="holdfast")
    _add(root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true")
    _add(_add(root, "option", gravity=digits(chain.gravity)), "flag", contact="disable")
    if visuals:
        default = _add(root, "default")
        _add(default, "geom", contype="0", conaffinity="0", group="2")
    world = _add(root, "worldbody")
    below = _add_trunk(world, chain, visuals)
    for name, arm in chain.arms.items():
        stands_on = below[chain.mounted_on[name]] if name in chain.mounts else world
        _add_arm(stands_on, name, arm, visuals)
    _add_object(world, chain, visuals)
    equality = _add(root, "equality")
    for name in chain.grasps:
        _add_grasp(equality, world, chain, name)
    for k, spring in enumerate(chain.springs, start=1):
        if not isinstance(spring, Spring):
            raise ModelError(f"spring {k - 1}: to_mjcf: expected a Spring, got {type(spring).__name__}")
        _add_spring(root, world, chain, f"spring{k}", spring)
    _require_distinct(root)
    return root


def coordinates(chain: ClosedChain, state: State) -> tuple[Array, Array]:
    """Return MuJoCo's qpos (n + 7,) and qvel (n + 6,), with a floating base (n + 14,) and (n + 12,).

    They are in the order of the bodies in the file: a floating base, the joints in `nested_order`, the object. The
    velocity of a free body is [v in world axes; omega in body axes].
    """
    parts = [chain.joints[name] for name in nested_order(chain)]
    positions, rates = [state.q[part] for part in parts], [state.qd[part] for part in parts]
    held, base = _free(state.object_pose, state.object_twist), ([], [])
    if state.base_pose is not None and state.base_twist is not None:
        base = _free(state.base_pose, state.base_twist)
    return np.concatenate([base[0], *positions, held[0]]), np.concatenate([base[1], *rates, held[1]])


def _free(wxyz_xyz: Array, twist: Array) -> tuple[Array, Array]:
    """Return coordinates (7,) and velocities (6,) of a free body."""
    R = rotation.from_quaternion(wxyz_xyz[:4])
    return np.concatenate([wxyz_xyz[4:], wxyz_xyz[:4]]), np.concatenate([twist[3:], twist[:3] @ R])


def nested_order(chain: ClosedChain) -> list[str]:
    """Return "trunk" and the arms in MuJoCo's order of joints, which is depth first.

    Arms on a trunk come after all of its joints, with those on its outermost body first; arms in the world are last.
    """
    below = [] if chain.trunk is None else [TRUNK]
    mounted = sorted(chain.mounted_on, key=lambda name: -chain.mounted_on[name])
    return [*below, *mounted, *(name for name in chain.arms if name not in chain.mounts)]


def digits(numbers: Any) -> str:
    """Return numbers in full precision, separated by blanks."""
    return " ".join(repr(float(x)) for x in numbers)


def _add_trunk(world: Element, chain: ClosedChain, visuals: bool) -> list[Element]:
    """Append the trunk and return the elements of its bodies, base outward; an empty list without a trunk."""
    trunk = chain.trunk
    if trunk is None:
        return []
    solids = visuals_of_trunk(chain) if visuals else [[] for _ in range(trunk.joint_count + 1)]
    body = _add(world, "body", name=TRUNK, **({} if chain.floats else _placed(trunk.base)))
    found = []
    if trunk.floating is not None:
        _require_possible(f"{TRUNK}: floating base", trunk.floating)
        _add(body, "freejoint", name=TRUNK)
        _add_inertial(body, trunk.floating)
        found.append(body)
    _add_solids(body, solids[0], Pose.identity())
    if massless := [k for k, link in enumerate(trunk.links) if link.mass == 0]:
        name = _names(trunk.links, "link")[massless[0]]
        raise ModelError(
            f"{TRUNK}, link '{name}': to_mjcf: expected links with mass, got a massless one; try giving it some"
        )
    return found + _add_links(body, TRUNK, f"{TRUNK}", trunk.joints, trunk.links, solids[1:])


def _add_arm(holder: Element, name: str, arm: Arm, visuals: bool) -> None:
    """Append the base of an arm and its links, each nested in the previous one."""
    solids = visuals_of(arm) if visuals else [[] for _ in range(arm.joint_count + 1)]
    body = _add(holder, "body", name=name, **_placed(arm.base))
    _add_solids(body, solids[0], Pose.identity())
    *_, last = body, *_add_links(body, name, f"arm '{name}'", arm.joints, arm.links, solids[1:])
    _add(last, "site", name=f"{name}/tip", **_placed(arm.tip))


def _add_links(
    body: Element, name: str, what: str, joints: Sequence[Joint], links: Sequence[Link], solids: list[list[Primitive]]
) -> list[Element]:
    """Append links to a base, each nested in the previous one, and return the elements of links with mass."""
    made = []
    waiting: list[tuple[str, Joint, Pose, list[Primitive]]] = []  # joints of massless links, with their frames
    at, joint_names, link_names = Pose.identity(), _names(joints, "joint"), _names(links, "link")
    for joint_name, link_name, joint, link, shapes in zip(joint_names, link_names, joints, links, solids, strict=True):
        at = at @ joint.placement
        waiting.append((f"{name}/{joint_name}", joint, at, shapes))
        if link.mass == 0:
            continue
        _require_possible(f"{what}, link '{link_name}'", link)
        body = _add(body, "body", name=f"{name}/{link_name}", **_placed(at))
        made.append(body)
        _add_inertial(body, link)
        inverse = at.inverse()
        for full_name, moved, frame, shapes_there in waiting:
            _add_joint(body, full_name, moved, inverse @ frame)
            _add_solids(body, shapes_there, inverse @ frame)
        waiting, at = [], Pose.identity()
    if waiting:
        raise ModelError(f"{what}: to_mjcf: expected a last link with mass, got a massless one; try giving it some")
    return made


def _add_object(world: Element, chain: ClosedChain, visuals: bool) -> None:
    """Append the object, with a site at every contact."""
    held = chain.held_object
    _require_possible("object", held)
    body = _add(world, "body", name="object")
    _add(body, "freejoint", name="object")
    _add_inertial(body, held)
    if visuals:
        _add_solids(body, [_object_solid(held)], Pose.identity())
    for name, grasp in chain.grasps.items():
        _add(body, "site", name=f"object/{name}", **_placed(grasp.frame))


def _object_solid(held: HeldObject) -> Primitive:
    """Return a sphere or a cylinder if the object is one, else the box with the same inertia."""
    match held.shape:
        case Sphere(radius):
            return Primitive("sphere", Pose.identity(), (radius,), "orange")
        case Cylinder(radius, length):
            return Primitive("cylinder", Pose.identity(), (radius, length), "orange")
    return equal_box(held, "orange")


def _add_grasp(equality: Element, world: Element, chain: ClosedChain, name: str) -> None:
    """Append the equality of one grasp, and the additional sites that it needs."""
    hard = {"solimp": f"{HARDEST} {HARDEST} 0.001 0.5 2"}
    kind = chain.grasps[name].of_kind
    if kind.equality is None:
        raise ModelError(
            f"grasp '{name}': to_mjcf: no equality of MJCF says what a {chain.grasps[name].kind} grasp does; try"
            f" chain.without_grasp('{name}')"
        )
    if kind.equality == "weld":
        _add(equality, "weld", name=name, site1=f"object/{name}", site2=f"{name}/tip", **hard)
        return
    if kind.rate_rows:
        shown = name.replace("-", "\u2010")  # two hyphens would end the comment
        equality.append(ElementTree.Comment(f" soft finger '{shown}': its moment about the normal is not written "))
    _add(equality, "connect", name=name, site1=f"object/{name}", site2=f"{name}/tip", **hard)
    if kind.equality == "two connects":
        along = Pose.translation(HINGE_LENGTH, 0.0, 0.0)
        ends = ((f"object/{name}", chain.grasps[name].frame), (f"{name}/tip", chain.arms[name].tip))
        for site, frame in ends:
            (holder,) = (body for body in world.iter("body") if body.find(f"site[@name='{site}']") is not None)
            _add(holder, "site", name=f"{site}/axis", **_placed(frame @ along))
        _add(equality, "connect", name=f"{name}/axis", site1=f"{ends[0][0]}/axis", site2=f"{ends[1][0]}/axis", **hard)


def _add_spring(root: Element, world: Element, chain: ClosedChain, name: str, spring: Spring) -> None:
    """Append a spring between bodies: a tendon, and a site at each of its ends."""
    tendons = root.find("tendon")
    tendon = _add(
        _add(root, "tendon") if tendons is None else tendons, "spatial", name=name, stiffness=repr(spring.stiffness),
        springlength=repr(spring.length), damping=repr(spring.damping),
    )  # fmt: skip
    for side, end in zip("ab", spring.ends, strict=True):
        wanted = _body_of(chain, name, end)
        (holder,) = (b for b in world.iter("body") if b.get("name") == wanted) if wanted else (world,)
        _add(holder, "site", name=f"{name}/{side}", pos=digits(end.point))
        _add(tendon, "site", site=f"{name}/{side}")


def _body_of(chain: ClosedChain, name: str, end: SpringEnd) -> str:
    """Return the name of the body to which a spring end is attached; an empty string for the world."""
    if end.on_trunk and chain.trunk is not None:
        k = chain.trunk.body(end.link, name) - (1 if chain.floats else 0)
        return TRUNK if k < 0 else f"{TRUNK}/{_names(chain.trunk.links, 'link')[k]}"
    if not end.on_arm:
        return "" if end.body == WORLD else end.body
    links = chain.arms[end.body].links
    if links[end.link_number()].mass == 0:
        raise ModelError(
            f"{name}: to_mjcf: expected a link with mass, got one without, {end.link_number()} of arm '{end.body}';"
            " try giving it some"
        )
    return f"{end.body}/{_names(links, 'link')[end.link_number()]}"


def _add_joint(body: Element, name: str, joint: Joint, frame: Pose) -> None:
    """Append a joint; `frame` is its frame at q = 0 in the body's frame."""
    if joint.type.mjcf is None:
        raise ModelError(f"joint '{name}': to_mjcf: MJCF has no {joint.kind} joint; try without it")
    made = _add(body, "joint", name=name, type=joint.type.mjcf, pos=digits(frame.p), axis=digits(frame.R @ joint.axis))
    for attribute, value in (
        ("armature", joint.armature),
        ("damping", joint.damping),
        ("frictionloss", joint.friction),
        ("stiffness", joint.stiffness),
        ("springref", joint.rest),
    ):
        if value:
            made.set(attribute, repr(value))
    low, high = joint.position_limits
    if np.isfinite(low) or np.isfinite(high):
        made.set("range", digits([max(low, -ENDLESS), min(high, ENDLESS)]))
    if np.isfinite(joint.effort_limit):
        made.set("actuatorfrcrange", digits([-joint.effort_limit, joint.effort_limit]))


def _add_inertial(body: Element, inertial: Link | HeldObject) -> None:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertial.inertia
    full = digits([xx, yy, zz, xy, xz, yz])
    _add(body, "inertial", mass=repr(inertial.mass), pos=digits(inertial.com), fullinertia=full)


def _add_solids(body: Element, solids: list[Primitive], frame: Pose) -> None:
    """Append geoms that are visible but do not collide."""
    for solid in solids:
        size = {"box": [0.5 * x for x in solid.size], "sphere": solid.size}.get(
            solid.kind, [solid.size[0], 0.5 * solid.size[-1]]
        )
        colour = digits([round(x / 255, 3) for x in LINK_COLOURS[solid.colour]] + [1.0])
        _add(body, "geom", type=solid.kind, size=digits(size), rgba=colour, **_placed(frame @ solid.pose))


def _add(parent: Element, tag: str, **attributes: str) -> Element:
    """Append an element and return it."""
    return SubElement(parent, tag, attributes)


def _placed(pose: Pose) -> dict[str, str]:
    return {"pos": digits(pose.p), "quat": digits(rotation.to_quaternion(pose.R))}


def _names(parts: Any, kind: str) -> list[str]:
    return [part.name or f"{kind}{k + 1}" for k, part in enumerate(parts)]


def _require_possible(what: str, inertial: Link | HeldObject) -> None:
    """Refuse an inertia that MuJoCo would refuse, with the name of its body."""
    a, b, c = np.linalg.eigvalsh(inertial.inertia).tolist()
    if inertial.mass < SMALLEST or a < SMALLEST:
        raise ModelError(
            f"{what}: to_mjcf: MuJoCo has no moving body without rotational inertia, got principal moments {a:.3g},"
            f" {b:.3g}, {c:.3g}; try giving it some"
        )
    if a + b < c * (1 - INERTIA_TOLERANCE):
        raise ModelError(
            f"{what}: to_mjcf: MuJoCo has no body with principal moments {a:.6g}, {b:.6g}, {c:.6g}, which no mass"
            " distribution has"
        )


def _require_distinct(root: Element) -> None:
    """Refuse names that are not printable, and two bodies, joints, sites or equalities with the same name."""
    for tags in (("body",), ("joint", "freejoint"), ("site",), ("weld", "connect")):
        names = sorted(part.get("name", "") for tag in tags for part in root.iter(tag) if part.get("name"))
        for one, next_one in itertools.pairwise(["", *names]):
            if one_line(next_one, len(next_one)) != next_one:
                raise ModelError(f"to_mjcf: {ascii(next_one)[:60]}: expected printable names")
            if one == next_one:
                raise ModelError(
                    f"to_mjcf: two are called '{one}' ({tags[0]}); try other names of arms, joints or links"
                )
