"""What is asked of a chain that is answered as a forest: accelerations of objects, trunk, links and frames by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import StateError
from holdfast.forces.affine_map import AccelerationTask
from holdfast.forces.forest_equations import CENTRE_OF_MASS, ForestEquations
from holdfast.model import checks
from holdfast.model.trunk import BASE, TRUNK
from holdfast.spatial.scalar import Array

BASE_FRAME = f"{TRUNK}/{BASE}"


class NamedTask(NamedTuple):
    """What is asked of one frame: rows S (r, 6) on its true acceleration [omega_dot; v_dot], and their values (r,).

    The rows are (r, 3) for the centre of mass.
    """

    name: str
    rows: Array
    values: Array


def named_tasks(equations: ForestEquations, acceleration: Any, task: Any) -> list[NamedTask]:
    """Return what is asked, checked, frame by frame.

    Args:
        equations: the chain's equations of motion.
        acceleration: values by name of a frame, as the ends of loops are named, or of `CENTRE_OF_MASS`; or (6,) of the
            only object, (k, 6) of k objects in order; None for zero.
        task: rows (r, 6) by name, or those of the only object; None for all six of every frame that is named, or else
            of every object, or without one of a floating base.

    Raises:
        ModelError: there is no such frame.
        StateError: a shape is wrong.
    """
    objects = [*equations.chain.free_objects]
    if isinstance(acceleration, Mapping) or isinstance(task, Mapping):
        for name, given in (("acceleration", acceleration), ("task", task)):
            if given is not None and not isinstance(given, Mapping):
                raise StateError(f"{name}: expected a mapping by name like the other one, got {checks.short(given)}")
        values, rows = acceleration or {}, task or {}
        names = [*dict.fromkeys([*values, *rows])]
        return [_named(name, values.get(name), rows.get(name), objects) for name in names]
    if task is not None:
        if len(objects) != 1:
            raise StateError(f"task: expected rows by name in a chain with {len(objects)} objects; try a mapping")
        return [_named(objects[0], acceleration, task, objects)]
    if not objects:
        if acceleration is not None or not equations.chain.floats:
            raise StateError(
                "acceleration: expected values by name of links or frames in a chain without an object; try a mapping,"
                " which may be empty"
            )
        return [_named(BASE_FRAME, None, None, objects)]
    shape = (6,) if len(objects) == 1 else (len(objects), 6)
    given = np.zeros(shape) if acceleration is None else checks.numbers(acceleration, shape, "acceleration", StateError)
    return [NamedTask(name, np.eye(6), x) for name, x in zip(objects, given.reshape(-1, 6), strict=True)]


def _named(name: Any, values: Any, task: Any, objects: list[str]) -> NamedTask:
    if not isinstance(name, str):
        raise StateError(f"acceleration: expected names of frames, got {checks.short(name)}")
    count = 3 if name == CENTRE_OF_MASS and name not in objects else 6
    rows = np.eye(count) if task is None else checks.numbers(task, None, f"task: '{name}'", StateError)
    if rows.ndim != 2 or rows.shape[1] != count:
        raise StateError(f"task: '{name}': expected shape (r, {count}), got shape {rows.shape}")
    given = np.zeros(len(rows)) if values is None else values
    return NamedTask(name, rows, checks.numbers(given, (len(rows),), f"acceleration: '{name}'", StateError))


def on_accelerations(equations: ForestEquations, tasks: list[NamedTask]) -> AccelerationTask:
    """Return what is asked as rows on the accelerations of all bodies, (r, n_v).

    Raises:
        ModelError: there is no such frame.
    """
    rows, values = [np.zeros((0, equations.size))], [np.zeros(0)]
    for one in tasks:
        J, bias = equations.acceleration_of(one.name)
        rows.append(one.rows @ J)
        values.append(one.values - one.rows @ bias)
    return AccelerationTask(np.vstack(rows), np.concatenate(values))
