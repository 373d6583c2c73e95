"""What checking the inputs of a compiled call costs, for every question: two Pandas with a box.

The cost is a call less a call bound to arrays; beside it, its ratio to that of `forward_dynamics(out=)`. Run it with
HOLDFAST_COMPILE unset, on a quiet machine: `python -m benchmarks.call_overhead`.
"""

from __future__ import annotations

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator

import numpy as np

import holdfast as hf
from benchmarks.bench.clock import Effort, timed
from benchmarks.bench.entries import Timed
from benchmarks.bench.systems import make_system
from holdfast.questions.question import QUESTIONS

EFFORT = Effort(turn=0.02, rounds=15)
FIRST = "forward_dynamics(out=)"


def entries() -> Iterator[Timed]:
    """Yield for each question a call, then the same call bound to arrays."""
    system = make_system(2, 7, states=1)
    fast = hf.compile(system.chain)
    q, qd, tau, object_pose, object_twist = (x[0].copy() for x in system.arrays)
    given = {"q": q, "qd": qd, "tau": tau, "object_pose": object_pose, "object_twist": object_twist}
    given |= {"qdd": np.zeros_like(q), "grasp_wrench": np.zeros((2, 6)), "acceleration": np.zeros(6)}
    out = fast.forward_dynamics(q, qd, tau, object_pose, object_twist)
    whole = fast.forward_dynamics.bind(q=q, qd=qd, tau=tau, object_pose=object_pose, object_twist=object_twist)
    yield Timed(FIRST, "call", lambda: fast.forward_dynamics(q, qd, tau, object_pose, object_twist, out=out), 1)
    yield Timed(FIRST, "bound", whole, 1)
    for name, question in QUESTIONS.items():
        function = getattr(fast, name)
        values = [given[x] for x in question.inputs]
        yield Timed(name, "call", lambda f=function, x=values: f(*x), 1)
        yield Timed(name, "bound", function.bind(**dict(zip(question.inputs, values, strict=True))), 1)


def main() -> None:
    """Print microseconds a call."""
    asked = list(entries())
    seconds = timed(asked, EFFORT)
    calls, bound = seconds[:, ::2], seconds[:, 1::2]
    checks = np.median(calls - bound, axis=0)
    print(f"{'us':24}{'call':>8}{'bound':>8}{'checks':>8}{'ratio':>8}")
    for k, entry in enumerate(asked[::2]):
        call, kept = (1e6 * float(np.median(x[:, k])) for x in (calls, bound))
        print(f"{entry.name:24}{call:8.2f}{kept:8.2f}{1e6 * checks[k]:8.2f}{checks[k] / checks[0]:8.2f}")


if __name__ == "__main__":
    ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter).parse_args()
    main()
