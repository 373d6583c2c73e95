"""What a step of `simulate` costs, beside the same step in a rollout: two Pandas hold a box by springs in their joints.

Run it with HOLDFAST_COMPILE unset, on a quiet machine; `--write` puts the table into the page, `--rollouts` prints the
steps of rollouts alone, among them those of hands with two fingers each, beside the operations of a step.

python benchmarks/simulation_cost.py [--only TEXT] [--write docs/limitations.md | --rollouts]
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import holdfast as hf
from benchmarks.bench.clock import least_time
from benchmarks.bench.systems import facing_pandas
from holdfast.cli.doctor import processor

STEP, STEPS, ROUNDS, MANY = 1e-3, 1000, 5, 1000
BEGIN, END = "<!-- cost:begin -->\n", "<!-- cost:end -->\n"


def with_grippers(serial: hf.ClosedChain, state: hf.State) -> tuple[hf.ClosedChain, hf.State]:
    """Return a chain with two fingers at every hand, one of which mimics the other."""
    finger, arms, grasps, q = hf.Link(0.1, [0, 0, 0.02], 1e-4 * np.eye(3)), {}, {}, []
    for name, arm in serial.arms.items():
        slides = [
            hf.Joint("prismatic", axis=[0, side, 0], placement=hf.Pose.translation(0, 0, 0.16), name=f"finger{k + 1}")
            for k, side in enumerate((1, -1))
        ]
        arms[name] = hf.Arm(
            [*arm.joints, *slides],
            [*arm.links, finger, finger],
            base=arm.base,
            parents=[None, *range(len(arm.joints)), len(arm.joints) - 1],
            frames={"hand": (len(arm.joints) - 1, arm.tip)},
            couplings=[hf.Coupling({"finger1": 1.0, "finger2": -1.0})],
        )
        grasps[name, "hand"] = serial.grasps[name]
        q += [*state.q[serial.joints[name]], 0.02, 0.02]
    chain = hf.ClosedChain(arms, serial.held_object, grasps)
    return chain, hf.State(q, np.zeros(len(q)), state.object_pose)


def costs(only: str | None = None) -> Iterator[tuple[str, float]]:
    """Yield what is run, and the processor time of a step [us]; with `only`, of the runs that are named like this."""
    rigid, state = facing_pandas()
    hold = hf.holding_torques(rigid, state, internal_force=40.0)

    def springs(t: Any, now: Any, memory: Any) -> tuple[Any, Any]:
        return hold + 200.0 * (state.q - now.q) - 0.5 * now.qd, memory

    def push(t: float) -> hf.Inputs:
        return hf.Inputs(object_wrench=[0.0, 0.0, 0.0, 2.0 * math.sin(20.0 * t), 0.0, 0.0])

    law = hf.ControlLaw(lambda t, now, memory, given: springs(t, now, memory))
    gripped, _ = facing_pandas("softfinger", hf.Friction(mu=0.8, torsion_radius=0.02))
    handy, open_hands = with_grippers(rigid, state)
    hold_with_hands = hf.holding_torques(handy, open_hands)
    path = hf.control.RestToRest(open_hands.object_frame, displacement=[0.0, 0.0, 0.05])

    def by_hand(t: Any, now: Any, memory: Any) -> tuple[Any, Any]:
        return hold_with_hands + 200.0 * (open_hands.q - now.q) - 0.5 * now.qd, memory

    runs: tuple[tuple[str, hf.ClosedChain, hf.State, Any, dict[str, Any]], ...] = (
        ("`simulate`, a Python function called at every stage", rigid, state, springs, {}),
        (
            "`simulate`, a Python function called once per step (`sample_time`)",
            rigid,
            state,
            springs,
            {"sample_time": STEP},
        ),
        ("`simulate`, a `ControlLaw`, a wrench that is a Python function of time", rigid, state, law, {"inputs": push}),
        ("`simulate`, a `ControlLaw`", rigid, state, law, {}),
        ("`simulate`, a `ControlLaw`, by the adaptive scheme", rigid, state, law, {"scheme": "dop853"}),
        ("`simulate`, a `ControlLaw`, soft fingers with friction", gripped, state, law, {}),
        (
            "`simulate`, hands with two fingers each, a Python function called at every stage",
            handy,
            open_hands,
            by_hand,
            {},
        ),
        (
            "`simulate`, hands with two fingers each, `ObjectTracking`",
            handy,
            open_hands,
            hf.control.ObjectTracking(handy, path),
            {},
        ),
    )
    for what, chain, start, controller, options in runs:
        if only is not None and only not in what:
            continue
        run = lambda c=chain, x=start, f=controller, o=options: hf.simulate(c, x, f, STEPS * STEP, STEP, **o)  # noqa: E731
        yield what, 1e6 * least_time(run, 1, ROUNDS) / STEPS
    if only is not None:
        return
    rollout = hf.compile_rollout(rigid, law)
    for count in (1, MANY):
        steps = STEPS if count == 1 else 20
        systems = rollout.start(np.tile(state.q, (count, 1)), state.qd, state.object_pose, state.object_twist)
        run = lambda s=systems, n=steps: rollout.step(s.copy(), STEP, steps=n, threads=1)  # noqa: E731
        plural = "system" if count == 1 else "systems, each of them"
        yield f"rollout of {count} {plural}, the same `ControlLaw`", 1e6 * least_time(run, 1, ROUNDS) / (steps * count)
    wanted = hf.forward_dynamics(gripped, state, hold)
    best = lambda: hf.forces.largest_margin(gripped, state, wanted, effort_limits=True)  # noqa: E731
    yield "one `largest_margin` of the soft fingers, with effort limits", 1e6 * least_time(best, 1, ROUNDS)
    cheapest = lambda: hf.forces.distribute(gripped, state)  # noqa: E731
    yield "one `distribute` of the soft fingers", 1e6 * least_time(cheapest, 1, ROUNDS)


def of_rollouts() -> Iterator[str]:
    """Yield a line for rollouts of several chains: operations of a step, its time alone, in a batch, with gradients."""
    rigid, state = facing_pandas()
    handy, open_hands = with_grippers(rigid, state)
    for what, chain, start in (("two Pandas", rigid, state), ("with two fingers each", handy, open_hands)):
        for scheme in ("rk4", "midpoint"):
            rollout = hf.compile_rollout(chain, scheme=scheme)
            times = []
            for count, steps in ((1, STEPS), (512, 20)):
                q = np.tile(start.q, (count, 1))
                tau = hf.holding_torques(chain, start)
                systems = rollout.start(q, start.qd, start.object_pose, start.object_twist, tau=tau)
                run = lambda s=systems, n=steps, r=rollout: r.step(s.copy(), STEP, steps=n, threads=1)  # noqa: E731
                times.append(1e6 * least_time(run, 1, ROUNDS) / (steps * count))
            back = lambda s=systems, r=rollout: r.tape(s, STEP, steps=20, threads=1).vjp({"q": s.q}, threads=1)  # noqa: E731
            times.append(1e6 * least_time(back, 1, ROUNDS) / (20 * 512))
            operations = rollout.kernel.step_code.schedule.operation_count
            yield (
                f"{what}, {scheme}: {operations:,} operations, one {times[0]:.1f} us, of 512 {times[1]:.2f} us each,"
                f" with gradients {times[2]:.2f} us"
            )


def row(what: str, cost: float) -> str:
    """Return a row of the table."""
    return f"| {what} | {cost:,.{0 if cost >= 10 else 1}f} us |"


def table() -> str:
    """Return the table of costs as Markdown."""
    rows = [row(*one) for one in costs()]
    name = processor()[0]
    return "\n".join(
        ["| two Pandas and a box, steps of 1 ms | processor time of a step or call |", "|---|---|", *rows]
    ) + (f"\n\nOne thread, {name}; after the first run, which compiles.\n")


def main() -> None:
    """Print the table, or write it between the markers of a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, help="the page")
    parser.add_argument("--rollouts", action="store_true", help="rollouts alone")
    parser.add_argument("--only", help="the runs that are named like this, whose rows alone are written")
    asked = parser.parse_args()
    if asked.only is not None:
        lines = [] if asked.write is None else asked.write.read_text().split("\n")
        for what, cost in costs(asked.only):
            print(row(what, cost))
            lines = [row(what, cost) if line.startswith(f"| {what} |") else line for line in lines]
        if asked.write is not None:
            asked.write.write_text("\n".join(lines))
        return
    if asked.rollouts:
        for line in of_rollouts():
            print(line)
        return
    page, found = asked.write, table()
    if page is None:
        print(found)
        return
    before, opened, rest = page.read_text().partition(BEGIN)
    _, closed, after = rest.partition(END)
    if not opened or not closed:
        parser.error(f"{page}: expected {BEGIN.strip()} and after it {END.strip()}")
    page.write_text(f"{before}{BEGIN}{found}{END}{after}")


if __name__ == "__main__":
    main()
