"""Sweeps by clusters of Dask: misuse in words, and the same bytes whoever died."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import holdfast as hf
from holdfast.sweeps.chunk import compute
from tests.sweeps.problems import data, small_sweep
from tests.sweeps.test_scene_sweep import TEXT

pytest.importorskip("pyarrow", reason="needs pyarrow: pip install 'holdfast[parquet]'")
pytest.importorskip("distributed", reason="needs distributed: pip install 'holdfast[dask]'")

PROGRAM = "import sys, holdfast.cli\nif __name__ == '__main__': sys.exit(holdfast.cli.main())"
LARGE = {"count": 4000, "chunk": 20, "duration": 0.02}


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"cluster": 3}, "cluster: expected an address"),
        ({"cluster": ""}, "cluster: expected an address"),
        ({"cluster": "tcp://127.0.0.1:1", "workers": 2}, "expected none beside"),
        ({"cluster": "local", "workers": 0}, "workers"),
        ({"cluster": "local", "workers": object()}, "workers"),
        ({"cluster": "nonsense://x"}, "no scheduler with a worker answers"),
        ({"cluster": "tcp://127.0.0.1:1"}, "no scheduler with a worker answers"),
    ],
)
def test_misuse(changed, said, tmp_path, monkeypatch):
    """Refused in words, and nothing is computed."""
    monkeypatch.setattr("holdfast.sweeps.workers.CONNECTION_TIMEOUT", 0.2)
    with pytest.raises(hf.errors.HoldfastError) as refused:
        small_sweep(tmp_path, **changed)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
    assert not data(tmp_path)


def test_the_extra_is_missing(tmp_path, monkeypatch):
    """The message has the command that installs it."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(hf.errors.MissingExtra, match=r"holdfast\[dask\]"):
        small_sweep(tmp_path, cluster="local")


def test_workers_with_other_libraries(tmp_path, monkeypatch):
    """A worker whose results would have other last bits refuses its chunk."""
    other = {"versions": {"numpy": "0.1"}, "processor": "abacus"}
    elsewhere = lambda task, **how: compute(task._replace(made_by=other), **how)  # noqa: E731
    monkeypatch.setattr("holdfast.sweeps.workers.compute", elsewhere)
    with pytest.raises(hf.errors.ResultError, match=r"expected workers with numpy 0.1, abacus"):
        small_sweep(tmp_path)


def gone(group):
    """Return whether a group of processes ends within twenty seconds."""
    for _ in range(200):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


class Cluster:
    """A scheduler and two workers as processes of their own, each begun again when it has died."""

    def __init__(self, scratch):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.address, own = f"tcp://127.0.0.1:{port}", ["--no-dashboard"]
        scheduler = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port), *own]
        worker = ["distributed.cli.dask_worker", self.address, "--nthreads", "1", "--no-nanny", "--death-timeout", "30"]
        self.commands = [scheduler, *[[*worker, "--local-directory", str(scratch), *own]] * 2]
        self.processes = [self.started(k) for k in range(3)]
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.tend)
        self.thread.start()

    def started(self, k):
        return subprocess.Popen([sys.executable, "-m", *self.commands[k]], stderr=subprocess.DEVNULL)

    def tend(self):
        while not self.ended.wait(0.1):
            for k, process in enumerate(self.processes):
                if process.poll() is not None:
                    self.processes[k] = self.started(k)

    def kill(self, k):
        self.processes[k].send_signal(signal.SIGKILL)

    def close(self):
        self.ended.set()
        self.thread.join()
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.skipif(os.name == "nt", reason="needs signals of POSIX; none can be installed")
def test_killed(tmp_path):
    """Workers killed twenty times, the scheduler three times: every chunk once, every byte as undisturbed."""
    expected = data(small_sweep(tmp_path / "undisturbed", **LARGE).folder)
    dice, killed, kept = np.random.default_rng(0), [], [0]
    plan = [1, 2, 1, 2, 2, 0, 1, 2, 1, 1, 2, 0, 1, 1, 2, 2, 1, 0, 2, 1, 2, 1, 2]  # 0 is the scheduler
    several = Cluster(tmp_path)

    def kill_one(progress):
        kept[0] += 1
        if plan and kept[0] >= 3 and (several.processes[plan[0]].poll() is None):
            several.kill(plan[0])
            killed.append(plan.pop(0))
            kept[0] = -int(dice.integers(0, 4))

    try:
        small_sweep(tmp_path / "store", cluster=several.address, progress=kill_one, ahead=6, **LARGE)
    finally:
        several.close()
    assert (sum(k > 0 for k in killed), killed.count(0)) == (20, 3)
    assert data(tmp_path / "store") == expected
    chunks = [json.loads(line)["chunk"] for line in (tmp_path / "store" / "log.jsonl").read_text().splitlines()]
    assert sorted(chunks) == list(range(200))


@pytest.mark.long
@pytest.mark.skipif(os.name == "nt", reason="needs signals of POSIX; none can be installed")
@pytest.mark.parametrize("how", [["--workers", "2"], ["--cluster", "local", "--workers", "2"]])
@pytest.mark.parametrize("chunks", [0, 3])
def test_interrupted(how, chunks, tmp_path):
    """Ctrl-C, which a terminal tells all processes, early or late: one line, exit code 130, and nobody is left."""
    scene, store = tmp_path / "scene.toml", tmp_path / "store"
    scene.write_text(TEXT.replace("count = 7", "count = 100_000").replace("chunk = 3", "chunk = 20"))
    command = [sys.executable, "-c", PROGRAM, "sweep", str(scene), "--out", str(store), *how]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    while process.poll() is None and not ((store / "sweep.json").exists() and len(data(store)) >= chunks):
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    lines = [line for line in said.splitlines() if not line.startswith("sweeping")]
    assert process.returncode == 130, said
    assert len(lines) == 1 and "interrupted; what was finished is in" in lines[0], said
    assert gone(process.pid)


@pytest.mark.long
@pytest.mark.parametrize("workers", [1, 3, 7])
def test_local(workers, tmp_path):
    """A local cluster of one, three or seven workers gives the bytes of this process."""
    expected = data(small_sweep(tmp_path / "here").folder)
    assert data(small_sweep(tmp_path / "there", cluster="local", workers=workers).folder) == expected
