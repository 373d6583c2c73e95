"""Figures, pages and playbacks of runs; `holdfast.plot` is its public name."""

from .calibration_report import calibration_page as calibration_page
from .comparison import compare_runs as compare_runs
from .identification_report import identification_page as identification_page
from .page import export_page as export_page
from .playback import playback_of_run as playback_of_run
from .plots import save_plots as save_plots
