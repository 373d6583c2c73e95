"""The targets of the compiler. The rest of the library imports from this package only, not from its modules.

The compiler's other files describe what is computed, as programs, stages and schedules; a target makes that run. The
target of the library itself is `llvm`, for the processor of this machine. Another target, such as a GPU, would be
a folder beside it that offers the same names:

    cpu               the processor (`target`, `lanes`, `has_fma`) and machine code for it (`Code`)
    single_module     the source of a schedule for one system
    batch_module      the source of a schedule for many systems
    Builtin           a Python callable that passes arrays directly to the machine code
    no_argument_call  the same without arguments, for control loops
    foreign_call      kernels as functions that other compilers' programs call (`publish`, `capsule`)

Two functions export code, for the processors named in `OBJECT_TARGETS`; such code is not run here:

    object_file       compiles modules into one object file
    single_source     writes a schedule for one system in C after DEFINITIONS
"""

from holdfast.compiler.targets.c_source import DEFINITIONS, single_source
from holdfast.compiler.targets.llvm import cpu, foreign_call
from holdfast.compiler.targets.llvm.batch import batch_module
from holdfast.compiler.targets.llvm.builtin import Builtin, no_argument_call
from holdfast.compiler.targets.llvm.object_file import OBJECT_TARGETS, ObjectTarget, object_file
from holdfast.compiler.targets.llvm.single import single_module

__all__ = [
    "DEFINITIONS",
    "OBJECT_TARGETS",
    "Builtin",
    "ObjectTarget",
    "batch_module",
    "cpu",
    "foreign_call",
    "no_argument_call",
    "object_file",
    "single_module",
    "single_source",
]
