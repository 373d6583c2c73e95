"""The processor of this machine, as its system describes it."""

from __future__ import annotations

import platform
import subprocess
from pathlib import Path


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
