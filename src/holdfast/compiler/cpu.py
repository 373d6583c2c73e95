"""LLVM's text to code of this machine. The only file that loads llvmlite."""

from __future__ import annotations

import functools
import json
import threading
from collections.abc import Callable
from typing import Any

import llvmlite
import llvmlite.binding as binding

from holdfast.compiler import cache, collector
from holdfast.compiler.errors import CompileError

_LOCK = threading.Lock()  # LLVM's compiler is used by one thread at a time

# Of code generation; no pass over the text is needed. Level 1 leaves out the last scheduling of instructions, which
# gains one percent at most and is a quarter of the time that LLVM takes: too much for long texts.
_LEVEL, _LEVEL_OF_LONG, _LONG = 2, 1, 2**21  # characters


@functools.cache
def features() -> dict[str, bool]:
    """Return which instruction sets this CPU has, as LLVM names them."""
    return dict(binding.get_host_cpu_features())


def lanes() -> int:
    """Return how many doubles one register holds."""
    return 8 if features().get("avx512f") else 4 if features().get("avx2") else 2


def has_fma() -> bool:
    """Return whether the CPU has fma; without it, it is a call of the C library, slow and only as exact as that."""
    return features().get("fma", False) or binding.get_process_triple().startswith(("aarch64", "arm64"))


def feature_text() -> str:
    """Return the CPU's features for LLVM, wide registers allowed where LLVM would rather not."""
    text = binding.get_host_cpu_features().flatten()
    return f"{text},-prefer-256-bit" if features().get("avx512f") else text


def declare(name: str, address: int) -> None:
    """Give code that is compiled or loaded from now on a C function to call by name."""
    binding.add_symbol(name, address)


Notes = dict[str, int]
Source = str | Callable[[], tuple[str, Notes]]


class Code:
    """Machine code in memory; it lives as long as this object.

    Attributes:
        addresses: of the functions asked for, by name.
        address: of the first of them.
        notes: what was written down when it was compiled.
    """

    def __init__(self, source: Source, *functions: str, key: str = "") -> None:
        """Compile one module, or load what an earlier run made of it.

        Args:
            source: the module in LLVM's language, or what makes it and notes to keep with it.
            functions: the names of the functions to call.
            key: stands for the source on disk; without it, its text does.
        """
        made = None if key else _made(source)
        key = cache.key_of(made[0] if made else key, *_fingerprint())
        stored = cache.load(key)
        if stored is None:
            stored = _compiled(*(made or _made(source)))
            cache.store(key, stored)
        size = int.from_bytes(stored[:8], "little")
        self.notes: Notes = json.loads(stored[8 : 8 + size])
        with _LOCK:
            self._engine: Any = binding.create_mcjit_compiler(binding.parse_assembly(""), _target_machine())
            self._engine.add_object_file(binding.ObjectFileRef.from_data(stored[8 + size :]))
            self._engine.finalize_object()
            self.addresses = {name: self._engine.get_function_address(name) for name in functions}
        self.address: int = self.addresses[functions[0]]


def _made(source: Source) -> tuple[str, Notes]:
    """Return a module's text and its notes."""
    if isinstance(source, str):
        return source, {}
    with collector.paused():
        return source()


def _compiled(text: str, notes: Notes) -> bytes:
    """Return the notes and the object file of a module."""
    head = json.dumps(notes).encode()
    with _LOCK:
        machine = _target_machine(_LEVEL if len(text) < _LONG else _LEVEL_OF_LONG)
        try:
            module = binding.parse_assembly(text)
            module.verify()
        except RuntimeError as error:
            raise CompileError(f"LLVM refuses the program: {error}") from error
        return len(head).to_bytes(8, "little") + head + machine.emit_object(module)


def _target_machine(level: int = _LEVEL) -> Any:
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.Target.from_default_triple().create_target_machine(
        cpu=binding.get_host_cpu_name(), features=feature_text(), opt=level, jit=True
    )


def _fingerprint() -> tuple[str, ...]:
    """Return what besides the text decides the code."""
    versions = (llvmlite.__version__, str(binding.llvm_version_info))
    levels = f"{_LEVEL} {_LEVEL_OF_LONG} {_LONG}"
    return (*versions, binding.get_process_triple(), binding.get_host_cpu_name(), feature_text(), levels)
