"""Compile LLVM's language to machine code of this processor.

`HOLDFAST_CPU` chooses the processor for which code is made: `host` (the default), or one of the levels `x86-64-v2`,
`x86-64-v3` and `x86-64-v4`, for code that is the same on every machine of a cluster. `HOLDFAST_COMPILE=quick` compiles
everything in less time, to code that takes 1.5 times as long; its results are the same bit for bit.
"""

from __future__ import annotations

import ctypes
import functools
import gc
import json
import os
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from types import MappingProxyType
from typing import Any, NamedTuple

import llvmlite
import llvmlite.binding as binding

from holdfast.compiler import cache
from holdfast.compiler.errors import CompileError

lock = threading.Lock()  # LLVM's compiler is used by one thread at a time
_other: ContextVar[Processor | None] = ContextVar("other", default=None)  # see `made_for`

# LLVM's level of code generation; optimisation passes are not needed. Level 1 omits the last instruction scheduling,
# which gains at most one percent but takes a quarter of LLVM's time. It is used for modules longer than _LONG.
_LEVEL, _LEVEL_OF_LONG, _LONG = 2, 1, 2**21  # _LONG in characters
_QUICK_LEVEL = 0  # takes a third of LLVM's time; the code takes 1.5 times as long, with the same bits

# Code and constants of a module lie in one block of memory (`use_lmm`), so that instructions can name constants as
# operands. By default a constant's address of 64 bits is loaded first, and the constant is kept in a register and
# spilled. Modules that name what lies elsewhere, or call fma because there is no such instruction, need such addresses.
# Measured under Linux on x86-64, and used there only.
_NEAR: dict[str, Any] = (
    {"codemodel": "small", "reloc": "pic"} if re.match("x86_64.*linux", binding.get_process_triple()) else {}
)

