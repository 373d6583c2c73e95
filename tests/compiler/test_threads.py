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
    """As many threads as there are processors, blocks, and portions of work worth a start; one is the caller's."""
    started = started_threads(monkeypatch, processors)
    parts, _ = parts_of(blocks, work)
    assert len(started) == wanted - 1
    assert [begin for begin, _ in parts] == [0, *(end for _, end in parts[:-1])] and parts[-1][1] == blocks
    sizes = [end - begin for begin, end in parts]
    assert max(sizes) - min(sizes) <= 1


def test_a_number_that_is_asked_for(monkeypatch):
    """It is taken whatever the work and the processors are, though never more than there are blocks."""
    started = started_threads(monkeypatch, processors=1)
    for blocks, count, wanted in ((100, 4, 4), (2, 5, 2), (100, 1, 1), (0, 5, 1), (1, 5, 1)):
        started.clear()
        parts, ran = parts_of(blocks, LONG, count)
        assert len(started) == wanted - 1 and len(ran) <= wanted
        assert sum(end - begin for begin, end in parts) == blocks


def test_threads_without_a_processor():
    """The caller does not wait for them: it runs all blocks itself, and they find nothing to do when they run."""
    held, late = threading.Event(), []

    def start(function, arguments):
        def wait():
            held.wait(10.0)
            function(*arguments)
            late.append(threading.get_ident())

        return threading.Thread(target=wait).start()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(threads, "start_new_thread", start)
        parts, ran = parts_of(40, 1, 5)
    assert len(parts) == 20 and ran == {threading.get_ident()}
    held.set()
    for _ in range(1000):
        time.sleep(0.01)
        if len(late) == 4:
            break
    assert len(late) == 4 and len(parts) == 20


def test_calls_that_overlap_share_the_processors(monkeypatch):
    """A batch inside another one's part, as in a thread pool of the user: it takes what is left, at least one."""
    started = started_threads(monkeypatch, processors=5)
    inner = []

    def part(begin, end):
        if begin == 0:
            before = len(started)
            threads.divide(lambda *_: None, 10, LONG, None)
            inner.append(len(started) - before)

    def start(function, arguments):  # those of the outer call, which the inner one is not to be mixed up with
        started.append(function)

    for blocks, left in ((3, 1), (5, 0)):
        monkeypatch.setattr(threads, "start_new_thread", start)
        threads.divide(part, blocks, LONG, None)
        assert inner.pop() == left
    started.clear()
    threads.divide(lambda *_: None, 10, LONG, None)
    assert len(started) == 4  # all are free again


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


@pytest.mark.parametrize("failing", [True, False])
def test_an_error_in_a_part(failing):
    """Of the caller or of another thread: it is raised in the caller, and the others take no further shares."""
    caller, done, both = threading.get_ident(), [], threading.Barrier(2)

    def part(begin, end):
        if not done:
            both.wait(10.0)
        done.append(begin)
        if (threading.get_ident() == caller) == failing:
            raise MemoryError("none left")
        time.sleep(0.1)

    with pytest.raises(MemoryError, match="none left"):
        threads.divide(part, 100, 1, 2)
    assert len(done) < 8


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs Unix")
def test_interruptions_wait_for_the_threads():
    """Several Ctrl-C while another thread still writes: all wait, because the arrays may be freed after them."""
    caller, running, both = threading.get_ident(), [], threading.Barrier(2)

    def part(begin, end):
        if threading.get_ident() != caller:
            running.append(begin)
            both.wait(10.0)
            time.sleep(0.5)
            running.remove(begin)
        elif not both.broken and not both.n_waiting:
            both.wait(10.0)

    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1, 0.1)
        with pytest.raises(KeyboardInterrupt):
            threads.divide(part, 2, 1, 2)
        left = list(running)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert left == []


def test_processors(monkeypatch, tmp_path):
    """Those of the process, of the container's quota and of HOLDFAST_THREADS, and those that are free: the least."""
    quota, load = tmp_path / "cpu.max", tmp_path / "loadavg"
    monkeypatch.delenv("HOLDFAST_THREADS", raising=False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(6)), raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    monkeypatch.setattr(threads, "_QUOTA", quota)
    monkeypatch.setattr(threads, "_LOAD", load)
    monkeypatch.setattr(threads, "_quota", threads._quota.__wrapped__)
    assert threads.free_processors() == 6  # neither file is there
    for text, found in (("max 100000\n", 6), ("350000 100000\n", 3), ("50000 100000\n", 1), ("900000 100000\n", 6)):
        quota.write_text(text)
        assert threads.free_processors() == found
    for running, found in ((1, 6), (3, 6), (4, 5), (8, 1), (20, 1)):
        load.write_text(f"7.00 3.00 1.00 {running}/300 1234\n")
        assert threads.free_processors() == found
    load.unlink()
    for most, found in (("1", 1), ("4", 4), ("100", 6), ("", 6)):
        monkeypatch.setenv("HOLDFAST_THREADS", most)
        assert threads.free_processors() == found


@pytest.mark.parametrize("most", ["0", "-1", "two", "1.5"])
def test_wrong_variable(monkeypatch, most):
    """It is named, and the batch is not run."""
    monkeypatch.setenv("HOLDFAST_THREADS", most)
    with pytest.raises(CompileError, match=f"HOLDFAST_THREADS: expected an integer >= 1, got '{most}'"):
        parts_of(2, LONG)
