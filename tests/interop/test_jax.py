"""Forward dynamics in JAX: the machine code's numbers, gradients by finite differences, vmaps, scans, refusals."""

import sys
from importlib import import_module

import numpy as np
import pytest

import holdfast as hf
from holdfast.compiled import CompiledChain
from holdfast.compiled.structure import Options
from holdfast.interop import to_jax
from holdfast.questions.question import QUESTIONS
from tests.derivatives.chains import random_chain
from tests.interop.differences import five_points, moved
from tests.longer import mostly_long, mostly_slow
from tests.questions.every import direct, inputs_of

jax = pytest.importorskip("jax", reason="needs JAX: pip install 'holdfast[jax]'")
jnp = pytest.importorskip("jax.numpy")

OF = ("qdd", "grasp_wrench", "object_acceleration")
PARAMETERS = ("object_mass", "object_inertia", "grasp_pose", "base_pose", "base_twist", "gravity")
NAMES = ("q", "qd", "tau", "object_pose", "object_twist", *PARAMETERS)
ERRORS = (RuntimeError, ValueError)  # XLA's own is one of these


pytestmark = pytest.mark.usefixtures("wide")


@pytest.fixture(scope="module")
def problem():
    """A compiled chain of two arms, and all arguments by name."""
    return compiled(1)


def compiled(seed):
    """Return a random chain, compiled, and all arguments by name."""
    p = random_chain(seed)
    chain, body = p.chain, p.chain.held_object
    values = {
        "q": p.state.q,
        "qd": p.state.qd,
        "tau": np.asarray(p.tau),
        "object_pose": p.state.object_pose,
        "object_twist": p.state.object_twist,
        "object_mass": np.array(body.mass),
        "object_inertia": np.array(body.inertia),
        "grasp_pose": np.array([grasp.frame.wxyz_xyz for grasp in chain.grasps.values()]),
        "base_pose": np.array([arm.base.wxyz_xyz for arm in chain.arms.values()]),
        "base_twist": np.random.default_rng(3).normal(size=(len(chain.arms), 6)),
        "gravity": np.array(chain.gravity),
    }
    return hf.compile(chain), values


def state_of(values):
    """Return the arguments of a call without parameters."""
    return [values[name] for name in NAMES[:5]]


def weighted(found):
    """Return one number made of all results."""
    return sum(jnp.sum(jnp.sin(x)) for x in found.values())


def expected(fast, values):
    """Return the same number by a call from Python."""
    result = fast.forward_dynamics(**values)
    return sum(float(np.sin(getattr(result, name)).sum()) for name in OF)


def directional(fast, values, name, along, h=1e-4):
    """Return the derivative of `expected`, central differences of sixth order."""
    at = {s: expected(fast, moved(values, name, s * h * along)) for s in (-3, -2, -1, 1, 2, 3)}
    return (45.0 * (at[1] - at[-1]) - 9.0 * (at[2] - at[-2]) + at[3] - at[-3]) / (60 * h)


@pytest.mark.slow
@pytest.mark.parametrize("route", ["ffi", "callback"])
def test_gradient_by_every_argument(problem, route, monkeypatch):
    """Values are those of a call from Python; gradients as finite differences have them, none along a quaternion."""
    fast, values = problem
    if route == "callback":
        monkeypatch.setattr(import_module("holdfast.interop.to_jax"), "available_route", lambda: route)
    f = to_jax(fast, of=OF, parameters=PARAMETERS)
    assert f.route == route
    found = jax.jit(f)(**values)
    result = fast.forward_dynamics(**values)
    for name in OF:
        assert np.abs(found[name] - getattr(result, name)).max() <= 1e-13 * np.abs(getattr(result, name)).max()
    gradient = jax.jit(jax.grad(lambda v: weighted(f(**v))))(values)
    random = np.random.default_rng(0)
    for name in NAMES:
        along = random.normal(size=np.shape(values[name]))
        along = along + along.T if name.endswith("inertia") else along
        along = along * 0.1 * max(1e-3, np.abs(values[name]).max())
        slope = directional(fast, values, name, along)
        assert float(jnp.sum(gradient[name] * along)) == pytest.approx(slope, rel=2e-7, abs=1e-7), name
        if name.endswith("_pose"):
            radial = jnp.sum(gradient[name][..., :4] * values[name][..., :4], -1)
            assert np.abs(radial).max() < 1e-12 * np.abs(gradient[name]).max()


