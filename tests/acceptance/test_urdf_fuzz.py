"""Mutated URDFs and meshes: each is a clear error of ours, or a valid arm or surface, in bounded time and memory."""

from __future__ import annotations

import random
import re
import resource
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from holdfast import HoldfastError
from holdfast.robots.urdf import UrdfChain, load_urdf_arms, read_urdf, urdf_chain, urdf_tree, urdf_visuals
from tests.robots.arm_dynamics import mass_jacobian_bias
from tests.robots.mesh_files.test_mesh_files import fuzz as fuzz_meshes
from tests.robots.two_armed import TWO_ARMED
from tests.systems import mutated_text
from tests.systems.mutated_text import bytes_flipped

SECONDS = 10.0  # a file of 100,000 elements, all others take milliseconds
GIGABYTES = 1.0
TAG = re.compile(r"<[a-z0-9_]+[^<>]*>")
VALUE = re.compile(r'"([^"]*)"')
ATTRIBUTE = re.compile(r' [a-z]+="[^"]*"')
# fmt: off
ODD_VALUES = (
    "nan", "inf", "-inf", "1e999", "1e308", "-1e308", "1e-320", "0", "-0", "-1", "1,0", "0x10", "1_0", "1.0f", "1e9",
    "1e-300", "true", "None", "${x}", "\u0663", "\u22121", "&#48;", "&lt;", "'", "%s%n", "../../etc", "\U0001f916",
    "fixed", "floating", "planar", "ball", "base", "torso", "left_hand", "left_elbow", "x" * 300_000, "", " ",
    "\n", "\t", "1 2", "1 2 3 4", "a b c", "$(arg x)", "9" * 5000, "1 " * 50_000,
    "0 0 0", "1e9 1e9 1e9", "1e200 0 0", "1e-200 0 0",
)
ENCODINGS = (
    "utf-16", "utf-32", "latin-1", "cp037", "shift_jis", "utf-7", "ascii", "bogus", "utf-8", "idna", "rot13", "hex",
)
# fmt: on


def entity_bomb(text: str, dice: random.Random) -> str:
    """Return the text with entities that would grow to a gigabyte, or that read a file."""
    levels = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 10))
    kinds = [
        f'<!DOCTYPE robot [<!ENTITY e0 "0123456789">{levels}]>',
        '<!DOCTYPE robot [<!ENTITY e9 SYSTEM "file:///etc/passwd">]>',
        f'<!DOCTYPE robot [<!ENTITY e9 "{"0" * 100_000}">]>',
        '<!DOCTYPE robot SYSTEM "http://localhost/robot.dtd">',
        "<!DOCTYPE robot [<!ENTITY % p \"<!ENTITY e9 '1'>\"> %p;]>",
    ]
    head, body = text.split("?>\n", 1)
    body = VALUE.sub('"&e9;"', body, count=dice.randrange(4))
    return f"{head}?>\n{dice.choice(kinds)}\n{body}"


def deep(text: str, dice: random.Random) -> str:
    """Return the text with elements nested far too deep, or a chain of very many links."""
    where, depth = text.rindex("</robot>"), dice.choice([50, 200, 100_000])
    if dice.random() < 0.5:
        return text[:where] + "<gazebo>" * depth + "</gazebo>" * depth + text[where:]
    kinds = ("fixed", "continuous", "floating")
    links = []
    for k in range(min(depth, 14_000)):
        parent = f"l{k - 1}" if k and dice.random() < 0.99 else "left_hand"
        links.append(f'<link name="l{k}"/><joint name="j{k}" type="{dice.choice(kinds)}"><child link="l{k}"/>')
        links.append(f'<parent link="{parent}"/><mimic joint="j{k - 1}"/></joint>')
    return text[:where] + "".join(links) + text[where:]


def encoded(text: str, dice: random.Random) -> bytes:
    """Return the text in one encoding, declared as another, perhaps cut or with stray bytes."""
    declared = text.replace("UTF-8", dice.choice(ENCODINGS)).replace("two_armed", "zw\u00f6i\u2713", 1)
    return mutated_text.recoded(declared, dice)


def mistyped(text: str, dice: random.Random) -> str:
    """Return the text with one letter of one word changed, dropped or doubled."""
    return mutated_text.mistyped(text, dice, "abcxyz<>&\"'/= ")


def odd_value(text: str, dice: random.Random) -> str:
    """Return the text with one attribute's value replaced by an odd one, or by another's."""
    values = list(VALUE.finditer(text))
    value = dice.choice(values)
    other = dice.choice(ODD_VALUES) if dice.random() < 0.7 else dice.choice(values)[1]
    return text[: value.start(1)] + other + text[value.end(1) :]


def deleted(text: str, dice: random.Random) -> str:
    """Return the text without one tag, one attribute, one line, or everything beyond a point."""
    return mutated_text.deleted(text, dice, TAG, ATTRIBUTE)


def duplicated(text: str, dice: random.Random) -> str:
    """Return the text with one tag, line or block repeated, a few or very many times, here or elsewhere."""
    return mutated_text.duplicated(text, dice, first=2)


