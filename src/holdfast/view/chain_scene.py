"""A chain in 3D: arms, trunk, objects, contact frames, friction cones, and arrows for the wrenches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.errors import ModelError
from holdfast.model.arm import Arm
from holdfast.model.force_element import HELD_OBJECT
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.trunk import TRUNK, Trunk
from holdfast.model.visuals import Cylinder, Sphere
from holdfast.model.world.features import Circle
from holdfast.robots.mesh_files.mesh import MeshFault, TriangleMesh
from holdfast.robots.visuals import arm_length, chain_length, equivalent_box, visuals_of, visuals_of_trunk
from holdfast.spatial import rotation
from holdfast.spatial.pose import UP, Pose
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style, markers, meshes
from holdfast.view.cameras import cameras, upward
from holdfast.view.link_meshes import LinkMesh, meshes_of, surface_of_object
from holdfast.view.playback import Playback, spring_ends
from holdfast.view.poses import joint_poses, object_poses
from holdfast.view.scene_writer import RGB, SceneWriter
from holdfast.view.world_drawing import circle_lines, placed_mesh, solids_of, touching_points

OBJECT_GREY, LINE_GREY = (150, 150, 158), (70, 70, 78)
TRUNK_NODE = f"/{TRUNK}"  # node of a trunk's base
OBJECT_OPACITY = 0.28
WORLD_GREY, WORLD_OPACITY, WORLD_SIZE = (176, 168, 150), 0.45, 2.5  # the last relative to the length of the longest arm
# relative to the length of the longest arm
SHAFT_RADIUS, COIL_RADIUS, TOOL_RADIUS, DISC_RADIUS, FOOT_RADIUS = 0.006, 0.012, 0.012, 0.035, 0.1
INTERNAL_OFFSET, AXES_LENGTH, CONE_HEIGHT, LINE_THICKNESS = 0.03, 0.05, 0.09, 0.0025
FOOT_HEIGHT, NAME_DEPTH = 0.008, 0.07


class ChainScene:
    """A playback's chain, drawn into a scene.

    Attributes:
        playback: the playback.
        scale: scale of the arrows, which may be changed between two frames.
    """

    def __init__(self, writer: SceneWriter, playback: Playback, scale: markers.ArrowScale | None = None) -> None:
        """Draw everything that does not change; `show` draws the rest. By default the scale is the playback's own."""
        self.playback, self.scale = playback, scale or markers.arrow_scale(playback)
        self._writer = writer
        chain = playback.chain
        self._size = self._widest = chain_length(chain)
        if chain.trunk is not None and chain.trunk.serial is not None:
            self._widest = max(self._size, arm_length(chain.trunk.serial))
        self._joints = {name: self._draw_arm(i, name, arm) for i, (name, arm) in enumerate(chain.arms.items())}
        if chain.trunk is not None:
            self._joints[TRUNK] = self._draw_trunk(chain.trunk)
        self._objects = {name: self._draw_object(name, one) for name, one in chain.free_objects.items()}
        self._bodies = [*self._joints.get(TRUNK, ()), *(n for name in chain.arms for n in self._joints[name])]
        self._bodies = [*([TRUNK_NODE] if chain.floats else ()), *self._bodies, *self._objects.values()]
        self._cones = self._draw_contacts()
        self._draw_ground()
        self._world = self._draw_world()
        self._reserves = {name: playback.reserve(name) for name in self._cones}
        for name in playback.holding:
            colour, node, shaft = figure_style.rgb(playback.colour(name)), _node(name), SHAFT_RADIUS * self._size
            writer.arrows(f"/forces/{node}", 1, colour, shaft)
            writer.arrows(f"/moments/{node}", 2, colour, 0.7 * shaft)
            if playback.internal.size:
                writer.arrows(f"/internal_force/{node}", 1, figure_style.rgb(figure_style.INTERNAL_COLOUR), 0.8 * shaft)
            if playback.commanded is not None:
                colour = figure_style.rgb(figure_style.COMMANDED_COLOUR)
                writer.arrows(f"/commanded_force/{node}", 1, colour, 0.5 * shaft)
        for i, segments in enumerate(self._coils(0)):
            writer.lines(f"/springs/{i}", segments, LINE_GREY, LINE_THICKNESS * self._size)
        writer.set_camera(cameras(playback)[0], upward(chain))
        self.show(0)

    def show(self, k: int) -> None:
        """Move everything to its pose in frame k."""
        playback, chain = self.playback, self.playback.chain
        with self._writer.at_once():
            bases = {_root(name): base for name, base in zip(chain.names, playback.base_pose[k], strict=True)}
            for root, base in {
                **bases,
                **({} if chain.trunk is None else {TRUNK_NODE: playback.trunk_pose[k]}),
            }.items():
                self._writer.place(root, base[:4], base[4:])
            for name, joints in chain.joints_of.items():
                poses = joint_poses(joints, playback.q[k, chain.positions[name]])
                for node, at in zip(self._joints[name], poses, strict=True):
                    self._writer.place(node, rotation.to_quaternion(at.R), at.p)
            for node, pose in zip(self._objects.values(), object_poses(playback.object_pose[k]), strict=True):
                self._writer.place(node, pose[:4], pose[4:])
            for name in playback.holding:
                self._point(name, k)
            for name, (node, in_shape) in self._world.items():
                at = playback.touching[k].world[name].pose @ in_shape
                self._writer.place(node, rotation.to_quaternion(at.R), at.p)
            if playback.touch_force is not None:
                tails = touching_points(playback, k)
                for i, (tail, force) in enumerate(zip(tails, playback.touch_force[k], strict=True)):
                    self._writer.point(f"/touching/{i}", np.array([[tail, tail + self.scale.force * force]]))
            for i, segments in enumerate(self._coils(k)):
                self._writer.redraw(f"/springs/{i}", segments)
            for name, reserve in self._reserves.items():
                self._writer.paint(self._cones[name], markers.cone_colour(float(reserve[k])))

    def _coils(self, k: int) -> list[Array]:
        """Return the lines of every spring, and of every bushing from tip to contact, in frame k, world axes."""
        playback, chain = self.playback, self.playback.chain
        if not chain.springs and not chain.bushings:
            return []
        held = Pose.from_wxyz_xyz(playback.object_pose[k])
        ends = [(playback.tip[k, chain.names.index(n)], (held @ chain.grasps[n].frame).p) for n in chain.bushings]
        return [markers.coil(a, b, COIL_RADIUS * self._size) for a, b in (*spring_ends(playback, k), *ends)]

    def _point(self, name: str, k: int) -> None:
        """Set the arrows of one arm, which start at its tip; internal forces are drawn below the force."""
        playback, node, writer = self.playback, _node(name), self._writer
        i = playback.row(name)[0]
        tip, wrench = playback.tip[k, i], playback.wrench[k, i]
        internal = playback.internal[k, i, 3:] if playback.internal.size else None
        force, moment = self.scale.force * wrench[3:], self.scale.moment * wrench[:3]
        writer.point(f"/forces/{node}", np.array([[tip, tip + force]]))
        # a moment's arrow has two heads
        writer.point(f"/moments/{node}", np.array([[tip, tip + share * moment] for share in (1.0, 0.8)]))
        commanded = None if playback.commanded is None else playback.commanded[k, i, 3:]
        beside = wrench[3:] if internal is None else internal
        below = INTERNAL_OFFSET * self._size * _across(beside, -upward(playback.chain))
        for what, inside, rows in (("internal_force", internal, 1), ("commanded_force", commanded, 2)):
            if inside is not None:
                start = tip + rows * below
                writer.point(f"/{what}/{node}", np.array([[start, start + self.scale.force * inside]]))

    def _draw_arm(self, index: int, name: str, arm: Arm) -> list[str]:
        """Draw an arm and return the names of its joints' nodes, base to tip."""
        chain, base = self.playback.chain, Pose.from_wxyz_xyz(self.playback.base_pose[0, index])
        root, colour = _root(name), arm_colour(index)
        nodes = self._draw_links(root, base, name, arm.joints, meshes_of(visuals_of(arm)), colour, arm.parent_of)
        if not arm.parents:
            self._writer.mesh(f"{nodes[-1]}/(own)" if nodes else f"{root}/(hand)", self._hand(arm.tip), colour)
        for key in chain.grasps:
            if not isinstance(key, str) and key[0] == name:
                link, frame = arm.frame(key[1], name)
                self._writer.mesh(f"{nodes[link]}/(hand {_node(key[1])})", self._hand(frame), colour)
        up = base.R.T @ upward(chain)
        # bases of arms on a trunk and of others may be far away
        beside = arm.joints[0].placement.p if name in chain.mounts and arm.joints else np.zeros(3)
        if name not in chain.mounts:
            self._writer.mesh(f"{root}/(own)", foot(self._size, up), colour)
        # away from the other arms' names, which may be near: fingers of a hand
        apart = base.R.T @ (base.p - self.playback.base_pose[0, :, 4:].mean(axis=0))
        outward = apart - (apart @ up) * up
        outward = outward / max(float(np.linalg.norm(outward)), NAME_DEPTH * self._size)
        self._writer.label(f"{root}/(name)", name, beside + NAME_DEPTH * self._size * (outward - up))
        return nodes

    def _draw_trunk(self, trunk: Trunk) -> list[str]:
        """Draw the trunk, its base frame with axes, and return the names of its joints' nodes, base outward."""
        base, colour = Pose.from_wxyz_xyz(self.playback.trunk_pose[0]), figure_style.rgb(figure_style.TRUNK_COLOUR)
        visuals = meshes_of(visuals_of_trunk(self.playback.chain))
        serial = (None, *range(len(trunk.joints)))[:-1]
        nodes = self._draw_links(TRUNK_NODE, base, TRUNK, trunk.joints, visuals, colour, serial)
        # outside the floating body, which would hide them
        inside = 0.0 if trunk.floating is None else float(equivalent_box(trunk.floating)[0].max()) / 2
        self._writer.frame(f"{TRUNK_NODE}/(axes)", Pose.identity(), inside + 3 * AXES_LENGTH * self._widest)
        if trunk.floating is None:
            self._writer.mesh(f"{TRUNK_NODE}/(own)", foot(self._widest, base.R.T @ upward(self.playback.chain)), colour)
        return nodes

    def _draw_links(
        self,
        root: str,
        base: Pose,
        name: str,
        joints: Sequence[Joint],
        otherwise: list[list[LinkMesh]],
        colour: RGB,
        parents: Sequence[int | None],
    ) -> list[str]:
        """Draw base and links with the playback's visuals or the given ones; return the names of the joints' nodes.

        A node lies in that of the link, or base, on which its joint stands.

        Raises:
            ModelError: the number of visuals differs from that of the links.
        """
        nodes = [root]
        self._writer.frame(root, base)
        for k, (joint, parent) in enumerate(zip(joints, parents, strict=True)):
            stands = nodes[0 if parent is None else parent + 1]
            nodes.append(f"{stands}/{_node(joint.name or f'joint{k + 1}')}")
            self._writer.frame(nodes[-1], Pose.identity())
        visuals = self.playback.visuals.get(name) or otherwise
        if len(visuals) != len(nodes):
            raise ModelError(
                f"visuals of '{name}': expected {len(nodes)} lists, one for the base and"
                f" one for each link, got {len(visuals)}"
            )
        for node, link_meshes in zip(nodes, visuals, strict=True):
            for j, shade in enumerate(dict.fromkeys(piece.colour for piece in link_meshes)):
                whole = meshes.joined(piece.mesh for piece in link_meshes if piece.colour == shade)
                self._writer.mesh(f"{node}/({j})", whole, colour if shade is None else shade)
        return nodes[1:]

    def _hand(self, tip: Pose) -> TriangleMesh:
        """Return a thin tool from a link's origin to a disc at a tip, in the link's axes."""
        thin, length = TOOL_RADIUS * self._size, float(np.linalg.norm(tip.p))
        # slightly beyond the tip, to avoid flicker with surfaces that end there
        disc = Pose(tip.R, tip.p - 0.4 * thin * tip.R[:, 2])
        parts = [meshes.cylinder(DISC_RADIUS * self._size, thin).at(disc)]
        if length > 3 * thin:
            middle = Pose(rotation.exp(rotation.align(UP, tip.p / length)), tip.p / 2)
            parts.append(meshes.cylinder(thin, length - 2 * thin).at(middle))
        return meshes.joined(parts)

    def _draw_object(self, name: str, held: HeldObject) -> str:
        """Draw an object and return the name of its node; with several, each has a label."""
        chain, writer = self.playback.chain, self._writer
        node = "/object" if name == HELD_OBJECT else f"/objects/{_node(name)}"
        surface, outline, edges, box = drawn_object(held, solids_of(chain.touching, WORLD_SIZE * self._size))
        writer.frame(node, Pose.identity())
        writer.mesh(f"{node}/body", surface, OBJECT_GREY, OBJECT_OPACITY)
        lines = np.concatenate([outline, markers.struts(markers.contacts_on(chain, name), edges, box)])
        if len(lines):
            writer.lines(f"{node}/edges", lines, LINE_GREY, LINE_THICKNESS * self._size)
        if len(chain.free_objects) > 1:
            writer.label(f"{node}/(name)", name, box.p)
        return node

    def _draw_contacts(self) -> dict[str, str]:
        """Draw contact frames and friction cones on the bodies that carry them; return the cones' nodes by row."""
        writer, cones = self._writer, {}
        for row in self.playback.rows:
            if row.grasp is None:
                continue
            body, grasp = self._bodies[row.body], row.grasp
            writer.frame(f"{body}/contacts/{_node(row.name)}", grasp.frame, AXES_LENGTH * self._size)
            if grasp.contact is not None:
                cones[row.name] = f"{body}/cones/{_node(row.name)}"
                lines = markers.cone_lines(grasp.contact.mu, CONE_HEIGHT * self._size, grasp.frame)
                writer.lines(cones[row.name], lines, markers.cone_colour(1.0), LINE_THICKNESS * self._size)
        return cones

    def _draw_ground(self) -> None:
        """Draw a grid below the lowest base in the world; none without such a base or without gravity."""
        playback, chain = self.playback, self.playback.chain
        up = upward(chain)
        placed = [
            p for name, p in zip(chain.names, playback.base_pose[0, :, 4:], strict=True) if name not in chain.mounts
        ]
        if chain.trunk is not None and (not chain.floats or chain.gravity.any()):
            placed.append(playback.trunk_pose[0, 4:])
        if not placed:
            return
        bases = np.array(placed)
        middle = bases.mean(axis=0)
        middle = middle + ((bases @ up).min() - middle @ up) * up
        turn = rotation.exp(rotation.align(UP, up))
        span = 2.0 * float(np.linalg.norm(bases - middle, axis=1).max()) + 2.0 * self._widest
        cell = markers.one_two_five(span / 25)
        self._writer.grid("/ground", Pose(turn, middle), float(np.ceil(span / (10 * cell)) * 10 * cell), cell)

    def _draw_world(self) -> dict[str, tuple[str, Pose]]:
        """Draw what may touch, and arrows for the forces there; return node and pose in its shape of each surface."""
        touching = self.playback.chain.touching
        if touching is None:
            return {}
        drawn, near = {}, self.playback.object_pose[0, 4:]
        for name, shape in self.playback.touching[0].world.items():
            if (placed := placed_mesh(shape, near, WORLD_SIZE * self._size)) is not None:
                self._writer.frame(f"/world/{_node(name)}", placed[0])
                self._writer.mesh(f"/world/{_node(name)}/surface", placed[1], WORLD_GREY, WORLD_OPACITY)
                drawn[name] = f"/world/{_node(name)}", shape.pose.inverse() @ placed[0]
        (held,) = self._objects.values()
        for name, one in [*touching.points.items(), *touching.edges.items()]:
            if isinstance(one, Circle):
                at = "/world" if name in touching.edges else held
                thickness = LINE_THICKNESS * self._size
                self._writer.lines(f"{at}/(circle) {_node(name)}", circle_lines(one), LINE_GREY, thickness)
        if self.playback.touch_force is not None:
            for i in range(len(touching.candidates)):
                self._writer.arrows(f"/touching/{i}", 1, LINE_GREY, SHAFT_RADIUS * self._size)
        return drawn


