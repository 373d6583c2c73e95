"""Where robots meet the compiler: chains become schedules of stages, and these machine code."""

from .bound_dynamics import BoundDynamics as BoundDynamics
from .chain import CompiledChain as CompiledChain
from .result import CompiledResult as CompiledResult
