"""What runs are drawn: theirs alone, and as the distribution says."""

import numpy as np
import pytest
from scipy import stats

import holdfast as hf
from holdfast.spatial import rotation
from holdfast.sweeps import NearPose, Normal, Uniform
from holdfast.sweeps.distributions import uniforms


@pytest.mark.parametrize("width", [1, 4, 7])
def test_a_run_draws_its_own(width):
    """However runs are split, each draws the same numbers; other names and seeds draw others."""
    whole = uniforms(3, "mass", 0, 50, width)
    parts = [uniforms(3, "mass", begin, begin + 10, width) for begin in range(0, 50, 10)]
    assert np.array_equal(whole, np.concatenate(parts))
    assert len(np.unique(whole)) == whole.size
    assert not np.isin(whole, uniforms(3, "push", 0, 50, width)).any()
    assert not np.isin(whole, uniforms(4, "mass", 0, 50, width)).any()


def test_uniform_and_normal():
    """Twenty thousand draws pass the Kolmogorov-Smirnov test, entry by entry; entries are uncorrelated."""
    u = uniforms(0, "x", 0, 20_000, 2)
    flat = Uniform([1.0, -2.0], [3.0, 5.0]).values("x", (2,), u)
    bell = Normal([1.0, -2.0], [0.5, 4.0]).values("x", (2,), u)
    for k, (low, size, mean, deviation) in enumerate([(1.0, 2.0, 1.0, 0.5), (-2.0, 7.0, -2.0, 4.0)]):
        assert stats.kstest(flat[:, k], stats.uniform(low, size).cdf).pvalue > 1e-3
        assert stats.kstest(bell[:, k], stats.norm(mean, deviation).cdf).pvalue > 1e-3
    assert abs(np.corrcoef(bell.T)[0, 1]) < 0.03


def test_near_pose():
    """A pose of rotation matrices: the given one, then shift and rotation vector in its own axes."""
    pose = np.array([0.5, -0.5, 0.5, -0.5, 1.0, 2.0, 3.0])
    u = uniforms(0, "x", 0, 20, 6)
    away = np.array([0.3] * 3 + [0.1] * 3) * (2 * u - 1)
    R = rotation.from_quaternion(pose[:4])
    for found, (a, b) in zip(
        NearPose(pose, turn=0.3, shift=0.1).values("x", (7,), u), away.reshape(20, 2, 3), strict=True
    ):
        angle = np.linalg.norm(a)
        x, y, z = a / angle
        K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turned = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
        assert np.allclose(rotation.from_quaternion(found[:4]), R @ turned, atol=1e-14)
        assert np.allclose(found[4:], pose[4:] + R @ b, atol=1e-14)


@pytest.mark.parametrize(
    ("sample", "shape", "said"),
    [
        (Uniform(2.0, 1.0), (), "low <= high"),
        (Uniform([1.0, 2.0], 3.0), (3,), r"shape \(3,\)"),
        (Uniform("a", 1.0), (), "low"),
        (Normal(0.0, -1.0), (), "deviation >= 0"),
        (Normal(np.nan, 1.0), (), "finite"),
        (Uniform(-1e308, 1e308), (), "overflows"),
        (Normal(1.7e308, 1e308), (1000,), "overflows"),
        (NearPose(np.eye(7)[0], shift=1e308, turn=1e308), (7,), "overflows"),
        (NearPose(np.zeros(7)), (7,), "length zero"),
        (NearPose(np.eye(7)[0], turn=-1.0), (7,), "turn and shift >= 0"),
        (NearPose(np.eye(7)[0]), (3,), "no pose"),
    ],
)
def test_refusals(sample, shape, said):
    """Distributions that do not fit are refused by the parameter's name."""
    with pytest.raises(hf.errors.StateError, match=said) as refused:
        sample.values("mass", shape, uniforms(0, "x", 0, 2, sample.width(shape)))
    assert "mass" in str(refused.value)
