"""Functions of outer rooms that methods of the core call: `run.save`, `run.page`, `HeldObject.from_mesh` ...

The core imports no file format and no screen. Its methods call these functions as attributes of this module, such as
`outer.save_run(run, folder)`, which imports the module that defines them.
"""

from importlib import import_module
from typing import Any

_MODULES = {
    "codegen.export": ("export_c",),
    "interop.mcap_writer": ("write_mcap",),
    "io.record_folder": ("RecordWriter", "parts_of_record", "save_record"),
    "io.save_run": ("AppendedRun", "save_run"),
    "io.tables": (
        "data_set_of_record",
        "data_set_of_run",
        "export_csv",
        "export_parquet",
        "frame_of_record",
        "frame_of_run",
    ),
    "robots.built_in": ("home_of",),
    "robots.mesh_files.solid": ("held_object_from_mesh", "size_notes"),
    "robots.urdf.bodies": ("held_object_from_urdf",),
    "robots.visuals": ("equivalent_box",),
    "view.chain_diagram": ("chain_diagram",),
    "view.inline": ("Figures", "html_of_run", "html_of_summary", "shown"),
    "view.page": ("export_page", "page"),
    "view.playback": ("playback_of_run",),
    "view.plots": ("figures",),
    "view.timing_plot": ("plot_timing",),
}
MODULE_OF = {name: f"holdfast.{module}" for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(MODULE_OF[name]), name)
