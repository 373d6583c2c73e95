"""Joint paths along a given motion of the object, planned before a law runs."""

from .joint_path import JointPath as JointPath
