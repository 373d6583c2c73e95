"""Real robots from wheels on PyPI (`make robots`): every arm loads or is refused by name, and agrees with Pinocchio."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from holdfast import HoldfastError
from holdfast.robots.urdf import UrdfChain, UrdfRobot, read_urdf, urdf_chain, urdf_visuals
from holdfast.robots.urdf.document import Element
from holdfast.robots.urdf.vocabulary import VOCABULARY, is_off, of_drive
from tests.acceptance.comparison import relative
from tests.robots.arm_dynamics import mass_jacobian_bias

pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")
from tests.robots.pinocchio_urdf import Models

FOLDER = Path(os.environ.get("HOLDFAST_ROBOTS", "results/robots"))
TOLERANCE = 1e-10
NAMED = re.compile(r"^.*:\d+: \S")  # file, line, element
STATES = 2
PAIRS = 12  # of base and tip anywhere in the robot


def gaps(models: Models, chain: UrdfChain, rng: np.random.Generator) -> np.ndarray:
    """Return the relative gaps of M, J and bias, the worst over states."""
    worst, least = np.zeros(3), models.rounding(chain)
    for _ in range(STATES):
        q, qd = rng.uniform(-1.5, 1.5, (2, chain.arm.joint_count))
        M, J, bias = mass_jacobian_bias(chain.arm, q, qd)
        M_pin, J_pin, bias_pin = models.mass_jacobian_bias(chain, q, qd)
        torque = max(float(np.abs(M_pin).max()) * float(qd @ qd), 10 * least)  # where gravity does no work
        gap = [relative(M, M_pin, least), relative(J, J_pin), relative(bias, bias_pin, torque)]
        worst = np.maximum(worst, gap)
    return worst


def pairs(robot: UrdfRobot, rng: np.random.Generator) -> list[tuple[str, str]]:
    """Return base and tip of every arm from the root to a leaf, and some between any two links."""
    leaves = [link for link in robot.links if not robot.joints_below[link]]
    links = list(robot.links)
    chosen = [tuple(rng.choice(links, 2)) for _ in range(PAIRS)]
    return [(robot.root, leaf) for leaf in leaves] + [(str(a), str(b)) for a, b in chosen]


def urdf_files() -> list[Path]:
    """Return the fetched files, one of each content."""
    found: dict[bytes, Path] = {}
    for path in sorted(FOLDER.rglob("*.urdf")):
        found.setdefault(path.read_bytes(), path)
    return list(found.values())


def compare(path: Path) -> tuple[Counter[str], np.ndarray]:
    """Return how many arms of a file load, or are refused and why, and the worst gaps."""
    rng, counts, worst = np.random.default_rng(0), Counter[str](), np.zeros(3)
    try:
        robot = read_urdf(path)
    except HoldfastError as refusal:
        return Counter({named(refusal, path): 1}), worst
    models = read_by_pinocchio(path)
    for base, tip in pairs(robot, rng):
        try:
            chain = load(path, base, tip, counts)
        except HoldfastError as refusal:
            counts[kind(named(refusal, path))] += 1
            continue
        try:
            urdf_visuals(chain)
        except HoldfastError as refusal:
            counts[named(refusal, path)] += 1
        counts["arms" if models else "arms that Pinocchio does not read"] += 1
        if models:
            worst = np.maximum(worst, gaps(models, chain, rng))
    return counts, worst


def read_by_pinocchio(path: Path) -> Models | None:
    """Return Pinocchio's models of a file, None if it refuses it."""
    try:
        return Models(path.read_text(encoding="utf-8"))
    except ValueError:
        return None


def named(refusal: HoldfastError, path: Path) -> str:
    """Return a refusal without its folder; it must name file, line and element."""
    assert NAMED.match(str(refusal)), refusal
    return str(refusal).replace(f"{path.parent}/", "")


def load(path: Path, base: str, tip: str, counts: Counter[str]) -> UrdfChain:
    """Return an arm, with impossible inertias if it has some."""
    try:
        return urdf_chain(path, base=base, tip=tip, lock_others=True)
    except HoldfastError as refusal:
        if "physical=False" not in str(refusal):
            raise
        counts["physical=False"] += 1
        return urdf_chain(path, base=base, tip=tip, lock_others=True, physical=False)


