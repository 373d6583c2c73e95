"""Costs of rollouts and of forward dynamics for SciPy: gradients by five-point differences, and what is refused."""

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

import holdfast as hf
from holdfast.interop import jacobian_operator, value_and_gradient
from holdfast.spatial.rotation import quaternion_exp, quaternion_product
from tests.derivatives.chains import random_chain
from tests.interop.differences import five_points
from tests.systems import random_system
from tests.systems.as_chain import as_chain

STEP, STEPS, SYSTEMS = 2e-3, 5, 3


def torque(t, now, memory, given):
    """Drive and damp."""
    return given["tau"] - given["gain"] * now.qd, memory


@pytest.fixture(scope="module")
def rolled():
    """A rollout and all that it is given: torques of each step, gains of all, a velocity of every system."""
    p = as_chain(random_system(5, arms=2, joints=[5, 4], grasps=["rigid", "hinge"], moving_base=False))
    n, random = p.chain.joint_count, np.random.default_rng(0)
    law = hf.ControlLaw(torque, parameters={"tau": (n,), "gain": (n,)})
    given = {"q": p.state.q, "object_pose": p.state.object_pose, "object_twist": p.state.object_twist}
    given |= {"qd": p.state.qd + 0.1 * random.normal(size=(SYSTEMS, n)), "gain": np.full(n, 0.5)}
    given |= {"grasp_pose": np.array([g.frame.wxyz_xyz for g in p.chain.grasps.values()])}
    given |= {"schedule": {"tau": p.tau + random.normal(size=(STEPS, n))}}
    return hf.compile_rollout(p.chain, law, scheme="midpoint"), given


def effort(results):
    """Return a smooth number of all results, and its derivatives."""
    value = sum(float(np.sin(x).sum()) for x in results.values())
    return value, {name: np.cos(x) for name, x in results.items()}


def slope(fun, x, along, far=1e-4):
    """Return the derivative along a direction by five points."""
    return five_points(lambda s: fun(x + s * along)[0], far)


def moved_from(fun, random):
    """Return a point near the beginning, poses turned and shifted a little there."""
    return fun.x0 + 1e-3 * random.normal(size=fun.x0.shape)


@pytest.mark.slow
def test_a_parameter_of_the_law_may_be_called_a_pose():
    """Seven numbers of a law are seven unknowns, whatever their name; poses are arguments of the chain."""
    p = as_chain(random_system(2, arms=1, joints=7, moving_base=False))
    law = hf.ControlLaw(
        lambda t, now, memory, given: (p.tau - given["goal_pose"] * now.qd, memory), parameters={"goal_pose": (7,)}
    )
    s, rollout = p.state, hf.compile_rollout(p.chain, law, scheme="midpoint")
    given = {"q": s.q, "qd": s.qd, "object_pose": s.object_pose, "object_twist": s.object_twist}
    fun = value_and_gradient(
        rollout, effort, of=("q", "qd"), by=("goal_pose",), step=STEP, steps=2, goal_pose=np.ones(7), **given
    )
    along = np.random.default_rng(0).normal(size=7)
    assert fun(fun.x0)[1] @ along == pytest.approx(slope(fun, fun.x0, along, 1e-2), rel=1e-8)


NAMES = ("tau", "gain", "qd", "object_pose", "grasp_pose", "step")


