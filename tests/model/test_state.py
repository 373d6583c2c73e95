"""States and inputs: checked, read-only, and refused by name."""

import numpy as np
import pytest

from holdfast import Inputs, Pose, State, StateError
from holdfast.spatial import rotation
from tests.model.parts import chain

POSE = np.r_[1.0, np.zeros(6)]


def test_fits():
    """A state of another chain is refused with both lengths and the arms'."""
    state = State(np.zeros(4), np.zeros(4), POSE)
    state.fits(chain(left=2, right=2))
    with pytest.raises(StateError, match=r"expected 5 joint positions \(left: 2, right: 3\), got 4"):
        state.fits(chain(left=2, right=3))


def test_pose():
    """A Pose or seven numbers; a quaternion off by rounding is normalised."""
    frame = Pose(rotation.exp(np.array([0.1, -0.2, 0.3])), np.array([1.0, 2.0, 3.0]))
    for given in (frame, frame.wxyz_xyz, frame.wxyz_xyz + np.r_[1e-8, np.zeros(6)]):
        state = State([0.0], [0.0], given)
        np.testing.assert_allclose(state.object_frame.R, frame.R, atol=3e-8)
        assert np.linalg.norm(state.object_pose[:4]) == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_array_equal(state.object_twist, np.zeros(6))


@pytest.mark.parametrize("seed", range(5))
def test_a_pose_that_was_normalised_keeps_its_bits(seed):
    """However often a state is made of another one's pose."""
    x = np.random.default_rng(seed).normal(size=7)
    pose = State([0.0], [0.0], np.r_[x[:4] / np.sqrt((x[:4] ** 2).sum()) * (1 + 3e-7), x[4:]]).object_pose
    for _ in range(5):
        again = State([0.0], [0.0], pose).object_pose
        np.testing.assert_array_equal(again, pose)
        pose = again


def test_inputs():
    """Missing inputs are zero; only link wrenches stay away; each shape is checked by name."""
    made = chain(left=2, right=3)
    empty = Inputs().shaped(made)
    assert empty.link_wrenches is None
    np.testing.assert_array_equal(empty.object_wrench, np.zeros(6))
    np.testing.assert_array_equal(empty.base_twists, np.zeros((2, 6)))
    np.testing.assert_array_equal(empty.base_accelerations, np.zeros((2, 6)))
    shapes = {"object_wrench": (6,), "link_wrenches": (5, 6), "base_twists": (2, 6), "base_accelerations": (2, 6)}
    for field, shape in shapes.items():
        assert getattr(Inputs(**{field: np.ones(shape)}).shaped(made), field).shape == shape
        with pytest.raises(StateError, match=rf"inputs: {field}: expected shape \({shape[0]}"):
            Inputs(**{field: np.zeros((9, 9))}).shaped(made)
        with pytest.raises(StateError, match=rf"inputs: {field}: expected finite"):
            Inputs(**{field: np.full(shape, np.nan)}).shaped(made)


def test_inputs_of_lists():
    """Whatever is given, arrays are held; what is none is refused at once."""
    assert isinstance(Inputs(object_wrench=[0, 0, 0, 0, 0, 1]).object_wrench, np.ndarray)
    with pytest.raises(StateError, match="inputs: base_twists: expected an array of numbers, got"):
        Inputs(base_twists=[[0], [0, 0]])
