"""Residuals of all joints at once, by composite bodies, beside those of automatic differentiation one by one."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closed.forward_derivatives import numbers_of
from holdfast.dynamics.closed.second_solve import point
from holdfast.dynamics.closed.self_response import joint_residuals
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.closed.virtual_power import ArmUnknowns
from tests.derivatives.chains import random_chain

SAME = 1e-12


@pytest.mark.parametrize("seed", range(6))
def test_beside_automatic_differentiation(seed):
    """Torques, base wrench and all that the grasp feels, by every joint's position and velocity."""
    p = random_chain(700 + seed)
    motion = chain_motion(p.chain, p.state, p.tau, p.inputs.shaped(p.chain))
    at = point(motion, sequential(motion), "auto")
    worst = 0.0
    for name, case in at.motion.cases.items():
        z = at.unknowns[name]
        at_once = joint_residuals(case, z)
        for by in ("q", "qd"):
            residual = case.residual(z, tuple(numbers_of([by])))
            for unit, found in zip(np.eye(len(z.qdd)), at_once[by], strict=True):
                expected = ArmUnknowns(*residual.rates(unit))
                for a, b in zip(found, expected, strict=True):
                    size = max(1.0, np.abs(b).max(initial=0.0))
                    worst = max(worst, np.abs(a - b).max(initial=0.0) / size)
    print(f"\n{worst:.1e}")
    assert worst < SAME
