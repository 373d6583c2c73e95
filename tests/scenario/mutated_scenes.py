"""Scenes to spoil: sound ones of every kind, and ways to damage their text, their structure, or both."""

from __future__ import annotations

import copy
import json
import os
import random
import re
import tomllib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from tests.io.mutations import Where, at, places
from tests.robots.two_armed import TWO_ARMED
from tests.scenario.test_anchors import BESIDE_A_PANDA, SWAYING
from tests.scenario.test_build import MORE, SPRINGS, TEXT, through, with_schedule
from tests.scenario.test_controllers import FORCES, LIFT, law_with
from tests.scenario.test_robot import scene as scene_of_urdf
from tests.scenario.test_trunk_scenes import FLYER, TORSO
from tests.systems import mutated_text
from tests.systems.mutated_text import bytes_flipped, duplicated, recoded
from tests.systems.random_scenes import random_scene

SHORT = TEXT.replace("duration = 2.0", "duration = 0.002")
SWAY = (
    "base_motion = { shift = { amplitude = [0.01, 0, 0], frequency = [1, 0, 0] },"
    " turn = { amplitude = [0, 0.01, 0], frequency = [0, 1, 0], phase = [0, 1, 0] }, smooth_start = 0.2 }\n"
)
FULL = TEXT.replace("step = 0.002", 'step = 0.02\nscheme = "dop853"\nrtol = 1e-6\non_slip = "release"').replace(
    "[object]", SWAY + "\n[object]", 1
)
SAMPLED = "duration = 0.004\nlargest_drift = 1e-8\nsample_time = 3e-3\ndelay = 5e-4"
SPRUNG = (
    through()
    .replace("duration = 2.0", 'duration = 0.004\nscheme = "imex"')
    .replace("box = [0.3, 0.2, 0.2]", "sphere = 0.15")
    + SPRINGS
)
SWAYED = BESIDE_A_PANDA.replace("anchor = true\n", f"anchor = true\n{SWAYING}", 1)
BUSHED = SHORT.replace(
    'kind = "rigid"', 'kind = "bushing"\nstiffness = [100, 100, 100, 4e4, 4e4, 4e4]\ndamping = [1, 1, 1, 40, 40, 40]', 1
)
LIFTED = [LIFT, *(law_with(f"forces = {one}\nobserver = {{ gain = 100 }}", sampled=True) for one, _ in FORCES.values())]
SEEDS = (
    *(SHORT, FULL + MORE, FULL.replace("rigid", "ball").replace('"dop853"', '"midpoint"')),
    *(with_schedule().replace("duration = 2.0", SAMPLED), scene_of_urdf()),
    scene_of_urdf(urdf=", locked = { lift = 0.1 }", arm="q = [0.3, 1.0, 0.1]\ntip = { rpy = [0, 0, 1] }"),
    *(random_scene(seed) for seed in (0, 1, 4, 6, 8, 9, 12)),
    *(text.replace("duration = 1.0", "duration = 0.004") for text in LIFTED),
    *(TORSO, FLYER, BESIDE_A_PANDA, SWAYED, SPRUNG, BUSHED),
)
SOUND = [tomllib.loads(text) for text in SEEDS]


class Token(str):
    """A value that stands in the file as it is, whether TOML or not."""


