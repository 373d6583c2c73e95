"""holdfast: exact dynamics of several robot arms that jointly grasp one object.

The names at the top are the model, its state, what acts on it, and the verbs of the README; the rest is found by theme:
`dynamics`, `forces`, `control`, `simulation`, `compiled`, `assembly`, `planning`, `robots`, `identification`, `io`,
`interop`, `sweeps`, `gym`, `codegen`, `plot`. Each name is written once, in `__init__.pyi` of its theme, and loaded
when it is first asked for.
"""

from holdfast.names import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)

__version__ = "0.1.0"
