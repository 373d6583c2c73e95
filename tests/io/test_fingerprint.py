"""A model's fingerprint tells two models apart by one bit, and is the same in every process."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from holdfast import Pose
from holdfast.io.fingerprint import fingerprint
from holdfast.robots import panda

CODE = "from holdfast.io.fingerprint import fingerprint; from holdfast.robots import panda; print(fingerprint(panda()))"


def test_same_model_same_text():
    """Made twice, and in another process."""
    assert fingerprint(panda()) == fingerprint(panda())
    elsewhere = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    assert elsewhere.stdout.strip() == fingerprint(panda())


def test_one_bit_tells():
    """In a mass, an inertia, a name, a base, or the order of joints."""
    arm = panda()
    link, joint = arm.links[3], arm.joints[3]
    heavier = replace(link, mass=float(np.nextafter(link.mass, np.inf)))
    moved = replace(link, com=link.com + np.array([0.0, 0.0, 1e-16]))
    others = [
        replace(arm, links=(*arm.links[:3], heavier, *arm.links[4:])),
        replace(arm, links=(*arm.links[:3], moved, *arm.links[4:])),
        replace(arm, joints=(*arm.joints[:3], replace(joint, name="elbow"), *arm.joints[4:])),
        replace(arm, joints=arm.joints[::-1]),
        arm.at(Pose.translation(0.0, 0.0, 1e-300)),
    ]
    found = {fingerprint(model) for model in (arm, *others)}
    assert len(found) == 1 + len(others)


def test_what_is_no_number_has_no_part():
    """Functions and files would differ in every process."""
    assert fingerprint({"mass": 1.0, "draw": print}) == fingerprint({"mass": 1.0, "draw": Path("mesh.obj")})
    assert fingerprint(["ab", "c"]) != fingerprint(["a", "bc"])
    assert fingerprint([1, [2]]) != fingerprint([[1], 2])
