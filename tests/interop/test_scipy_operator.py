"""The Jacobian as an operator: its columns are the matrix's, its transpose is its own, SciPy solves with it."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import holdfast as hf
from holdfast.interop import jacobian_operator
from tests.derivatives.chains import random_chain

BY = ("tau", "gravity", "object_pose")


@pytest.fixture(scope="module")
def problem():
    """A compiled chain of two arms, and its state and torques."""
    p = random_chain(1)
    s = p.state
    arguments = {"q": s.q, "qd": s.qd, "tau": np.asarray(p.tau), "object_pose": s.object_pose}
    return hf.compile(p.chain), arguments | {"object_twist": s.object_twist}


def test_products(problem):
    """Both products are those of the matrix."""
    fast, arguments = problem
    J = jacobian_operator(fast, by=BY, **arguments)
    whole = fast.forward_dynamics_jacobian(**arguments, of=["qdd"], by=list(BY))
    matrix = np.hstack([whole["qdd", name] for name in BY])
    random = np.random.default_rng(0)
    x, y = random.normal(size=J.shape[1]), random.normal(size=J.shape[0])
    assert J.shape == matrix.shape
    assert np.allclose(J @ x, matrix @ x, rtol=1e-10, atol=1e-10 * np.abs(matrix).max())
    assert np.allclose(J.T @ y, matrix.T @ y, rtol=1e-10, atol=1e-10 * np.abs(matrix).max())


def test_least_squares(problem):
    """Torques for given accelerations are found without a matrix; what remains is none."""
    fast, arguments = problem
    rest = {name: x for name, x in arguments.items() if name != "tau"}
    wanted = fast.forward_dynamics(**arguments).qdd

    found = least_squares(
        lambda tau: fast.forward_dynamics(**rest, tau=tau).qdd - wanted,
        np.zeros_like(arguments["tau"]),
        jac=lambda tau: jacobian_operator(fast, **rest, tau=tau),
        tr_solver="lsmr",
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-12,
    )
    assert np.abs(found.fun).max() < 1e-6 * np.abs(wanted).max()


def test_refusals(problem):
    """Names that are not there, and a state that is not whole."""
    fast, arguments = problem
    for options, words in (({"of": "qd"}, "no 'qd'"), ({"by": ["tao"]}, "no 'tao'"), ({"by": "tau"}, "by")):
        with pytest.raises(hf.StateError, match=words):
            jacobian_operator(fast, **options, **arguments)
    with pytest.raises(hf.StateError, match="got no qd"):
        jacobian_operator(fast, q=arguments["q"])
    with pytest.raises(hf.StateError, match="compiled"):
        jacobian_operator(fast.chain, **arguments)
