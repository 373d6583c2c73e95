"""Derivatives of inverse dynamics and of energies: differences, laws, and what is refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pytest

import holdfast as hf
from holdfast import dynamics
from tests.derivatives.asked import NAMES, size_of
from tests.derivatives.moved import moved_problem
from tests.derivatives.products import flat_direction, random_directions
from tests.systems.as_chain import Problem
from tests.systems.bushed import random_bushed
from tests.systems.problems import random_problem, relative_gap
from tests.systems.sprung import with_springs
from tests.systems.trunk_problems import random_on_trunk

FIVE_POINTS = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}
STEP, TRUNCATED, EXACT = 1e-3, 3e-9, 1e-12
OWN = ("qdd", "grasp_wrench")
OF_ENERGY = ("object_mass", "object_com", "object_inertia", "link_mass", "link_com", "link_inertia", "base_pose")
EVERY = {
    "inverse_dynamics": (*(name for name in NAMES if name != "tau"), *OWN),
    "kinetic_energy": ("q", "qd", "object_pose", "object_twist", "base_twist", "armature", *OF_ENERGY),
    "potential_energy": ("q", "object_pose", "gravity", "grasp_pose", *OF_ENERGY),
}
RESULT = {"inverse_dynamics": "tau"}


class Asked(NamedTuple):
    """A function at a problem.

    Attributes:
        name: its name.
        p: the problem.
        own: what it is given besides.
    """

    name: str
    p: Problem
    own: Mapping[str, np.ndarray]

    @property
    def result(self) -> str:
        """The name of what it returns."""
        return RESULT.get(self.name, self.name)

    @property
    def by(self) -> tuple[str, ...]:
        """All of its arguments."""
        return EVERY[self.name]

    def called(self, suffix: str = "", **options: Any) -> Any:
        """Return what the function, or one of its derivatives, returns."""
        function: Callable[..., Any] = getattr(hf if self.name == "inverse_dynamics" else dynamics, self.name + suffix)
        inputs = {} if self.name == "potential_energy" else {"inputs": self.p.inputs}
        return function(self.p.chain, self.p.state, **self.own, **inputs, **options)

    def directions(self, random: np.random.Generator) -> dict[str, np.ndarray]:
        """Return a direction of every argument; wrenches that are not the caller's to choose stay."""
        found = random_directions(self.p, random, [name for name in self.by if name not in OWN])
        return found | {name: random.normal(size=x.shape) * (x != 0.0) for name, x in self.own.items()}

    def moved(self, name: str, flat: np.ndarray) -> Asked:
        """Return the same with one argument displaced."""
        if name in OWN:
            return self._replace(own={**self.own, name: self.own[name] + flat.reshape(self.own[name].shape)})
        return self._replace(p=displaced(self.p, {name: flat}))


def displaced(p: Problem, by: Mapping[str, Any]) -> Problem:
    """Return a problem with some arguments displaced, by name, flat."""
    ends = np.cumsum([0, *(size_of(p, x) for x in NAMES)])
    at = {x: slice(a, b) for x, a, b in zip(NAMES, ends, ends[1:], strict=False)}
    along = np.zeros(ends[-1])
    for name, flat in by.items():
        along[at[name]] = flat
    return moved_problem(p, at, along)


def problem(kind: str) -> Problem:
    """Return arms that hold rigidly and by a ball, on moving bases; with springs; or one by a bushing."""
    if kind == "bushing":
        return displaced(random_bushed(2), {"armature": 0.1, "damping": 0.1})  # none is on the bound, at 0
    p = random_problem(3, joints=(4, 6, 2), grasps=("rigid", "ball", None), moving_base=True)
    return p if kind == "plain" else Problem(with_springs(p.chain), p.state, p.tau, p.inputs)


def asked(name: str, kind: str) -> Asked:
    """Return a function at one of the problems, accelerations and wrenches at random."""
    p, random = problem(kind), np.random.default_rng(5)
    if name != "inverse_dynamics":
        return Asked(name, p, {})
    free = [name not in p.chain.grasps or p.chain.grasps[name].kind == "bushing" for name in p.chain.arms]
    f = np.where(np.array(free)[:, None], 0.0, random.normal(size=(len(p.chain.arms), 6)))
    return Asked(name, p, {"qdd": random.normal(size=p.chain.joint_count), "grasp_wrench": f})


ALL = pytest.mark.parametrize(
    ("name", "kind"), [(name, kind) for name in EVERY for kind in ("plain", "springs", "bushing")]
)


@ALL
def test_rates_are_five_point_differences(name, kind):
    of, random = asked(name, kind), np.random.default_rng(7)
    for by, along in of.directions(random).items():
        flat = np.ravel(along) if by in OWN else flat_direction(of.p, by, along)
        size = max(1.0, float(np.abs(flat).max()))
        far = [w * np.asarray(of.moved(by, k * STEP / size * flat).called()) for k, w in FIVE_POINTS.items()]
        got = of.called("_jvp", along={by: along})[of.result]
        assert relative_gap(got, sum(far) * size / STEP, floor=1e-2 * np.abs(of.called()).max()) < TRUNCATED, by