NUMBERS = (
    *("nan", "-nan", "inf", "-inf", "1e308", "-1e308", "1e999", "1e-320", "1e-300", "1e-12", "0", "-0.0", "-1", "1"),
    *("1e9", "-1e9", "999999999.9", "1e-9", "1e4", "1e6", "9" * 5000, "-" + "9" * 400, "0x" + "f" * 5000, "1_0"),
    *("1__0", "01", "1.", ".5", "+5", "0o17", "0b1", "1e", "1979-05-27", "07:32:00", "0000-13-40", "true", "false"),
    *("\u0663", "\u22121", "\uff11", "1\u00a0", "1,0", "1.0f", "0.1 0.2"),
)
NAMES = (
    *("", " ", "left", "right", "arm0", "panda", "pandas", "ur5e", "rigid", "ball", "hinge", "release"),
    *("x" * 300_000, "x" * 65, "ab" * 128, "left_hand", "right_hand", "torso", "lift", "neck", "left_finger1"),
    *("\n", "a\nb", "\x1b[31m", "a\x00b", "\u2028", "\u202e", "\U0001f916", "\u0663", "e\u0301", "a/b", "a.b", "."),
    *("'", '"', "%s%n", "{x}", "[red]x[/red]", "__class__", "1e9", "$(arg x)", "\x7f", "\ufeff", "\ud7ff"),
)
FILES = (
    *("", ".", "..", "robots", "/", "/dev/zero", "/dev/null", "/dev/random", "/proc/self/mem", "robots/fifo"),
    *("robots/loop.urdf", "robots/empty.urdf", "robots/long.urdf", "robots/endless.urdf", "robots/two.urdf/"),
    *("robots//two.urdf", "scene.toml", "robots/two.urdf\n", "robots/two.urdf\x00", "\x00", "x" * 300_000, "~"),
    *("x/" * 3000, "robots/" + "y" * 300, "robots/none.xacro", "robots/empty.xacro", "<robot/>", "a\x1bb"),
    *("file:///etc/passwd", "http://localhost/r.urdf"),
)
NESTS = (
    *([], {}, [[]], [{}], [[], []], {"": {}}, [0.0], [0.0] * 3, [0.0] * 7, [[1.0, 0.0, 0.0]] * 3, [1e9] * 6, ["a"]),
    *(Token("[" * depth + "]" * depth) for depth in (30, 400, 50_000)),
    *(Token("{a=" * depth + "1" + "}" * depth) for depth in (30, 400, 50_000)),
    *(Token("[" + "0.5," * count + "]") for count in (100, 100_000)),
    *(Token("[" + "[0.5]," * count + "]") for count in (14, 10_000)),
)
MANY = (12, 300, 10_000)


def prepare(folder: Path) -> None:
    """Put what scenes name into a folder: robots, and things that are none."""
    robots = folder / "robots"
    robots.mkdir()
    (robots / "two.urdf").write_text(TWO_ARMED)
    (robots / "empty.urdf").write_text("")
    (robots / "empty.xacro").write_text("")
    (robots / "long.urdf").write_text(_arm(300))
    (robots / "endless.urdf").write_text(_arm(3000))
    (robots / "loop.urdf").symlink_to(robots / "loop.urdf")
    os.mkfifo(robots / "fifo")


def _arm(joints: int) -> str:
    """Return the URDF of an arm of so many joints."""
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = [f'<link name="l{k}">{body}</link>' for k in range(joints + 1)]
    axis = '<axis xyz="0 0 1"/><origin xyz="0.01 0 0.01" rpy="0.1 0.2 0.3"/>'
    for k in range(joints):
        ends = f'<parent link="l{k}"/><child link="l{k + 1}"/>'
        links.append(f'<joint name="j{k}" type="continuous">{ends}{axis}</joint>')
    return f'<robot name="long">{"".join(links)}</robot>'


def written(data: dict[str, Any]) -> str:
    """Return TOML of a scene's data: plain values first, then tables and arrays of tables."""
    plain, tables = [], []
    for key, value in data.items():
        if isinstance(value, dict) and not isinstance(value, str):
            tables += [f"[{_key(key)}]", *(f"{_key(k)} = {_inline(v)}" for k, v in value.items()), ""]
        elif isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
            for item in value:
                tables += [f"[[{_key(key)}]]", *(f"{_key(k)} = {_inline(v)}" for k, v in item.items()), ""]
        else:
            plain.append(f"{_key(key)} = {_inline(value)}")
    return "\n".join([*plain, "", *tables])


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _inline(key)


def _inline(value: Any) -> str:
    if isinstance(value, Token):
        return str(value)
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(k)} = {_inline(v)}" for k, v in value.items()) + " }"
    return repr(value)


# Mutations of the structure: of a scene's data in place.


def chosen(data: Any, dice: random.Random, kind: type | tuple[type, ...] = object) -> Where:
    """Return a place in the data at which something of a type stands."""
    found = [where for where in places(data) if isinstance(at(data, where), kind)]
    return dice.choice(found)


def odd_number(data: dict, dice: random.Random) -> None:
    """Put an odd number, or what looks like one, in place of a number."""
    put(data, chosen(data, dice, (int, float)), Token(dice.choice(NUMBERS)))


def other_number(data: dict, dice: random.Random) -> None:
    """Put another sound number in place of one, near or far."""
    where = chosen(data, dice, (int, float))
    x = float(at(data, where))
    put(data, where, dice.choice([-x, x + 0.1, 2 * x, 0.5 * x, 1e3 * x, 1e-3 * x, 1e6 * x, 0, 1, dice.gauss(0, 1)]))


def odd_text(data: dict, dice: random.Random) -> None:
    """Put an odd name or file in place of a text."""
    where = chosen(data, dice, str)
    put(data, where, dice.choice(FILES if where[-1] == "file" else NAMES))


