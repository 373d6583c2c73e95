"""The page of the scene format has every key with its default, every word, and nothing that is not there."""

import re
import tomllib
import typing

import msgspec
import pytest

from holdfast.robots import ROBOTS
from holdfast.scenario import scene, world_tables
from tests.docs.pages import DOCS

PAGE = (DOCS / "scenes.md").read_text(encoding="utf-8")
TABLE = re.compile(
    r"^\| (?P<of>[^\n|]+) \| value \| default \| meaning \|\n\|[-|]+\|\n(?P<rows>(?:\|.*\n)+)", re.MULTILINE
)
NONE = "\N{EN DASH}"


def structs(kind) -> list[type[msgspec.Struct]]:
    """Return the structures inside a type such as `list[ArmTable] | None`."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return [kind]
    return [found for argument in typing.get_args(kind) for found in structs(argument)]


def words(kind) -> set[str]:
    """Return the values of every Literal inside a type."""
    if typing.get_origin(kind) is typing.Literal:
        return set(typing.get_args(kind))
    return {word for argument in typing.get_args(kind) for word in words(argument)}


def reached(struct, known=frozenset()) -> set[type[msgspec.Struct]]:
    """Return known structures, another one and all those that its keys hold."""
    found = {*known, struct}
    for inside in (inside for key in msgspec.structs.fields(struct) for inside in structs(key.type)):
        found |= set() if inside in found else reached(inside, found)
    return found


STRUCTS = reached(scene.SceneTable) | {world_tables.ShapeTable}  # its keys are those of all shapes


def holder(of: str) -> type[msgspec.Struct]:
    """Return the structure of a table's heading: a `type = "tag"`, a path, else names of keys that hold the same."""
    if tag := re.fullmatch(r"`type = \"(\w+)\"`", of):
        (found,) = {struct for struct in STRUCTS if struct.__struct_config__.tag == tag[1]}
        return found
    if path := re.fullmatch(r"`(\w+)\.(\w+)`", of):
        (outer,) = structs(typing.get_type_hints(scene.SceneTable)[path[1]])
        (found,) = structs(typing.get_type_hints(outer)[path[2]])
        return found
    if top := re.fullmatch(r"`\[+(\w+)\]+`", of):
        found = structs(typing.get_type_hints(scene.SceneTable)[top[1]])
        return found[0] if len(found) == 1 else _of_keys(of)
    return _of_keys(of)


def _of_keys(of: str) -> type[msgspec.Struct]:
    """Return the structure that the keys in a heading hold."""
    names = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`]+)`", of))))
    if not names:
        return scene.SceneTable
    held = [key for struct in STRUCTS for key in msgspec.structs.fields(struct) if key.name in names]
    found = {struct for key in held for struct in structs(key.type)}
    (one,) = found if len(found) == 1 else set.intersection(*({*struct.__bases__} for struct in found))
    return one


ROWS: dict[type[msgspec.Struct], list[list[str]]] = {
    holder(table["of"]): [[cell.strip() for cell in row.split("|")[1:-1]] for row in table["rows"].splitlines()]
    for table in TABLE.finditer(PAGE)
}


def own_keys(struct) -> dict[str, msgspec.structs.FieldInfo]:
    """Return the keys of a structure by name, without those of another one to which the page refers."""
    keys = {key.name: key for key in msgspec.structs.fields(struct)}
    above = STRUCTS & {*struct.__bases__} | ({scene.HoldTable} if struct is scene.LoopTable else set())
    return {name: key for name, key in keys.items() if not any(hasattr(one, name) for one in above)}


def test_every_table():
    """Each structure that a scene can hold has a table, and no other."""
    assert set(ROWS) == STRUCTS


@pytest.mark.parametrize("struct", sorted(STRUCTS, key=lambda struct: struct.__name__))
def test_every_key(struct):
    """Its table has its keys, all of them once, and their defaults as one would write them."""
    keys = own_keys(struct)
    assert {name.strip("`") for name, *_ in ROWS[struct]} == set(keys)
    assert len(ROWS[struct]) == len(keys)
    for name, _, default, _ in ROWS[struct]:
        key = keys[name.strip("`")]
        if key.required or default == "required":
            assert key.required and default == "required", name
        elif default == NONE:
            assert key.default is None, name
        else:
            given = key.default if key.default_factory is msgspec.NODEFAULT else key.default_factory()
            written = tomllib.loads(f"default = {default.strip('`')}")["default"]
            assert msgspec.convert(written, key.type) == given, name


def test_every_word():
    """Each word that a key takes is there as one would write it, the robots' names too."""
    types = [key.type for struct in STRUCTS for key in msgspec.structs.fields(struct)]
    tags = {str(struct.__struct_config__.tag) for struct in STRUCTS} - {"None"}
    for word in set(ROBOTS) | tags | {word for kind in types for word in words(kind)}:
        assert f'`"{word}"`' in PAGE, word
