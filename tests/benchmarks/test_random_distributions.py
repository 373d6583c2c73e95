"""A small share of the random questions about forces that `make distributions` asks."""

import numpy as np
import pytest
from benchmarks.random_distributions import FORMS, outcome, outcomes

from holdfast.forces.cone_solver import Verdict


def test_random_questions():
    """Residuals are at most 1e-7, on nearly all 1e-9; no verdict contradicts the least violation; all kinds occur."""
    found, refused = outcomes(0, 48)
    residuals = np.array([one.residual for one in found])
    assert residuals.max() <= 1e-7
    assert np.mean(residuals <= 1e-9) >= 0.95
    assert not [one for one in found if one.wrong]
    assert {one.form for one in found} == set(FORMS)
    assert {one.verdict for one in found} == {Verdict.OPTIMAL, Verdict.INFEASIBLE}
    assert refused.total() <= 5


def test_values_beside_clarabel():
    """Clarabel's values are the same where both say solved."""
    pytest.importorskip("clarabel", reason="needs Clarabel: pip install clarabel")
    gaps = [outcome(seed, form).gap for form in FORMS for seed in (1, 2, 6, 12)]
    assert np.nanmax(gaps) <= 1e-7


@pytest.mark.long
def test_many_random_questions():
    """Of ten thousand, with the same bars and 99 % for the first."""
    found, _ = outcomes(0, 10000)
    residuals = np.array([one.residual for one in found])
    assert residuals.max() <= 1e-7
    assert np.mean(residuals <= 1e-9) >= 0.99
    assert not [one for one in found if one.wrong]
    gaps = np.array([one.gap for one in found])
    assert np.isnan(gaps).all() or np.nanmax(gaps) <= 1e-7
