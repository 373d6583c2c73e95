"""Processors that this one can pass for: what NumPy and its BLAS compute with, and what machine code is made for."""

from __future__ import annotations

import os

from holdfast.compiler.targets import cpu

BLAS_KERNELS = ("Haswell", "Zen", "Prescott")


def without_dispatch() -> dict[str, str]:
    """Return the environment in which NumPy uses no more than its baseline of instructions.

    A feature that it does not know, or that the processor does not have, is left out: NumPy would warn of it.
    """
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    there = [name for name in __cpu_dispatch__ if __cpu_features__.get(name)]
    return {"NPY_DISABLE_CPU_FEATURES": " ".join(there)} if there else {}


def settings() -> dict[str, dict[str, str]]:
    """Return what to set in the environment, by a name for it; the processor as it is comes first."""
    found = {"default": {}} | {f"OpenBLAS: {name}": {"OPENBLAS_CORETYPE": name} for name in BLAS_KERNELS}
    return found | {"NumPy: baseline": without_dispatch()}


def levels(fma: bool) -> list[str]:
    """Return the values of HOLDFAST_CPU that this processor can run, those with fma or those without."""
    runnable = [name for name, needs in cpu.X86_LEVELS.items() if cpu.features().issuperset(needs)]
    return [name for name in runnable if ("fma" in cpu.X86_LEVELS[name]) == fma]


def environment(setting: dict[str, str]) -> dict[str, str]:
    """Return this process's environment with a setting in place of its own."""
    ours = ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "HOLDFAST_CPU")
    return {name: value for name, value in os.environ.items() if name not in ours} | setting
