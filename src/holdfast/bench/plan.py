"""What a run of the benchmark measures."""

from __future__ import annotations

from dataclasses import dataclass

from holdfast.bench.clock import Effort

Size = tuple[int, int]  # arms, joints of each


@dataclass(frozen=True)
class Plan:
    """The sizes and the effort of a run.

    Attributes:
        mode: its name.
        systems: sizes to compare at.
        batch_sizes: states in one call.
        batch_of: the system whose states those are.
        growth: pairs (larger, smaller) whose times are compared in the same rounds.
        compiled: sizes whose compile time is taken.
        compile_runs: fresh processes for each.
        effort: of every timing.
        rollout_sizes: systems of `batch_of` that one call steps.
    """

    mode: str
    systems: tuple[Size, ...]
    batch_sizes: tuple[int, ...]
    growth: tuple[tuple[Size, Size], ...]
    compiled: tuple[Size, ...]
    compile_runs: int
    effort: Effort
    batch_of: Size = (2, 7)
    rollout_sizes: tuple[int, ...] = ()


QUICK = Plan(
    "quick", ((2, 7), (4, 7), (2, 24)), (512,), (), ((2, 7),), 1, Effort(turn=0.02, rounds=5), rollout_sizes=(512,)
)
FULL = Plan(
    "full",
    (
        *((arms, 7) for arms in (2, 3, 4, 8, 16, 32, 64)),
        *((2, joints) for joints in (6, 12, 24, 48, 96)),
    ),
    (1, 8, 64, 512, 4096, 16384),
    (((64, 7), (16, 7)), ((2, 96), (2, 24))),
    ((2, 7), (64, 7), (2, 96)),
    3,
    Effort(turn=0.03, rounds=15),
    rollout_sizes=(8, 64, 512, 4096),
)


def name_of(size: Size) -> str:
    """Return "l x N"."""
    return f"{size[0]} x {size[1]}"