# The features that each level of x86-64 adds to the one before (System V psABI, 3.1.1), by LLVM's names.
_V2 = ("cx16", "popcnt", "sahf", "sse3", "sse4.1", "sse4.2", "ssse3")
_V3 = (*_V2, "avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
_V4 = (*_V3, "avx512bw", "avx512cd", "avx512dq", "avx512f", "avx512vl")
_WIDE = "-prefer-256-bit"  # makes LLVM use registers of 512 bits, which it avoids by default
X86_LEVELS = {"x86-64-v2": _V2, "x86-64-v3": _V3, "x86-64-v4": _V4}


class Processor(NamedTuple):
    """A processor for which code is made.

    Attributes:
        name: the processor's name in `HOLDFAST_CPU`.
        cpu: LLVM's name for it.
        features: its instruction sets, by LLVM's names.
        feature_text: the features to be passed to LLVM in addition to the name.
    """

    name: str
    cpu: str
    features: frozenset[str]
    feature_text: str


def target() -> Processor:
    """Return the processor for which code is made.

    Raises:
        CompileError: `HOLDFAST_CPU` is not a known name, or names a processor whose code this machine cannot run.
    """
    return _other.get() or _target(os.environ.get("HOLDFAST_CPU") or "host")


@contextmanager
def made_for(other: Processor) -> Iterator[None]:
    """Within the block and in this thread, write programs for another processor."""
    token = _other.set(other)
    try:
        yield
    finally:
        _other.reset(token)


@functools.cache
def _target(name: str) -> Processor:
    host = features() | ({"fma"} if binding.get_process_triple().startswith(("aarch64", "arm64")) else set())
    if name == "host":
        text = binding.get_host_cpu_features().flatten()
        return Processor(name, binding.get_host_cpu_name(), host, f"{text},{_WIDE}" if "avx512f" in host else text)
    available = ", ".join(["host", *(level for level, needs in X86_LEVELS.items() if host.issuperset(needs))])
    if name not in X86_LEVELS:
        known = ", ".join(["host", *X86_LEVELS])
        raise CompileError(
            f"HOLDFAST_CPU: expected one of {known}, got {name!r}. Available on this machine: {available}"
        )
    lacking = ", ".join(feature for feature in X86_LEVELS[name] if feature not in host)
    if lacking:
        raise CompileError(f"HOLDFAST_CPU: {name} needs {lacking}, which this processor lacks. Available: {available}")
    return level(name)


def level(name: str) -> Processor:
    """Return a level of x86-64."""
    return Processor(name, name, frozenset(X86_LEVELS[name]), _WIDE if "avx512f" in X86_LEVELS[name] else "")


@functools.cache
def features() -> frozenset[str]:
    """Return the instruction sets of this machine's processor, by LLVM's names."""
    return frozenset(name for name, there in dict(binding.get_host_cpu_features()).items() if there)


def lanes() -> int:
    """Return how many doubles one vector register holds."""
    has = target().features
    return 8 if "avx512f" in has else 4 if "avx2" in has else 2


def has_fma() -> bool:
    """Return whether the processor has an fma instruction; otherwise fma is a call of the C library."""
    return "fma" in target().features


def declare(name: str, address: int) -> None:
    """Make a C function callable by name from code that is compiled or loaded from now on."""
    binding.add_symbol(name, address)


Notes = dict[str, int]
ModuleSource = str | Callable[[], tuple[str, Notes]]


class Code:
    """Machine code in memory; it is freed together with this object.

    Attributes:
        addresses: the addresses of the requested functions, by name.
        address: the address of the first of them.
        notes: the notes stored with the code when it was compiled.
    """

    def __init__(self, source: ModuleSource, *functions: str, key: str = "", quick: bool = False) -> None:
        """Compile one module, or load its machine code from the cache.

        Args:
            source: the module in LLVM's language, or a function that returns it together with notes.
            functions: the names of the functions to call.
            key: identifies the module in the cache; without a key, its source identifies it.
            quick: whether to spend less time on optimisation, for code that will not run for long.
        """
        quick = quick or _always_quick()
        made = None if key else _made(source)
        key = cache.key_of(made[0] if made else key, *_fingerprint(quick))
        stored = cache.load(key)
        if stored is None:
            stored = _compiled(*(made or _made(source)), quick)
            cache.store(key, stored)
        size = int.from_bytes(stored[:8], "little")
        self.notes: Notes = json.loads(stored[8 : 8 + size])
        with lock:
            empty = binding.parse_assembly("")
            self._engine: Any = binding.create_mcjit_compiler(empty, _target_machine(), use_lmm=bool(_NEAR) or None)
            self._engine.add_object_file(binding.ObjectFileRef.from_data(stored[8 + size :]))
            self._engine.finalize_object()
            self.addresses = {name: self._engine.get_function_address(name) for name in functions}
        self.address: int = self.addresses[functions[0]]


def _always_quick() -> bool:
    """Return whether `HOLDFAST_COMPILE` asks to spend less time on optimisation for all code.

    Raises:
        CompileError: `HOLDFAST_COMPILE` is neither `quick` nor `full`.
    """
    how = os.environ.get("HOLDFAST_COMPILE") or "full"
    if how not in ("full", "quick"):
        raise CompileError(f"HOLDFAST_COMPILE: expected full or quick, got {how!r}")
    return how == "quick"


def _made(source: ModuleSource) -> tuple[str, Notes]:
    """Return a module's source and its notes."""
    if isinstance(source, str):
        return source, {}
    with collector_paused():
        return source()


_collector_lock = threading.Lock()
_pauses = 0
_wanted = True  # whether the collector ran before the first pause


@contextmanager
def collector_paused() -> Iterator[None]:
    """Pause Python's garbage collector within the block and restore its state after it; blocks of threads may overlap.

    Tracing makes hundreds of thousands of nodes and instructions, all of them in use. The collector would inspect them
    again and again, which took more than a third of the compile time.
    """
    global _pauses, _wanted
    with _collector_lock:
        if not _pauses:
            _wanted = gc.isenabled()
            gc.disable()
        _pauses += 1
    try:
        yield
    finally:
        with _collector_lock:
            _pauses -= 1
            if not _pauses and _wanted:
                gc.enable()


def _compiled(text: str, notes: Notes, quick: bool) -> bytes:
    """Return the notes and the object file of a module."""
    head = json.dumps(notes).encode()
    with lock:
        machine, module = _parsed(text, quick)
        return len(head).to_bytes(8, "little") + head + machine.emit_object(module)


def assembly(text: str, quick: bool = False) -> str:
    """Return a module's machine code as assembly, in which comments mark what goes to the stack and comes from it.

    Args:
        text: the module in LLVM's language.
        quick: as for `Code`.
    """
    with lock:
        machine, module = _parsed(text, quick)
        machine.set_asm_verbosity(True)
        return machine.emit_assembly(module)


def _parsed(text: str, quick: bool) -> tuple[Any, Any]:
    """Return the target machine for a module, and the module."""
    level = _QUICK_LEVEL if quick else _LEVEL if len(text) < _LONG else _LEVEL_OF_LONG
    try:
        module = binding.parse_assembly(text)
        module.verify()
    except RuntimeError as error:
        raise CompileError(f"LLVM refuses the program: {error}") from error
    named = [*module.functions, *module.global_variables]
    alone = has_fma() and all(x.name.startswith("llvm.") or not x.is_declaration for x in named)
    return _target_machine(level, _NEAR if alone else {}), module


def _target_machine(level: int = _LEVEL, addresses: Mapping[str, Any] = MappingProxyType({})) -> Any:
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    if not has_fma():
        declare("fma", _fma_of_the_c_library())
    made_for = target()
    return binding.Target.from_default_triple().create_target_machine(
        cpu=made_for.cpu, features=made_for.feature_text, opt=level, jit=True, **addresses
    )


@functools.cache
def _fma_of_the_c_library() -> int:
    """Return the address of the C library's fma, which rounds only once, as sin and cos require."""
    try:
        fma = ctypes.CDLL(None).fma
    except (OSError, AttributeError) as error:
        raise CompileError("the processor has no fma instruction, and the C library no function for it") from error
    return ctypes.cast(fma, ctypes.c_void_p).value or 0


def _fingerprint(quick: bool) -> tuple[str, ...]:
    """Return everything besides the source on which the machine code depends."""
    versions = (llvmlite.__version__, str(binding.llvm_version_info))
    levels = str(_QUICK_LEVEL) if quick else f"{_LEVEL} {_LEVEL_OF_LONG} {_LONG}"
    made_for = target()
    return (*versions, binding.get_process_triple(), *_NEAR, made_for.cpu, made_for.feature_text, levels)
