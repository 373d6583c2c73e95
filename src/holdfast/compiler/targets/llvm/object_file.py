"""Object files without Python, for this processor or another one.

Their functions call no library, keep no state and allocate no memory. How much stack a function needs is read from its
assembly.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import llvmlite.binding as binding

from holdfast.compiler.errors import CompileError
from holdfast.compiler.targets.llvm import cpu
from holdfast.compiler.targets.llvm.functions import filled, number_type


class ObjectTarget(NamedTuple):
    """A processor, under Linux, for which object files are made.

    Attributes:
        made_for: the processor.
        triple: LLVM's name of the architecture and the operating system.
        flags: the flags of GCC and Clang that select the same processor.
    """

    made_for: cpu.Processor
    triple: str
    flags: str

    @property
    def name(self) -> str:
        """The target's name in the user interface."""
        return self.made_for.name


class ObjectFile(NamedTuple):
    """Machine code to be linked.

    Attributes:
        content: the bytes of the file, in ELF format.
        stack: the largest number of bytes of stack that a call needs, its return address included, by function.
    """

    content: bytes
    stack: dict[str, int]


_X86, _ARM = "x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu"
OBJECT_TARGETS = {
    **{name: ObjectTarget(cpu.level(name), _X86, f"-march={name}") for name in cpu.X86_LEVELS},
    "aarch64": ObjectTarget(cpu.Processor("aarch64", "generic", frozenset({"fma"}), ""), _ARM, "-march=armv8-a"),
}


def object_file(modules: Sequence[str], target: ObjectTarget) -> ObjectFile:
    """Compile modules into one object file.

    Args:
        modules: their sources in LLVM's language, written for this target; no two may share a public name.
        target: the processor.

    Raises:
        CompileError: LLVM was built without this architecture.
    """
    with cpu.lock:
        binding.initialize_all_targets()
        binding.initialize_all_asmprinters()
        try:
            known = binding.Target.from_triple(target.triple)
        except RuntimeError as error:
            raise CompileError(f"target: this build of LLVM cannot generate code for {target.name}: {error}") from error
        machine = known.create_target_machine(
            cpu=target.made_for.cpu, features=target.made_for.feature_text, opt=2, reloc="pic", codemodel="small"
        )
        whole, *others = [_parsed(_with_own_fma(text, target), machine, target) for text in modules]
        for other in others:
            whole.link_in(other)
        assembly = machine.emit_assembly(whole.clone())
        return ObjectFile(machine.emit_object(whole), stack_needed(assembly))


def _parsed(text: str, machine: Any, target: ObjectTarget) -> Any:
    try:
        module = binding.parse_assembly(text)
        module.triple, module.data_layout = target.triple, str(machine.target_data)
        module.verify()
    except RuntimeError as error:
        raise CompileError(f"LLVM refuses the program: {error}") from error
    return module


def _with_own_fma(text: str, target: ObjectTarget) -> str:
    """Return the module with its own fma function added, if the target has no fma instruction."""
    if "fma" in target.made_for.features:
        return text
    used = {1 if not n else int(n) for n in re.findall(r"@llvm\.fma\.(?:v(\d+))?f64\(", text)}
    if not used:
        return text
    lines = [line for line in text.splitlines() if not (line.startswith("declare") and "@llvm.fma." in line)]
    own = [_fma_of_lanes(n) for n in sorted(used - {1})]
    return "\n".join([*lines, filled("fma"), *own]).replace("@llvm.fma.", "@exact.fma.")


def _fma_of_lanes(lanes: int) -> str:
    """Return the function that applies the scalar fma of `fma.ll` to every lane of vectors."""
    T, result = number_type(lanes), "poison"
    lines = [f"define internal {T} @llvm.fma.v{lanes}f64({T} %a, {T} %b, {T} %c) noinline nounwind {{"]
    for j in range(lanes):
        lines += [f"  %{x}{j} = extractelement {T} %{x}, i64 {j}" for x in "abc"]
        lines.append(f"  %r{j} = call double @exact.fma.f64(double %a{j}, double %b{j}, double %c{j})")
        lines.append(f"  %to{j} = insertelement {T} {result}, double %r{j}, i64 {j}")
        result = f"%to{j}"
    return "\n".join([*lines, f"  ret {T} {result}", "}"])


_FUNCTION = re.compile(r"^([\w.$]+|\"[^\"]+\"):")
_FRAME = (  # instructions that allocate stack: of x86-64, then of 64-bit ARM
    (re.compile(r"\bpushq\b"), 8),
    (re.compile(r"\bsubq\s+\$(\d+), %rsp"), None),
    (re.compile(r"\bandq\s+\$-(\d+), %rsp"), None),
    (re.compile(r"\bsub\s+sp, sp, #(\d+)(?:, lsl #12)?"), None),
    (re.compile(r"\bst[rp]\s.*\[sp, #-(\d+)\]!"), None),
)
_BELOW = re.compile(r"\s-(\d+)\(%rsp")  # accesses to the red zone of x86-64: 128 bytes below the stack pointer
_CALL = re.compile(r"\b(?:callq|jmp|bl|b)\s+([\w.$]+|\"[^\"]+\")(?:@PLT)?$")


def stack_needed(assembly: str) -> dict[str, int]:
    """Return the stack that each public function needs, including the functions that it calls [bytes].

    Args:
        assembly: the assembly of a module without recursion.
    """
    own: dict[str, int] = {}
    below: dict[str, int] = {}
    called: dict[str, set[str]] = {}
    name = ""
    for line in assembly.splitlines():
        label = _FUNCTION.match(line)
        if label and not label[1].startswith("."):
            name = label[1]
            own[name] = 8  # the return address; ARM keeps it in a register until it calls
            below[name], called[name] = 0, set()
        elif name:
            own[name] += _taken(line)
            below[name] = max([below[name], *map(int, _BELOW.findall(line))])
            if found := _CALL.search(line.strip()):
                called[name].add(found[1])

    def most(function: str) -> int:
        deeper = (most(x) for x in called[function] if x in own and x != function)
        return own[function] + max(deeper, default=below[function])

    public = re.findall(r"^\s*\.globl\s+(\S+)", assembly, re.MULTILINE)
    return {function: most(function) for function in public}


def _taken(line: str) -> int:
    for pattern, size in _FRAME:
        if found := pattern.search(line):
            taken = size if size is not None else int(found[1])
            return taken * 4096 if "lsl #12" in line else taken
    return 0