def shuffled(text: str, dice: random.Random) -> str:
    """Return the text with two attribute values exchanged: links re-hung, joints in circles."""
    kinds = (r'link="([^"]*)"', r'joint="([^"]*)"', r'name="([^"]*)"', r'"([^"]*)"', r'type="([^"]*)"')
    return mutated_text.exchanged(text, dice, *kinds)


def hollow(text: str, dice: random.Random) -> str:
    """Return almost nothing, or something that is no robot at all."""
    kinds = ["", " \n", "<", "<robot>", "<robot/>", "<a/>", "</robot>", "<!-- -->", '{"robot": 1}', "robot:\n - a"]
    kinds += ["\x00" * 100, '<robot name="r"><link/></robot>', '<robot><link name="a"/></robot>', text.replace('"', "")]
    return dice.choice(kinds)


MUTATIONS = (odd_value, mistyped, deleted, duplicated, shuffled, bytes_flipped, encoded, deep, entity_bomb, hollow)
WEIGHTS = (30, 20, 15, 10, 15, 8, 8, 2, 2, 2)
PAIR = {"left": ("torso", "left_hand"), "right": ("torso", "right_hand")}
OPTIONS = (
    {"base": "torso", "tip": "left_grasp", "lock_others": True},
    {"tip": "right_grasp", "lock_others": True},
    {"tip": "left_hand", "lock_others": True, "locked": {"lift": 0.1}},
    {"base": "left_grasp", "tip": "right_grasp", "lock_others": True, "physical": False},
    {"base": "torso", "tip": "right_hand", "locked": {"right_finger1": 0.02}},
)


def mutated(seed: int) -> tuple[str, bytes]:
    """Return the name of a mutation, and the mutated file; often mutated more than once."""
    dice = random.Random(seed)
    mutation = dice.choices(MUTATIONS, WEIGHTS)[0]
    text = TWO_ARMED
    for _ in range(dice.choice([0, 0, 1, 2])):
        text = dice.choice([odd_value, shuffled, duplicated])(text, dice) if len(text) < 1_000_000 else text
    try:
        made = mutation(text, dice)
    except (IndexError, ValueError):  # an earlier mutation left nothing for this one
        made = text
    return mutation.__name__, made if isinstance(made, bytes) else made.encode("utf-8", "surrogatepass")


def use(path: Path, seed: int) -> tuple[str, str]:
    """Return 'loaded' or 'refused' and why, after every function that takes a file."""
    options = OPTIONS[seed % len(OPTIONS)]
    try:
        assert urdf_tree(read_urdf(path)).replace("\n", "").isprintable()
        chain = urdf_chain(path, **options)
        check(chain)
        arms = load_urdf_arms(path, PAIR, lock_others=True, locked={"lift": 0.1})
        assert all(np.isfinite(arm.base.p).all() for arm in arms.values())
    except HoldfastError as refusal:
        said = str(refusal)
        assert re.match(rf"{re.escape(str(path))}:\d+: \S", said), said[:300]  # file, line, element
        assert len(said) < 3000, said[:300]
        assert "\n" not in said, said[:300]
        return "refused", said[len(str(path)) + 1 :]
    return "loaded", ""


def check(chain: UrdfChain) -> None:
    """Check that an arm is finite and its mass matrix no less than semidefinite."""
    urdf_visuals(chain)
    n = chain.arm.joint_count
    if n > 50:
        return
    M, J, bias = mass_jacobian_bias(chain.arm, np.full(n, 0.3), np.full(n, 0.2))
    assert np.isfinite(M).all() and np.isfinite(J).all() and np.isfinite(bias).all()
    assert np.linalg.eigvalsh(M)[0] >= -1e-6 * np.abs(M).max()


def fuzz(seeds: range, folder: Path) -> Counter[tuple[str, str]]:
    """Return how often each mutation loaded and was refused."""
    counts: Counter[tuple[str, str]] = Counter()
    path = folder / "mutated.urdf"
    for seed in seeds:
        name, data = mutated(seed)
        path.write_bytes(data)
        start = time.process_time()
        outcome, _ = use(path, seed)
        assert time.process_time() - start < SECONDS, (seed, name)
        counts[name, outcome] += 1
    return counts


def test_mutated_files(tmp_path):
    """60 mutated files: none escapes as another exception."""
    counts = fuzz(range(60), tmp_path)
    assert {outcome for _, outcome in counts} == {"loaded", "refused"}


@pytest.mark.long
def test_3000_mutated_files(tmp_path):
    """3,000 mutated files, of every kind, in bounded time and memory."""
    before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    counts = fuzz(range(3000), tmp_path)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 2**20
    for mutation in MUTATIONS:
        name = mutation.__name__
        print(f"{name:14s} {counts[name, 'loaded']:5d} loaded {counts[name, 'refused']:5d} refused")
    print(f"{sum(counts.values())} files, {time.process_time() - start:.0f} s, {grown:.2f} GiB more at most")
    assert grown < GIGABYTES


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.skipif(sys.platform != "linux", reason="needs limits of memory as on Linux")
def test_mutated_meshes(tmp_path):
    """6,000 mutated files of every kind."""
    read, refused = fuzz_meshes(300, 6300, tmp_path)
    assert read + refused == 6000
    assert min(read, refused) > 300
