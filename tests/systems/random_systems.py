"""Random closed-chain systems, consistent in position and velocity by construction."""

import numpy as np

from tests.systems.closing import (
    closure_gaps,
    contact_position,
    place_arm,
    scaled_condition,
    set_velocities,
)
from tests.systems.random_parts import (
    GRAVITY,
    KINDS,
    joint_kinds,
    random_arm,
    random_contact,
    random_grasp,
    random_object,
    rotation,
    unit_vector,
)

__all__ = ["closure_gaps", "random_system", "scaled_condition", "well_conditioned_system"]


def random_system(
    seed: int,
    arms: int | None = None,
    joints=None,
    grasps=None,
    moving_base=None,
    gravity=None,
    extras: bool = True,
    *,
    object_scale: float = 1.0,
    com_offset: float = 0.1,
    world_offset=(0.0, 0.0, 0.0),
    angle_scale: float = np.pi,
    joint_speed: float = 1.0,
    base_speed: float = 0.5,
) -> dict:
    """Return a random case in the stored cases' layout, without ``expected``.

    The same arguments give the same case.  Few joints may lock the chain; use
    ``scaled_condition`` to reject what is badly conditioned or singular.

    Args:
        seed: of the random numbers.
        arms: number of arms; None draws 1 to 8 (or follows a list below).
        joints: joints of each arm, one number or a list; None draws 3 to 12 per arm.
        grasps: ``rigid``, ``hinge``, ``softfinger`` or ``ball`` for all arms, or a list
            in which None is an arm that does not hold; None draws kinds.
        moving_base: one flag or a list; None moves each base with probability 0.3.
        gravity: (3,) [m/s^2]; None draws none, ordinary or oblique.
        extras: whether to add armature, damping and external wrenches.
        object_scale: factor on the object's mass and inertia.
        com_offset: distance of the object's mass centre from its origin C [m].
        world_offset: (3,) displacement of everything [m].
        angle_scale: joint angles are drawn from +- this [rad].
        joint_speed: typical joint rate [rad/s, m/s].
        base_speed: typical base rate [rad/s, m/s]; accelerations are twice as many.
    """
    rng = np.random.default_rng(seed)
    count = _arm_count(rng, arms, joints, grasps, moving_base)
    joint_counts = _per_arm(joints, lambda: int(rng.integers(3, 13)), count)
    kinds = _per_arm(grasps, lambda: str(rng.choice(KINDS)), count)
    moves = _per_arm(moving_base, lambda: bool(rng.random() < 0.3), count)
    case = {
        "name": f"random_{seed}",
        "tags": {"all_rigid": set(kinds) == {"rigid"}, "moving_base": any(moves), "seed": seed},
        "gravity": _gravity(rng) if gravity is None else np.array(gravity, dtype=float).tolist(),
        "object": random_object(rng, object_scale, com_offset),
        "arms": [random_arm(rng, joint_kinds(rng, n), angle_scale) for n in joint_counts],
    }
    case["object"]["p"] = (np.array(case["object"]["p"]) + world_offset).tolist()
    for arm, kind, flag in zip(case["arms"], kinds, moves, strict=True):
        _attach(rng, case, arm, kind)
        if flag:
            _let_base_move(rng, arm, base_speed)
    set_velocities(case, rng, joint_speed, base_speed)
    if extras:
        _add_extras(rng, case)
    for arm in case["arms"]:
        arm["base"].pop("moves", None)
    return case


def well_conditioned_system(seed: int, limit: float = 1e4, tries: int = 200, **options) -> dict:
    """Return the first of many random systems whose scaled condition is below the limit.

    Judged with the object at its natural weight: a light object spoils the number
    however sound the geometry is.

    Args:
        seed: of the first draw; the k-th draw uses ``seed * 1000 + k``.
        limit: largest accepted scaled condition number.
        tries: draws before giving up.
        options: as for ``random_system``.

    Raises:
        ValueError: no draw was good enough.
    """
    for k in range(tries):
        judged = random_system(seed * 1000 + k, **options | {"object_scale": 1.0})
        if scaled_condition(judged) < limit:
            return random_system(seed * 1000 + k, **options)
    raise ValueError(f"none of {tries} systems had a condition below {limit:g}; {options=}")


def _arm_count(rng: np.random.Generator, arms: int | None, *per_arm) -> int:
    """Return the number of arms: given, or the length of a given list, or 1 to 8."""
    lengths = {len(value) for value in per_arm if isinstance(value, list | tuple)}
    lengths |= {arms} if arms is not None else set()
    if len(lengths) > 1:
        raise ValueError(f"arm counts disagree: {sorted(lengths)}")
    return lengths.pop() if lengths else int(rng.integers(1, 9))


def _per_arm(given, draw, count: int) -> list:
    """Return one value per arm from a list, a single value or a draw."""
    if isinstance(given, list | tuple):
        return list(given)
    return [draw() if given is None else given for _ in range(count)]


def _gravity(rng: np.random.Generator) -> list[float]:
    """Return no gravity, the ordinary one or an oblique one [m/s^2]."""
    choices = ([0.0, 0.0, 0.0], list(GRAVITY), (9.81 * unit_vector(rng)).tolist())
    return choices[rng.integers(3)]


def _attach(rng: np.random.Generator, case: dict, arm: dict, kind: str | None) -> None:
    """Put the arm's tip on a random contact, or nearby if it holds nothing."""
    grasp = random_grasp(rng, kind or "rigid", random_contact(rng, case["object"]))
    place_arm(arm, rotation(rng), contact_position(case, grasp))
    if kind is not None:
        arm["grasp"] = grasp


def _let_base_move(rng: np.random.Generator, arm: dict, base_speed: float) -> None:
    """Give the base an acceleration and mark it as one whose twist is to be drawn."""
    arm["base"] |= {
        "moves": True,
        "omega_dot": (2.0 * base_speed * rng.normal(size=3)).tolist(),
        "v_dot": (2.0 * base_speed * rng.normal(size=3)).tolist(),
    }


def _add_extras(rng: np.random.Generator, case: dict) -> None:
    """Add armature [kg m^2, kg], damping [N m s, N s/m] and external wrenches."""
    case["object"]["wrench"] = (3.0 * rng.normal(size=6)).tolist()
    for arm in case["arms"]:
        for joint in arm["joints"]:
            joint["armature"] = float(rng.uniform(0.0, 0.3))
            joint["damping"] = float(rng.uniform(0.0, 1.0))
        arm["link_wrench"] = (2.0 * rng.normal(size=(len(arm["joints"]), 6))).tolist()
