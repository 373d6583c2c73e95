"""Random instants in the layout of cases_contact, answered and compared with an enumeration of all modes.

    python -m benchmarks.contact_instants --count 300

The chains are those of tests/data/cases.json. Mobility, free motion and what follows from the contacts' wrench come
from the dense equations of `tests.oracles.maximal_kkt`, the motions that the laws allow from
`tests.oracles.contact_modes`. One motion must be answered as OK (or INDETERMINATE_FORCES), several as AMBIGUOUS, none
as JAMMED.
"""

from __future__ import annotations

import argparse
import copy
import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from tests.oracles.contact_modes import Motion, all_motions
from tests.oracles.maximal_kkt import solve

from holdfast.cli.contact_answers import contact_answers
from holdfast.io.case_file import parse_cases
from holdfast.io.contact_case import ContactCase
from holdfast.spatial.scalar import Array

CHAINS = json.loads((Path(__file__).parents[1] / "tests/data/cases.json").read_text(encoding="utf-8"))["cases"]
FAMILIES = {  # kind, and the largest friction of each contact
    "impact_1": ("impact", (1.6,)),
    "impact_2": ("impact", (1.6, 1.6)),
    "impact_3": ("impact", (1.6, 1.6, 0.0)),
    "impact_6": ("impact", (0.0,) * 6),
    "rest_1": ("rest", (1.6,)),
    "rest_2": ("rest", (1.6, 1.6)),
    "rest_4": ("rest", (0.0,) * 4),
    "sliding_1": ("sliding", (0.8,)),
    "sliding_2": ("sliding", (0.8, 0.8)),
    "sliding_3": ("sliding", (0.8, 0.8, 0.8)),
}
WORDS = {"o": "open", "s": "sticks", "x": "slips"}
LEAST_MARGIN = 1e-4  # nearer to another mode, an instant is drawn again
AGREED = 1e-9


def instant(seed: int) -> tuple[dict[str, Any], list[Motion]]:
    """Return a case with its answer, and all motions that the laws allow."""
    dice = np.random.default_rng([seed, 44])
    while True:
        name = list(FAMILIES)[dice.integers(len(FAMILIES))]
        kind, friction = FAMILIES[name]
        chosen = CHAINS[dice.integers(len(CHAINS))]
        if not (chosen["tags"]["f_unique"] and chosen["tags"]["omega_regular"]):
            continue
        case = at_rest(chosen) if kind == "rest" else copy.deepcopy(chosen)
        case |= {"name": f"{name}_{seed}", "kind": kind, "solutions": 1}
        del case["expected"]
        if kind == "impact" and not np.any(case["object"]["v"]):
            continue
        P, V0 = mobility(case)
        rows = placed(dice, case, friction, V0)
        if rows is None:
            continue
        C, b, slide, mu = rows
        found = all_motions(P, C, b, mu, slide)
        if any(one.margin < LEAST_MARGIN for one in found):
            continue
        if len(found) == 1:
            if not np.isfinite(found[0].forces).all() and np.linalg.cond(P) > 1e9:
                continue  # wrenches that move nothing are not unique either
            case["expected"] = expected(case, found[0], C, b)
        return case, found


def at_rest(case: dict[str, Any]) -> dict[str, Any]:
    """Return a case without any velocity."""
    case = copy.deepcopy(case)
    for part in [case["object"], *(arm["base"] for arm in case["arms"])]:
        for one in set(part) & {"omega", "v", "omega_dot", "v_dot"}:
            part[one] = [0.0, 0.0, 0.0]
    for arm in case["arms"]:
        arm["qd"] = [0.0] * len(arm["qd"])
    return case


def without_loads(case: dict[str, Any]) -> dict[str, Any]:
    """Return a case at rest that nothing pulls."""
    case = at_rest(case) | {"gravity": [0.0, 0.0, 0.0]}
    for arm in case["arms"]:
        arm["tau"] = [0.0] * len(arm["tau"])
    return case


def pushed(case: dict[str, Any], wrench: Array) -> dict[str, Any]:
    """Return a case with a wrench on the object."""
    return case | {"object": case["object"] | {"wrench": wrench.tolist()}}


def mobility(case: dict[str, Any]) -> tuple[Array, Array]:
    """Return the object's mobility, and its velocity or free acceleration."""
    still = without_loads(case)
    P = np.array([solve(pushed(still, e))["alpha_C"] for e in np.eye(6)]).T
    own = case["object"]
    free = np.array(own["omega"] + own["v"]) if case["kind"] == "impact" else solve(case)["alpha_C"]
    return (P + P.T) / 2.0, free


