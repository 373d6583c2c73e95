"""Random numbers of laws: the published ones, of the distribution that is promised, in streams without relation."""

import numpy as np
import pytest
from scipy import stats

from holdfast.compiler.trace import trace
from holdfast.control.random_streams import _jumps, normals, stream_states, uniform
from holdfast.simulation.rollout.user_functions import replayed

# first numbers from the seed 12345 (six times), and the matrices of 2^127 draws: RngStreams, L'Ecuyer et al. 2002
PUBLISHED = [0.127011122046577, 0.318527565396799, 0.309186015583270, 0.825846862927114, 0.221629915782023]
MATRICES = [
    [[2427906178, 3580155704, 949770784], [226153695, 1230515664, 3580155704], [1988835001, 986791581, 1230515664]],
    [[1464411153, 277697599, 1610723613], [32183930, 1464411153, 1022607788], [2824425944, 32183930, 2093834863]],
]


def test_published_numbers():
    """The generator is the one that passes the published tests."""
    state, found = [12345.0] * 6, []
    for _ in PUBLISHED:
        state, u = uniform(state)
        found.append(u)
    np.testing.assert_allclose(found, PUBLISHED, rtol=0.0, atol=5e-15)
    assert [_jumps(k)[0].tolist() for k in range(2)] == MATRICES


def test_streams_are_so_many_jumps_apart():
    """Stream k begins where k jumps from stream 0 lead, by the integers of Python, however large k is."""
    large = 2**62 + 12345
    found = stream_states(7, [0, 1, 5, large])
    for row, stream in zip(found[1:], (1, 5, large), strict=True):
        expected = []
        for k, m in enumerate((4294967087, 4294944443)):
            jump, power = np.array(MATRICES[k], dtype=object), np.eye(3, dtype=object).astype(int).astype(object)
            for bit in bin(stream)[2:]:
                power = power @ power % m
                power = power @ jump % m if bit == "1" else power
            expected += (power @ found[0, 3 * k : 3 * k + 3].astype(int).astype(object) % m).tolist()
        assert row.tolist() == expected
    assert (stream_states(8, [0]) != found[0]).any()


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 8, 41])
def test_normal_distribution(count):
    """Mean, variance and shape of 40,000 numbers, of one stream and of the first numbers of many."""
    states, found = stream_states(3, range(10)), []
    for state in states:
        mine = []
        while len(mine) * count < 4000:
            drawn, state = normals(state, count)
            mine.append(drawn)
        found.append(np.concatenate(mine)[:4000])
    numbers = np.array(found)
    assert stats.kstest(numbers.ravel(), "norm").pvalue > 0.01
    first = np.array([normals(state, 1)[0][0] for state in stream_states(3, range(4000))])
    assert stats.kstest(first, "norm").pvalue > 0.01
    apart = np.corrcoef(numbers) - np.eye(10)
    assert np.abs(apart).max() < 5.0 / np.sqrt(4000)
    assert abs(np.corrcoef(numbers.ravel()[:-1], numbers.ravel()[1:])[0, 1]) < 5.0 / np.sqrt(40000)


def test_machine_code_draws_the_same():
    """A trace computes the states' bits, and the numbers to rounding."""
    state = stream_states(11, [4])[0]
    program = trace(lambda x: normals(x, 5), [(6,)])
    found, after = replayed(program, state)
    expected, then = normals(state, 5)
    assert (after == then).all()
    np.testing.assert_allclose(found, expected, rtol=1e-13)
