"""A drawing of a chain's structure: for each arm a row with its base, joints and grasp, and the object."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from holdfast.model.closed_chain import TRUNK, ClosedChain
from holdfast.model.joint import Joint
from holdfast.view.figure_style import TRUNK_COLOUR, arm_style

DRAWN_ARMS, DRAWN_JOINTS = 16, 8  # chains with more arms are not drawn; of more joints, the first and the last
ROW_HEIGHT, JOINT_WIDTH, RADIUS, LETTER_WIDTH = 34, 24, 6, 7  # pixels
KIND_WIDTH, OBJECT_WIDTH = 90, 64  # widths of a grasp's kind and of the object [pixels]
GREY = "#8a8a92"


def chain_diagram(chain: ClosedChain) -> str:
    """Return an SVG image of a chain's structure; empty for more arms than can be told apart.

    An arm extends from its base, which is hatched if it is fixed in the world, over its joints to the object. Circles
    are revolute joints, squares prismatic ones, and a diamond is the grasp. Arms on a trunk begin at its vertical line.
    """
    arms = list(chain.arms)
    if not 0 < len(arms) <= DRAWN_ARMS:
        return ""
    rows = {name: ROW_HEIGHT * (0.5 + k) for k, name in enumerate(arms)}
    height = ROW_HEIGHT * len(arms)
    left = 0.0 if chain.trunk is None else 30.0 + _length(chain.trunk.joints)
    start = left + 20.0 + LETTER_WIDTH * max(map(len, arms))
    longest = max(_length(arm.joints) for arm in chain.arms.values())
    contact = start + longest + KIND_WIDTH
    parts = [] if chain.trunk is None else _trunk(chain, left, height, rows)
    holding = [rows[name] for name in chain.grasps]
    if holding:
        top, bottom = min(holding) - 0.4 * ROW_HEIGHT, max(holding) + 0.4 * ROW_HEIGHT
        parts.append(
            f'<rect x="{contact}" y="{top:g}" width="{OBJECT_WIDTH}" height="{bottom - top:g}" rx="4" fill="{GREY}"'
            f' fill-opacity="0.25" stroke="{GREY}"/>'
        )
        mass = f"{chain.held_object.mass:.4g} kg" if isinstance(chain.held_object.mass, float) else ""
        parts.append(_text(contact + OBJECT_WIDTH / 2, 0.5 * (top + bottom) + 4, mass, "middle"))
    for index, name in enumerate(arms):
        parts += _arm(chain, name, arm_style(index)[0], left, start, rows[name], contact)
    width = contact + OBJECT_WIDTH + 4
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" width="{width:g}" height="{height:g}"'
        f' viewBox="0 0 {width:g} {height:g}" font-family="sans-serif" font-size="12" fill="currentColor">'
        f"<title>structure of the chain</title>{''.join(parts)}</svg>"
    )


def _arm(chain: ClosedChain, name: str, colour: str, left: float, start: float, y: float, contact: float) -> list[str]:
    """Return an arm's row: its name, base, joints and grasp."""
    joints, grasp = chain.arms[name].joints, chain.grasps.get(name)
    end = contact if grasp is not None else start + _length(joints) + 0.3 * JOINT_WIDTH
    parts = [_line(start, y, end, y, colour), *_joints(joints, start, y, colour)]
    if name in chain.mounts:
        parts += [_line(left, y, start, y, TRUNK_COLOUR), _text(left + 6, y - 4, name)]
    else:
        parts += [_ground(start, y, colour), _text(start - 10, y + 4, name, "end")]
    if grasp is not None:
        parts.append(
            f'<path d="M{contact - 8:g} {y:g}l8 -6l8 6l-8 6z" fill="{colour}"/>'
            + _text(contact - 12, y - 5, grasp.kind, "end")
        )
    return parts


def _trunk(chain: ClosedChain, left: float, height: float, rows: dict[str, float]) -> list[str]:
    """Return the trunk: its base, its joints, and the vertical line at which the arms on it begin."""
    joints = () if chain.trunk is None else chain.trunk.joints
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


def _joints(joints: Sequence[Joint], start: float, y: float, colour: str) -> list[str]:
    """Return the joints of a row, from its base, as circles and squares; a number counts those that are omitted."""
    ends = DRAWN_JOINTS // 2
    shown = [*joints] if len(joints) <= DRAWN_JOINTS else [*joints[: ends - 1], None, None, *joints[-ends + 1 :]]
    parts = []
    for k, joint in enumerate(shown):
        x = start + JOINT_WIDTH * (k + 0.75)
        if joint is None:
            if k == ends - 1:
                parts.append(_text(x + JOINT_WIDTH / 2, y - 5, f"+ {len(joints) - len(shown) + 2}", "middle"))
        else:
            half, look = RADIUS, f'fill="white" stroke="{colour}" stroke-width="2"/>'
            circle = f'<circle cx="{x:g}" cy="{y:g}" r="{half}" {look}'
            square = f'<rect x="{x - half:g}" y="{y - half:g}" width="{2 * half}" height="{2 * half}" {look}'
            parts.append(circle if joint.turns else square)
    return parts


def _ground(x: float, y: float, colour: str) -> str:
    """Return a base that is fixed in the world, hatched on its left."""
    hatches = "".join(f"M{x - 5:g} {y + dy + 4:g}l5 -4" for dy in (-8, -3, 2, 7))
    return f'<path d="M{x:g} {y - 10:g}v20{hatches}" stroke="{colour}" stroke-width="2" fill="none"/>'


def _line(x1: float, y1: float, x2: float, y2: float, colour: str) -> str:
    return f'<path d="M{x1:g} {y1:g}L{x2:g} {y2:g}" stroke="{colour}" stroke-width="2"/>'


def _text(x: float, y: float, text: str, anchor: str = "start") -> str:
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(text)}</text>'