def arm_colour(index: int) -> RGB:
    """Return the colour of the arm at an index of the chain's order, 0 to 255."""
    return figure_style.rgb(figure_style.arm_style(index)[0])


def foot(size: float, normal: Array) -> TriangleMesh:
    """Return a flat plate below a base.

    Args:
        size: size of the arm [m].
        normal: (3,) unit normal of the plate, base axes.
    """
    plate = Pose(rotation.exp(rotation.align(UP, normal)), np.zeros(3))
    return meshes.cylinder(FOOT_RADIUS * size, FOOT_HEIGHT * size).at(plate)


def _across(vector: Array, wanted: Array) -> Array:
    """Return the unit vector perpendicular to a vector that is nearest to a given direction."""
    size = float(np.linalg.norm(vector))
    along = vector / size if size > 0 else np.zeros(3)
    for direction in (wanted, *np.eye(3)):
        square = direction - (direction @ along) * along
        if (length := float(np.linalg.norm(square))) > 0.1:
            return square / length
    return wanted


def _root(name: str) -> str:
    """Return the node of an arm's base."""
    return f"/arms/{_node(name)}"


def _node(name: str) -> str:
    """Return a name as one component of a path, with a division sign in place of each slash.

    Nodes in parentheses are our own, so parentheses in names are others.
    """
    return name.replace("/", "\u2215").replace("(", "\u2768") or "\u2768"


