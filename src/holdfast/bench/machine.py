"""What the times were taken on."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = ("holdfast", "numpy", "llvmlite")


def description() -> dict[str, Any]:
    """Return processor, its lanes and features, cores, and versions."""
    from holdfast.compiler.targets import cpu

    made_for = cpu.target()
    return {
        "processor": processor(),
        "cores": os.cpu_count() or 1,
        "lanes": cpu.lanes(),
        "features": [name for name in ("avx2", "avx512f", "fma", "neon") if name in made_for.features],
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {package: metadata.version(package) for package in PACKAGES},
    }


def processor() -> str:
    """Return the processor's name, as far as the system tells."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text(errors="replace").splitlines():
            if line.lower().startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def memory_available() -> float:
    """Return the bytes that can be had without swapping; infinite where the system does not tell."""
    meminfo = Path("/proc/meminfo")
    if meminfo.exists():
        for line in meminfo.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * float(line.split()[1])
    return float("inf")
