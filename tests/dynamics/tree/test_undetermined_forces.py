"""Groups of closures that share undetermined forces, beside the rank of their rows alone."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast.dynamics.tree.forest_rows import forest_rows
from holdfast.dynamics.tree.mechanism_terms import mechanism_arguments
from holdfast.dynamics.tree.undetermined_forces import undetermined_forces
from tests.systems.branched import branched_problems


@pytest.mark.parametrize("name", sorted(branched_problems()))
def test_groups(name):
    """A group's forces are those that its own rows leave undetermined; no smaller set of its closures has them all."""
    p = branched_problems()[name]
    motion = mechanism_arguments(p.chain, p.state.at_rest()).motion({})
    rows = forest_rows(motion)
    G = rows.on_qd(motion)
    rank = int(np.linalg.matrix_rank(G, 1e-9)) if G.size else 0
    groups = undetermined_forces(motion, rank)
    assert sum(group.number for group in groups) == len(G) - rank
    for group in groups:
        slots = [rows.closures[i] for i in group.closures]
        slots += [slice(rows.couplings[i], rows.couplings[i] + 1) for i in group.couplings]
        for without in (None, *range(len(slots))):
            own = np.concatenate([G[at] for k, at in enumerate(slots) if k != without] or [G[:0]])
            left = len(own) - (np.linalg.matrix_rank(own, 1e-9) if len(own) else 0)
            assert left == group.number if without is None else left < group.number
