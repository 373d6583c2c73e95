"""The closed chain: arms, the object or objects that they hold, grasps, inner loops and couplings of joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import Any

import numpy as np

from holdfast import outer
from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.chain_forest import ChainForest, chain_forest
from holdfast.model.closure import Closure, checked_loops
from holdfast.model.coupling import Coupling, checked_couplings
from holdfast.model.fingerprint import ADDED, OMITTED
from holdfast.model.force_element import HELD_OBJECT, ForceElement
from holdfast.model.forest import Forest
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.trunk import TRUNK, Trunk
from holdfast.model.world.touching import Touching
from holdfast.names import called
from holdfast.spatial.frozen import NOT_GIVEN, ArrayField, Frozen, FrozenDict, frozen_property, making
from holdfast.spatial.scalar import Array

STANDARD_GRAVITY = (0.0, 0.0, -9.81)


@called
@dataclass(frozen=True, eq=False)
class ClosedChain(Frozen):
    """Named arms that hold one object, in a fixed order, each on its own base or on a common trunk.

    There may be no arm: the object then moves freely. Arms may have branches, there may be several objects or none,
    loops inside and between arms, and couplings of joints; docs/how_to/branches.md says what such chains can be asked.

    Attributes:
        arms: arms by name. Their order is that of every flat array, in which the trunk's joints come first.
        held_object: the object, whose name is "object".
        grasps: grasps by arm name; an arm without one moves freely. The key (arm, frame) is a grasp by a link or a
            further frame of the arm, for example by a finger.
        gravity: (3,) gravitational acceleration, world axes [m/s^2].
        trunk: the trunk on which the arms in `mounts` are mounted, or None.
        mounts: by arm name, the trunk's link on which the arm is mounted: its name or index, or "base" for a floating
            body. The base of such an arm is a pose relative to that link. The bases of other arms are in the world.
        springs: springs, or other force elements, between points of the world, links and the object.
        objects: objects by name, which grasps hold by their field `of`.
        loops: by name, closures between links, objects and the world other than grasps, beside those of the arms.
        couplings: linear relations between joints, beside those of the arms: mimic joints, gears, locked joints.
        touching: points of the object and shapes of the world that may touch, or None; docs/how_to/contact.md.
    """

    arms: Mapping[str, Arm]
    held_object: HeldObject = NOT_GIVEN
    grasps: Mapping[Any, Grasp] = field(default_factory=dict)
    gravity: ArrayField = field(default_factory=making(np.array, STANDARD_GRAVITY))
    trunk: Trunk | None = field(default=None, metadata=ADDED)
    mounts: Mapping[str, str | int] = field(default_factory=dict, metadata=ADDED)
    springs: Sequence[ForceElement] = field(default=(), metadata=ADDED)
    objects: Mapping[str, HeldObject] = field(default_factory=dict, metadata=OMITTED)
    loops: Mapping[str, Closure] = field(default_factory=dict, metadata=OMITTED)
    couplings: Sequence[Coupling] = field(default=(), metadata=OMITTED)
    touching: Touching | None = field(default=None, metadata=OMITTED)

    def __post_init__(self) -> None:
        put = object.__setattr__
        if not isinstance(self.arms, Mapping) or not isinstance(self.grasps, Mapping):
            raise ModelError("chain: expected arms and grasps as mappings from a name, e.g. {'left': arm}")
        for name, arm in self.arms.items():
            checks.name(name, f"chain: name of arm {name!r}")
            if not isinstance(arm, Arm):
                raise ModelError(f"arm '{name}': expected an Arm, got {type(arm).__name__}")
        if not isinstance(self.held_object, HeldObject) and (
            self.held_object is not None or (self.grasps and not self.objects)
        ):
            raise ModelError(f"object: expected a HeldObject, got {type(self.held_object).__name__}")
        for key, grasp in self.grasps.items():
            name = holding_arm(key)
            if name not in self.arms:
                raise ModelError(f"grasp '{name}': no such arm.{checks.did_you_mean(name, self.arms)}")
            if not isinstance(grasp, Grasp):
                raise ModelError(f"grasp '{name}': expected a Grasp, got {type(grasp).__name__}")
        put(self, "arms", FrozenDict({name: replace(arm, name=name) for name, arm in self.arms.items()}))
        order = [*self.arms]
        keys = sorted(self.grasps, key=lambda key: order.index(holding_arm(key)))
        put(self, "grasps", FrozenDict({key: self.grasps[key] for key in keys}))
        put(self, "gravity", checks.numbers(self.gravity, (3,), "chain: gravity"))
        if not isinstance(self.springs, Sequence) or not all(isinstance(one, ForceElement) for one in self.springs):
            raise ModelError(f"chain: springs: expected a list of Spring, got {checks.short(self.springs)}")
        self._check_trunk()
        put(self, "springs", tuple(spring.found(self.arms, self.trunk) for spring in self.springs))
        checks.instance(self.touching, (Touching, type(None)), "chain: touching")
        put(self, "mounts", FrozenDict({name: self.mounts[name] for name in self.arms if name in self.mounts}))
        self._check_forest()

    def _check_forest(self) -> None:
        """Check objects, loops and couplings, and that a chain with such parts is a forest."""
        given = self.objects
        if not isinstance(given, Mapping) or not all(isinstance(one, HeldObject) for one in given.values()):
            raise ModelError(f"chain: objects: expected a HeldObject by name, got {checks.short(given)}")
        object.__setattr__(self, "objects", FrozenDict(given))
        object.__setattr__(self, "loops", checked_loops(self.loops, "chain"))
        object.__setattr__(self, "couplings", checked_couplings(self.couplings, "chain"))
        if self.held_object is not None and HELD_OBJECT in self.objects:
            raise ModelError(f"object '{HELD_OBJECT}': expected another name, as it is that of held_object")
        taken = [*self.arms, TRUNK, *self.grasps]
        for name in (*self.objects, *self.loops):
            checks.name(name, f"chain: name of {name!r}")
            if name in taken or (name in self.objects and name in self.loops):
                raise ModelError(f"chain: '{name}': expected names of objects and loops that nothing else has")
        if not (self.arms or self.free_objects):
            raise ModelError("chain: expected at least one arm or an object, got none")
        if self.beyond_serial:
            if refused := [w for w in ("springs", "bushings", "touching") if getattr(self, w)]:
                raise ModelError(f"chain: {refused[0]}: expected none in a chain with {self.beyond_serial[0]}")
            _ = self.as_forest  # raises an error if a name is unknown

    @frozen_property
    def beyond_serial(self) -> tuple[str, ...]:
        """What the chain has beyond serial arms that hold one object; such a chain is answered as a forest."""
        found = [f"branches in arm '{name}'" for name, arm in self.arms.items() if arm.parents]
        for name, joint in zip(self.joint_names(), self.all_joints, strict=True):
            if joint.type.quaternion or not joint.actuated:
                found.append(f"the {joint.kind if joint.actuated else 'passive'} joint '{name}'")
        found += [f"a grasp by {key!r}" for key in self.grasps if not isinstance(key, str)]
        found += [
            f"a loop '{name}'"
            for name in (*(f"{x}/{y}" for x, arm in self.arms.items() for y in arm.loops), *self.loops)
        ]
        found += ["coupled joints"] if self.all_couplings else []
        named = [key for key, grasp in self.grasps.items() if grasp.of not in (None, HELD_OBJECT)]
        if self.objects or named:
            found.append("objects with names")
        elif self.held_object is None:
            found.append("no held object")
        return tuple(found)

    @frozen_property
    def all_couplings(self) -> tuple[Coupling, ...]:
        """The couplings of the arms in order, with their joints as "arm/joint", and then those of the chain itself."""
        own = [
            Coupling({f"{name}/{joint}": c for joint, c in coupling.terms.items()}, coupling.offset)
            for name, arm in self.arms.items()
            for coupling in arm.couplings
        ]
        return *own, *self.couplings

    @frozen_property
    def free_objects(self) -> Mapping[str, HeldObject]:
        """All objects by name, the held one first, as "object"."""
        held = {} if self.held_object is None else {HELD_OBJECT: self.held_object}
        return {**held, **self.objects}

    def held_by(self, grasp: Grasp, key: Any) -> str:
        """Return the name of the object that a grasp holds.

        Args:
            grasp: the grasp.
            key: its key in `grasps`, for messages.

        Raises:
            ModelError: there is no such object, or the grasp does not say which.
        """
        known = self.free_objects
        name = next(iter(known)) if grasp.of is None and (len(known) == 1 or HELD_OBJECT in known) else grasp.of
        if name is None or name not in known:
            hint = checks.did_you_mean(str(name), known) if name else f" Known: {', '.join(known)}."
            raise ModelError(f"grasp {key!r}: of: expected the name of an object, got {name!r}.{hint}")
        return name

    @frozen_property
    def as_forest(self) -> ChainForest:
        """The chain's forest, and where its parts are in it."""
        return chain_forest(self)

    def _check_trunk(self) -> None:
        """Check that the trunk and the mounts fit the arms."""
        if not isinstance(self.trunk, Trunk | None):
            raise ModelError(f"trunk: expected a Trunk or None, got {type(self.trunk).__name__}")
        if not isinstance(self.mounts, Mapping):
            raise ModelError("chain: expected mounts as a mapping from an arm's name, e.g. {'left': 'chest'}")
        if self.trunk is None:
            if self.mounts:
                raise ModelError(f"mounts: expected a trunk to mount {', '.join(map(repr, self.mounts))} on, got none")
            return
        if TRUNK in self.arms:
            raise ModelError(f"arm '{TRUNK}': the name is reserved for the trunk in flat arrays; try another")
        for name, mount in self.mounts.items():
            if name not in self.arms:
                raise ModelError(f"mount of '{name}': no such arm.{checks.did_you_mean(name, self.arms)}")
            self.trunk.body(mount, f"mount of '{name}'")

    def __repr__(self) -> str:
        """Return the arms with their grasps and the object, one per line."""
        lines = [f"ClosedChain: {_count(len(self.arms), 'arm')}, {_count(self.joint_count, 'joint')}"]
        lines += [f"  {name}: {', '.join(filter(None, row))}" for name, *row in self._table()]
        return f"<{chr(10).join(lines)}>"

    def _repr_html_(self) -> str:
        """Return a table of the arms with their grasps and of the object beside a drawing of these, for notebooks."""
        titles = ("", "", "stands", "grasp")
        head = "".join(f"<th>{title}</th>" for title in titles)
        body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in self._table())
        table = f"<table><tr>{head}</tr>{body}</table>"
        drawn = outer.chain_diagram(self)
        return f'<div style="display:flex;flex-wrap:wrap;gap:2em;align-items:start">{table}{drawn}</div>'

    def _table(self) -> list[tuple[str, str, str, str]]:
        """Return the name, joints, base and grasp of trunk, arms and object."""
        rows = []
        if self.trunk is not None:
            place = "floats" if self.floats else f"base at {checks.place(self.trunk.base.p)} m"
            rows.append((TRUNK, _count(self.trunk.joint_count, "joint"), place, ""))
        for name, arm in self.arms.items():
            where = f"on {self.mounts[name]}" if name in self.mounts else f"base at {checks.place(arm.base.p)} m"
            held = [_held(key, grasp) for key, grasp in self.grasps.items() if holding_arm(key) == name]
            joints = _count(arm.joint_count, "joint") if arm.joints else "anchor"
            rows.append((name, joints, where, "; ".join(held) or "holds nothing"))
        for name, one in self.free_objects.items():
            rows.append((name, f"{one.mass:.4g} kg" if isinstance(one.mass, float) else "", "", ""))
        rows += [("loops", ", ".join(self.loops), "", "")] if self.loops else []
        rows += [("couplings", str(len(self.all_couplings)), "", "")] if self.all_couplings else []
        if self.springs:
            rows.append(("springs", str(len(self.springs)), "", ""))
        if self.touching is not None:
            places = _count(len(self.touching.names), "contact")
            rows.append(("world", ", ".join(self.touching.world), f"{places} possible", ""))
        return rows

    @property
    def names(self) -> tuple[str, ...]:
        """The arms' names, in order."""
        return tuple(self.arms)

    @frozen_property
    def joints(self) -> Mapping[str, slice]:
        """The slice of each arm's joints in the flat arrays q, qd, tau; that of "trunk" comes first.

        With spherical joints it is that in qd, qdd and tau alone; see `positions`.
        """
        return _slices({name: sum(joint.type.freedoms for joint in of) for name, of in self.joints_of.items()})

    @frozen_property
    def positions(self) -> Mapping[str, slice]:
        """The slice of each arm's joints in q, in which a spherical joint has four entries."""
        return _slices({name: sum(joint.type.position_count for joint in of) for name, of in self.joints_of.items()})

    @property
    def arm_joints(self) -> list[slice]:
        """The slices of the joints of all arms, in order."""
        return [self.joints[name] for name in self.arms]

    @frozen_property
    def mounted_on(self) -> Mapping[str, int]:
        """By name of a mounted arm, the index of its body in `Trunk.bodies`."""
        if self.trunk is None:
            return {}
        return {name: self.trunk.body(at, f"mount of '{name}'") for name, at in self.mounts.items()}

    @property
    def floats(self) -> bool:
        """Whether the trunk begins with a floating base, whose pose and twist are in the state."""
        return self.trunk is not None and self.trunk.floating is not None

    @frozen_property
    def contact_freedoms(self) -> Mapping[str, slice]:
        """The slice of each grasp's relative rates in the flat arrays W and W_dot."""
        ends = np.cumsum([len(grasp.free) for grasp in self.grasps.values()], dtype=int)
        return {
            name: slice(int(end) - len(grasp.free), int(end))
            for (name, grasp), end in zip(self.grasps.items(), ends, strict=True)
        }

    @frozen_property
    def bushings(self) -> tuple[str, ...]:
        """The names of the arms whose grasp is a bushing, which exerts a known wrench and imposes no constraint."""
        return tuple(name for name, grasp in self.grasps.items() if grasp.of_kind.bushing is not None)

    @frozen_property
    def forest(self) -> Forest:
        """The chain as a forest: the bodies of the trunk, those of the arms in order, and the objects last.

        Raises:
            ModelError: springs between bodies or bushings act, which are no part of a forest yet.
        """
        if self.springs or self.bushings:
            raise ModelError(
                "forest: expected a chain without springs between bodies and bushings, which are no part of a forest;"
                " try the chain itself, for example forward_dynamics(chain, state, tau)"
            )
        return self.as_forest.forest

    @frozen_property
    def joint_count(self) -> int:
        """Number of joints n of the trunk and all arms, without a floating base; a spherical joint counts three."""
        return sum(joint.type.freedoms for joint in self.all_joints)

    @frozen_property
    def position_count(self) -> int:
        """Length of q; the number of joints, with four for a spherical joint."""
        return sum(joint.type.position_count for joint in self.all_joints)

    @frozen_property
    def contact_freedom_count(self) -> int:
        """Sum of n_g over all grasps, the length of W."""
        return sum(len(grasp.free) for grasp in self.grasps.values())

    @property
    def velocity_count(self) -> int:
        """Length of (twist of a floating base, qd, V(C)), which is n + 6, or n + 12 with a floating base."""
        return self.joint_count + 6 + (6 if self.floats else 0)

    @property
    def constraint_row_count(self) -> int:
        """Number of rows of [J, -A, H^T], six per grasp; the relative rates W count as unknown velocities."""
        return 6 * len(self.grasps)

    @property
    def joints_of(self) -> Mapping[str, Sequence[Joint]]:
        """The joints of "trunk", if there is one, and of every arm, by name, in the order of q."""
        below = {} if self.trunk is None else {TRUNK: self.trunk.joints}
        return below | {name: arm.joints for name, arm in self.arms.items()}

    def joint_names(self) -> list[str]:
        """Return 'arm/joint' names in the order of q."""
        return [
            f"{name}/{joint.name or f'joint{k + 1}'}"
            for name, joints in self.joints_of.items()
            for k, joint in enumerate(joints)
        ]

    @property
    def all_joints(self) -> list[Joint]:
        """The joints in the order of q."""
        return [joint for joints in self.joints_of.values() for joint in joints]

    @frozen_property
    def freedoms(self) -> Sequence[Joint]:
        """The joint of every entry of qd and tau: each joint once, and a spherical one three times."""
        return [joint for joint in self.all_joints for _ in range(joint.type.freedoms)]

    @frozen_property
    def position_limits(self) -> Array:
        """(n, 2) lowest and highest joint positions in the order of qd [rad or m]; a spherical joint has none."""
        return np.array([joint.position_limits for joint in self.freedoms]).reshape(-1, 2)

    def with_bases(self, bases: Mapping[str, object]) -> ClosedChain:
        """Return the chain with the bases of the named arms at other poses (Pose or wxyz_xyz)."""
        checks.instance(bases, Mapping, "bases")
        for name in bases:
            if name not in self.arms:
                raise ModelError(f"base of '{name}': no such arm.{checks.did_you_mean(name, self.arms)}")
        return replace(self, arms={n: a.at(bases[n]) if n in bases else a for n, a in self.arms.items()})

    def with_grasp(self, name: str | tuple[str, str], grasp: Grasp) -> ClosedChain:
        """Return the chain with an additional grasp of an arm, or of its frame as (arm, frame), that has none."""
        arm = holding_arm(name)
        checks.instance(arm, str, "grasp: name of the arm")
        if arm not in self.arms:
            raise ModelError(f"grasp '{arm}': no such arm.{checks.did_you_mean(arm, self.arms)}")
        if name in self.grasps:
            raise ModelError(
                f"grasp {name!r}: expected an arm without a grasp, got one that has a {self.grasps[name].kind} grasp;"
                f" try without_grasp({name!r}) first"
            )
        return replace(self, grasps={**self.grasps, name: grasp})

    def without_grasp(self, name: str | tuple[str, str]) -> ClosedChain:
        """Return the chain without the grasp of the named arm, or of its frame, which then moves freely."""
        checks.instance(holding_arm(name), str, "grasp: name of the arm")
        if name not in self.grasps:
            raise ModelError(f"grasp {name!r}: no such grasp.{checks.did_you_mean(str(name), map(str, self.grasps))}")
        return replace(self, grasps={n: g for n, g in self.grasps.items() if n != name})


def holding_arm(key: Any) -> Any:
    """Return the name of the arm in a key of `grasps`."""
    return key[0] if isinstance(key, tuple) and len(key) == 2 else key


def _held(key: Any, grasp: Grasp) -> str:
    """Return a grasp in words."""
    by = "" if isinstance(key, str) else f"{key[1]}: "
    of = "" if grasp.of is None else f" of {grasp.of}"
    return f"{by}{grasp.kind} grasp{of}" + ("" if grasp.contact is None else f" with friction {grasp.contact.mu}")


def _slices(counts: Mapping[str, int]) -> dict[str, slice]:
    ends = np.cumsum([*counts.values()])
    return {name: slice(int(end) - n, int(end)) for (name, n), end in zip(counts.items(), ends, strict=True)}


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
