"""What a user does with a run: save it, write it as tables, plot it, look at it."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from holdfast.simulation.summary import Summary
    from holdfast.simulation.trajectory import Trajectory

RATE = 30.0  # moments a second that pages show


class RunOutputs:
    """Methods of everything that is a run: what `simulate` returns, and what `load_result` does.

    The rooms that write files and draw are asked when a method is called; a run itself is arrays.
    """

    def whole_run(self) -> Trajectory:
        """Return every sample, with what it is a run of.

        Raises:
            StateError: a run that does not know its chain.
        """
        raise NotImplementedError

    def summary(self) -> Summary:
        """Return what the run comes down to: gaps, balances, peak forces, lowest margins.

        Raises:
            StateError: a run that does not know its chain, or one without samples.
        """
        from holdfast.simulation.summary import summarise

        run, setting = self._run_and_setting()
        return summarise(setting.chain, run)

    def save(self, folder: str | PathLike[str], overwrite: bool = False) -> Path:
        """Write the run as a result folder, as `holdfast simulate` does, and return the folder.

        `hf.load_result`, `holdfast view`, `plot` and `export` read it; the chain is in it, in `model.json`, and the
        meshes of its arms are named, not copied. Controller and initial state are functions and choices of your
        program and are not in it, so nobody can go on with the run or begin it anew from the folder alone.

        Args:
            folder: where to; made if need be.
            overwrite: replace an earlier result there.

        Raises:
            StateError: a run that does not know its chain, or one without samples.
            ResultError: the folder is in use or cannot be written.
        """
        from holdfast.io.save_run import save_run

        return save_run(self._run_and_setting()[0], folder, overwrite)

    def to_csv(self, path: str | PathLike[str]) -> list[Path]:
        """Write the run as CSV, a row a sample, and return the files written; see `holdfast.io.export_csv`.

        Args:
            path: of the file; what is there is replaced.

        Raises:
            StateError: a run that does not know its chain, or one without samples.
            ResultError: a file cannot be written.
        """
        from holdfast.io.export import export_csv

        return export_csv(self._run_and_setting()[0], path)

    def to_parquet(self, path: str | PathLike[str]) -> list[Path]:
        """Write the run as Parquet, the tables of `to_csv`, and return the files written.

        Args:
            path: of the file; what is there is replaced.

        Raises:
            MissingExtra: pyarrow is not installed.
            StateError: a run that does not know its chain, or one without samples.
            ResultError: a file cannot be written.
        """
        from holdfast.io.export import export_parquet

        return export_parquet(self._run_and_setting()[0], path)

    def to_mcap(self, path: str | PathLike[str]) -> Path:
        """Write the run as an MCAP file of ROS 2 messages and return the file; see `write_mcap`.

        Args:
            path: of the file; what is there is replaced.

        Raises:
            MissingExtra: mcap-ros2-support is not installed.
            StateError: a run that does not know its chain, or one without samples.
            ResultError: the file cannot be written.
        """
        from holdfast.interop.mcap_writer import write_mcap

        run, setting = self._run_and_setting()
        write_mcap(setting.chain, run, path, setting.base_motion)
        return Path(path)

    def to_pandas(self) -> Any:
        """Return the run as a pandas DataFrame, the table of `to_csv`.

        Raises:
            MissingExtra: pandas is not installed.
            StateError: a run that does not know its chain, or one without samples.
        """
        from holdfast.io.frames import frame_of_run

        return frame_of_run(self._run_and_setting()[0])

    def to_xarray(self) -> Any:
        """Return the run as an xarray Dataset: its arrays over `t`, joints and arms by name, each with its unit.

        Raises:
            MissingExtra: xarray is not installed.
            StateError: a run that does not know its chain, or one without samples.
        """
        from holdfast.io.frames import data_set_of_run

        return data_set_of_run(self._run_and_setting()[0])

    def plot(self) -> dict[str, Any]:
        """Return the figures that have something to show, matplotlib's, by name; no window opens.

        A notebook shows them all. `figure.savefig(path)` writes one, `holdfast.plot.save_plots` all.

        Raises:
            MissingExtra: matplotlib is not installed.
            StateError: a run that does not know its chain, or one without samples.
        """
        from holdfast.view.inline import Figures
        from holdfast.view.plots import figures

        run, setting = self._run_and_setting()
        return Figures(figures(setting.chain, run))

    def page(self, path: str | PathLike[str], rate: float = RATE) -> Path:
        """Write the run as one HTML file that opens without a network, and return the file.

        Arms out of URDF files are drawn with their meshes where these can be read, with simple solids otherwise.

        Args:
            path: of the file; what is there is replaced.
            rate: moments a second that it shows.

        Raises:
            MissingExtra: viser is not installed.
            StateError: a run that does not know its chain, or one without samples.
            ModelError: a rate that is not positive or gives too many moments.
            ResultError: the file cannot be written.
        """
        from holdfast.view.page import export_page

        export_page(self.playback(rate), path)
        return Path(path)

    def show(self, rate: float = RATE) -> Any:
        """Show the page: inside a notebook, or in the browser, out of a file of this session.

        Args:
            rate: as for `page`.

        Returns:
            In a notebook what it displays, elsewhere the file's path.

        Raises:
            HoldfastError: as for `page`, or no browser opens; the message names the file.
        """
        from holdfast.view.inline import shown
        from holdfast.view.page import page

        playback = self.playback(rate)
        return shown(page(playback), playback.title)

    def playback(self, rate: float = RATE) -> Any:
        """Return the moments that the page shows, a `Playback`, for `holdfast.plot.export_page`.

        Args:
            rate: moments a second.

        Raises:
            StateError: a run that does not know its chain, or one without samples.
            ModelError: a rate that is not positive or gives too many moments.
        """
        from holdfast.view.playback import playback_of_run

        run, setting = self._run_and_setting()
        return playback_of_run(setting.chain, run, setting.name, rate, setting.base_motion)

    def _run_and_setting(self) -> tuple[Trajectory, Any]:
        """Return the run and its setting, checked against each other."""
        from holdfast.simulation.trajectory import require_run_of

        run = self.whole_run()
        setting = run.require_setting()
        require_run_of(setting.chain, run)
        return run, setting

    def _repr_html_(self) -> str | None:
        """Return what a notebook shows of it."""
        from holdfast.view.inline import html_of_run

        return html_of_run(self)
