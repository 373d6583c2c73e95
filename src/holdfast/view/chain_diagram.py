"""A drawing of a chain's structure: for each arm a row with its base, joints and grasp, and the object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from itertools import accumulate
from typing import NamedTuple

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_rows import grasp_rows
from holdfast.model.joint import Joint
from holdfast.model.trunk import TRUNK
from holdfast.view.diagram_rows import Branch, branches_of
from holdfast.view.figure_style import TRUNK_COLOUR, arm_style

DRAWN_ARMS, DRAWN_JOINTS = 16, 8  # chains with more arms are not drawn; of more joints, the first and the last
DRAWN_IN_BRANCHES = 16  # joints one behind the other beyond which arms with branches are not drawn
ROW_HEIGHT, JOINT_WIDTH, RADIUS, LETTER_WIDTH = 34, 24, 6, 7  # pixels
KIND_WIDTH, OBJECT_WIDTH = 90, 64  # widths of a grasp's kind and of the object [pixels]
GREY = "#8a8a92"


def chain_diagram(chain: ClosedChain) -> str:
    """Return an SVG image of a chain's structure; empty for more arms and branches than can be told apart.

    An arm extends from its base, which is hatched if it is fixed in the world, over its joints to an object. Circles
    are revolute joints, double ones spherical, squares prismatic, dashed ones have no drive, and a diamond is the
    grasp. Branches of an arm have rows of their own; dashed lines are loops. Arms on a trunk begin at its vertical
    line.
    """
    arms = {name: branches_of(chain, name) for name in chain.arms}
    joints = max(branch.end for branches in arms.values() for branch in branches)
    if sum(map(len, arms.values())) > DRAWN_ARMS or (chain.beyond_serial and joints > DRAWN_IN_BRANCHES):
        return ""
    first = dict(zip(arms, accumulate(map(len, arms.values()), initial=0), strict=False))
    rows = {name: [ROW_HEIGHT * (0.5 + first[name] + k) for k in range(len(found))] for name, found in arms.items()}
    height = ROW_HEIGHT * sum(map(len, arms.values()))
    left = 0.0 if chain.trunk is None else 30.0 + _length(chain.trunk.joints)
    start = left + 20.0 + LETTER_WIDTH * max(map(len, arms))
    shown = joints if chain.beyond_serial else min(joints, DRAWN_JOINTS)
    contact = start + JOINT_WIDTH * (shown + 0.5) + KIND_WIDTH
    parts = [] if chain.trunk is None else _trunk(chain, left, height, {name: ys[0] for name, ys in rows.items()})
    boxes, width = _objects(chain, arms, rows, contact)
    parts += [part for box in boxes.values() for part in box.drawn]
    for index, (name, branches) in enumerate(arms.items()):
        parts += _arm(chain, name, branches, rows[name], arm_style(index)[0], left, start, boxes)
    parts += _loops(chain, arms, rows, start, boxes)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" width="{width:g}" height="{height:g}"'
        f' viewBox="0 0 {width:g} {height:g}" font-family="sans-serif" font-size="12" fill="currentColor">'
        f"<title>structure of the chain</title>{''.join(parts)}</svg>"
    )


class _Box(NamedTuple):
    """An object: where its left edge and its middle are, and its parts."""

    x: float
    y: float
    drawn: Sequence[str]


def _objects(
    chain: ClosedChain, arms: Mapping[str, Sequence[Branch]], rows: Mapping[str, Sequence[float]], contact: float
) -> tuple[dict[str, _Box], float]:
    """Return the objects that are held, as boxes beside all rows that hold them, and the width of the image."""
    held: dict[str, list[float]] = {}
    for name, branches in arms.items():
        for branch, y in zip(branches, rows[name], strict=True):
            if branch.key is not None:
                held.setdefault(chain.held_by(chain.grasps[branch.key], branch.key), []).append(y)
    boxes: dict[str, _Box] = {}
    columns: list[float] = []  # lowest end of the boxes in each
    for name, ys in sorted(held.items(), key=lambda one: min(one[1])):
        top, bottom = min(ys) - 0.4 * ROW_HEIGHT, max(ys) + 0.4 * ROW_HEIGHT
        column = next((k for k, low in enumerate(columns) if low < top), len(columns))
        columns[column : column + 1] = [bottom]
        x, y = contact + column * (OBJECT_WIDTH + 24), 0.5 * (top + bottom)
        one = chain.free_objects[name]
        mass = f"{one.mass:.4g} kg" if isinstance(one.mass, float) else ""
        words = [mass] if len(chain.free_objects) == 1 or bottom - top < ROW_HEIGHT else [name, mass]
        texts = [
            _text(x + OBJECT_WIDTH / 2, y + 4 + 14 * (k - (len(words) - 1) / 2), word, "middle")
            for k, word in enumerate(words)
        ]
        box = (
            f'<rect x="{x:g}" y="{top:g}" width="{OBJECT_WIDTH}" height="{bottom - top:g}" rx="4" fill="{GREY}"'
            f' fill-opacity="0.25" stroke="{GREY}"/>'
        )
        boxes[name] = _Box(x, y, [box, *texts])
    return boxes, contact + max(len(columns), 1) * (OBJECT_WIDTH + 24) - 20


def _arm(
    chain: ClosedChain,
    name: str,
    branches: Sequence[Branch],
    rows: Sequence[float],
    colour: str,
    left: float,
    start: float,
    boxes: Mapping[str, _Box],
) -> list[str]:
    """Return an arm's rows: its name, base, joints and grasps."""
    parts, y = [], rows[0]
    for branch, here in zip(branches, rows, strict=True):
        joints = [chain.arms[name].joints[k] for k in branch.joints]
        begin = start + JOINT_WIDTH * branch.column
        reach = JOINT_WIDTH * len(joints) if chain.beyond_serial else _length(joints) - 0.5 * JOINT_WIDTH
        end = begin + reach + 0.8 * JOINT_WIDTH
        grasp = None if branch.key is None else chain.grasps[branch.key]
        if grasp is not None:
            end = boxes[chain.held_by(grasp, branch.key)].x
        fork = begin + (0.25 * JOINT_WIDTH if branch.origin is not None else 0.0)
        if branch.origin is not None:
            parts.append(_line(fork, rows[branch.origin], fork, here, colour))
        parts += [
            _line(fork, here, end, here, colour),
            *_joints(joints, begin, here, colour, bool(chain.beyond_serial)),
        ]
        if grasp is not None:
            parts.append(
                f'<path d="M{end - 8:g} {here:g}l8 -6l8 6l-8 6z" fill="{colour}"/>'
                + _text(end - 12, here - 5, grasp.kind, "end")
            )
    if name in chain.mounts:
        return [*parts, _line(left, y, start, y, TRUNK_COLOUR), _text(left + 6, y - 4, name)]
    return [*parts, _ground(start, y, colour), _text(start - 10, y + 4, name, "end")]