def odd_file(data: dict, dice: random.Random) -> None:
    """Give an arm an odd URDF file."""
    arm = dice.choice(data["arms"])
    arm.pop("robot", None)
    arm["urdf"] = {**arm.get("urdf", {}), "file": dice.choice(FILES)}


def other_type(data: dict, dice: random.Random) -> None:
    """Put a value of another type somewhere: a number for a table, a nest for a number, another place's value."""
    where = chosen(data, dice)
    other = copy.deepcopy(at(data, chosen(data, dice)))
    put(data, where, dice.choice([Token(dice.choice(NUMBERS)), dice.choice(NAMES), dice.choice(NESTS), other]))


def taken_out(data: dict, dice: random.Random) -> None:
    """Take out a key or an item."""
    where = chosen(data, dice)
    del at(data, where[:-1])[where[-1]]


def renamed(data: dict, dice: random.Random) -> None:
    """Rename a key: mistyped, odd, or another's."""
    where = dice.choice([where for where in places(data) if isinstance(where[-1], str)])
    parent, key = at(data, where[:-1]), where[-1]
    assert isinstance(key, str)
    k = dice.randrange(len(key)) if key else 0
    name = dice.choice([key[:k] + key[k + 1 :], key.upper(), dice.choice(NAMES), str(chosen(data, dice)[-1])])
    items = [(name if key == k else k, v) for k, v in parent.items()]
    parent.clear()
    parent.update(items)


def exchanged(data: dict, dice: random.Random) -> None:
    """Exchange two values."""
    one, other = chosen(data, dice), chosen(data, dice)
    if one != other[: len(one)] and other != one[: len(other)]:
        a, b = at(data, one), at(data, other)
        put(data, one, b)
        put(data, other, a)


def grafted(data: dict, dice: random.Random) -> None:
    """Give a table a key that another scene's table of the same name has."""
    where = dice.choice([(), *(where for where in places(data) if isinstance(at(data, where), dict))])
    key, value = dice.choice(GRAFTS[_room(where)]) if _room(where) in GRAFTS else ("x", 1)
    at(data, where)[key] = copy.deepcopy(value)


def doubled(data: dict, dice: random.Random) -> None:
    """Repeat the items of a list."""
    where = chosen(data, dice, list)
    put(data, where, at(data, where) * 2)


def multiplied(data: dict, dice: random.Random) -> None:
    """Give a scene very many arms, events, pieces, coefficients or the like; alike, or each its own."""
    data["simulation"].setdefault("breakpoints", [1e-5])
    where = chosen(data, dice, list)
    items, count, own = at(data, where), dice.choice(MANY), dice.random() < 0.6
    put(data, where, [_numbered(items[k % len(items)], k, len(items)) if own else items[0] for k in range(count)])


def _numbered(item: Any, k: int, first: int) -> Any:
    """Return an item as the k-th of many: names and times of its own after the first ones."""
    if k < first or not isinstance(item, dict):
        return item + 1e-6 * k if isinstance(item, float) else item
    names = {key: f"{item[key]}{k}" for key in ("name",) if key in item}
    return item | names | {key: item[key] + 1e-6 * k for key in ("t", "begin") if key in item}


def put(data: dict, where: Where, value: Any) -> None:
    """Put a value at a place."""
    at(data, where[:-1])[where[-1]] = value


def _room(where: Where) -> str:
    """Return the name of the table at a place."""
    return next((key for key in reversed(where) if isinstance(key, str)), "")


def _grafts() -> dict[str, list[tuple[str, Any]]]:
    """Return every key and value of every scene by its table's name."""
    found: dict[str, list[tuple[str, Any]]] = {}
    for scene in SOUND:
        for where in [(), *places(scene)]:
            if isinstance(table := at(scene, where), dict):
                found.setdefault(_room(where), []).extend(table.items())
    return found


GRAFTS = _grafts()


# Mutations of the text.

LETTERS = "abcxyz_[]{}\"'=#.,\\ \t\n"
VALUE = re.compile(r"= *(\S.*)")
KEY = re.compile(r"\w+ *=")
BRACKET = re.compile(r"[\[\]{}\"=,]")


def mistyped(text: str, dice: random.Random) -> str:
    """Return the text with one letter changed, dropped or doubled."""
    return mutated_text.mistyped(text, dice, LETTERS)


def deleted(text: str, dice: random.Random) -> str:
    """Return the text without its end, a line, a value, a key or a bracket."""
    return mutated_text.deleted(text, dice, VALUE, KEY, BRACKET)


