"""LLVM's text to code of this machine. The only file that loads llvmlite."""

from __future__ import annotations

import functools
import threading
from typing import Any

import llvmlite
import llvmlite.binding as binding

from holdfast.compiler import cache
from holdfast.compiler.errors import CompileError

_LOCK = threading.Lock()  # LLVM's compiler is used by one thread at a time
_LEVEL = 2  # of code generation; no pass over the text is needed


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


class Code:
    """Machine code in memory; it lives as long as this object.

    Attributes:
        address: of the function asked for.
    """

    def __init__(self, text: str, function: str) -> None:
        """Compile one module, or load what an earlier run made of it.

        Args:
            text: the module in LLVM's language.
            function: the name of the function to call.
        """
        key = cache.key_of(text, *_fingerprint())
        with _LOCK:
            machine = _target_machine()
            code = cache.load(key)
            if code is None:
                code = _compiled(text, machine)
                cache.store(key, code)
            self._engine: Any = binding.create_mcjit_compiler(binding.parse_assembly(""), machine)
            self._engine.add_object_file(binding.ObjectFileRef.from_data(code))
            self._engine.finalize_object()
            self.address: int = self._engine.get_function_address(function)


def _compiled(text: str, machine: Any) -> bytes:
    """Return the object file of a module."""
    try:
        module = binding.parse_assembly(text)
        module.verify()
    except RuntimeError as error:
        raise CompileError(f"LLVM refuses the program: {error}") from error
    return machine.emit_object(module)


def _target_machine() -> Any:
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.Target.from_default_triple().create_target_machine(
        cpu=binding.get_host_cpu_name(), features=feature_text(), opt=_LEVEL, jit=True
    )


def _fingerprint() -> tuple[str, ...]:
    """Return what besides the text decides the code."""
    versions = (llvmlite.__version__, str(binding.llvm_version_info))
    return (*versions, binding.get_process_triple(), binding.get_host_cpu_name(), feature_text(), str(_LEVEL))
