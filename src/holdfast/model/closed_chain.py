"""The closed chain: arms, the object that they hold, and the grasps between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape

import numpy as np

from holdfast import outer
from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.chain_forest import chain_forest
from holdfast.model.fingerprint import ADDED
from holdfast.model.force_element import ForceElement
from holdfast.model.forest import Forest
from holdfast.model.grasp import Grasp
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.trunk import NAME as TRUNK
from holdfast.model.trunk import Trunk
from holdfast.names import called
from holdfast.spatial.frozen import ArrayField, Frozen, FrozenDict, frozen_property, making
from holdfast.spatial.scalar import Array

STANDARD_GRAVITY = (0.0, 0.0, -9.81)


@called
@dataclass(frozen=True, eq=False)
class ClosedChain(Frozen):
    """Named arms that hold one object, in a fixed order, each on its own base or on a common trunk.

    Attributes:
        arms: arms by name. Their order is that of every flat array, in which the trunk's joints come first.
        held_object: the object.
        grasps: grasps by arm name; an arm without one moves freely.
        gravity: (3,) gravitational acceleration, world axes [m/s^2].
        trunk: the trunk on which the arms in `mounts` are mounted, or None.
        mounts: by arm name, the trunk's link on which the arm is mounted: its name or index, or "base" for a floating
            body. The base of such an arm is a pose relative to that link. The bases of other arms are in the world.
        springs: springs, or other force elements, between points of the world, links and the object.
    """

    arms: Mapping[str, Arm]
    held_object: HeldObject
    grasps: Mapping[str, Grasp]
    gravity: ArrayField = field(default_factory=making(np.array, STANDARD_GRAVITY))
    trunk: Trunk | None = field(default=None, metadata=ADDED)
    mounts: Mapping[str, str | int] = field(default_factory=dict, metadata=ADDED)
    springs: Sequence[ForceElement] = field(default=(), metadata=ADDED)

    def __post_init__(self) -> None:
        put = object.__setattr__
        if not isinstance(self.arms, Mapping) or not isinstance(self.grasps, Mapping):
            raise ModelError("chain: expected arms and grasps as mappings from a name, e.g. {'left': arm}")
        if not self.arms:
            raise ModelError("chain: expected at least one arm, got none")
        for name, arm in self.arms.items():
            checks.name(name, f"chain: name of arm {name!r}")
            if not isinstance(arm, Arm):
                raise ModelError(f"arm '{name}': expected an Arm, got {type(arm).__name__}")
        if not isinstance(self.held_object, HeldObject):
            raise ModelError(f"object: expected a HeldObject, got {type(self.held_object).__name__}")
        for name, grasp in self.grasps.items():
            if name not in self.arms:
                raise ModelError(f"grasp '{name}': no such arm.{checks.did_you_mean(name, self.arms)}")
            if not isinstance(grasp, Grasp):
                raise ModelError(f"grasp '{name}': expected a Grasp, got {type(grasp).__name__}")
        put(self, "arms", FrozenDict({name: replace(arm, name=name) for name, arm in self.arms.items()}))
        put(self, "grasps", FrozenDict({name: self.grasps[name] for name in self.arms if name in self.grasps}))
        put(self, "gravity", checks.numbers(self.gravity, (3,), "chain: gravity"))
        if not isinstance(self.springs, Sequence) or not all(isinstance(one, ForceElement) for one in self.springs):
            raise ModelError(f"chain: springs: expected a list of Spring, got {checks.short(self.springs)}")
        self._check_trunk()
        put(self, "springs", tuple(spring.found(self.arms, self.trunk) for spring in self.springs))
        put(self, "mounts", FrozenDict({name: self.mounts[name] for name in self.arms if name in self.mounts}))

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
        diagram = outer.chain_diagram(self)
        return f'<div style="display:flex;flex-wrap:wrap;gap:2em;align-items:start">{table}{diagram}</div>'

    def _table(self) -> list[tuple[str, str, str, str]]:
        """Return the name, joints, base and grasp of trunk, arms and object."""
        rows = []
        if self.trunk is not None:
            place = "floats" if self.floats else f"base at {checks.place(self.trunk.base.p)} m"
            rows.append((TRUNK, _count(self.trunk.joint_count, "joint"), place, ""))
        for name, arm in self.arms.items():
            where = f"on {self.mounts[name]}" if name in self.mounts else f"base at {checks.place(arm.base.p)} m"
            held = "holds nothing"
            if (grasp := self.grasps.get(name)) is not None:
                held = f"{grasp.kind} grasp" + ("" if grasp.contact is None else f" with friction {grasp.contact.mu}")
            rows.append((name, _count(arm.joint_count, "joint") if arm.joints else "anchor", where, held))
        mass = self.held_object.mass
        rows.append(("object", f"{mass:.4g} kg" if isinstance(mass, float) else "", "", ""))
        if self.springs:
            rows.append(("springs", str(len(self.springs)), "", ""))
        return rows

    @property
    def names(self) -> tuple[str, ...]:
        """The arms' names, in order."""
        return tuple(self.arms)

    @frozen_property
    def joints(self) -> Mapping[str, slice]:
        """The slice of each arm's joints in the flat arrays q, qd, tau; that of "trunk" comes first."""
        counts = {} if self.trunk is None else {TRUNK: self.trunk.joint_count}
        counts |= {name: arm.joint_count for name, arm in self.arms.items()}
        ends = np.cumsum([*counts.values()])
        return {name: slice(int(end) - n, int(end)) for (name, n), end in zip(counts.items(), ends, strict=True)}

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
        """The chain as a forest: the bodies of the trunk, those of the arms in order, and the object last.

        Raises:
            ModelError: springs or bushings act, which are no part of a forest yet.
        """
        if self.springs or self.bushings or any(joint.stiffness for joint in self.all_joints):
            raise ModelError(
                "forest: expected a chain without springs and bushings, which are no part of a forest; try the chain"
                " itself, for example forward_dynamics(chain, state, tau)"
            )
        return chain_forest(self).forest

    @frozen_property
    def joint_count(self) -> int:
        """Number of joints n of the trunk and all arms, without a floating base."""
        return sum(arm.joint_count for arm in self.arms.values()) + (
            0 if self.trunk is None else self.trunk.joint_count
        )

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
    def position_limits(self) -> Array:
        """(n, 2) lowest and highest joint positions in the order of q [rad or m]."""
        return np.array([joint.position_limits for joint in self.all_joints]).reshape(-1, 2)

    def with_bases(self, bases: Mapping[str, object]) -> ClosedChain:
        """Return the chain with the bases of the named arms at other poses (Pose or wxyz_xyz)."""
        checks.instance(bases, Mapping, "bases")
        for name in bases:
            if name not in self.arms:
                raise ModelError(f"base of '{name}': no such arm.{checks.did_you_mean(name, self.arms)}")
        return replace(self, arms={n: a.at(bases[n]) if n in bases else a for n, a in self.arms.items()})

    def with_grasp(self, name: str, grasp: Grasp) -> ClosedChain:
        """Return the chain with an additional grasp of an arm that has none."""
        checks.instance(name, str, "grasp: name of the arm")
        if name not in self.arms:
            raise ModelError(f"grasp '{name}': no such arm.{checks.did_you_mean(name, self.arms)}")
        if name in self.grasps:
            raise ModelError(
                f"grasp '{name}': expected an arm without a grasp, got one that has a {self.grasps[name].kind} grasp;"
                f" try without_grasp('{name}') first"
            )
        return replace(self, grasps={**self.grasps, name: grasp})

    def without_grasp(self, name: str) -> ClosedChain:
        """Return the chain without the grasp of the named arm, which then moves freely."""
        checks.instance(name, str, "grasp: name of the arm")
        if name not in self.grasps:
            raise ModelError(f"grasp '{name}': no such grasp.{checks.did_you_mean(name, self.grasps)}")
        return replace(self, grasps={n: g for n, g in self.grasps.items() if n != name})


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
