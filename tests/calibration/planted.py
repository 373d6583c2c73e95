"""Cells in which some directions cannot be determined, and these directions by geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import holdfast as hf
from holdfast.dynamics import link_poses
from tests.calibration.cells import Cell, base_with_grasp, box_at, cell, named, screw_between, sought

SMALL = 0.05  # size of truths, so that what is not determined does not enter the rest
Planted = tuple[Cell, list[str], list[dict[str, float]]]


def planar(seed: int) -> Planted:
    """The part turns about z and moves across z: the base's height is not determined."""
    one = cell(seed, offsets=False, size=SMALL, moves=lambda g: np.r_[0, 0, g.uniform(-0.6, 0.6), _shift(g)[:2], 0])
    return one, ["bases", "grasps"], [base_with_grasp(one.truth, one.q[0], np.eye(6)[5])]


def shifts(seed: int) -> Planted:
    """The part does not turn: the base's position is not determined."""
    one = cell(seed, offsets=False, size=SMALL, moves=lambda g: np.r_[0, 0, 0, _shift(g)])
    return one, ["bases", "grasps"], [base_with_grasp(one.truth, one.q[0], e) for e in np.eye(6)[3:]]


def two_postures(seed: int) -> Planted:
    """Two postures: the base can turn about and slide along the axis of the motion between them."""
    one = cell(seed, offsets=False, size=SMALL, count=2)
    axes = screw_between(*(box_at(one.truth, q) for q in one.q))
    return one, ["bases", "grasps"], [base_with_grasp(one.truth, one.q[0], axis) for axis in axes]


def one_posture(seed: int) -> Planted:
    """One posture: any motion of the base is made good by the grasp."""
    one = cell(seed, offsets=False, size=SMALL, count=1)
    return one, ["bases", "grasps"], [base_with_grasp(one.truth, one.q[0], e) for e in np.eye(6)]


def both_bases(seed: int) -> Planted:
    """Both bases: where the whole cell stands is not determined."""
    one = cell(seed, offsets=False, size=SMALL)
    planted = []
    for e in np.eye(6):
        w, v = e[:3], e[3:]
        by_arm = [named(f"base {name}", np.r_[w, v + np.cross(w, arm.base.p)]) for name, arm in one.truth.arms.items()]
        planted.append(by_arm[0] | by_arm[1])
    return one, ["bases:left", "bases:right", "grasps"], planted


def end_offsets(seed: int) -> Planted:
    """Offsets of the first and last joint of an arm: its base and its grasp make them good."""
    one = cell(seed, offsets=True, size=SMALL)
    right = one.truth.arms["right"]
    frames = link_poses(right, one.q[0][-right.joint_count :])
    first, last = (frames[k].R @ right.joints[k].axis for k in (0, -1))
    base, box = right.base, box_at(one.truth, one.q[0])
    by_base = named("base right", np.r_[-first, -np.cross(first, base.p - frames[0].p)])
    tip = (box @ one.truth.grasps["right"].frame).p
    by_grasp = named("grasp right", np.r_[box.R.T @ last, box.R.T @ np.cross(last, tip - frames[-1].p)])
    n = right.joint_count
    planted = [{"offset right/joint1": 1.0} | by_base, {f"offset right/joint{n}": 1.0} | by_grasp]
    return one, [*dict.fromkeys([*sought(one), "offsets:right"])], planted


def _free(kind: Any, directions: Callable[[hf.Pose], list[Any]]) -> Callable[[int], Planted]:
    def made(seed: int) -> Planted:
        one = cell(seed, offsets=False, size=SMALL)
        held = replace(one.model.grasps["right"], kind=kind)
        model = replace(one.model, grasps={**one.model.grasps, "right": held})
        frame = one.truth.grasps["right"].frame
        return replace(one, model=model), ["bases", "grasps"], [named("grasp right", x) for x in directions(frame)]

    return made


def _shift(random: np.random.Generator) -> Any:
    return random.uniform(-0.15, 0.15, 3)


def _turn_about(frame: hf.Pose, axes: tuple[int, ...]) -> list[Any]:
    return [np.r_[frame.R[:, k], np.zeros(3)] for k in axes]


CASES: dict[str, Callable[[int], Planted]] = {
    "planar motion": planar,
    "shifts alone": shifts,
    "two postures": two_postures,
    "one posture": one_posture,
    "both bases": both_bases,
    "offsets of end joints": end_offsets,
    "a hinge": _free("hinge", lambda frame: _turn_about(frame, (0,))),
    "a ball": _free("ball", lambda frame: _turn_about(frame, (0, 1, 2))),
    "a planar grasp": _free(
        "planar", lambda frame: [*_turn_about(frame, (2,)), *(np.r_[np.zeros(3), frame.R[:, k]] for k in (0, 1))]
    ),
}
