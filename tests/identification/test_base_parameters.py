"""Base parameters: as many as books say, and the combinations that pendulums have."""

from __future__ import annotations

import numpy as np
import pytest

import holdfast as hf
from holdfast.identification import base_parameters
from holdfast.robots import panda
from holdfast.spatial.inertia import PARAMETERS


def stacked(arm: hf.Arm, samples: int, gravity=(0, 0, -9.81)) -> tuple[np.ndarray, list[str]]:
    """Return regressors of random motions, one below the other, and the parameters' names."""
    rng, n = np.random.default_rng(0), arm.joint_count
    chain = hf.ClosedChain({"arm": arm}, hf.HeldObject.sphere(1.0, 0.1), {}, gravity)
    rows = []
    for _ in range(samples):
        state = hf.State(rng.normal(size=n), rng.normal(size=n), [1, 0, 0, 0, 0, 0, 0])
        Y = hf.regressor(chain, state, rng.normal(size=n), np.zeros(6))
        rows.append(Y.links["arm"].reshape(n, -1))
    return np.concatenate(rows), [f"link{k + 1} {name}" for k in range(n) for name in PARAMETERS]


def test_panda():
    """Gaz et al. 2019 find 43 for the seven joints of a Panda that stands upright."""
    assert base_parameters(*stacked(panda(), 40)).rank == 43


def test_the_same_torques():
    """Parameters moved along what is not told change no torque; base parameters decide them all."""
    Y, names = stacked(panda(), 40)
    found = base_parameters(Y, names)
    rng = np.random.default_rng(1)
    change = rng.normal(size=len(names))
    change -= np.linalg.pinv(found.combinations) @ (found.combinations @ change)
    assert np.abs(Y @ change).max() < 1e-9 * np.abs(Y).max()
    assert np.linalg.norm(change) > 1.0
    assert set(found.absent) >= {"link1 m", "link1 Ixx", "link2 hz"}


def test_a_pendulum():
    """One joint about y across gravity: its moment about the axis, and the first moments across it."""
    joint = hf.Joint("revolute", [0, 1, 0])
    arm = hf.Arm([joint], [hf.Link(1.0, [0.1, 0.2, 0.3], np.diag([0.1, 0.1, 0.1]))])
    found = base_parameters(*stacked(arm, 10))
    assert set(found.in_words()) == {"link1 hx", "link1 hz", "link1 Iyy"}
    assert "link1 m" in found.absent


def test_two_links_in_a_plane():
    """A double pendulum, links of length l: the second's mass acts as l m at the first's end (Khalil and Dombre)."""
    l, joints = 0.7, [hf.Joint("revolute", [0, 1, 0]), hf.Joint("revolute", [0, 1, 0], hf.Pose.translation(0.7, 0, 0))]
    arm = hf.Arm(joints, [hf.Link(1.0, [0.1, 0.2, 0.3], np.diag([0.1, 0.1, 0.1]))] * 2)
    Y, names = stacked(arm, 20)
    found = base_parameters(Y, names)
    assert found.rank == 6
    row = np.zeros(20)
    row[[names.index("link1 Iyy"), names.index("link2 m")]] = 1.0, l * l
    both = np.zeros(20)
    both[[names.index("link1 hx"), names.index("link2 m")]] = 1.0, l
    for known in (row, both):
        weights = np.linalg.lstsq(found.combinations.T, known, rcond=None)[0]
        assert np.abs(found.combinations.T @ weights - known).max() < 1e-9
    assert "6 of 20" in str(found)


@pytest.mark.parametrize("matrix", [np.zeros((3, 2)), np.zeros(3), [[np.nan] * 3], np.zeros((0, 3))])
def test_refusals(matrix):
    """Shapes and numbers that are none, by name."""
    with pytest.raises(hf.errors.ModelError, match="base_parameters: matrix"):
        base_parameters(matrix, ["a", "b", "c"])