def shuffled(text: str, dice: random.Random) -> str:
    """Return the text with two values, keys or headers exchanged."""
    return mutated_text.exchanged(text, dice, r"= *(\S.*)", r"(\w+) *=", r"(\[+\w+\]+)", r"([\d.]+)")


def stretched(text: str, dice: random.Random) -> str:
    """Return the text with a very long line, key, text or path of keys, or very many empty lines or comments."""
    where = text.index("\n", dice.randrange(len(text) - 1)) if "\n" in text[:-1] else 0
    kinds = (
        "#" + "x" * 3_000_000,
        "x" * 300_000 + " = 1",
        f'x = "{"y" * 3_000_000}"',
        ".".join(["x"] * dice.choice([30, 900, 30_000])) + " = 1",
        "[" + ".".join(["x"] * dice.choice([30, 900, 30_000])) + "]",
        "\n" * 1_000_000,
        "# \u2713\n" * 300_000,
        "\n".join(f"x{k} = {k}" for k in range(100_000)),
        "\n".join(f"[x{k}.y.z]" for k in range(30_000)),
        "x = [" + "\n" * 300_000 + "1]",
    )
    return text[:where] + "\n" + dice.choice(kinds) + text[where:]


def spelt(text: str, dice: random.Random) -> bytes:
    """Return the text with other line ends, a byte order mark, other digits or NULs."""
    kinds: tuple[Callable[[bytes], bytes], ...] = (
        lambda data: data.replace(b"\n", b"\r\n"),
        lambda data: data.replace(b"\n", b"\r"),
        lambda data: b"\xef\xbb\xbf" + data,
        lambda data: data.replace(b"0", "\u0660".encode(), dice.randrange(1, 4)),
        lambda data: data.replace(b" ", "\u00a0".encode(), dice.randrange(1, 4)),
        lambda data: data.replace(b"\n", b"\x00\n", 1),
        lambda data: data + b"\x00" * 1000,
        lambda data: data.replace(b'"', b'"""', dice.randrange(1, 5)),
        lambda data: data.replace(b'"', b"'"),
        lambda data: data.replace(b"\n", b"", dice.randrange(1, 3)),
        lambda data: data.upper(),
    )
    return dice.choice(kinds)(text.encode())


def hollow(text: str, dice: random.Random) -> str:
    """Return almost nothing, or something that is no scene at all."""
    kinds = ("", " \n", "=", "[", "[[arms]]", "[arms]", "arms = []", "arms = 1", '{"arms": []}', "<robot/>", "\x00")
    return dice.choice([*kinds, "# nothing", "a.b.c = 1", text.replace('"', ""), text.replace("=", ":"), text * 2])


OF_STRUCTURE: dict[Callable[[dict, random.Random], None], int] = {  # how often
    odd_number: 20,
    other_number: 40,
    odd_text: 8,
    odd_file: 3,
    other_type: 8,
    taken_out: 6,
    renamed: 3,
    exchanged: 6,
    grafted: 14,
    doubled: 2,
    multiplied: 5,
}
OF_TEXT: dict[Callable[[str, random.Random], str | bytes], int] = {
    mistyped: 8,
    deleted: 6,
    duplicated: 4,
    shuffled: 8,
    stretched: 2,
    spelt: 4,
    bytes_flipped: 4,
    recoded: 2,
    hollow: 1,
}


def mutated(seed: int) -> tuple[str, bytes]:
    """Return the name of a mutation, and the mutated scene; often mutated more than once."""
    dice = random.Random(seed)
    which, spoil_text = dice.randrange(len(SEEDS)), dice.random() < 0.25
    count = dice.choice([0, 0, 1, 2] if spoil_text else [1, 1, 1, 2, 3])
    steps = dice.choices(list(OF_STRUCTURE), list(OF_STRUCTURE.values()), k=count)
    data = copy.deepcopy(SOUND[which])
    for step in steps:
        with suppress(IndexError, KeyError, TypeError, AttributeError, ValueError):  # nothing is left for this one
            step(data, dice)
    made: str | bytes = written(data) if steps else SEEDS[which]
    name = steps[-1].__name__ if steps else ""
    if spoil_text:
        (mutation,) = dice.choices(list(OF_TEXT), list(OF_TEXT.values()))
        name = mutation.__name__
        with suppress(IndexError, ValueError):
            made = mutation(made, dice)
    return name, made if isinstance(made, bytes) else made.encode("utf-8", "surrogatepass")
