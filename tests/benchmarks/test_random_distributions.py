"""A small share of the random questions about forces that `make distributions` asks."""

import numpy as np
import pytest
from benchmarks.random_distributions import FORMS, outcome, outcomes

from holdfast.forces.cone_solver import Verdict


@pytest.mark.slow
def test_random_questions():
    """Residuals are at most 1e-7, on nearly all 1e-9; no verdict contradicts the least violation; all kinds occur.

    The text of machine code, with its 16 iterations, is within 1e-6, and its costs are the reference's.
    """
    found, texts, refused = outcomes(0, 24)
    assert max(one.residual for one in texts) <= 1e-6
    assert max(one.gap for one in texts) <= 1e-7
    residuals = np.array([one.residual for one in found])
    assert residuals.max() <= 1e-7
    assert np.mean(residuals <= 1e-9) >= 0.95
    assert not [one for one in found if one.wrong]
    assert {one.form for one in found} == set(FORMS)
    assert {one.verdict for one in found} == {Verdict.OPTIMAL, Verdict.INFEASIBLE}
    assert refused.total() <= 3


@pytest.mark.slow
def test_values_beside_clarabel():
    """Clarabel's values are the same where both say solved."""
    pytest.importorskip("clarabel", reason="needs Clarabel: pip install clarabel")
    gaps = [outcome(seed, form).gap for form in FORMS for seed in (1, 2, 6, 12)]
    assert np.nanmax(gaps) <= 1e-7


@pytest.mark.long
def test_many_random_questions():
    """Of ten thousand, with the same bars and 99 % for the first."""
    found, texts, _ = outcomes(0, 10000)
    assert np.mean([one.residual <= 1e-6 for one in texts]) >= 0.999
    residuals = np.array([one.residual for one in found])
    assert residuals.max() <= 1e-7
    assert np.mean(residuals <= 1e-9) >= 0.99
    assert not [one for one in found if one.wrong]
    gaps = np.array([one.gap for one in found])
    assert np.isnan(gaps).all() or np.nanmax(gaps) <= 1e-7
