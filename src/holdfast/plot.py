"""Pictures, playbacks and pages of runs."""

from holdfast.view import calibration_page as calibration_page
from holdfast.view import compare_runs as compare_runs
from holdfast.view import export_page as export_page
from holdfast.view import identification_page as identification_page
from holdfast.view import playback_of_run as playback_of_run
from holdfast.view import save_plots as save_plots