def _loops(
    chain: ClosedChain,
    arms: Mapping[str, Sequence[Branch]],
    rows: Mapping[str, Sequence[float]],
    start: float,
    boxes: Mapping[str, _Box],
) -> list[str]:
    """Return the loops as dashed lines between links or objects; those with other ends are left out."""
    found, places = chain.as_forest, {}
    for name, branches in arms.items():
        for branch, y in zip(branches, rows[name], strict=True):
            for k, joint in enumerate(branch.joints):
                places[found.arms[name][joint]] = (start + JOINT_WIDTH * (branch.column + k + 1.25), y)
    places |= {found.objects[name]: (box.x + OBJECT_WIDTH - 6, box.y) for name, box in boxes.items()}
    drawn = []
    for row in grasp_rows(chain) if chain.beyond_serial else ():
        closure = found.forest.closures[found.closures[row.key]]
        if row.key not in chain.grasps and closure.a in places and closure.b in places:
            (x1, y1), (x2, y2) = places[closure.a], places[closure.b]
            drawn.append(
                f'<path d="M{x1:g} {y1:g}L{x2:g} {y2:g}" stroke="{GREY}" stroke-width="2" stroke-dasharray="4 3">'
                f"<title>{escape(row.name)}</title></path>"
            )
    return drawn


