"""Sound calls of machine code."""

from __future__ import annotations

from functools import cache
from itertools import product
from typing import Any

import jax
import numpy as np

import holdfast as hf
from holdfast.interop import jacobian_operator, to_jax
from tests.fuzz.calls import Later, call, everything, fixed

# Machine code.


@cache
def compiled() -> Any:
    """Return the machine code of the floating chain with everything."""
    return hf.compile(everything().chain)


def given_compiled(**more: Any) -> dict[str, Any]:
    """Return sound arguments of the machine code, and more of them."""
    found = {}
    for name, field in (
        ("q", "q"),
        ("qd", "qd"),
        ("object_pose", "object_pose"),
        ("object_twist", "object_twist"),
        ("floating_pose", "base_pose"),
        ("floating_twist", "base_twist"),
    ):
        found[name] = Later(lambda field=field: np.array(getattr(everything().state, field)))
    return {**found, "tau": Later(lambda: np.array(everything().tau)), **more}


ACTING = {
    "object_wrench": np.ones(6),
    "gravity": np.array([0.0, 0.0, -9.81]),
    "object_mass": 2.0,
    "object_inertia": "scale",
    "threads": 1,
}


@call("compiled forward_dynamics", **given_compiled(**ACTING))
def _forward(**given: Any) -> Any:
    return compiled().forward_dynamics(**given)


@call(
    "compiled batch",
    **{
        **given_compiled(**ACTING),
        "q": Later(lambda: np.tile(everything().state.q, (4, 1))),
        "gravity": np.tile([0.0, 0.0, -9.81], (4, 1)),
        "threads": 2,
    },
)
def _batch(**given: Any) -> Any:
    return compiled().forward_dynamics(**given)


@call("bind", **given_compiled(object_wrench=np.ones(6)))
def _bind(**given: Any) -> Any:
    compiled().bind(**given)  # a call checks nothing: see `BoundDynamics`


@cache
def plain() -> Any:
    """Return the machine code of two arms on bases that stand."""
    return hf.compile(fixed().chain)


GIVEN = {
    "q": Later(lambda: np.array(fixed().state.q)),
    "qd": Later(lambda: np.array(fixed().state.qd)),
    "tau": Later(lambda: np.array(fixed().tau)),
    "object_pose": Later(lambda: np.array(fixed().state.object_pose)),
    "object_twist": np.zeros(6),
}


@call("compiled vjp", **GIVEN, by=["q", "tau"], qdd=Later(lambda: np.array(fixed().tau)))
def _compiled_vjp(**given: Any) -> Any:
    found = plain().forward_dynamics_vjp(**given)
    return [found[name] for name in given["by"]]


@call("compiled jacobian", **GIVEN, of=["qdd"], by=["q"])
def _compiled_jacobian(**given: Any) -> Any:
    found = plain().forward_dynamics_jacobian(**given)
    return [found[one] for one in product(given["of"], given["by"])]


for _name in ("mass_matrix", "jacobian", "tip_poses", "link_poses"):

    def _of_q(_name: str = _name, **given: Any) -> Any:
        return getattr(plain(), _name)(**given)

    call(f"compiled {_name} of q", q=Later(lambda: np.array(fixed().state.q)), threads=1)(_of_q)


@call("compiled closure", **{key: x for key, x in given_compiled().items() if key != "tau"})
def _compiled_closure(**given: Any) -> Any:
    return compiled().closure(**given), compiled().kinetic_energy(**given)


@call(
    "compile",
    chain=Later(lambda: fixed().chain),
    dtype="float64",
    method="auto",
    parameters=["link_inertia"],
    generic_rank=9,
)
def _compile(**given: Any) -> Any:
    return repr(hf.compile(**given))


@call("jacobian_operator", **GIVEN, of="qdd", by=["tau"])
def _operator(**given: Any) -> Any:
    return jacobian_operator(plain(), **given).shape


@call("to_jax", of=["qdd"], parameters=[], forward_mode=False)
def _jax(**given: Any) -> Any:
    with jax.enable_x64(True):
        return repr(to_jax(plain(), **given))
