"""Whatever is wrong with a case file, one line says where; nothing else is ever raised."""

import contextlib
import json
import random

import numpy as np
import pytest

from holdfast.cli import main
from holdfast.errors import SceneError
from holdfast.io.case_file import load_cases
from tests.io.mutations import CASES, arm_with, at, path, places, renamed, replaced, small_case, with_token, without

PLACES = list(places(small_case()))
KEYS = [where for where in PLACES if isinstance(where[-1], str)]
NUMBERS = [where for where in PLACES if isinstance(at(small_case(), where), float)]
OPTIONAL = {"expected", "W", "omega_dot", "v_dot"}
HINGE, SOFT, BALL, RIGID = (arm_with(kind) for kind in ("hinge", "softfinger", "ball", "rigid"))
FIRST = ("arms", 0)
LINK, JOINT = (*FIRST, "links", 2), (*FIRST, "joints", 1)


@pytest.fixture
def write(tmp_path):
    """Return a function that writes data or text to a file and returns its path."""

    def write(content):
        file = tmp_path / "case.json"
        if isinstance(content, bytes):
            file.write_bytes(content)
        else:
            file.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
        return file

    return write


def refusal(file) -> str:
    """Return the message of the refusal, without the file's name; one line."""
    with pytest.raises(SceneError) as caught:
        load_cases(file)
    text = str(caught.value)
    assert text.startswith(f"{file}: "), text
    assert "\n" not in text
    return text.removeprefix(f"{file}: ")