def _trunk(chain: ClosedChain, left: float, height: float, rows: dict[str, float]) -> list[str]:
    """Return the trunk: its base, its joints, and the vertical line at which the arms on it begin."""
    joints = chain.joints_of.get(TRUNK, ())
    mounted = [rows[name] for name in chain.mounts] or [height / 2]
    y, start = 0.5 * (min(mounted) + max(mounted)), left - _length(joints) - 14.0
    base = _ground(start, y, TRUNK_COLOUR)
    if chain.floats:
        base = f'<rect x="{start - 12:g}" y="{y - 9:g}" width="18" height="18" rx="3" fill="{TRUNK_COLOUR}"/>'
    upright = _line(left, min(mounted), left, max(mounted), TRUNK_COLOUR)
    return [
        _line(start, y, left, y, TRUNK_COLOUR), base, upright, *_joints(joints, start, y, TRUNK_COLOUR),
        _text(start - 12, y + 22, TRUNK),
    ]  # fmt: skip


def _length(joints: Sequence[Joint]) -> float:
    """Return the width of a row of joints [pixels]."""
    return JOINT_WIDTH * (min(len(joints), DRAWN_JOINTS) + 0.5)


def _joints(joints: Sequence[Joint], start: float, y: float, colour: str, every: bool = False) -> list[str]:
    """Return the joints of a row, from its base, as circles and squares; a number counts those that are omitted.

    Args:
        joints: the joints.
        start: where the row begins.
        y: height of the row.
        colour: of the arm.
        every: whether none is omitted.
    """
    ends = DRAWN_JOINTS // 2
    whole = every or len(joints) <= DRAWN_JOINTS
    shown = [*joints] if whole else [*joints[: ends - 1], None, None, *joints[-ends + 1 :]]
    parts = []
    for k, joint in enumerate(shown):
        x = start + JOINT_WIDTH * (k + 0.75)
        if joint is None:
            if k == ends - 1:
                parts.append(_text(x + JOINT_WIDTH / 2, y - 5, f"+ {len(joints) - len(shown) + 2}", "middle"))
        else:
            dashes = "" if joint.actuated else ' stroke-dasharray="3 2"'
            half, look = RADIUS, f'fill="white" stroke="{colour}" stroke-width="2"{dashes}/>'
            circle = f'<circle cx="{x:g}" cy="{y:g}" r="{half}" {look}'
            square = f'<rect x="{x - half:g}" y="{y - half:g}" width="{2 * half}" height="{2 * half}" {look}'
            parts.append(circle if joint.turns else square)
            if joint.type.quaternion:
                parts.append(f'<circle cx="{x:g}" cy="{y:g}" r="{half / 3:g}" fill="{colour}"/>')
    return parts


def _ground(x: float, y: float, colour: str) -> str:
    """Return a base that is fixed in the world, hatched on its left."""
    hatches = "".join(f"M{x - 5:g} {y + dy + 4:g}l5 -4" for dy in (-8, -3, 2, 7))
    return f'<path d="M{x:g} {y - 10:g}v20{hatches}" stroke="{colour}" stroke-width="2" fill="none"/>'


def _line(x1: float, y1: float, x2: float, y2: float, colour: str) -> str:
    return f'<path d="M{x1:g} {y1:g}L{x2:g} {y2:g}" stroke="{colour}" stroke-width="2"/>'


def _text(x: float, y: float, text: str, anchor: str = "start") -> str:
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(text)}</text>'
