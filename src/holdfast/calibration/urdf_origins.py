"""Adjusted joints as `<origin>` elements of URDF files."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from holdfast.calibration.calibrate import Calibration
from holdfast.errors import ModelError
from holdfast.io.files import file_path, write_atomically
from holdfast.model import checks
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose


def write_urdf(found: Calibration, source: str | PathLike[str], target: str | PathLike[str]) -> list[str]:
    """Write a URDF file with the calibrated origins of its joints, and return the names of those that changed.

    A joint with the placement T in the model and T' in the calibration gets the origin T_file T^-1 T', so fixed joints
    between two moving ones remain as they are. Bases, grasps and sensors are not in such files; see
    `Calibration.chain`.

    Args:
        found: the calibration of a chain with arms from this file.
        source: the file from which the arms were read.
        target: the file to write, which is replaced if it exists.

    Raises:
        ModelError: the source is no URDF file, or has none of the joints that changed.
        ResultError: the target cannot be written.
    """
    checks.instance(found, Calibration, "write_urdf: found")
    path = file_path(source, "write_urdf: source", ModelError)
    try:
        tree = ElementTree.parse(path)
    except (OSError, ValueError, ElementTree.ParseError) as cause:
        raise ModelError(f"{path}: expected a URDF file; {cause}") from cause
    joints = {joint.get("name"): joint for joint in tree.getroot().iter("joint")}
    changed = []
    pairs = zip(found.model.all_joints, found.chain.all_joints, strict=True)
    for old, new in pairs:
        step = old.placement.inverse() @ new.placement
        if old.name not in joints or (np.array_equal(step.R, np.eye(3)) and not step.p.any()):
            continue
        joint = joints[old.name]
        origin = joint.find("origin")
        if origin is None:
            origin = ElementTree.SubElement(joint, "origin")
        xyz, rpy = ([float(x) for x in (origin.get(key) or "0 0 0").split()] for key in ("xyz", "rpy"))
        pose = Pose.from_rpy(*rpy, xyz) @ step
        origin.set("xyz", " ".join(f"{x:.17g}" for x in pose.p.tolist()))
        origin.set("rpy", " ".join(f"{x:.17g}" for x in rotation.to_euler_zyx(pose.R)[::-1].tolist()))
        changed.append(old.name)
    if not changed:
        known = [name for name in joints if name]
        raise ModelError(
            f"{path}: expected a joint that the calibration changed, got none; its joints are {', '.join(known[:10])}"
        )
    write_atomically(Path(file_path(target, "write_urdf: target")), ElementTree.tostring(tree.getroot(), "utf-8"))
    return changed
