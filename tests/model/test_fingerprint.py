"""A model's fingerprint tells two models apart by one bit, and is the same in every process."""

import functools
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import MethodType
from typing import NamedTuple

import numpy as np

from holdfast import HeldObject, Joint, Pose
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest
from holdfast.model.fingerprint import exact_fingerprint, fingerprint
from holdfast.robots import panda
from tests.control.two_pandas import two_pandas

CODE = (
    "from holdfast.model.fingerprint import fingerprint; from holdfast.robots import panda; print(fingerprint(panda()))"
)


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


def test_earlier_models_keep_their_text():
    """What later versions added has a part once it is used: folders of earlier ones still name their model."""
    joint = Joint("prismatic", (0, 0, 1), Pose.identity(), damping=2.0)
    assert fingerprint(joint) == "586e35a7925373fe5f9d5068bfd97d09147dda10c380b7ad50c787a4bb84a24f"
    others = [replace(joint, stiffness=1.0), replace(joint, rest=1.0)]
    assert len({fingerprint(other) for other in (joint, *others)}) == 3


@dataclass(frozen=True)
class Mine(RestToRest):
    """A path of the user's, its text wherever he likes."""


class Also(NamedTuple):
    """Another one."""

    path: RestToRest

    def at(self, t):
        """Return the target."""
        return self.path.at(t)


def test_what_decides_a_call():
    """Numbers, types and methods, at any depth; None where code of the user's takes part."""
    chain, path = two_pandas()[0], RestToRest(Pose.identity(), [0.0, 0.0, 0.1])
    tracking = ObjectTracking(chain, path.at, internal_force=20.0)
    again = ObjectTracking(two_pandas()[0], RestToRest(Pose.identity(), [0.0, 0.0, 0.1]).at, internal_force=20.0)
    assert exact_fingerprint(tracking) == exact_fingerprint(again) is not None
    heavy = replace(chain, held_object=HeldObject.box(3.5, 0.3, 0.2, 0.2))
    others = [
        replace(tracking, internal_force=np.nextafter(20.0, 21.0)),
        replace(tracking, path=replace(path, duration=2.0).at),
        replace(tracking, path=path.start.inverse),
        replace(tracking, chain=heavy),
        path,
        path.at,
        GravityCompensation(chain),
        GravityCompensation(heavy),
    ]
    found = {exact_fingerprint(one) for one in (tracking, *others)}
    assert len(found) == 1 + len(others) and None not in found
    foreigners = [Mine(Pose.identity()).at, Also(path).at, MethodType(lambda self, t: self.at(t), path)]
    for foreign in (lambda t: path.at(t), functools.partial(path.at), *foreigners):
        assert exact_fingerprint(replace(tracking, path=foreign)) is None
