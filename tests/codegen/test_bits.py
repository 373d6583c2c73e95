"""Exported code and the library's own machine code: equal bits."""

import numpy as np
import pytest

from holdfast.codegen.export import files_of
from holdfast.compiler.targets import OBJECT_TARGETS, cpu
from tests.codegen.exported import APART, built, outputs, require
from tests.codegen.problems import NAMES, truths
from tests.compiler.programs import same_bits
from tests.longer import mostly_slow

HERE = [name for name, needs in cpu.LEVELS.items() if "fma" in needs and cpu.features().issuperset(needs)]
COMPILERS = {"aarch64": ["aarch64-linux-gnu-gcc"]}


def check(name, target, source, compilers, folder, count, derivatives=True, with_step=True):
    """Library = exported, for every function, system and array."""
    require(*APART.get(target, []), *compilers)
    known = [truth for truth in truths(name, count, derivatives) if with_step or truth.function.name != "step"]
    exported = files_of("part", [truth.function for truth in known], OBJECT_TARGETS[target], source)
    folder.mkdir(exist_ok=True)
    for file, content in exported.files.items():
        (folder / file).write_bytes(content)
    for compiler in compilers:
        flags = OBJECT_TARGETS[target].flags
        program = built(folder, "part", exported.functions, compiler, target, flags)
        given = {truth.function.name: truth.given for truth in known}
        found = outputs(program, [truth.function for truth in known], given, APART.get(target, ()))
        for truth in known:
            of_function = found[truth.function.name]
            for k, (got, expected) in enumerate(zip(of_function, truth.expected, strict=True)):
                for array, x in expected.items():
                    assert same_bits(got[array].ravel(), np.asarray(x, dtype=got[array].dtype).ravel()), (
                        truth.function.name,
                        k,
                        array,
                    )


@pytest.mark.parametrize("source", mostly_slow((False, True), (True,)))
def test_one_chain(source, tmp_path):
    """Object file and source of two arms, one of which holds."""
    if not HERE:
        pytest.skip("this processor has no fma: its machine code rounds products apart")
    check("one holds", HERE[-1], source, ["gcc"], tmp_path, 20, derivatives=False, with_step=not source)


@pytest.mark.long
@pytest.mark.parametrize("source", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_ten_chains(name, source, tmp_path):
    """1,000 systems of every chain, for every processor, by both compilers."""
    for target in (*HERE, "aarch64"):
        compilers = COMPILERS.get(target, ["gcc", "clang"] if source else ["gcc"])
        check(name, target, source, compilers, tmp_path / target, 1000, derivatives=name == "two of seven")
