"""`holdfast plot`: a result folder in; its figures out."""

from __future__ import annotations

from pathlib import Path

from holdfast.cli.console import stdout
from holdfast.cli.recorded import chain_for_figures
from holdfast.errors import ResultError
from holdfast.view.plots import save_plots


def plot(folder: Path, out: Path | None, trust_xacro: bool) -> int:
    """Draw every figure of a run; say on stderr what is missing of an incomplete run.

    Args:
        folder: the result folder.
        out: folder for the figures; the result folder if None.
        trust_xacro: expand xacro files of a result that keeps no robots.

    Returns:
        0.

    Raises:
        ResultError: no result, or a folder that cannot be written.
        MissingExtra: matplotlib is not installed.
    """
    chain, result = chain_for_figures(folder, trust_xacro)
    place = folder if out is None else out
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as cause:
        raise ResultError(f"{place}: cannot be written: {cause.strerror or cause}") from cause
    for name in save_plots(chain, result.trajectory, place):
        stdout().print(f"look at {place / name}", soft_wrap=True)
    return 0
