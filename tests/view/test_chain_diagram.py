"""The drawing of a chain's structure has what the chain has, whatever its state."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import holdfast as hf
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.view.chain_diagram import DRAWN_ARMS, DRAWN_JOINTS, chain_diagram
from tests.control.two_pandas import two_pandas
from tests.systems.branched import branched_problems
from tests.systems.trunk_problems import random_on_trunk

SVG = "{http://www.w3.org/2000/svg}"


def drawn(chain):
    """Return the parts of a chain's drawing by tag, after checking that each is inside the image."""
    root = ElementTree.fromstring(chain_diagram(chain))
    width, height = float(root.get("width")), float(root.get("height"))
    for one in root.iter(f"{SVG}text"):
        letters, x = 7.5 * len(one.text or ""), float(one.get("x"))
        begin = x - {"start": 0.0, "middle": 0.5, "end": 1.0}[one.get("text-anchor")] * letters
        assert begin >= -4 and begin + letters <= width + 4 and 0 < float(one.get("y")) <= height + 2, one.text
    tags = {tag: list(root.iter(f"{SVG}{tag}")) for tag in ("text", "circle", "rect")}
    return tags, [one.text for one in tags["text"] if one.text]


def test_two_arms():
    """A circle for every joint that turns, the names, the kinds of the grasps, the object with its mass."""
    chain, _ = two_pandas("softfinger", "ball")
    parts, words = drawn(chain)
    assert len(parts["circle"]) == 14 and len(parts["rect"]) == 1
    assert sorted(words) == ["3 kg", "ball", "left", "right", "softfinger"]
    assert chain_diagram(chain) in chain._repr_html_()


def test_slides_many_joints_and_what_holds_nothing():
    """A square for a joint that slides; of many joints the first and last; long names; no object without a grasp."""
    joints = [Joint("prismatic" if k == 0 else "revolute", [0, 0, 1]) for k in range(12)]
    arm = hf.Arm(joints, [Link(1.0, np.zeros(3), 0.1 * np.eye(3))] * 12)
    chain = hf.ClosedChain({"an arm with <a long> name": arm}, hf.HeldObject.box(1.0, 0.1, 0.1, 0.1), {})
    parts, words = drawn(chain)
    assert len(parts["rect"]) == 1 and len(parts["circle"]) == 5
    assert sorted(words) == ["+ 6", "an arm with <a long> name"]


@pytest.mark.parametrize("floating", [True, False])
def test_trunks(floating):
    """The trunk's joints are there once, its floating base is a box, and the arms on it are named."""
    chain = random_on_trunk(3, 2, floating=floating).chain
    parts, words = drawn(chain)
    shown = [j for js in chain.joints_of.values() for j in (js if len(js) <= DRAWN_JOINTS else [*js[:3], *js[-3:]])]
    turning = sum(joint.turns for joint in shown)
    assert len(parts["circle"]) == turning
    assert len(parts["rect"]) == len(shown) - turning + bool(chain.grasps) + floating
    assert {"trunk", *chain.arms} <= set(words)


def test_too_many_arms():
    """What could not be told apart is not drawn; the table is still there."""
    chain, _ = two_pandas()
    many = replace(chain, arms={f"arm{k}": chain.arms["left"] for k in range(DRAWN_ARMS + 1)}, grasps={})
    assert chain_diagram(many) == "" and many._repr_html_().count("<tr>") == DRAWN_ARMS + 3


def test_branches():
    """Branches have rows of their own, every joint its place, and every object a box; a passive joint is dashed."""
    for name, p in branched_problems().items():
        parts, words = drawn(p.chain)
        joints = p.chain.all_joints
        spheres = sum(joint.type.quaternion for joint in joints)
        assert len(parts["circle"]) == sum(joint.turns for joint in joints) + spheres
        boxes = len(parts["rect"]) - sum(not joint.turns for joint in joints) - p.chain.floats
        assert boxes == len({p.chain.held_by(grasp, key) for key, grasp in p.chain.grasps.items()})
        dashed = [one for one in parts["circle"] if one.get("stroke-dasharray")]
        assert len(dashed) == sum(not joint.actuated for joint in joints)
        assert {grasp.kind for grasp in p.chain.grasps.values()} <= set(words), name
        assert chain_diagram(p.chain) in p.chain._repr_html_()
    places = [(one.get("cx"), one.get("cy")) for one in parts["circle"]]
    assert len(set(places)) == len(places) - spheres


def test_loops():
    """A loop is a dashed line that names it."""
    chain = branched_problems()["pot and lid"].chain
    assert chain_diagram(chain).count("<title>knob</title>") == 1
    alone = branched_problems()["palletiser"].chain
    assert chain_diagram(alone).count("<title>robot/level</title>") == 1