def assert_cli_refuses(file, capsys, start: str) -> None:
    """Assert exit code 2, nothing on stdout and one line on stderr that starts so."""
    assert main(["solve", str(file), "--format", "json"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"holdfast: error: {file}: {start}"), err
    assert err.count("\n") == 1


def is_optional(where) -> bool:
    """Return whether the format can do without this key."""
    return where[-1] in OPTIONAL or (where[-1] in ("omega", "v") and where[-2] == "base")


def test_the_small_case_is_sound(write):
    """Every mutation below starts from a file that loads."""
    (case,) = load_cases(write(small_case()))
    assert case.chain.joint_count == sum(len(arm["q"]) for arm in small_case()["arms"])


def require_free_arm(file, where) -> None:
    """An arm without a grasp is free, so that no relative rate is expected of it."""
    i = where[1]
    if small_case()["expected"]["W_dot"][i]:
        assert refusal(file).startswith(f"$.expected.W_dot[{i}]: expected 0 numbers, got ")
    else:
        assert f"arm{i + 1}" not in load_cases(file)[0].chain.grasps


@pytest.mark.parametrize("where", KEYS, ids=path)
def test_missing_or_misspelt_key(where, write):
    """A missing key is named where it is missing; an unknown one is refused, with a suggestion."""
    file = write(without(where))
    if is_optional(where):
        assert len(load_cases(file)) == 1
    elif where[-1] == "grasp":
        require_free_arm(file, where)
    elif where[-1] == "h_object":
        assert refusal(file).startswith(f"{path(where)}: expected ")
    else:
        assert refusal(file) == f"{path(where[:-1])}: Object missing required field `{where[-1]}`"
    wrong = where[-1] + "x"
    text = refusal(write(renamed(where, wrong)))
    assert text.startswith(f"{path(where[:-1])}: Object contains unknown field `{wrong}`.")
    assert f" Did you mean '{where[-1]}'?" in text or (
        len(where[-1]) < 3 and (" Did you" in text or " Known: " in text)
    )


def one_of_three_soon(where):
    """Return places for parameters, two of three of which are `slow`."""
    return [pytest.param(x, marks=[pytest.mark.slow] if k % 3 else []) for k, x in enumerate(where)]


JUNK = ("text", None, True, [], {}, [[]])


@pytest.mark.parametrize("where", one_of_three_soon(PLACES), ids=path)
def test_wrong_type_or_length(where, write):
    """A value of another type, or a list one item too short or too long, is refused at its place."""
    was = at(small_case(), where)
    for junk in JUNK:
        nothing = junk is None and where[-1] in ("expected", "W")
        if was == junk or nothing or (junk == "text" and where == ("name",)):
            load_cases(write(replaced(where, junk)))
        elif junk is None and where[-1] == "grasp":
            require_free_arm(write(replaced(where, junk)), where)
        else:
            assert refusal(write(replaced(where, junk))).startswith(path(where))
    if not isinstance(was, list) or where == ("arms",):  # any number of arms is fine
        return
    for items in (was[:-1], [*was, *was[-1:]]):
        if items != was:  # the list of joints sets the length of all the others
            start = path(where[:-1] if where[-1] == "joints" else where)
            assert refusal(write(replaced(where, items))).startswith(start)


def test_arms_beyond_the_answer(write):
    """An arm taken out leaves an answer for four: its shape is refused."""
    case = small_case()
    del case["arms"][-1]
    assert refusal(write(case)) == "$.expected.qdd: expected 3 lists, one per arm, got 4"


@pytest.mark.parametrize("where", one_of_three_soon(NUMBERS), ids=path)
def test_extreme_numbers(where, write):
    """What is not finite is refused by its path; near the end of the range files load or are refused."""
    for token in ("NaN", "-Infinity", "1e999"):
        assert refusal(write(with_token(where, token))).startswith(f"{path(where)}: expected a finite number, got ")
    for value in (-1e308, 1e200, 10**400):
        with contextlib.suppress(SceneError):
            load_cases(write(replaced(where, value)))


IMPOSSIBLE = [
    (LINK, {"mass": -1.0}, ".mass: expected > 0, got -1.0"),
    (LINK, {"inertia": [[1, 0, 0], [0, 1, 0], [0, 0, 3]]}, ".inertia: no mass distribution has principal moments"),
    (LINK, {"inertia": [[1, 0, 0], [0, -1, 0], [0, 0, 1]]}, ".inertia: expected principal moments >= 0"),
    (LINK, {"inertia": [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]}, ".inertia: expected a symmetric matrix"),
    (JOINT, {"axis": [0, 0, 2.0]}, ".axis: expected a unit vector, got length 2"),
    (JOINT, {"R0": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, ".R0: expected a rotation matrix"),
    (JOINT, {"R0": [[1, 0, 0], [0, 1, 0.01], [0, 0, 1]]}, ".R0: expected a rotation matrix"),
    (JOINT, {"type": "revolut"}, ".type: Invalid enum value 'revolut'. Did you mean 'revolute'?"),
    ((*FIRST, "base"), {"R": [[0, 0, 0]] * 3}, ".R: expected a rotation matrix"),
    (("object",), {"mass": 0.0}, ".mass: expected > 0, got 0.0"),
    (("object",), {"inertia": [[0] * 3] * 3}, ".inertia: expected principal moments > 0"),
    (("arms", HINGE, "grasp"), {"h_object": [[0, 3.0, 0]]}, ".h_object[0]: expected a unit vector, got length 3"),
    (("arms", SOFT, "grasp"), {"h_object": [[1, 0, 0], [0, 0, 0.9]]}, ".h_object[1]: expected a unit vector"),
    (("arms", SOFT, "grasp"), {"h_object": [[1, 0, 0], [0.6, 0.8, 0]]}, ".h_object: expected perpendicular tangents"),
    (("arms", SOFT, "grasp"), {"h_object": [[1, 0, 0]]}, ".h_object: expected 2 unit vectors for a softfinger, got 1"),
    (("arms", RIGID, "grasp"), {"h_object": [[1, 0, 0]]}, ".h_object: expected 0 unit vectors for a rigid, got 1"),
    (("arms", BALL, "grasp"), {"W": [0.0, 0.0]}, ".W: expected 3 relative rates for a ball, got 2"),
    (("arms", RIGID, "grasp"), {"W": [0.0]}, ".W: expected 0 relative rates for a rigid, got 1"),
    (("arms", BALL, "grasp"), {"type": "bal"}, ".type: Invalid enum value 'bal'. Did you mean 'ball'?"),
    (FIRST, {"q": [0.0]}, ".q: expected 6 entries, one per joint, got 1"),
    (FIRST, {"tau": [0.0] * 9}, ".tau: expected 6 entries, one per joint, got 9"),
    (FIRST, {"joints": []}, ".joints: expected at least one joint, got none"),
    ((), {"arms": []}, ".arms: expected at least one arm, got none"),
    (("expected",), {"alpha_C": [0.0] * 5}, ".alpha_C: expected 6 numbers, got 5"),
    (("expected",), {"f": [[0.0] * 6]}, ".f: expected 4 lists, one per arm, got 1"),
]


@pytest.mark.parametrize(("where", "change", "problem"), IMPOSSIBLE, ids=lambda value: str(value)[:40])
def test_impossible_values(where, change, problem, write, capsys):
    """What cannot exist is refused at its place, in every shape of file, by the program too."""
    case, other = small_case(), small_case() | {"name": "sound"}
    at(case, where).update(change)
    for content, root in (
        (case, "$"),
        ([other, case], "$[1]"),
        ({"format": "x", "cases": [other, case]}, "$.cases[1]"),
    ):
        file = write(content)
        assert refusal(file).startswith(root + path(where)[1:] + problem)
    assert_cli_refuses(file, capsys, root + path(where)[1:] + problem)


DEEP = "[" * 100_000
FILES = {
    "empty": (b"", "is empty"),
    "blank": (b" \n ", "is empty"),
    "binary": (bytes(range(256)), "not valid JSON: "),
    "truncated": (json.dumps(small_case())[:-5], "not valid JSON: Expecting ',' delimiter (line 1, column "),
    "trailing comma": ('{"name": "a",}', "not valid JSON: "),
    "two documents": ("{} {}", "not valid JSON: Extra data (line 1, column 4)"),
    "nested": (DEEP, "not valid JSON: "),
    "nested and closed": (DEEP + DEEP.replace("[", "]"), "not valid JSON: "),
    "nested in a case": ('{"cases": [' + DEEP + DEEP.replace("[", "]") + "]}", "not valid JSON: "),
    "no UTF-8": (b'{"name": "\xff"}', "not valid JSON: "),
    "half a surrogate": (b'{"name": "\\ud800"}', "not valid JSON: "),
    "endless integer": ("1" * 10_000, "not valid JSON: "),
    "a number": ("5", "$: Expected `object`, got `int`"),
    "list of numbers": ("[1, 2]", "$[0]: Expected `object`, got `int`"),
    "empty list": ("[]", "$: expected at least one case, got none"),
    "no cases": ('{"cases": []}', "$: expected at least one case, got none"),
    "cases no list": ('{"cases": {}}', "$.cases: Expected `array`, got `object`"),
    "cases misspelt": ('{"casses": []}', "$: Object contains unknown field `casses`. Did you mean 'cases'?"),
    "empty object": ("{}", "$: Object missing required field `cases`"),
}


@pytest.mark.parametrize("kind", FILES)
def test_no_case_file(kind, write, capsys):
    """Files of another kind altogether."""
    content, problem = FILES[kind]
    file = write(content)
    assert refusal(file).startswith(problem)
    assert_cli_refuses(file, capsys, problem)


def test_no_file(tmp_path, capsys):
    """A missing file, a directory, a path no file system takes."""
    for file, problem in ((tmp_path / "none.json", "No such file"), (tmp_path, "Is a directory")):
        assert refusal(file).startswith(f"cannot be read: {problem}")
        assert_cli_refuses(file, capsys, f"cannot be read: {problem}")
    with pytest.raises(SceneError, match="cannot be read"):
        load_cases("a\0b")


def test_duplicate_names(write, capsys):
    """Names tell cases apart; one used twice is refused, line ends in it or not."""
    case = small_case() | {"name": "twice\nand again"}
    file = write([case, small_case(), case])
    problem = r"$[2].name: duplicate name 'twice\nand again', first used at $[0]"
    assert refusal(file) == problem
    assert_cli_refuses(file, capsys, problem)


@pytest.mark.parametrize("seed", range(60))
def test_random_damage(seed, write):
    """Three random pieces of junk anywhere: the file loads, or one line says where it does not."""
    rng = random.Random(seed)
    case = small_case()
    for _ in range(3):
        where = rng.choice(list(places(case)))
        junk = rng.choice([None, True, -1, 0, 1e308, 1e-308, "", "rigid", [], {}, [0.0] * 3, [[1.0, 0.0, 0.0]] * 3])
        at(case, where[:-1])[where[-1]] = junk
    try:
        load_cases(write(case))
    except SceneError as refused:
        text = str(refused)
        assert ": $" in text
        assert "\n" not in text


def test_rates_may_be_given_in_part(write):
    """A W left out is the one the velocities imply; with none given there is nothing to compare."""
    whole = load_cases(write(small_case()))[0].rates
    assert whole is not None
    case = small_case()
    del case["arms"][BALL]["grasp"]["W"]
    np.testing.assert_allclose(load_cases(write(case))[0].rates, whole, atol=1e-13)
    for arm in case["arms"]:
        arm["grasp"].pop("W", None)
    assert load_cases(write(case))[0].rates is None


def test_nearly_unit_values_are_mended(write):
    """Rounding to seven digits is no error: rotations, axes and tangents are made exact."""
    case = json.loads(json.dumps(small_case()), parse_float=lambda text: round(float(text), 7))
    (loaded,) = load_cases(write(case))
    for arm in loaded.chain.arms.values():
        for joint in arm.joints:
            R = joint.placement.R
            np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
            assert abs(np.linalg.norm(joint.axis) - 1) < 1e-14


def test_every_stored_case_loads(write):
    """All stored cases, in one file and one by one."""
    assert len(load_cases(write({"cases": CASES}))) == len(CASES)
    for case in CASES[:3]:
        assert load_cases(write(case))[0].name == case["name"]
