"""The outputs of a run: result folders, tables, plots and pages."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast import outer

if TYPE_CHECKING:
    from holdfast.simulation.summary import Summary
    from holdfast.simulation.trajectory import Trajectory

FRAME_RATE = 30.0  # frames per second that pages show


class RunOutputs:
    """Output methods shared by the runs that `simulate` and `load_result` return.

    What writes files and draws is imported by `outer` when a method needs it; a run itself consists of arrays.
    """

    def whole_run(self) -> Trajectory:
        """Return the run with all samples and its setting.

        Raises:
            StateError: the run does not contain its chain.
        """
        raise NotImplementedError

    def summary(self) -> Summary:
        """Return the summary of the run: gaps, imbalances, peak forces and lowest margins.

        Raises:
            StateError: the run does not contain its chain, or has no samples.
        """
        from holdfast.simulation.summary import summarise

        run, setting = self._run_and_setting()
        return summarise(setting.chain, run)

    def save(self, folder: str | PathLike[str], overwrite: bool = False) -> Path:
        """Write the run as a result folder, as `holdfast simulate` does, and return the folder.

        The folder can be read by `hf.load_result`, `holdfast view`, `holdfast plot` and `holdfast export`. It contains
        the chain in `model.json`; meshes of the arms are referenced by name, not copied. It does not contain the
        controller, which is a function of your program, so the run cannot be continued or repeated from the folder
        alone.

        Args:
            folder: the folder to write; it is created if it does not exist.
            overwrite: replace an earlier result in this folder.

        Raises:
            StateError: the run does not contain its chain, or has no samples.
            ResultError: the folder is in use or cannot be written.
        """
        return outer.save_run(self._run_and_setting()[0], folder, overwrite)

    def to_csv(self, path: str | PathLike[str]) -> list[Path]:
        """Write the run as CSV, one row per sample, and return the files written; see `holdfast.io.export_csv`.

        Args:
            path: of the file; what is there is replaced.

        Raises:
            StateError: a run that does not know its chain, or one without samples.
            ResultError: a file cannot be written.
        """
        return outer.export_csv(self._run_and_setting()[0], path)

    def to_parquet(self, path: str | PathLike[str]) -> list[Path]:
        """Write the run as Parquet, the tables of `to_csv`, and return the files written.

        Args:
            path: of the file; what is there is replaced.

        Raises:
            MissingExtra: pyarrow is not installed.
            StateError: a run that does not know its chain, or one without samples.
            ResultError: a file cannot be written.
        """
        return outer.export_parquet(self._run_and_setting()[0], path)

    def to_mcap(self, path: str | PathLike[str]) -> Path:
        """Write the run as an MCAP file of ROS 2 messages and return the file; see `write_mcap`.

        Args:
            path: of the file; what is there is replaced.

        Raises:
            MissingExtra: mcap-ros2-support is not installed.
            StateError: a run that does not know its chain, or one without samples.
            ResultError: the file cannot be written.
        """
        run, setting = self._run_and_setting()
        outer.write_mcap(setting.chain, run, path, setting.base_motion)
        return Path(path)

    def to_pandas(self) -> Any:
        """Return the run as a pandas DataFrame, the table of `to_csv`.

        Raises:
            MissingExtra: pandas is not installed.
            StateError: a run that does not know its chain, or one without samples.
        """
        return outer.frame_of_run(self._run_and_setting()[0])

    def to_xarray(self) -> Any:
        """Return the run as an xarray Dataset: arrays over `t` with units, and joints and arms by name.

        Raises:
            MissingExtra: xarray is not installed.
            StateError: a run that does not know its chain, or one without samples.
        """
        return outer.data_set_of_run(self._run_and_setting()[0])

    def plot(self) -> dict[str, Any]:
        """Return the Matplotlib figures of this run by name, without opening a window.

        Figures without data are left out. A notebook displays all of them. `figure.savefig(path)` writes one figure,
        and `holdfast.plot.save_plots` writes all.

        Raises:
            MissingExtra: matplotlib is not installed.
            StateError: a run that does not know its chain, or one without samples.
        """
        run, setting = self._run_and_setting()
        return outer.Figures(outer.figures(setting.chain, run))

    def page(self, path: str | PathLike[str], rate: float = FRAME_RATE) -> Path:
        """Write the run as one HTML file that needs no network connection, and return its path.

        Arms from URDF files are drawn with their meshes if these can be read, and with simple solids otherwise. The
        page then says which mesh cannot be read and why, as do the `notes` of `playback()`.

        Args:
            path: path of the file, which is replaced if it exists.
            rate: frames per second that the page shows.

        Raises:
            MissingExtra: viser is not installed.
            StateError: a run that does not know its chain, or one without samples.
            ModelError: a rate that is not positive or gives too many moments.
            ResultError: the file cannot be written.
        """
        outer.export_page(self.playback(rate), path)
        return Path(path)

    def show(self, rate: float = FRAME_RATE) -> Any:
        """Show the page in a notebook, or in the browser from a temporary file.

        Args:
            rate: as for `page`.

        Returns:
            The object that the notebook displays, or otherwise the path of the file.

        Raises:
            HoldfastError: as for `page`, or no browser can be opened; the message then names the file.
        """
        playback = self.playback(rate)
        return outer.shown(outer.page(playback), playback.title)

    def playback(self, rate: float = FRAME_RATE, *, controller: Any = None) -> Any:
        """Return the frames that the page shows as a `Playback`, for `holdfast.plot.export_page`.

        Args:
            rate: frames per second.
            controller: the run's controller, whose commanded internal forces and limits are then shown, too; by default
                that of its scene, if it has one.

        Raises:
            StateError: a run that does not know its chain, or one without samples.
            ModelError: a rate that is not positive or gives too many moments.
        """
        run, setting = self._run_and_setting()
        chain, motions = setting.chain, setting.base_motion
        law = setting.controller if controller is None else controller
        return outer.playback_of_run(chain, run, setting.name, rate, motions, controller=law)

    def _run_and_setting(self) -> tuple[Trajectory, Any]:
        """Return the run and its setting, after checking that they match."""
        from holdfast.simulation.trajectory import require_run_of

        run = self.whole_run()
        setting = run.require_setting()
        require_run_of(setting.chain, run)
        return run, setting

    def _repr_html_(self) -> str | None:
        """Return the HTML representation for notebooks."""
        return outer.html_of_run(self)
