"""What belongs to one target: the only door through which the rest of the library reaches it.

The compiler's other files say what is computed: programs, stages, schedules. A target makes that run. The one there
is, `llvm`, is this processor: its lanes, its calling convention, its language. Another (a GPU) is a folder
beside it that offers the same:

    cpu               the processor (`target`, `lanes`, `has_fma`) and code made for it or loaded (`Code`)
    single_module     the source of a schedule for one system
    batch_module      the source of a schedule for many systems
    Builtin           a Python callable that takes arrays straight to the code
    no_argument_call  the same without arguments, for control loops
    foreign_call      kernels as functions that other compilers' programs call (`publish`, `capsule`)

Code that leaves the library, for processors by name (`OBJECT_TARGETS`), is not run here:

    object_file       modules as one object file
    single_source     a schedule for one system in C, of the folder `c`
"""

from holdfast.compiler.targets.c.single import single_source
from holdfast.compiler.targets.llvm import cpu, foreign_call
from holdfast.compiler.targets.llvm.batch import batch_module
from holdfast.compiler.targets.llvm.builtin import Builtin, no_argument_call
from holdfast.compiler.targets.llvm.object_file import OBJECT_TARGETS, ObjectTarget, object_file
from holdfast.compiler.targets.llvm.single import single_module

__all__ = [
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
