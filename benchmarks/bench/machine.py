"""Description of the machine on which times were measured."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

from holdfast.cli.doctor import processor

PACKAGES = ("holdfast", "numpy", "llvmlite")


def description() -> dict[str, Any]:
    """Return processor, vector lanes, features, number of cores, and versions."""
    from holdfast.compiler.targets import cpu

    made_for = cpu.target()
    return {
        "processor": processor()[0],
        "cores": os.cpu_count() or 1,
        "lanes": cpu.lanes(),
        "features": [name for name in ("avx2", "avx512f", "fma", "neon") if name in made_for.features],
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {package: metadata.version(package) for package in PACKAGES},
    }


def memory_available() -> float:
    """Return the memory available without swapping; infinite if the system does not report it [bytes]."""
    meminfo = Path("/proc/meminfo")
    if meminfo.exists():
        for line in meminfo.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * float(line.split()[1])
    return float("inf")
