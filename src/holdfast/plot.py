"""Pictures, playbacks and pages of runs."""

from holdfast.view.comparison import compare_runs as compare_runs
from holdfast.view.page import export_page as export_page
from holdfast.view.playback import playback_of_run as playback_of_run
from holdfast.view.plots import save_plots as save_plots