@pytest.mark.slow
@pytest.mark.parametrize("trunk", mostly_long(["floating", "fixed"], ("floating",)))
def test_trunks(trunk):
    """Gradients by a floating base's pose and twist, and by how a base in the world moves; both modes agree."""
    p = random_chain(1, trunk)
    s, fast = p.state, hf.compile(p.chain, parameters=["link_wrench"])
    names = ("q", "qd", "object_pose", "object_twist")
    values = {name: np.asarray(getattr(s, name)) for name in names} | {"tau": np.asarray(p.tau)}
    parameters = ["trunk_link_wrench"]
    if p.chain.floats:
        values |= {"floating_pose": s.base_pose, "floating_twist": s.base_twist}
    else:
        parameters += ["trunk_base_twist", "trunk_base_acceleration"]
    random = np.random.default_rng(5)
    sizes = {"trunk_link_wrench": (len(p.chain.trunk.bodies), 6)}
    values |= {name: random.normal(size=sizes.get(name, 6)) for name in parameters}
    of = ("qdd", "trunk_base_wrench", *(["floating_acceleration"] if p.chain.floats else []))
    f = to_jax(fast, of=of, parameters=parameters)
    result = fast.forward_dynamics(**values)
    found = jax.jit(f)(**values)
    for name in of:
        at = result.array(name)
        assert np.abs(found[name] - at).max() <= 1e-12 * np.abs(at).max()
    gradient = jax.jit(jax.grad(lambda v: weighted(f(**v))))(values)
    forward = to_jax(fast, of=of, parameters=parameters, forward_mode=True)
    for name, x in values.items():
        along = random.normal(size=np.shape(x))
        if name.endswith("_pose"):
            along[:4] -= (along[:4] @ x[:4]) * x[:4]
        slope = jax.jvp(lambda y, name=name: weighted(forward(**(values | {name: y}))), (x,), (along,))[1]

        def value(s, name=name, along=along):
            return float(weighted(fast_results(fast, of, moved(values, name, s * along))))

        assert float(jnp.sum(gradient[name] * along)) == pytest.approx(float(slope), rel=1e-9, abs=1e-9), name
        assert float(slope) == pytest.approx(five_points(value), rel=1e-6, abs=1e-6), name


def fast_results(fast, of, values):
    """Return results of a call from Python, by name."""
    found = fast.forward_dynamics(**values)
    return {name: found.array(name) for name in of}


@pytest.mark.slow
def test_vmaps(problem):
    """A vmap in another, and the rows of a Jacobian under one, are the single calls, also with what is shared."""
    fast, values = problem
    f = to_jax(fast, of=("qdd",), parameters=("gravity",))
    random = np.random.default_rng(1)
    tau, gravity = random.normal(size=(3, *values["tau"].shape)), random.normal(size=(2, 3))
    rest = {name: values[name] for name in NAMES[:5]}

    def qdd(t, g):
        return f(**(rest | {"tau": t}), gravity=g)["qdd"]

    inner = jax.vmap(qdd, (0, None))
    both = jax.jit(jax.vmap(inner, (None, 0)))(tau, gravity)
    rows = jax.vmap(jax.jacrev(qdd, 1), (0, None))(tau, gravity[0])
    assert both.shape == (2, 3, len(values["q"])) and rows.shape == (3, len(values["q"]), 3)
    for j, t in enumerate(tau):
        for i, g in enumerate(gravity):
            single = fast.forward_dynamics(**(rest | {"tau": t}), gravity=g).qdd
            assert np.abs(both[i, j] - single).max() <= 1e-13 * np.abs(single).max()
        exact = fast.forward_dynamics_jacobian(**(rest | {"tau": t}), gravity=gravity[0], of=["qdd"], by=["gravity"])
        assert np.allclose(rows[j], exact["qdd", "gravity"], rtol=1e-10, atol=1e-12)


