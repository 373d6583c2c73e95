"""`holdfast doctor`: versions, processor features and optional packages of this installation."""

from __future__ import annotations

import platform
import re
import subprocess
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from rich.table import Table

from holdfast.cli.console import print_document, stdout
from holdfast.cli.options import Switch

# as /proc/cpuinfo and sysctl spell them; asimd is ARM's name for NEON
FEATURES = {"avx2": "avx2", "avx512": "avx512f", "fma": "fma", "neon": "asimd"}


def doctor(json: Switch = False) -> int:
    """Report versions, processor features and optional packages.

    Args:
        json: print one JSON document instead of a table.
    """
    lines = dict(_lines())
    if json:
        print_document(lines)
        return 0
    table = Table("what", "found", show_header=False)
    for what, found in lines.items():
        table.add_row(what, found)
    stdout().print(table)
    return 0


def _lines() -> Iterator[tuple[str, str]]:
    yield "holdfast", _version("holdfast") or "not installed"
    yield "python", f"{platform.python_version()} ({platform.system()} {platform.machine()})"
    extras = _requirements()
    for package in extras.pop("", []):
        yield package, _version(package) or "missing: pip install holdfast"
    name, flags = processor()
    yield "processor", name
    yield "features", ", ".join(f"{k} {'yes' if v in flags else 'no'}" for k, v in FEATURES.items())
    yield "machine code", _machine_code()
    yield "machine-code cache", _cache()
    for extra, packages in extras.items():
        missing = [package for package in packages if _version(package) is None]
        found = f"missing {', '.join(missing)}: pip install 'holdfast[{extra}]'" if missing else "installed"
        yield f"extra '{extra}'", found


def _machine_code() -> str:
    """Return the processor for which `holdfast.compile` compiles, and how it uses the processor."""
    from holdfast.compiler.errors import CompileError
    from holdfast.compiler.targets import cpu

    try:
        chosen = cpu.target().name
    except CompileError as error:
        return str(error)
    made_for = "this processor" if chosen == "host" else f"{chosen} (HOLDFAST_CPU)"
    bits = "fma: results identical to those of every processor with fma"
    if not cpu.has_fma():
        bits = "no fma: last digits differ from those of processors with fma"
    return f"for {made_for}, {cpu.lanes()} SIMD lanes, {bits}"


def _cache() -> str:
    """Return the folder and the size of the cache of machine code."""
    from holdfast.compiler import cache

    place = cache.folder()
    if place is None:
        return "off (HOLDFAST_CACHE=off, or its folder is accessible to other users): code is compiled in every process"
    size = sum(path.stat().st_size for path in place.iterdir() if path.is_file())
    return f"{place}, {size / 2**20:.1f} MiB"


def _requirements() -> dict[str, list[str]]:
    """Return the packages that holdfast needs (under '') and those of each extra."""
    groups: dict[str, list[str]] = {"": []}
    for requirement in metadata.requires("holdfast") or []:
        package = re.match(r"[A-Za-z0-9._-]+", requirement)
        extra = re.search(r"extra == ['\"]([^'\"]+)['\"]", requirement)
        if package:
            groups.setdefault(extra[1] if extra else "", []).append(package[0])
    return groups


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


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
