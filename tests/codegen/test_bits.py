"""Exported code and the library's own machine code: equal bits."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.codegen.export import files_of
from holdfast.compiler.targets import OBJECT_TARGETS, cpu
from holdfast.spatial.scalar import cos, sin
from tests.codegen.exported import APART, built, outputs, require
from tests.codegen.problems import NAMES, chain_and_state, steps, truths
from tests.compiler.programs import same_bits
from tests.longer import mostly_slow

HERE = [name for name, needs in cpu.X86_LEVELS.items() if "fma" in needs and cpu.features().issuperset(needs)]
COMPILERS = {"aarch64": ["aarch64-linux-gnu-gcc"]}


def check(name, target, source, compilers, folder, count, derivatives=True, with_step=True):
    """Library = exported, for every function, system and array."""
    known = [truth for truth in truths(name, count, derivatives) if with_step or truth.function.name != "step"]
    check_all(known, target, source, compilers, folder)


def check_all(known, target, source, compilers, folder):
    """The same for functions whose answers are known."""
    require(*APART.get(target, []), *compilers)
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


@pytest.mark.slow
@pytest.mark.parametrize("source", mostly_slow((False, True), (True,)))
def test_one_chain(source, tmp_path):
    """Object file and source of two arms, one of which holds."""
    if not HERE:
        pytest.skip("this processor has no fma: its machine code rounds products apart")
    check("one holds", HERE[-1], source, ["gcc"], tmp_path, 20, derivatives=False, with_step=not source)


@pytest.mark.slow
def test_a_step_on_moving_bases(tmp_path):
    """The base's motion is part of the code: as the rollout steps that has it, whose base has moved by then."""
    if not HERE:
        pytest.skip("this processor has no fma: its machine code rounds products apart")
    chain, state = chain_and_state("one holds")
    name = next(iter(chain.arms))
    base, along = chain.arms[name].base, np.array([0.0, 0.05, 0.02])

    def heave(t):
        still = np.zeros(3)
        twist, acceleration = (np.concatenate([still, x * along]) for x in (5.0 * sin(5.0 * t), 25.0 * cos(5.0 * t)))
        return hf.Pose(base.R, base.p + (1.0 - cos(5.0 * t)) * along), twist, acceleration

    found = steps(hf.compile(chain), state, 20, {name: heave})
    assert not same_bits(found.expected[-1]["last.q"], steps(hf.compile(chain), state, 20).expected[-1]["last.q"])
    check_all([found], HERE[-1], False, ["gcc"], tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("source", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_ten_chains(name, source, tmp_path):
    """1,000 systems of every chain, for every processor, by both compilers."""
    for target in (*HERE, "aarch64"):
        compilers = COMPILERS.get(target, ["gcc", "clang"] if source else ["gcc"])
        check(name, target, source, compilers, tmp_path / target, 1000, derivatives=name == "two of seven")