@ALL
def test_a_gradient_along_a_direction_is_a_cotangent_along_the_rates(name, kind):
    of, random = asked(name, kind), np.random.default_rng(8)
    along = of.directions(random)
    value = np.asarray(of.called())
    bar = random.normal(size=value.shape)
    pulled, pushed = of.called("_vjp", by=of.by, **{of.result: bar}), of.called("_jvp", along=along)
    parts = [float(np.sum(pulled[by] * x)) for by, x in along.items()]
    assert sum(parts) == pytest.approx(float(np.sum(bar * pushed[of.result])), abs=1e-13 * np.abs(parts).sum())
    assert np.array_equal(pulled.result, value)
    assert np.array_equal(pushed.result, value)


@pytest.mark.parametrize("name", EVERY)
def test_the_jacobian_holds_the_rates_of_all_directions(name):
    of, random = asked(name, "springs"), np.random.default_rng(9)
    along = of.directions(random)
    matrix = of.called("_jacobian", by=of.by)
    several = of.called("_jvp", along={by: np.stack([x, 0.5 * x, 0.0 * x]) for by, x in along.items()})[of.result]
    value = np.asarray(of.called())
    expected = sum(np.tensordot(matrix[of.result, by], x, np.ndim(x)) for by, x in along.items())
    assert several.shape == (3, *value.shape)
    assert relative_gap(several[0], expected) < EXACT
    assert relative_gap(several[1], 0.5 * expected) < EXACT
    assert not several[2].any()


@pytest.mark.parametrize("kind", ["plain", "springs"])
def test_inverse_after_forward_dynamics_returns_the_change_of_torques(kind):
    """tau = inverse(theta, qdd(theta, tau), f(theta, tau)) for all theta: its total derivative is tau's own."""
    p, random = problem(kind), np.random.default_rng(10)
    along = random_directions(p, random)
    there = hf.forward_dynamics_jvp(p.chain, p.state, p.tau, inputs=p.inputs, along=along)
    back = hf.inverse_dynamics_jvp(
        p.chain,
        p.state,
        there.result.qdd,
        there.result.grasp_wrench,
        p.inputs,
        along={name: x for name, x in along.items() if name != "tau"} | {name: there[name] for name in OWN},
    )
    # terms that cancel are larger than what is left of them
    assert relative_gap(back.tau, along["tau"], floor=np.abs(there.grasp_wrench).max()) < 1e-10


@pytest.mark.parametrize("kind", ["plain", "springs"])
def test_energy_changes_by_the_power(kind):
    p = problem(kind)
    still = hf.Inputs(object_wrench=p.inputs.object_wrench)
    chain, state = p.chain, dynamics.project_velocity(p.chain, p.state)
    result = hf.forward_dynamics(chain, state, p.tau, inputs=still)
    motion = {"q": state.qd, "object_pose": state.object_twist}
    faster = {"qd": result.qdd, "object_twist": result.object_acceleration}
    rate = dynamics.kinetic_energy_jvp(chain, state, still, along=motion | faster)["kinetic_energy"]
    rate = rate + dynamics.potential_energy_jvp(chain, state, along=motion)["potential_energy"]
    power = dynamics.power(chain, state, p.tau, result, still)
    assert float(rate) == pytest.approx(sum(power), abs=1e-11 * np.abs(power).sum())


def test_what_torques_do_not_depend_on_has_a_gradient_of_nothing():
    of = asked("inverse_dynamics", "plain")
    found = of.called("_vjp", by=["object_mass", "grasp_pose", "object_wrench"], tau=np.ones(of.p.chain.joint_count))
    assert not any(np.any(found[name]) for name in found.parts)


def test_names_and_shapes_that_do_not_fit_are_refused():
    of = asked("inverse_dynamics", "plain")
    n = of.p.chain.joint_count
    with pytest.raises(hf.StateError, match="inverse_dynamics_vjp: no 'tau'"):
        of.called("_vjp", by=["tau"], tau=np.ones(n))
    with pytest.raises(hf.StateError, match="expected some of"):
        of.called("_vjp", by=[], tau=np.ones(n))
    with pytest.raises(hf.StateError, match="expected some of"):
        of.called("_vjp", by=3, tau=np.ones(n))
    with pytest.raises(hf.StateError, match="tau: expected finite numbers, got an overflow"):
        of.called("_jvp", along={"q": 1e308 * np.ones(n)})
    with pytest.raises(hf.StateError, match="tau"):
        of.called("_vjp", tau=np.ones(n + 1))
    with pytest.raises(hf.StateError, match="expected shape"):
        of.called("_jvp", along={"q": np.ones(n + 1)})
    with pytest.raises(hf.StateError, match="kinetic_energy_jacobian: no 'gravity'"):
        asked("kinetic_energy", "plain").called("_jacobian", by=["gravity"])


@pytest.mark.parametrize("name", EVERY)
def test_a_trunk_is_refused_by_name(name):
    p = random_on_trunk(1, 2)
    n, l = p.chain.joint_count, len(p.chain.arms)
    own = {"qdd": np.zeros(n), "grasp_wrench": np.zeros((l, 6))} if name == "inverse_dynamics" else {}
    for suffix, options in (("_vjp", {}), ("_jvp", {"along": {"q": np.ones(n)}}), ("_jacobian", {})):
        more = {"tau": np.ones(n)} if own and suffix == "_vjp" else {}
        with pytest.raises(hf.MethodNotApplicable, match=f"{name}{suffix}.*trunk"):
            Asked(name, p, own).called(suffix, **options, **more)
