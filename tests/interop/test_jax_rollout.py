"""Rollouts in JAX: the tape's numbers, gradients by differences, a vmap as a batch, what stands still, refusals."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.interop import to_jax
from tests.derivatives.chains import random_chain
from tests.interop.differences import five_points, moved
from tests.interop.test_jax import weighted
from tests.systems import random_system
from tests.systems.as_chain import as_chain

jax = pytest.importorskip("jax", reason="needs JAX: pip install 'holdfast[jax]'")
jnp = pytest.importorskip("jax.numpy")

STEP, STEPS, SYSTEMS = 2e-3, 4, 3
OF = ("q", "tau", "object_pose", "grasp_wrench", "memory")


pytestmark = pytest.mark.usefixtures("wide")


def torque(t, now, memory, given):
    """Drive and damp; what it remembers of its gain enters the next step."""
    return given["tau"] - memory * now.qd, 0.9 * memory + 0.1 * given["gain"]


@pytest.fixture(scope="module")
def problem():
    """A rollout of two arms, and all that it is given: torques of each step."""
    p = as_chain(random_system(5, arms=2, joints=[5, 4], grasps=["rigid", "hinge"], moving_base=False))
    n, random = p.chain.joint_count, np.random.default_rng(0)
    law = hf.ControlLaw(torque, memory=np.full(n, 0.2), parameters={"tau": (n,), "gain": (n,)})
    values = {"q": p.state.q, "qd": p.state.qd + 0.1, "object_pose": p.state.object_pose}
    values |= {"object_twist": p.state.object_twist, "tau": p.tau + random.normal(size=(STEPS, n))}
    values |= {"gain": np.full(n, 0.5), "memory": np.full(n, 0.3)}
    values |= {"grasp_pose": np.array([g.frame.wxyz_xyz for g in p.chain.grasps.values()])}
    return hf.compile_rollout(p.chain, law, scheme="midpoint"), values


def function(rollout, of=OF):
    """Return the rollout as a function of JAX."""
    given = {"parameters": ["memory", "grasp_pose"], "schedule": ["tau"]}
    return to_jax(rollout, of=of, step=STEP, steps=STEPS, **given)


def tape_of(rollout, values):
    """Return the steps of one system."""
    first = {name: x[None] for name, x in (values | {"tau": values["tau"][0]}).items()}
    schedule = {"tau": values["tau"]}
    record = [*OF, "running"]
    return rollout.tape(rollout.start(**first), STEP, steps=STEPS, schedule=schedule, record=record)


@pytest.mark.slow
def test_gradient_by_every_argument(problem):
    """Values are the tape's, gradients those of five-point differences; those by poses have no part along them."""
    rollout, values = problem
    f = function(rollout)
    found, records = jax.jit(f)(**values), tape_of(rollout, values).records
    for name in OF:
        assert np.array_equal(found[name], records[name][:, 0])
    gradient = jax.jit(jax.grad(lambda v: weighted(f(**v))))(values)
    random = np.random.default_rng(1)
    for name, x in values.items():
        along = random.normal(size=x.shape)
        if name.endswith("_pose"):
            along[..., :4] -= (along[..., :4] * x[..., :4]).sum(-1, keepdims=True) * x[..., :4]
            along *= 0.1

        def value(s, name=name, along=along):
            return weighted(f(**moved(values, name, s * along)))

        slope = five_points(value)
        assert float(jnp.sum(gradient[name] * along)) == pytest.approx(slope, rel=1e-7, abs=1e-7), name
        if name.endswith("_pose"):
            radial = jnp.sum(gradient[name][..., :4] * x[..., :4], -1)
            assert np.abs(radial).max() < 1e-12 * np.abs(gradient[name]).max()


@pytest.mark.slow
@pytest.mark.parametrize("called", ["aim_pose", "object_pose_goal"])
def test_a_law_may_call_its_parameters_poses(problem, called):
    """A law's own parameter is a list of numbers, whatever its name: it has its own shape, and the law's gradient."""
    rollout, values = problem
    n = rollout.chain.joint_count

    def pull(t, now, memory, given):
        return given[called] - 2.0 * now.qd, memory

    own = hf.compile_rollout(rollout.chain, hf.ControlLaw(pull, parameters={called: (n,)}), scheme="midpoint")
    f = to_jax(own, of=("q", "object_pose"), step=STEP, steps=2)
    rest = {name: values[name] for name in ("q", "qd", "object_pose", "object_twist")}
    aim, along = values["tau"][0], np.random.default_rng(3).normal(size=n)

    def end(x):
        return weighted(f(**rest, **{called: x}))

    gradient = jax.grad(end)(aim)
    assert gradient.shape == (n,)
    assert float(gradient @ along) == pytest.approx(five_points(lambda s: end(aim + s * along), 0.1), rel=1e-7)
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0.0


