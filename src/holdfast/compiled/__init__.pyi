"""Where robots meet the compiler: chains become schedules of stages, and these machine code."""

from .chain import CompiledChain as CompiledChain
from .forest import CompiledForest as CompiledForest
from .forest import CompiledMechanism as CompiledMechanism
from .function import Function as Function
