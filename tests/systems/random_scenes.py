"""Random scenes as TOML texts: sound ones, and such as no arm reaches, that slip, are singular or say nonsense."""

from __future__ import annotations

import numpy as np

from holdfast.robots import HOME, ROBOTS

KINDS = ("rigid", "hinge", "softfinger", "ball")


def random_scene(seed: int) -> str:
    """Return the text of a scene; the same seed gives the same text."""
    rng = np.random.default_rng(seed)
    count = int(rng.choice([1, 2, 2, 2, 3, 4]))
    names = [f"arm{k}" for k in range(count)]
    size = rng.uniform(0.1, 0.4, 3)
    height = float(rng.choice([rng.uniform(0.3, 0.8), 2.5], p=[0.95, 0.05]))
    grasps = [_grasp(rng, name, k, count, size) for k, name in enumerate(names)]
    holding = [name for name, grasp in zip(names, grasps, strict=True) if grasp]
    step, steps = 10 ** rng.uniform(-4, -1.3), int(rng.integers(1, 4))
    return "\n".join(
        [
            *(_arm(rng, name, k, count) for k, name in enumerate(names)),
            f"[object]\nmass = {10 ** rng.uniform(-1, 1):.4g}\nbox = {_list(size)}",
            f"pose = {{ position = {_list([*rng.normal(0, 0.02, 2), height])}, rpy = {_list(rng.normal(0, 0.1, 3))} }}",
            *grasps,
            _controller(rng, holding),
            _simulation(rng, step, steps),
            *_events(rng, names, holding, size, step * steps),
            *_wrenches(rng, step * steps),
        ]
    )


def _list(numbers) -> str:
    return "[" + ", ".join(f"{x:.6g}" if abs(x) > 1e-12 else "0.0" for x in numbers) + "]"


def _arm(rng, name: str, k: int, count: int) -> str:
    robot = str(rng.choice(list(ROBOTS)))
    angle, distance = 2 * np.pi * k / count + rng.normal(0, 0.1), rng.uniform(0.45, 0.75)
    at = distance * np.array([-np.cos(angle), -np.sin(angle)])
    lines = [
        f'[[arms]]\nname = "{name}"\nrobot = "{robot}"',
        f"base = {{ position = {_list([*at, 0.0])}, rpy = {_list([0, 0, angle])} }}",
    ]
    if rng.random() < 0.3:
        spread = 0.0 if rng.random() < 0.2 else 0.3
        q = np.zeros(len(HOME[robot])) if rng.random() < 0.3 else HOME[robot]
        lines.append(f"q = {_list(q + spread * rng.normal(size=len(q)))}")
    if rng.random() < 0.15:
        sway = f"amplitude = {_list(rng.uniform(0, 0.02, 3))}, frequency = {_list(rng.uniform(0.2, 5, 3))}"
        lines.append(f"base_motion = {{ shift = {{ {sway} }}, smooth_start = {rng.uniform(0.01, 0.5):.3g} }}")
    return "\n".join(lines)


def _grasp(rng, name: str, k: int, count: int, size) -> str:
    """Return a grasp on the side that the arm stands at; sometimes none."""
    if rng.random() < 0.12:
        return ""
    kind = str(rng.choice(KINDS))
    return f'[[grasps]]\narm = "{name}"\n{_contact(rng, kind, 2 * np.pi * k / count, size)}'


def _contact(rng, kind: str, angle: float, size) -> str:
    inward = np.array([np.cos(angle), np.sin(angle)])
    reach = 0.5 * min(size[0] / max(abs(inward[0]), 1e-9), size[1] / max(abs(inward[1]), 1e-9))
    place = [*(-reach * inward), rng.normal(0, 0.01)]
    lines = [f'kind = "{kind}"\nposition = {_list(place)}\nrpy = {_list([0.0, np.pi / 2, angle])}']
    if kind != "rigid" and rng.random() < 0.6:
        extra = {"softfinger": f", torsion_radius = {rng.uniform(0.005, 0.05):.3g}",
                 "hinge": f", half_length = {rng.uniform(0.005, 0.05):.3g}"}.get(kind, "")  # fmt: skip
        lines.append(f"contact = {{ mu = {rng.uniform(0.1, 1.2):.3g}{extra} }}")
    if rng.random() < 0.1:
        lines.append(f"wrench_limits = {{ force = {10 ** rng.uniform(0, 3):.4g} }}")
    return "\n".join(lines)


def _controller(rng, holding: list[str]) -> str:
    internal_force = f"internal_force = {rng.choice([0.0, 5.0, 20.0, 60.0])}"
    if not holding or rng.random() < 0.4:
        return f'[controller]\ntype = "gravity_compensation"\n{internal_force}\njoint_damping = {rng.uniform(0, 2):.3g}'
    shift, turn = rng.normal(0, 0.3, 3), rng.normal(0, 0.3, 3)
    path = (
        f"begin = 0.0\nduration = {10 ** rng.uniform(-2, 0):.4g}\ndisplacement = {_list(shift)}\nturn = {_list(turn)}"
    )
    return f'[controller]\ntype = "object_tracking"\n{internal_force}\n[controller.path]\n{path}'


def _simulation(rng, step: float, steps: int) -> str:
    lines = [
        f"[simulation]\nstep = {step:.6g}\nduration = {step * steps:.6g}",
        f'scheme = "{rng.choice(["rk4", "midpoint", "dop853"], p=[0.6, 0.3, 0.1])}"\nrtol = 1e-5',
        f'on_slip = "{rng.choice(["stop", "record", "release", "relase"], p=[0.35, 0.3, 0.33, 0.02])}"',
        f'on_limit = "{rng.choice(["record", "stop"], p=[0.7, 0.3])}"',
    ]
    if rng.random() < 0.2:
        lines.append(f"breakpoints = {_list(rng.uniform(-1, 5, 2) * step)}")
    return "\n".join(lines)


def _events(rng, names: list[str], holding: list[str], size, duration: float) -> list[str]:
    """Return up to three events; some are impossible, or too late."""
    found, times = [], np.sort(duration * rng.uniform(0, 1.03, 3))
    for t in times[: int(rng.choice([0, 0, 1, 2, 3]))]:
        arm = str(rng.choice(names))
        if (arm in holding) != (rng.random() < 0.05):
            found.append(f'[[events]]\ntype = "release"\nt = {t:.6g}\narm = "{arm}"')
            holding = [name for name in holding if name != arm]
        else:
            angle = 2 * np.pi * names.index(arm) / len(names)
            here = "true" if rng.random() < 0.7 else "false"
            contact = _contact(rng, str(rng.choice(KINDS)), angle, size)
            found.append(f'[[events]]\ntype = "attach"\nt = {t:.6g}\narm = "{arm}"\nhere = {here}\n{contact}')
            holding = [*holding, arm]
    return found


def _wrenches(rng, duration: float) -> list[str]:
    if rng.random() < 0.7:
        return []
    begin, end = np.sort(duration * rng.uniform(-0.1, 1.3, 2))
    force = rng.normal(0, 10 ** rng.uniform(0, 2.5), 3)
    return [f"[[wrenches]]\nforce = {_list(force)}\nbegin = {begin:.6g}\nend = {end:.6g}"]
