"""Pictures, films and pages of runs."""

from holdfast.view.film import film_of_run as film_of_run
from holdfast.view.page import export_page as export_page
from holdfast.view.plots import save_plots as save_plots
