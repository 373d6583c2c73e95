"""How a call ended: an answer without not-a-number, or an error of ours on one line; anything else is a fault."""

from __future__ import annotations

import dataclasses
import signal
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import chdir, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import holdfast as hf
from holdfast.assembly.report import ArmReport
from holdfast.compiled.result import CompiledResult
from holdfast.dynamics import Status
from holdfast.simulation import RolloutSystems

SECONDS = 30
LONGEST_MESSAGE = 1500
ANSWERED = (Status.OK, Status.INDETERMINATE_FORCES)
# attributes that are not-a-number where they have no meaning, as their docstrings say
UNKNOWN = {(ArmReport, name) for name in ("reach", "residual", "tip_angle")}


class Fault(AssertionError):
    """What no user should see."""


@contextmanager
def in_time() -> Iterator[None]:
    """End what takes too long, where the system can."""
    if not hasattr(signal, "SIGALRM") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def late(*_: Any) -> None:
        raise Fault(f"not done after {SECONDS} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def elsewhere() -> Iterator[None]:
    """Within this context the working directory is an empty one, where no file may be left half written."""
    with TemporaryDirectory() as folder, chdir(folder):
        yield
        left = [str(path) for path in Path().rglob("*.part")]
        if left:
            raise Fault(f"half-written files remain: {left}")


def ended(call: Callable[[], Any]) -> str:
    """Return "answered", or the type of the error of ours; files by relative names go to a folder of this call alone.

    Raises:
        Fault: it ended in another way.
    """
    with elsewhere(), warnings.catch_warnings(), in_time():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", hf.errors.ModelWarning)  # notes on a robot's file are part of an answer
        try:
            found = call()
        except hf.HoldfastError as refused:
            said = str(refused)
            if "\n" in said or not 10 <= len(said) <= LONGEST_MESSAGE:
                raise Fault(f"the message is no line: {said[:2000]!r}") from refused
            return type(refused).__name__
        except Fault:
            raise
        except BaseException as raw:
            frames = traceback.extract_tb(raw.__traceback__)[-4:]
            where = " < ".join(f"{Path(f.filename).name}:{f.lineno} {f.name}" for f in frames[::-1])
            raise Fault(f"{type(raw).__name__}: {str(raw)[:300]} at {where}") from raw
    wrong = next(not_numbers(found, "result"), None)
    if wrong is not None:
        raise Fault(f"{wrong} is not a number")
    return "answered"


def not_numbers(x: Any, where: str, depth: int = 0) -> Iterator[str]:
    """Yield where a result has not-a-number that no status explains."""
    if isinstance(x, float | np.floating):
        if np.isnan(x):
            yield where
    elif isinstance(x, np.ndarray):
        if x.dtype.kind in "fc" and np.isnan(x).any():
            yield where
    elif isinstance(x, CompiledResult):
        good = np.isin(np.asarray(x.status), ANSWERED)  # of one system the call raises
        for name in ("qdd", "grasp_wrench", "object_acceleration", "base_wrench"):
            yield from not_numbers(np.asarray(getattr(x, name))[good if np.ndim(x.status) else ...], f"{where}.{name}")
    elif isinstance(x, RolloutSystems):
        for name, array in x.arrays.items():
            yield from not_numbers(array[x.running], f"{where}.{name}")
    elif depth < 5 and isinstance(x, Mapping):
        for key, one in x.items():
            yield from not_numbers(one, f"{where}[{key!r}]", depth + 1)
    elif depth < 5 and isinstance(x, list | tuple):
        for k, one in enumerate(x):
            yield from not_numbers(one, f"{where}[{k}]", depth + 1)
    elif depth < 5 and dataclasses.is_dataclass(x) and not isinstance(x, type):
        for one in dataclasses.fields(x):
            if (type(x), one.name) in UNKNOWN:
                continue
            yield from not_numbers(getattr(x, one.name, None), f"{where}.{one.name}", depth + 1)