def kind(refusal: str) -> str:
    """Return a refusal in a few words."""
    kinds = {
        "expected a joint that moves": "no joint",
        "expected <inertial>": "no <inertial>",
        "mimic:": "mimic",
        "moves link": "mimic",  # lock_others holds all but those that follow the arm's own joints
        "principal moments >= 0": "inertia < 0",
        "type:": "joint type",
        "gravity off": "gravity off",
        "closes a loop": "loop",
    }
    return next((short for words, short in kinds.items() if words in refusal), refusal)


@pytest.mark.long
@pytest.mark.skipif(not any(FOLDER.rglob("*.urdf")), reason="no robots fetched: make robots")
def test_real_robots():
    """Every arm between root and leaves, and between any two links: loads and agrees, or is refused by name."""
    total, robots, overall = Counter[str](), 0, np.zeros(3)
    for path in urdf_files():
        counts, worst = compare(path)
        total, robots, overall = total + counts, robots + (counts["arms"] > 0), np.maximum(overall, worst)
        facts = ", ".join(f"{count} {what}" for what, count in counts.items())
        print(f"{path.name:45s} M {worst[0]:.1e}  J {worst[1]:.1e}  bias {worst[2]:.1e}  {facts}")
    print(f"{robots} robots, {total['arms']} arms: M {overall[0]:.1e}, J {overall[1]:.1e}, bias {overall[2]:.1e}")
    print("; ".join(f"{count} {what}" for what, count in total.items() if len(what) < 40))
    assert robots >= 30
    assert overall.max() <= TOLERANCE


INSIDE = {  # elements of extensions, and the row of the elements in them
    "gazebo": "gazebo", "transmission": "transmission", "ros2_control": "ros2_control", "actuator": "transmission part",
    "leftActuator": "transmission part", "rightActuator": "transmission part", "joint": "transmission part",
    "passive_joint": "transmission part", "gap_joint": "transmission part", "rollJoint": "transmission part",
    "flexJoint": "transmission part",
}  # fmt: skip


def elements(robot: UrdfRobot) -> Iterator[tuple[str, Element]]:
    """Yield each element of a file that stands beside visuals, sensors and plugins, with the effect of its row."""
    waiting = [(child, "robot") for child in robot.element.children]
    for element, row in waiting:  # the loop appends to this list
        effect = VOCABULARY[row].effect(element.tag) or ("read" if of_drive(element.tag) else "")
        yield effect, element
        if effect == "read" and row == "robot" and element.tag in ("link", "joint"):
            waiting += [(child, element.tag) for child in element.children]
        elif effect == "read" and element.tag in INSIDE:
            waiting += [(child, INSIDE[element.tag]) for child in element.children]


@pytest.mark.long
@pytest.mark.skipif(not any(FOLDER.rglob("*.urdf")), reason="no robots fetched: make robots")
def test_every_element():
    """Each element of every real robot is read, noted, refused, or has no effect; what has no row is noted by name."""
    counts, files = Counter[str](), 0
    for path in urdf_files():
        try:
            robot = read_urdf(path)
        except HoldfastError as refusal:
            counts["files refused"] += bool(named(refusal, path))
            continue
        files += 1
        parts = [robot, *robot.links.values(), *robot.joints.values()]
        noted = {note.rpartition(": ")[0] for part in parts for note in part.notes}
        coupled = {coupling.element for coupling in robot.couplings}
        for effect, element in elements(robot):
            counts[effect or "unknown"] += 1
            if effect == "refused":
                assert element in coupled
            elif effect == "" or (effect == "noted" and not is_off(element)):
                place = element.message("").rstrip(": ")
                assert place in noted or any(note.startswith(place) for note in noted), place
    print(f"{files} files;", ", ".join(f"{count} {effect}" for effect, count in sorted(counts.items())))
    assert files >= 160
    assert counts["refused"] >= 6  # the grippers of the PR2
    assert counts["read"] > 10_000
