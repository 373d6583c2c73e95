"""Where robots meet the compiler: chains become schedules of stages, and these machine code."""

from .chain import CompiledChain as CompiledChain
from .function import Function as Function
