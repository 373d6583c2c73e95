"""The tests on the processors that this one can pass for: `make test-portable`, or `python -m tests.portable [ROW...]`.

NumPy's last digits belong to the processor's BLAS, so its packages run under several kernels of it. Machine code is
made for every level of instructions that this processor has, and for 64-bit ARM, which is emulated. Settings share a
cache of machine code: what all of them compile to the same text is compiled once. Tests that compare machine code with
itself run in the first row only, and for every level of instructions.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from tests.processors import environment, levels, settings

ROOT = Path(__file__).parents[1]
PACKAGES = [f"tests/{name}" for name in ("spatial", "dynamics", "laws", "simulation", "compiled")]
PROCESSORS = "tests/compiled/test_processors.py"  # sets its processors itself: once is enough
OF_ITSELF = [  # machine code against machine code: NumPy's kernels have no part in it
    *(
        f"tests/compiled/test_{name}.py"
        for name in ("batches", "cache_of_chains", "composition", "one_composition", "out")
    ),
    *(f"tests/simulation/rollout/test_{name}.py" for name in ("arguments", "bits", "call_inputs", "statuses")),
]
ARM = "tests/compiler/test_aarch64.py"
MACHINE_CODE = [  # those that run it; what is written of programs and schedules before is the same everywhere
    *(
        f"tests/compiler/test_{name}.py"
        for name in ("builtin", "elementary", "graph", "kernel", "llvm", "schedule", "signs_of_zeros")
    ),
    "tests/compiled/test_batches.py",
]
FORWARD = "tests/compiled/test_forward.py"  # against the reference; levels with fma have equal bits
COUNTED = ("passed", "failed", "error", "skipped")


class Row(NamedTuple):
    """One run of pytest.

    Attributes:
        name: what the processor passes for.
        setting: what is set in the environment.
        arguments: of pytest.
    """

    name: str
    setting: dict[str, str]
    arguments: list[str]


def rows() -> list[Row]:
    """Return all runs."""
    first, *others = settings().items()
    numeric = [Row(*first, [*PACKAGES, *_without([PROCESSORS])])]
    numeric += [Row(name, setting, [*PACKAGES, *_without([PROCESSORS, *OF_ITSELF])]) for name, setting in others]
    of_levels = [Row(x, {"HOLDFAST_CPU": x}, [*MACHINE_CODE, FORWARD]) for x in levels(False)]
    of_levels += [Row(x, {"HOLDFAST_CPU": x}, MACHINE_CODE) for x in levels(True)]
    return [*numeric, *of_levels, Row("bits of all with fma", {}, [PROCESSORS]), Row("aarch64 (QEMU)", {}, [ARM])]


def _without(files: list[str]) -> list[str]:
    return [f"--ignore={file}" for file in files]


def run(row: Row, cache: Path) -> tuple[int, dict[str, int], float]:
    """Return pytest's exit status, what it counted, and the time [s]."""
    print(f"\n== {row.name}: {' '.join(f'{k}={v!r}' for k, v in row.setting.items()) or 'as it is'}", flush=True)
    command = [sys.executable, "-m", "pytest", *row.arguments, "-m", "not long", "-n", "2", "--dist", "worksteal"]
    env = environment(row.setting) | {"HOLDFAST_TEST_CACHE": str(cache)}
    begin, last = time.monotonic(), ""
    with subprocess.Popen([*command, "-rfEs"], cwd=ROOT, env=env, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        for line in running.stdout:
            print(line, end="", flush=True)
            last = line if re.search(r"\d+ (passed|failed|error|skipped)", line) else last
    counts = {what: int(found[1]) if (found := re.search(rf"(\d+) {what}", last)) else 0 for what in COUNTED}
    return running.returncode, counts, time.monotonic() - begin


def main(wanted: list[str]) -> int:
    """Run all rows, or those of the names given; print the table; return 0 if nothing failed."""
    chosen = [row for row in rows() if not wanted or row.name in wanted]
    if not chosen:
        print(f"expected one of: {', '.join(row.name for row in rows())}; got {', '.join(wanted)}")
        return 2
    with tempfile.TemporaryDirectory(prefix="holdfast-portable-") as cache:
        found = [(row, *run(row, Path(cache))) for row in chosen]
    print(f"\n{'processor':22} {'passed':>7} {'failed':>7} {'skipped':>8} {'time':>7}")
    for row, status, counts, seconds in found:
        failed = counts["failed"] + counts["error"]
        ended = "" if status == (1 if failed else 0) else f"  pytest ended with {status}"  # -9: killed
        print(f"{row.name:22} {counts['passed']:7} {failed:7} {counts['skipped']:8} {seconds:5.0f} s{ended}")
    print(f"{'in all':22} {'':24} {sum(seconds for *_, seconds in found):5.0f} s")
    return 1 if any(status for _, status, *_ in found) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
