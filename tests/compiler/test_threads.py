"""Batches divided among threads: how many there are, who starts them, and what happens when one fails."""

import os
import signal
import threading
import time

import pytest

from holdfast.compiler import threads
from holdfast.compiler.errors import CompileError
from tests.compiler.started_threads import started_threads

LONG = threads.LEAST_WORK  # the work of a block that is worth a thread


def parts_of(blocks, work, count=None):
    """Return the parts into which a batch is divided, in order, and the threads that ran them."""
    ran = []
    threads.divide(lambda begin, end: ran.append((begin, end, threading.get_ident())), blocks, work, count)
    return sorted(part[:2] for part in ran), {part[2] for part in ran}


def test_small_batches_stay_on_the_callers_thread(monkeypatch):
    """Less work than two threads are worth, or a single block: nothing is started, on however many processors."""
    started = started_threads(monkeypatch, processors=64)
    for blocks, work in ((0, LONG), (1, 100 * LONG), (2, LONG - 1), (1000, LONG // 1000)):
        assert parts_of(blocks, work) == ([(0, blocks)], {threading.get_ident()})
    assert started == []


@pytest.mark.parametrize(
    ("blocks", "work", "processors", "wanted"),
    [(2, LONG, 8, 2), (1000, LONG, 3, 3), (1000, LONG // 100, 64, 9), (1000, 5 * LONG, 1, 1), (3, 9 * LONG, 64, 3)],
)
def test_large_batches_take_what_is_worth_it(monkeypatch, blocks, work, processors, wanted):
    """As many threads as there are processors, blocks, and shares of work worth a start; one is the caller's."""
    started = started_threads(monkeypatch, processors)
    parts, _ = parts_of(blocks, work)
    assert len(parts) == wanted and len(started) == wanted - 1
    assert [begin for begin, _ in parts] == [0, *(end for _, end in parts[:-1])] and parts[-1][1] == blocks
    sizes = [end - begin for begin, end in parts]
    assert max(sizes) - min(sizes) <= 1


def test_a_number_that_is_asked_for(monkeypatch):
    """It is taken whatever the work and the processors are, though never more than there are blocks."""
    started = started_threads(monkeypatch, processors=1)
    assert len(parts_of(10, 1, 4)[0]) == 4 and len(started) == 3
    assert len(parts_of(2, 1, 5)[0]) == 2 and len(started) == 4
    assert parts_of(10, 100 * LONG, 1) == ([(0, 10)], {threading.get_ident()}) and len(started) == 4
    assert parts_of(0, 1, 5) == ([(0, 0)], {threading.get_ident()})


def test_calls_that_overlap_share_the_processors(monkeypatch):
    """A batch inside another one's part, as in a thread pool of the user: it takes what is left, at least one."""
    started = started_threads(monkeypatch, processors=5)
    inner = []

    def part(begin, end):
        if begin == 0:
            inner.append(len(parts_of(10, LONG)[0]))

    threads.divide(part, 3, LONG, None)
    assert inner == [2] and len(started) == 2 + 1
    threads.divide(part, 5, LONG, None)
    assert inner == [2, 1] and len(started) == 3 + 4
    assert len(parts_of(10, LONG)[0]) == 5  # all are free again


def test_a_system_without_more_threads(monkeypatch):
    """The caller runs what nobody else can."""
    started_threads(monkeypatch, processors=8)
    started = []

    def start(function, arguments):
        started.append(function)
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threads, "start_new_thread", start)
    parts, ran = parts_of(8, LONG)
    assert len(parts) == 8 and ran == {threading.get_ident()} and len(started) == 1


@pytest.mark.parametrize("failing", [0, 1])
def test_an_error_in_a_part(failing):
    """It is raised in the caller, once all other parts are done."""
    done = []

    def part(begin, end):
        if begin == failing:
            raise MemoryError("none left")
        time.sleep(0.05)
        done.append(begin)

    with pytest.raises(MemoryError, match="none left"):
        threads.divide(part, 3, 1, 3)
    assert sorted(done) == sorted({0, 1, 2} - {failing})


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs Unix")
def test_interruptions_wait_for_the_threads():
    """Two Ctrl-C while other threads still write: both wait, because the arrays may be freed after them."""
    done = []

    def part(begin, end):
        if begin:
            time.sleep(0.4)
        done.append(begin)

    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1, 0.1)
        with pytest.raises(KeyboardInterrupt):
            threads.divide(part, 3, 1, 3)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert sorted(done) == [0, 1, 2]


def test_processors(monkeypatch, tmp_path):
    """Those of the process, of the container's quota and of HOLDFAST_THREADS; the least counts."""
    monkeypatch.delenv("HOLDFAST_THREADS", raising=False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(6)), raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(threads, "_QUOTA", tmp_path / "cpu.max")

    def processors(quota):
        (tmp_path / "cpu.max").write_text(quota)
        threads._quota.cache_clear()
        return threads.usable_processors()

    try:
        assert threads.usable_processors() == 6  # there is no file of a quota
        assert [processors(text) for text in ("max 100000\n", "350000 100000\n", "50000 100000\n")] == [6, 3, 1]
        assert processors("900000 100000\n") == 6
        for most, found in (("1", 1), ("4", 4), ("100", 6), ("", 6)):
            monkeypatch.setenv("HOLDFAST_THREADS", most)
            assert threads.usable_processors() == found
    finally:
        threads._quota.cache_clear()


@pytest.mark.parametrize("most", ["0", "-1", "two", "1.5"])
def test_wrong_variable(monkeypatch, most):
    """It is named, and the batch is not run."""
    monkeypatch.setenv("HOLDFAST_THREADS", most)
    with pytest.raises(CompileError, match=f"HOLDFAST_THREADS: expected an integer >= 1, got '{most}'"):
        parts_of(2, LONG)
