"""Random runs of `simulate` by an earlier commit and by the working tree: are they the same?

Each version makes all runs in a process of its own with an empty cache of machine code; the earlier one's sources come
from a worktree of Git that is removed at the end. `run_differences` states the bars; exit status 1 if any is broken.

With `--blas Prescott` the working tree computes by another BLAS kernel: against HEAD this shows what rounding does.

python benchmarks/against.py COMMIT [--scenes 500] [--seed 0] [--jobs 2] [--only SEED ...] [--keep FOLDER]
"""

from __future__ import annotations

import argparse
import hashlib
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.run_differences import ADAPTIVE, AFTER, BEFORE, INSTANTS, Difference, Record, differences

ROOT = Path(__file__).parents[1]
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "HOLDFAST_COMPILE": "quick"}
MEASURES = {"before": BEFORE, "after": AFTER, "adaptive": ADAPTIVE, "instants": INSTANTS}


def recorded(seed: int) -> Record:
    """Return the run of a seed as plain data: its arrays, its log, how it ended, or the error that it raised."""
    import holdfast as hf
    from benchmarks.random_runs import random_run

    begin = time.process_time()
    made = random_run(seed)
    found: Record = {"family": made.family, "options": made.options, "tolerance": made.tolerance}
    found |= {"arrays": {}, "stopped": None, "occurrences": [], "error": None}
    try:
        run = made.make()
    except Exception as error:  # whatever a version raises, the other one has to raise as well
        found["error"] = f"{type(error).__name__}: {error}"
    else:
        every = {one.name: getattr(run, one.name) for one in fields(hf.simulation.Trajectory)}
        found["arrays"] = {name: np.array(x) for name, x in every.items() if isinstance(x, np.ndarray)}
        found["stopped"] = run.stopped
        found["occurrences"] = [asdict(one) for one in run.occurrences]
    found["seconds"] = time.process_time() - begin
    return found


def record(seeds: list[int], folder: Path, sources: Path) -> None:
    """Record runs into files of a folder, those that are not there yet."""
    import holdfast as hf

    if not Path(hf.__file__).is_relative_to(sources):
        raise SystemExit(f"expected the sources of {sources}, got {hf.__file__}")
    for k, seed in enumerate(seeds, start=1):
        path = _file(folder, seed)
        if not path.exists():
            part = path.with_suffix(".part")
            part.write_bytes(pickle.dumps(recorded(seed)))
            part.replace(path)
        if k % 10 == 0 or k == len(seeds):
            print(f"{folder.name}: {k} of {len(seeds)} runs", file=sys.stderr, flush=True)


def _file(folder: Path, seed: int) -> Path:
    return folder / f"{seed}.pickle"


@contextmanager
def worktree(commit: str) -> Iterator[Path]:
    """Check a commit out into a temporary folder within this context."""
    with tempfile.TemporaryDirectory(prefix="holdfast-against-") as temporary:
        path = Path(temporary) / "commit"
        _git("worktree", "add", "--quiet", "--detach", str(path), commit)
        try:
            yield path
        finally:
            _git("worktree", "remove", "--force", str(path))


def _git(*arguments: str) -> str:
    return subprocess.run(["git", "-C", str(ROOT), *arguments], check=True, capture_output=True, text=True).stdout


def start(sources: Path, seeds: list[int], folder: Path, setting: dict[str, str]) -> subprocess.Popen[bytes]:
    """Start a process that records runs with the sources of a version and a setting of its environment."""
    folder.mkdir(parents=True, exist_ok=True)
    cache = folder / "cache"
    cache.mkdir(mode=0o700, exist_ok=True)
    env = os.environ | ONE_THREAD | setting | {"PYTHONPATH": str(sources), "HOLDFAST_CACHE": str(cache)}
    command = [sys.executable, __file__, "--record", str(folder), str(sources), *map(str, seeds)]
    return subprocess.Popen(command, env=env)


def record_both(versions: Sequence[tuple[Path, Path, dict[str, str]]], seeds: list[int], jobs: int) -> None:
    """Record the runs of several versions, so many processes at a time.

    Args:
        versions: folders of the sources and of the records, and settings of the environment.
        seeds: of the runs.
        jobs: number of processes.
    """
    parts = max(1, jobs // len(versions))
    waiting = [
        (sources, seeds[k::parts], folder, setting) for k in range(parts) for sources, folder, setting in versions
    ]
    running: list[subprocess.Popen[bytes]] = []
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                running.append(start(*waiting.pop(0)))
            running = [one for one in running if one.poll() is None]
            time.sleep(0.1)
    finally:
        for one in running:
            one.kill()


def _digest() -> str:
    """Return a digest of what the runs are made of, apart from the library."""
    made_of = [
        *ROOT.glob("benchmarks/random_*.py"),
        *ROOT.glob("tests/systems/*.py"),
        *ROOT.glob("tests/simulation/*.py"),
    ]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(made_of))).hexdigest()


