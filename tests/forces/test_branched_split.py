"""The split of forces at objects of chains with branches: that of serial chains, and its laws at each object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics.tree.mechanism_terms import mechanism_arguments
from holdfast.errors import ModelError, StateError
from tests.control.two_pandas import two_pandas
from tests.dynamics.tree.as_branched import AWAY, STRAY
from tests.systems.branched import branched_problems, palletiser

UNIT = np.array([1.0, 1.0, 1.0])


@pytest.mark.parametrize("kinds", [("rigid", "rigid"), ("softfinger", "ball")])
def test_as_a_serial_chain(kinds):
    """Beside an object that falls, the parts are those of the serial chain; nothing touches the other one."""
    chain, state = two_pandas(*kinds)
    f = np.random.default_rng(3).normal(size=(2, 6)) * [[0, 0, 0, 1, 1, 1]]
    beside = replace(chain, objects={"stray": STRAY})
    apart = replace(state, object_pose=[state.object_pose, AWAY], object_twist=np.zeros((2, 6)))
    wanted, found = hf.forces.split(chain, state, f), hf.forces.split(beside, apart, f)
    for name in ("motion", "internal", "load_share", "length"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), atol=1e-12, err_msg=name)
    of_stray = hf.forces.split(beside, apart, f, of="stray")
    assert not of_stray.motion.any() and not of_stray.internal.any() and of_stray.load_share is None


@pytest.mark.parametrize(("name", "of"), [("grippers", "object"), ("pot and lid", "object"), ("pot and lid", "lid")])
def test_two_parts(name, of):
    """They add up; the internal part has no resultant; the motion part is the smallest, by all wrenches without one."""
    chain, state, tau = branched_problems()[name]
    f = hf.forward_dynamics(chain, state, tau).grasp_wrench
    parts, found = hf.forces.split(chain, state, f, of=of), chain.as_forest
    motion, body = mechanism_arguments(chain, state).motion({}), found.objects[of]
    K, to_C, sign, rows = [], [], [], []
    for i, (own, at) in enumerate(zip(found.forest.closures, motion.closures, strict=True)):
        if body in (own.a, own.b):
            rows.append(i)
            sign.append(1.0 if body == own.b else -1.0)
            K.append(at.K)
            to_C.append((at.on_b if body == own.b else -at.on_a).T)
    assert len(rows) == {"grippers": 3, "pot and lid": 3 if of == "object" else 2}[name]
    np.testing.assert_allclose((parts.motion + parts.internal)[rows], np.array(sign)[:, None] * f[rows], atol=1e-12)
    by_K = np.concatenate([k @ x for k, x in zip(K, parts.internal[rows], strict=True)])
    A, size = np.hstack(to_C), np.abs(f).max()
    assert np.abs(A @ by_K).max() < 1e-11 * size
    metric = [k @ np.diag([*UNIT / parts.length**2, *UNIT]) @ k.T for k in K]
    W, ends = np.zeros((A.shape[1],) * 2), np.cumsum([0, *map(len, K)])
    for k, m in enumerate(metric):
        W[ends[k] : ends[k + 1], ends[k] : ends[k + 1]] = m
    lam = np.concatenate([k @ x for k, x in zip(K, parts.motion[rows], strict=True)])
    null = np.linalg.svd(A)[2][np.linalg.matrix_rank(A) :]
    assert len(null) and np.abs(null @ W @ lam).max() < 1e-11 * size * W.max()
    assert not np.delete(parts.motion, rows, axis=0).any()
    assert parts.load_share.sum() == pytest.approx(1.0, abs=1e-12)


def test_between_objects():
    """What the pot does to the lid, the lid does to the pot."""
    chain, state, tau = branched_problems()["pot and lid"]
    f = hf.forward_dynamics(chain, state, tau).grasp_wrench
    knob = [*chain.as_forest.closures].index("knob")
    pot, lid = (hf.forces.split(chain, state, f, of=name) for name in ("object", "lid"))
    np.testing.assert_allclose((pot.motion + pot.internal)[knob], -(lid.motion + lid.internal)[knob], atol=1e-12)


def test_wrong_calls():
    """An object that there is not, and wrenches of a wrong shape, are refused by name."""
    chain, state, _ = branched_problems()["pot and lid"]
    with pytest.raises(ModelError, match=r"of: expected one of the objects object, lid, got 'lit'.*lid"):
        hf.forces.split(chain, state, np.zeros((5, 6)), of="lit")
    with pytest.raises(StateError, match="grasp_wrench: expected shape"):
        hf.forces.split(chain, state, np.zeros((2, 6)))
    empty, at_rest, _ = palletiser()
    with pytest.raises(ModelError, match=r"expected one of the objects \(none\), got None"):
        hf.forces.split(empty, at_rest, np.zeros((1, 6)))
