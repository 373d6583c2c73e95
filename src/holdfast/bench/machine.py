"""Description of the machine on which times were measured."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

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


def processor() -> tuple[str, set[str]]:
    """Return the processor's name and its features in lower case; empty if unknown."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        fields: dict[str, str] = {}
        for line in cpuinfo.read_text(errors="replace").splitlines():
            key, _, value = line.partition(":")
            fields.setdefault(key.strip().lower(), value.strip())
        flags = fields.get("flags") or fields.get("features") or ""
        return fields.get("model name") or platform.machine(), set(flags.lower().split())
    if platform.system() == "Darwin":
        name = _sysctl("machdep.cpu.brand_string")
        flags = set(f"{_sysctl('machdep.cpu.features')} {_sysctl('machdep.cpu.leaf7_features')}".lower().split())
        return name or platform.machine(), flags | ({"asimd"} if platform.machine() == "arm64" else set())
    return platform.processor() or platform.machine(), set()


def _sysctl(name: str) -> str:
    try:
        return subprocess.run(["sysctl", "-n", name], capture_output=True, text=True, timeout=5).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


def memory_available() -> float:
    """Return the memory available without swapping; infinite if the system does not report it [bytes]."""
    meminfo = Path("/proc/meminfo")
    if meminfo.exists():
        for line in meminfo.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * float(line.split()[1])
    return float("inf")
