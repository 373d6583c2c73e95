"""The stored derivatives, 126 digits rounded: as problems, and as what is expected of every block."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from holdfast import ClosedChain
from holdfast.io import load_cases
from tests.systems.as_chain import Problem

FILE = Path(__file__).parents[1] / "data" / "cases_derivatives.json"
OF = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration")
NOTHING = 1e-20  # a block below this share of its group's largest entry is zero
# groups of inputs whose name is not that of an argument or parameter: which, and which entries of it
PARTS = {
    "object_turn": ("object_pose", slice(0, 3)),
    "object_shift": ("object_pose", slice(3, 6)),
    "grasp_turn": ("grasp_pose", slice(0, 3)),
    "grasp_shift": ("grasp_pose", slice(3, 6)),
    "base_turn": ("base_pose", slice(0, 3)),
}
SIZES = {"link_mass": 1, "link_com": 3, "link_inertia": 6}


@dataclass(frozen=True, eq=False)
class Stored:
    """A system and its derivatives.

    Attributes:
        problem: the system.
        unique: whether forces are.
        values: by output, flat.
        blocks: by output and group of inputs, (outputs, inputs); none where forces are not unique.
        tangent: (2n + 12, m) columns (dq, turn, shift, dqd, d omega, dv), a basis of the state manifold's tangent.
        along: by output, derivatives along the tangent; of the least forces where these are not unique.
    """

    problem: Problem
    unique: bool
    values: Mapping[str, np.ndarray]
    blocks: Mapping[tuple[str, str], np.ndarray]
    tangent: np.ndarray
    along: Mapping[str, np.ndarray]

    @property
    def groups(self) -> list[str]:
        """The groups of inputs."""
        return list(dict.fromkeys(group for _, group in self.blocks))


def names() -> list[str]:
    """Return the names of all systems."""
    return list(raw())


@cache
def raw() -> dict[str, Any]:
    """Return the file by name of its systems."""
    return {case["name"]: case for case in json.loads(FILE.read_text())["cases"]}


@cache
def problems() -> dict[str, Problem]:
    """Return the systems by name."""
    return {case.name: Problem(case.chain, case.state, case.tau, case.inputs) for case in load_cases(FILE)}


@cache
def stored(name: str) -> Stored:
    """Return a system by name."""
    case, problem = raw()[name], problems()[name]
    expected, found = case["expected"], case["debug"]["derivatives"]
    answers = [np.concatenate([np.ravel(x) for x in expected[key]]) for key in ("qdd", "f", "alpha_C", "W_dot")]
    values = dict(zip(OF, answers, strict=True))
    ends = np.cumsum([len(x) for x in values.values()])[:-1]

    def by_output(matrix: list) -> dict[str, np.ndarray]:
        return dict(zip(OF, np.split(np.array(matrix), ends), strict=True))

    ambient = found["ambient"] or {}
    blocks = {(of, group): x for group, matrix in ambient.items() for of, x in by_output(matrix).items()}
    return Stored(
        problem, case["tags"]["f_unique"], values, blocks, np.array(found["tangent"]), by_output(found["along"])
    )


def columns(chain: ClosedChain, group: str) -> tuple[str, list[int]]:
    """Return the argument or parameter that a group of inputs belongs to, and which of its directions the group lists.

    Directions of a name are flat, arm by arm and link by link: six a pose, six an inertia (xx, xy, xz, yy, yz, zz).
    """
    if group in PARTS:
        name, part = PARTS[group]
        count = {"object_pose": 1, "grasp_pose": len(chain.grasps), "base_pose": len(chain.arms)}[name]
        return name, np.arange(6 * count).reshape(count, 6)[:, part].ravel().tolist()
    if group in SIZES:
        size, first = SIZES[group], chain.arm_joints[0].start
        counts = [(part.start - first, part.stop - part.start) for part in chain.arm_joints]
        links = [start + k for start, N in counts for k in sorted({N // 2, N - 1})]
        return group, [size * k + i for k in links for i in range(size)]
    sizes = {"q": chain.joint_count, "qd": chain.joint_count, "tau": chain.joint_count, "gravity": 3, "object_mass": 1}
    sizes |= {"object_com": 3, "base_twist": 6 * len(chain.arms), "base_acceleration": 6 * len(chain.arms)}
    return group, list(range(sizes.get(group, 6)))


def gaps(
    found: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray], nothing: float = NOTHING
) -> Iterator[tuple[str, float]]:
    """Yield how far each block of rows is off, relative to its largest entry; of zeros, to the largest of all blocks.

    Args:
        found: by output, matrices by one group of inputs.
        expected: the same.
        nothing: below this share of the largest entry of all, a block that is expected is the rounding of zero.
    """
    largest = max(np.abs(x).max(initial=0.0) for x in expected.values())
    for of, wanted in expected.items():
        assert found[of].shape == wanted.shape, f"{of}: {found[of].shape}, expected {wanted.shape}"
        size = np.abs(wanted).max(initial=0.0)
        size = size if size > nothing * largest else largest
        yield of, float(np.abs(found[of] - wanted).max(initial=0.0) / (size or 1.0))