@pytest.mark.slow
def test_forward_mode():
    """Columns of a Jacobian in forward mode are its rows in reverse mode, by a pose too."""
    fast, values = compiled(5)
    of = {"of": ("qdd",), "parameters": ("gravity",)}
    rest = {name: values[name] for name in NAMES[:5] if name != "object_pose"}

    def jacobian(which, f):
        given = {name: jnp.asarray(values[name]) for name in ("object_pose", *of["parameters"])}
        return which(lambda v: f(**rest, **v))(given)

    backward = jacobian(jax.jacrev, to_jax(fast, **of))
    forward = jacobian(jax.jacfwd, to_jax(fast, **of, forward_mode=True))
    for x, y in zip(jax.tree.leaves(backward), jax.tree.leaves(forward), strict=True):
        assert np.abs(x - y).max() <= 1e-9 * np.abs(x).max()


@pytest.mark.slow
def test_scan(problem):
    """The gradient of a rollout in a scan is that of finite differences."""
    fast, values = problem
    f = to_jax(fast, of=("qdd",))
    q0, _, tau, pose, twist = state_of(values)

    def end(qd0):
        def step(carry, _):
            q, qd = carry
            qd = qd + 1e-3 * f(q, qd, tau, pose, twist)["qdd"]
            return (q + 1e-3 * qd, qd), None

        return jnp.sum(jnp.sin(jax.lax.scan(step, (q0, qd0), None, length=5)[0][0]))

    qd0 = jnp.asarray(values["qd"])
    along = np.random.default_rng(2).normal(size=qd0.shape)
    run, slope = jax.jit(end), float(jax.jit(jax.grad(end))(qd0) @ along)
    assert slope == pytest.approx(five_points(lambda s: run(qd0 + s * along)), rel=1e-8)


def test_no_answer(problem):
    """A quaternion too long is not-a-number in its own row of a batch only; no warning, no error."""
    fast, values = problem
    f = to_jax(fast, of=("qdd",))
    poses = np.stack([values["object_pose"], 1.01 * values["object_pose"]])
    found = jax.vmap(lambda pose: f(*state_of(values)[:3], pose, values["object_twist"])["qdd"])(poses)
    assert np.isfinite(found[0]).all() and np.isnan(found[1]).all()


def test_unknown_program():
    """A program whose kernel is not in this process says so, and what to do."""
    assert to_jax(hf.compile(random_chain(1).chain)).route == "ffi"
    call = jax.ffi.ffi_call("holdfast", jax.ShapeDtypeStruct((), jnp.float64))
    with pytest.raises(ERRORS, match="kernel is not in this process"):
        jax.block_until_ready(call(jnp.zeros(()), key=np.int64(1)))


def test_forces_that_are_not_unique():
    """One choice among many forces has no derivative: refused."""
    arms = {name: hf.robots.panda(base) for name, base in bases().items()}
    hands = {"a": hf.Grasp("ball", hf.Pose.identity()), "b": hf.Grasp("ball", hf.Pose.translation(0.1, 0, 0))}
    chain = hf.ClosedChain(arms, hf.HeldObject.box(mass=1.0, x=0.2, y=0.1, z=0.1), hands)
    fast = hf.compile(chain, generic_rank=5)
    state = np.zeros(14), np.zeros(14), np.zeros(14), np.eye(7)[0], np.zeros(6)
    with pytest.raises(hf.errors.StateError, match="not unique"):
        jax.grad(lambda tau: jnp.sum(to_jax(fast)(*state[:2], tau, *state[3:])["grasp_wrench"]))(state[2])