def ends(run: Record) -> Iterator[str]:
    """Yield in words what happened in a run."""
    kinds = Counter(one["kind"] for one in run["occurrences"])
    yield from kinds
    if run["error"]:
        yield "raised"
    elif run["stopped"]:
        yield "slip" if re.search(r"slips|lifts off|gives way|tips", run["stopped"]) else "ended early"
    else:
        yield "complete"


def report(old: Path, new: Path, seeds: list[int]) -> int:
    """Print how far all runs are apart by family, what happened in them, and what failed; return how many did."""
    by_family: dict[str, list[Difference]] = defaultdict(list)
    happened: dict[str, Counter[str]] = defaultdict(Counter)
    failed: list[str] = []
    seconds = [0.0, 0.0]
    for seed in seeds:
        pair = [_loaded(_file(folder, seed)) for folder in (old, new)]
        if pair[0] is None or pair[1] is None:
            failed.append(f"seed {seed}: its process ended before it was recorded")
            continue
        found = differences(*pair)
        family = pair[0]["family"]
        by_family[family].append(found)
        happened[family].update(ends(pair[0]))
        seconds = [total + run["seconds"] for total, run in zip(seconds, pair, strict=True)]
        failed += [f"seed {seed} ({family}; {pair[0]['options']}): {what}" for what in found.failures]
    print(
        f"{'family':20}{'runs':>5}{'before':>10}{'after':>10}{'adaptive':>10}{'instants':>10}{'same':>6}  what happened"
    )
    print(f"{'':20}{'':5}{'1e-11':>10}{'1e-9':>10}{'10 tol':>10}{'1e-9 s':>10}")
    for family, all_found in by_family.items():
        print(_row(family, all_found, happened[family]))
    print(_row("all", [one for found in by_family.values() for one in found], sum(happened.values(), Counter())))
    print(f"processor time: {seconds[0]:.0f} s by the commit, {seconds[1]:.0f} s by the working tree")
    for line in failed:
        print(line)
    return len(failed)


def _loaded(path: Path) -> Any:
    return pickle.loads(path.read_bytes()) if path.exists() else None


def _row(family: str, found: list[Difference], happened: Counter[str]) -> str:
    worst = [max((getattr(one, name) for one in found), default=0.0) for name in MEASURES]
    said = ", ".join(f"{what} {count}" for what, count in happened.most_common())
    same = sum(not one.failures for one in found)
    return f"{family:20}{len(found):5}" + "".join(f"{x:10.1e}" for x in worst) + f"{same:6}  {said}"


def main() -> None:
    """Compare the working tree with a commit."""
    if sys.argv[1:2] == ["--record"]:
        folder, sources, *seeds = sys.argv[2:]
        record([int(seed) for seed in seeds], Path(folder), Path(sources))
        return
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("commit", help="the earlier commit")
    parser.add_argument("--scenes", type=int, default=500, help="number of runs")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first run")
    parser.add_argument("--jobs", type=int, default=2, help="number of processes")
    parser.add_argument("--only", type=int, nargs="+", help="seeds of the runs, instead of --scenes and --seed")
    parser.add_argument("--keep", type=Path, help="folder for the commit's runs, which are not made again next time")
    parser.add_argument("--blas", help="OPENBLAS_CORETYPE of the working tree's runs")
    chosen = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that the worktree is removed
    seeds = chosen.only or [*range(chosen.seed, chosen.seed + chosen.scenes)]
    commit = _git("rev-parse", "--verify", f"{chosen.commit}^{{commit}}").strip()
    with worktree(commit) as checkout, tempfile.TemporaryDirectory(prefix="holdfast-runs-") as temporary:
        old = (chosen.keep or Path(temporary)) / f"commit {commit[:12]}, runs {_digest()[:8]}"
        new = Path(temporary) / "working tree"
        tree = Path(temporary) / "src"
        shutil.copytree(ROOT / "src", tree)  # so that the tree can be edited meanwhile
        blas = {"OPENBLAS_CORETYPE": chosen.blas} if chosen.blas else {}
        record_both([(checkout / "src", old, {}), (tree, new, blas)], seeds, chosen.jobs)
        failures = report(old, new, seeds)
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