CIRCLE_LINES = 48  # lines of a circle


def drawn_object(held: HeldObject, solids: Sequence[TriangleMesh] = ()) -> tuple[TriangleMesh, Array, Array, Pose]:
    """Return surface, outline (N, 2, 3), and edges (3,) and pose of the box around it, all in object axes [m].

    An object whose surface is not known or cannot be read is drawn as the solids with which it touches the world, or,
    without these, as the box with its inertia.
    """
    surface = surface_of_object(held)
    if solids and (surface is None or isinstance(surface, MeshFault)):
        surface = meshes.joined(solids)
    if surface is None or isinstance(surface, MeshFault):
        edges, box = equivalent_box(held)
        return meshes.box(edges).at(box), markers.box_lines(edges) @ box.R.T + box.p, edges, box
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    return surface, outline(held), high - low, Pose(np.eye(3), 0.5 * (low + high))


def outline(held: HeldObject) -> Array:
    """Return lines (N, 2, 3) that show the attitude of a shape: circles, rims and sides; none for one from a file."""
    match held.shape:
        case Sphere(radius):
            return np.concatenate([_circle(radius, axis, 0.0) for axis in range(3)])
        case Cylinder(radius, length):
            rims = [_circle(radius, 2, z) for z in (-length / 2, length / 2)]
            starts = rims[0][:: CIRCLE_LINES // 4, 0]
            return np.concatenate([*rims, np.stack([starts, starts + np.array([0.0, 0.0, length])], axis=1)])
    return np.zeros((0, 2, 3))


def _circle(radius: float, axis: int, height: float) -> Array:
    """Return a circle about an axis, at a height along it, as lines (CIRCLE_LINES, 2, 3)."""
    angles = np.linspace(0.0, 2 * np.pi, CIRCLE_LINES + 1)
    points = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(CIRCLE_LINES + 1, height)])
    points = np.roll(points, axis + 1, axis=1)
    return np.stack([points[:-1], points[1:]], axis=1)