def placed(
    dice: np.random.Generator, case: dict[str, Any], friction: tuple[float, ...], V0: Array
) -> tuple[Array, Array, Array, Array] | None:
    """Add contacts to a case; return their rows, free velocities or accelerations, slips and friction."""
    own = case["object"]
    R, p, twist = np.array(own["R"]), np.array(own["p"]), np.array(own["omega"] + own["v"])
    case["contacts"], rows, slide, drift = [], [], [], []
    for most in friction:
        point = dice.uniform(-0.25, 0.25, 3)
        l, n = R @ point, unit(dice.normal(size=3))
        velocity = twist[3:] + np.cross(twist[:3], l)
        if case["kind"] == "sliding":
            if np.linalg.norm(velocity) < 1e-2:
                return None
            n = unit(n - velocity * (n @ velocity) / (velocity @ velocity))
        turning = np.cross(twist[:3], np.cross(twist[:3], l)) if case["kind"] == "sliding" else np.zeros(3)
        moves = V0[3:] + np.cross(V0[:3], l) + turning
        n = -n if n @ moves > 0.0 and dice.random() < 0.9 else n
        t1 = unit(np.cross(n, np.eye(3)[np.argmin(np.abs(n))]))
        axes = np.array([t1, np.cross(n, t1), n])
        mu = round(float(dice.uniform(0.1, most)), 3) if most else 0.0
        case["contacts"].append(
            {"point_object": point.tolist(), "normal": n.tolist(), "offset": float(n @ (p + l)), "mu": mu}
        )
        rows.append([np.concatenate([np.cross(l, t), t]) for t in axes])
        slide.append(axes[:2] @ unit(velocity) if case["kind"] == "sliding" else np.zeros(2))
        drift.append(axes @ turning)
    C, mu = np.array(rows), np.array([one["mu"] for one in case["contacts"]])
    return C, C @ V0 + np.array(drift), np.array(slide), mu


def unit(x: Array) -> Array:
    """Return a vector of length 1."""
    return x / np.linalg.norm(x)


def expected(case: dict[str, Any], one: Motion, C: Array, b: Array) -> dict[str, Any]:
    """Return the answer: forces, and what the chain does with their sum by the dense equations."""
    known = np.isfinite(one.forces).all()
    w = np.einsum("kia,ki->a", C, one.forces) if known else np.array(one.wrench)
    frictionless = [contact["mu"] == 0.0 for contact in case["contacts"]]
    modes = [
        "closed" if letter == "x" and free else WORDS[letter]
        for letter, free in zip(one.modes, frictionless, strict=True)
    ]
    told = {"modes": modes, "contact_force_unique": bool(known), "object_wrench": w.tolist(), "margin": one.margin}
    if known:
        told["contact_force"] = np.einsum("ki,kia->ka", one.forces, C[:, :, 3:]).tolist()
    if case["kind"] != "impact":
        after = solve(pushed(case, w))
        rates = {"qdd": [x.tolist() for x in after["qdd"]], "f": [x.tolist() for x in after["f"]]}
        return told | rates | {"alpha_C": after["alpha_C"].tolist()}
    own = case["object"]
    change = solve(pushed(without_loads(case), w))
    qd = [(np.array(arm["qd"]) + x).tolist() for arm, x in zip(case["arms"], change["qdd"], strict=True)]
    twist = np.array(own["omega"] + own["v"]) + change["alpha_C"]
    told |= {"object_twist": twist.tolist(), "qd": qd, "grasp_impulse": [x.tolist() for x in change["f"]]}
    if known and not case["tags"]["moving_base"]:
        told["energy_change"] = float((one.forces * (b + 0.5 * C @ change["alpha_C"])).sum())
    return told


def compared(seed: int) -> tuple[str, str | None]:
    """Return how an instant was answered, and what is wrong with it."""
    case, found = instant(seed)
    (parsed,) = parse_cases(json.dumps([case]).encode(), case["name"])
    assert isinstance(parsed, ContactCase)
    (answer,) = contact_answers(parsed, ["sequential"])
    wanted = ("JAMMED", "unique", "AMBIGUOUS")[min(len(found), 2)]
    if len(found) == 1:
        wanted = "OK" if case["expected"]["contact_force_unique"] else "INDETERMINATE_FORCES"
    told = f"{case['kind']}: {wanted} answered {answer.status}"
    truth = f"{case['name']}: {[(one.modes, f'{one.margin:.1e}') for one in found]}, {answer.status} {answer.reason}"
    if answer.status != wanted:
        return told, truth
    if answer.error is not None and answer.error > AGREED:
        return told, f"{truth}, error {answer.error:.1e}"
    return told, None


def main() -> None:
    """Compare, and print what differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    ends, wrong = Counter[str](), 0
    for seed in range(given.first, given.first + given.count):
        told, fault = compared(seed)
        ends[told] += 1
        if fault is not None:
            wrong += 1
            print(f"seed {seed}, {fault}", flush=True)
    for told, count in sorted(ends.items()):
        print(f"{count:5d} {told}")
    print(f"{wrong} of {given.count} differ")


if __name__ == "__main__":
    main()
