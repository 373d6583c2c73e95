"""The run-time parameters of a chain: the arrays that machine code reads, made from what users pass."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np

from holdfast.compiler.schedule import External
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import (
    ARRAYS,
    BASE_MOTION,
    FLOATING,
    INTERNAL,
    MOVING,
    POSE_ARRAYS,
    TOUCH_START,
    Shape,
    shapes,
    value_of,
)
from holdfast.spatial import rotation
from holdfast.spatial.real_numbers import real_array
from holdfast.spatial.scalar import Array

WRENCHES = ("link_wrench", "trunk_link_wrench")
_INPUTS = ("object_wrench", *WRENCHES, *FLOATING, TOUCH_START)  # inputs that users pass like parameters


def rank_number(generic_rank: int | None) -> Array:
    """Return the generic rank as machine code reads it: a number, -1 if it is unknown."""
    return np.array(-1.0 if generic_rank is None else float(generic_rank))


def parameters_of(chain: ClosedChain, generic_rank: int | None) -> dict[str, Array]:
    """Return the chain's own parameters by name, with zeros for external wrenches and base motion."""
    known = shapes(chain)
    zero = {
        name: np.zeros(known[name])
        for name in ("about", "object_wrench", *WRENCHES, "floating_twist", *MOVING, TOUCH_START)
    }
    own = {name: value_of(name, chain) for name, row in ARRAYS.items() if row.value is not None}
    return zero | own | {"generic_rank": rank_number(generic_rank), "floating_pose": np.eye(7)[0]}


def require_inputs(names: Iterable[str], given: Collection[str]) -> None:
    """Raise an error if a call does not give the motion of a trunk's floating base, or of the object where it matters.

    Raises:
        StateError: One of `names` is missing; the message names it.
    """
    for name in names:
        if name not in given and name.startswith("object"):
            raise StateError(f"{name}: expected it, as springs between bodies or bushings depend on it, got none")
        if name not in given and name == TOUCH_START:
            raise StateError(f"{name}: expected the touch_force of a similar instant, for which this was compiled")
        if name not in given:
            raise StateError(f"{name}: expected that of the trunk's floating base, got none; its state is an input")


def parse_parameters(
    given: Mapping[str, Any], externals: Mapping[str, External], chain: ClosedChain
) -> dict[str, Array]:
    """Convert the parameters that a user passes to the arrays that machine code reads.

    Args:
        given: arrays of each parameter's shape, or with a leading batch axis; base_pose (arms, 7) and
            grasp_pose (grasps, 7) are wxyz_xyz. An object_mass requires an object_inertia, which may be "scale".
        externals: the arrays that the machine code reads and writes.
        chain: the chain, whose object's inertia is scaled for "scale".

    Raises:
        StateError: A name is unknown, a shape is wrong, a number is not finite, or a mass has no inertia.
    """
    shapes = {name: _shape(name, externals) for name in given}
    for name, shape in shapes.items():
        if shape is None:
            known = [other for other in (*externals, *POSE_ARRAYS) if _shape(other, externals) is not None]
            raise StateError(f"no parameter '{name}'.{checks.did_you_mean(name, known)}")
    found: dict[str, Array] = {}
    for name, value in _with_inertia(given, chain).items():
        a, shape = np.array(real_array(value, name, "real numbers", StateError), dtype=float, order="C"), shapes[name]
        if a.shape != shape and a.shape[1:] != shape:
            raise StateError(f"{name}: expected shape {checks.shapes_with_rows(shape or (), 'batch')}, got {a.shape}")
        if not np.isfinite(a).all():
            raise StateError(f"{name}: expected finite numbers")
        if name in BASE_MOTION:
            _require_still(name, a, chain)
        if name.endswith(("_mass", "_inertia")):
            _require_inertia(name, a)
        if name in POSE_ARRAYS:
            rotations, origins = POSE_ARRAYS[name]
            found[rotations], p = _from_quaternions(name, a)
            if origins in externals:
                found[origins] = p
        else:
            found[name] = a
    return found


def _shape(name: str, externals: Mapping[str, External]) -> Shape | None:
    """Return the shape of a parameter that users may pass, or None if there is none of that name."""
    if name in POSE_ARRAYS:
        rotations = externals.get(POSE_ARRAYS[name][0])
        return None if rotations is None else (rotations.shape[0], 7)
    e = externals.get(name)
    passed = e is not None and name not in INTERNAL and (e.role == "parameter" or name in _INPUTS)
    return e.shape if e is not None and passed else None


def _with_inertia(given: Mapping[str, Any], chain: ClosedChain) -> Mapping[str, Any]:
    """Return the parameters with "scale" replaced by the scaled inertia; raise an error for a mass without inertia."""
    inertia = given.get("object_inertia")
    if isinstance(inertia, str):
        if inertia != "scale" or "object_mass" not in given:
            raise StateError(
                f"object_inertia: expected (3, 3) numbers, or 'scale' beside object_mass, got {checks.short(inertia)}"
            )
        mass = np.array(real_array(given["object_mass"], "object_mass", "real numbers", StateError), dtype=float)
        with np.errstate(all="ignore"):  # a mass that is not finite raises an error later
            scaled = (mass / chain.held_object.mass)[..., None, None] * chain.held_object.inertia
        return {"object_mass": mass, **given, "object_inertia": scaled}
    if inertia is None and "object_mass" in given:
        raise StateError(
            "object_mass: expected object_inertia beside it, as another mass rarely leaves the inertia as it is; try"
            " object_inertia='scale' (the chain's own, in proportion to the mass), or (3, 3) about the mass centre"
        )
    return given


def _require_still(name: str, a: Array, chain: ClosedChain) -> None:
    """Raise an error if an arm on a trunk is given its own base motion."""
    for i, arm in enumerate(chain.arms):
        if arm in chain.mounts and a[..., i, :].any():
            raise StateError(f"{name}: arm '{arm}' moves with the trunk it stands on; expected zeros")


def _require_inertia(name: str, a: Array) -> None:
    """Raise an error for negative masses or inertias that are not positive semidefinite; an object's must be > 0."""
    sizes = a if name.endswith("mass") else np.linalg.eigvalsh(a)
    if name.endswith("inertia") and not np.allclose(a, np.swapaxes(a, -1, -2), rtol=1e-9, atol=0.0):
        raise StateError(f"{name}: expected symmetric matrices")
    least, bound = float(sizes.min(initial=np.inf)), "> 0" if name.startswith("object") else ">= 0"
    if least < 0 or (least == 0 and bound == "> 0"):
        raise StateError(f"{name}: expected {bound} (principal moments of an inertia), got {least:.6g}")


def _from_quaternions(name: str, poses: Array) -> tuple[Array, Array]:
    """Return rotation matrices and origins of poses wxyz_xyz on any leading axes."""
    # Lengths are computed as in `checks.pose_numbers`, so that the results are the same bit for bit.
    length = np.array([math.hypot(*p) for p in poses[..., :4].reshape(-1, 4)]).reshape(*poses.shape[:-1], 1)
    if not (np.abs(length - 1) <= checks.ROTATION_TOLERANCE).all():
        raise StateError(f"{name}: expected unit quaternions (w, x, y, z), got lengths {np.unique(length)[:3]}")
    R = rotation.from_quaternion(np.moveaxis(poses[..., :4] / length, -1, 0))
    R = np.moveaxis(R, (0, 1), (-2, -1))
    return np.ascontiguousarray(R), np.ascontiguousarray(poses[..., 4:])