@pytest.mark.slow
def test_vmap(problem, monkeypatch):
    """A vmap, of the gradient too, is one rollout of many systems, each with the numbers of its own."""
    rollout, values = problem
    f, random = function(rollout), np.random.default_rng(2)
    gains, qd = random.normal(size=(SYSTEMS, 9)), random.normal(size=(SYSTEMS, 9))
    counts, tape = [], type(rollout).tape
    monkeypatch.setattr(type(rollout), "tape", lambda self, s, *a, **k: counts.append(len(s)) or tape(self, s, *a, **k))

    def cost(gain, qd):
        return weighted(f(**(values | {"gain": gain, "qd": qd})))

    both = jax.jit(jax.vmap(jax.value_and_grad(cost, (0, 1))))(gains, qd)
    assert set(counts) == {SYSTEMS} and len(counts) <= 2
    for k in range(SYSTEMS):
        one = jax.value_and_grad(cost, (0, 1))(gains[k], qd[k])
        for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(both), strict=True):
            assert np.abs(x - y[k]).max() <= 1e-12 * np.abs(x).max()


@pytest.mark.slow
def test_standing_still(problem):
    """From the step on at which a system stands still its results are not-a-number; before, all is well."""
    rollout, values = problem
    f = function(rollout, of=("q",))
    wild = np.array(values["tau"])
    wild[2:] = 1e9  # the third step is not taken
    quaternions = np.stack([values["object_pose"], 1.01 * values["object_pose"]])
    torques = np.stack([values["tau"], wild])
    rest = {name: x for name, x in values.items() if name not in ("tau", "object_pose")}

    def q(tau, pose):
        return f(**rest, tau=tau, object_pose=pose)["q"]

    found = jax.vmap(jax.vmap(q, (0, None)), (None, 0))(torques, quaternions)
    assert np.isfinite(found[0, 0]).all() and np.isnan(found[1]).all()
    assert np.isfinite(found[0, 1, :2]).all() and np.isnan(found[0, 1, 2:]).all()
    before, after = (jax.grad(lambda tau, k=k: q(tau, quaternions[0])[k].sum())(wild) for k in (1, 2))
    assert np.isfinite(before).all() and before.any() and np.isnan(after).all()


@pytest.mark.long
def test_floating_base():
    """A floating base's pose and twist are among the arguments, and have gradients."""
    p = random_chain(1, "floating")
    s, rollout = p.state, hf.compile_rollout(p.chain)
    f = to_jax(rollout, of=["floating_pose"], step=1e-3, steps=2)
    rest = {"q": s.q, "qd": s.qd, "object_pose": s.object_pose, "object_twist": s.object_twist, "tau": p.tau}

    def end(x):
        return jnp.sum(jnp.sin(f(**rest, floating_pose=s.base_pose, floating_twist=x)["floating_pose"]))

    twist, along = s.base_twist, np.random.default_rng(4).normal(size=6)
    slope = five_points(lambda s: end(twist + s * along), 1e-3)
    assert float(jax.grad(end)(twist) @ along) == pytest.approx(slope, rel=1e-7)


def test_refusals(problem):
    """Whatever is not there is named."""
    rollout, values = problem
    steps = {"step": STEP, "steps": STEPS}
    for options, words in (
        ({}, "expected step and steps"),
        (steps | {"forward_mode": True}, "no forward_mode"),
        (steps | {"of": ["margin"]}, "of: no 'margin'"),
        (steps | {"of": []}, "expected some results"),
        (steps | {"parameters": ["gian"]}, "parameters: no 'gian'"),
        (steps | {"parameters": ["gain"]}, "parameters: no 'gain'"),
        (steps | {"schedule": ["memory"]}, "schedule: no 'memory'"),
        ({"step": -1.0, "steps": 2}, "step"),
    ):
        with pytest.raises(hf.errors.StateError, match=words):
            to_jax(rollout, **options)
    f = function(rollout)
    with pytest.raises(hf.errors.StateError, match="expected tau, gain, memory, grasp_pose, got gain"):
        f(*(values[name] for name in ("q", "qd", "object_pose", "object_twist")), gain=values["gain"])
    with pytest.raises(hf.errors.StateError, match=r"tau: expected shape \(4, 9\)"):
        f(**(values | {"tau": values["tau"][0]}))