@pytest.mark.slow
def test_gradient_through_a_rollout(rolled):
    """By what is given for each step, for every system, once for all, and by rotation vectors of poses, also long."""
    rollout, given = rolled
    random, pose = np.random.default_rng(1), given["object_pose"]
    turn = np.array([0.7, -0.4, 1.1])
    undone = quaternion_product(quaternion_exp(-turn), pose[:4])
    given = given | {"object_pose": np.concatenate([undone, pose[4:]])}
    fun = value_and_gradient(rollout, effort, of=("q", "qd", "tau"), by=NAMES, step=STEP, steps=STEPS, **given)
    sizes = [x.size - x.size // 7 * name.endswith("_pose") for name, x in fun.values(fun.x0).items()]
    parts = dict(zip(NAMES, np.split(np.arange(len(fun.x0)), np.cumsum(sizes)[:-1]), strict=True))
    x = fun.x0.copy()
    x[parts["object_pose"][:3]] = turn
    back = fun.values(x)["object_pose"]
    assert np.abs(quaternion_product(back[:4], pose[:4] * [1, -1, -1, -1])[1:]).max() < 1e-14
    x[parts["gain"]] += 0.1
    x[parts["grasp_pose"]] += 1e-4 * random.normal(size=12)
    gradient = fun(x)[1]
    for name, part in parts.items():
        along = np.zeros(len(x))
        along[part] = random.normal(size=len(part)) * (1e-2 if name in ("step", "grasp_pose") else 1.0)
        assert gradient @ along == pytest.approx(slope(fun, x, along), rel=1e-8, abs=1e-8), name


@pytest.mark.slow
def test_minimum(rolled):
    """BFGS finds the torques after which nothing moves much less; unknowns come back by name."""
    rollout, given = rolled

    def rates(results):
        qd = results["qd"]
        return float((qd[-1] ** 2).sum()), {"qd": np.concatenate([0 * qd[:-1], 2 * qd[-1:]])}

    fun = value_and_gradient(rollout, rates, of=("qd",), by=("tau", "gain"), step=STEP, steps=STEPS, **given)
    best = minimize(fun, fun.x0, jac=True, method="BFGS", options={"maxiter": 15})
    assert best.fun < 0.5 * fun(fun.x0)[0]
    assert {name: x.shape for name, x in fun.values(best.x).items()} == {"tau": (STEPS, 9), "gain": (9,)}


@pytest.mark.slow
def test_standing_still(rolled):
    """What cannot be run is infinitely dear, and refused where the search begins."""
    rollout, given = rolled
    fun = value_and_gradient(rollout, effort, of=("q",), by=("object_pose",), step=STEP, steps=STEPS, **given)
    value, gradient = fun(fun.x0 + np.array([0, 0, 0, 5.0, 0, 0]))
    assert value == np.inf and not gradient.any()
    far = given | {"object_pose": given["object_pose"] + np.array([0, 0, 0, 0, 5.0, 0, 0])}
    cost = value_and_gradient(rollout, effort, of=("q",), by=("object_pose",), step=STEP, steps=STEPS, **far)
    with pytest.raises(hf.errors.StateError, match="that have an answer"):
        cost(cost.x0)


@pytest.fixture(scope="module")
def solved():
    """A compiled chain, and its state and torques."""
    p = random_chain(1)
    s = p.state
    state = {"q": s.q, "qd": s.qd, "object_pose": s.object_pose, "object_twist": s.object_twist}
    return hf.compile(p.chain), state | {"tau": np.asarray(p.tau)}


@pytest.mark.slow
@pytest.mark.parametrize("batch", [None, 3])
def test_gradient_of_forward_dynamics(solved, batch):
    """Of one system, and of several that share all but their torques."""
    fast, given = solved
    random = np.random.default_rng(2)
    if batch:
        given = given | {"tau": given["tau"] + random.normal(size=(batch, len(given["tau"])))}
    by = ("tau", "q", "object_pose", "gravity")
    given = given | {"gravity": np.array(fast.chain.gravity)}
    fun = value_and_gradient(fast, effort, of=("qdd", "grasp_wrench"), by=by, **given)
    x = moved_from(fun, random)
    along = 1e-2 * random.normal(size=x.shape)
    assert fun(x)[1] @ along == pytest.approx(slope(fun, x, along, 1e-3), rel=1e-6)


def test_refusals(rolled, solved):
    """Whatever is missing, or means nothing, is named."""
    rollout, given = rolled
    fast, state = solved
    whole = {"of": ("q",), "by": ("gain",), "step": STEP, "steps": STEPS} | given
    for wrong, words in (
        ({"by": ("gian",)}, "by: gian: expected a value"),
        ({"by": ()}, "by: expected some names"),
        ({"by": "gain"}, "by"),
        ({"steps": None}, "expected step and steps of a rollout"),
        ({"object_pose": np.zeros(6), "by": ["object_pose"]}, "expected wxyz_xyz"),
    ):
        with pytest.raises(hf.errors.StateError, match=words):
            value_and_gradient(rollout, effort, **(whole | wrong))
    with pytest.raises(hf.errors.StateError, match="neither step"):
        value_and_gradient(fast, effort, of=("qdd",), by=("tau",), step=STEP, **state)
    with pytest.raises(hf.errors.StateError, match="got no q"):
        value_and_gradient(fast, effort, of=("qdd",), by=("tau",), tau=state["tau"])
    with pytest.raises(hf.errors.StateError, match="dynamics"):
        value_and_gradient(fast.chain, effort, of=("qdd",), by=("tau",))
    for cost in (lambda results: 1.0, lambda results: ("much", {})):
        fun = value_and_gradient(fast, cost, of=("qdd",), by=("tau",), **state)
        with pytest.raises(hf.errors.StateError, match="cost: expected a number and derivatives"):
            fun(fun.x0)
    fun = value_and_gradient(fast, lambda results: (1.0, {}), of=("qdd",), by=("tau",), **state)
    assert fun(fun.x0)[0] == 1.0 and not fun(fun.x0)[1].any()
    with pytest.raises(hf.errors.StateError, match="x: expected shape"):
        fun(fun.x0[1:])


BY = ("tau", "gravity", "object_pose")


@pytest.mark.slow
def test_products(solved):
    """Both products are those of the matrix."""
    fast, arguments = solved
    J = jacobian_operator(fast, by=BY, **arguments)
    whole = fast.forward_dynamics_jacobian(**arguments, of=["qdd"], by=list(BY))
    matrix = np.hstack([whole["qdd", name] for name in BY])
    random = np.random.default_rng(0)
    x, y = random.normal(size=J.shape[1]), random.normal(size=J.shape[0])
    assert J.shape == matrix.shape
    assert np.allclose(J @ x, matrix @ x, rtol=1e-10, atol=1e-10 * np.abs(matrix).max())
    assert np.allclose(J.T @ y, matrix.T @ y, rtol=1e-10, atol=1e-10 * np.abs(matrix).max())


def test_least_squares(solved):
    """Torques for given accelerations are found without a matrix; what remains is none."""
    fast, arguments = solved
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


def test_refusals_of_the_operator(solved):
    """Names that are not there, and a state that is not whole."""
    fast, arguments = solved
    for options, words in (({"of": "qd"}, "no 'qd'"), ({"by": ["tao"]}, "no 'tao'"), ({"by": "tau"}, "by")):
        with pytest.raises(hf.errors.StateError, match=words):
            jacobian_operator(fast, **options, **arguments)
    with pytest.raises(hf.errors.StateError, match="got no qd"):
        jacobian_operator(fast, q=arguments["q"])
    with pytest.raises(hf.errors.StateError, match="compiled"):
        jacobian_operator(fast.chain, **arguments)