def bases():
    """Return where two arms stand."""
    return {"a": hf.Pose.translation(-0.5, 0, 0), "b": hf.Pose.from_rpy(0, 0, np.pi, [0.5, 0, 0])}


@pytest.mark.slow
def test_refusals(problem, monkeypatch):
    """Whatever is not there, or not a number, is named."""
    fast, values = problem
    state = state_of(values)
    for options, words in (
        ({"of": ["qd"]}, "of: no 'qd'"),
        ({"of": []}, "expected some results"),
        ({"of": "qdd"}, "of"),
        ({"parameters": ["object_mas"]}, "object_mass"),
        ({"parameters": ["object_mass"]}, "object_inertia beside"),
        ({"parameters": ["link_mass"]}, "no 'link_mass'"),
        ({"forward_mode": 1}, "forward_mode"),
    ):
        with pytest.raises(hf.errors.StateError, match=words):
            to_jax(fast, **options)
    with pytest.raises(hf.errors.StateError, match="dynamics"):
        to_jax(fast.chain)
    with pytest.raises(hf.errors.StateError, match="neither step"):
        to_jax(fast, step=0.1)
    f = to_jax(fast)
    for arguments, words in (
        ([*state[:2], state[2][1:], *state[3:]], "tau: expected shape"),
        ([*state[:2], state[2] + 1j, *state[3:]], "tau: expected real"),
        ([*state[:2], "no", *state[3:]], "tau: expected real"),
    ):
        with pytest.raises(hf.errors.StateError, match=words):
            f(*arguments)
    with pytest.raises(hf.errors.StateError, match="parameters: expected none, got gravity"):
        f(*state, gravity=np.zeros(3))
    floating = to_jax(hf.compile(random_chain(1, "floating").chain))
    with pytest.raises(hf.errors.StateError, match="expected floating_pose, floating_twist, got none"):
        floating(*state)
    jax.config.update("jax_enable_x64", False)
    for call in (lambda: to_jax(fast), lambda: f(*state)):
        with pytest.raises(hf.errors.StateError, match=r'jax.config.update\("jax_enable_x64", True\)'):
            call()
    monkeypatch.setitem(sys.modules, "jax", None)
    with pytest.raises(hf.errors.MissingExtra, match=r"pip install 'holdfast\[jax\]'"):
        to_jax(fast)


@pytest.mark.parametrize("name", mostly_slow(direct(), ["kinetic_energy", "link_poses"]))
def test_every_question(name):
    """The machine code's numbers under jit, of one system and of several; gradients are those of `vjp`."""
    chain, question = random_chain(1).chain, QUESTIONS[name]
    fast = getattr(CompiledChain(chain, Options(), None), name)
    many = [inputs_of(chain, 3)[x] for x in question.inputs]
    given, found = [x[0] for x in many], to_jax(fast)
    one, several = jax.jit(found)(*given), jax.vmap(found)(*many)
    assert set(one) == set(question.names_at(chain))
    result = fast.results(None)
    fast.calls(dict(zip(question.inputs, given, strict=True)), result)
    for of, x in one.items():
        assert np.array_equal(x, result.array(of)) and np.array_equal(several[of][0], x)
    if question.arguments:
        k = next(k for k, x in enumerate(question.inputs) if not x.endswith("_pose"))
        slope = jax.grad(lambda *x: sum(jnp.sum(y) for y in found(*x).values()), argnums=k)(*given)
        ones = {of: np.ones(x.shape) for of, x in one.items()}
        expected = fast.vjp(*given, by=[question.inputs[k]], **ones)[question.inputs[k]]
        assert np.allclose(slope, expected, rtol=1e-13, atol=1e-13 * np.abs(expected).max())
