"""The collector of garbage is left as it was found."""

import gc
import threading

import pytest

from holdfast.compiler.targets import cpu


def test_paused():
    """Off within, also within itself; on again at the end, and after an error."""
    assert gc.isenabled()
    with cpu.collector_paused():
        with cpu.collector_paused():
            assert not gc.isenabled()
        assert not gc.isenabled()
    assert gc.isenabled()
    with pytest.raises(ZeroDivisionError), cpu.collector_paused():
        1 / 0  # noqa: B018
    assert gc.isenabled()


def test_who_turned_it_off_keeps_it_off():
    """It is not turned on for somebody who did not want it."""
    gc.disable()
    try:
        with cpu.collector_paused():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_threads():
    """The last one out turns it on."""
    inside, leave = threading.Barrier(2), threading.Event()

    def stay():
        with cpu.collector_paused():
            inside.wait()
            leave.wait()

    thread = threading.Thread(target=stay)
    thread.start()
    with cpu.collector_paused():
        inside.wait()
    assert not gc.isenabled()
    leave.set()
    thread.join()
    assert gc.isenabled()


def test_while_a_text_is_made():
    """That is when it is off, and not while LLVM works."""
    seen = []

    def source():
        seen.append(gc.isenabled())
        return "define i64 @run() {\n  ret i64 1\n}", {}

    cpu.Code(source, "run")
    assert seen == [False] and gc.isenabled()
