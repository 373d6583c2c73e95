"""Machine code of a 64-bit ARM processor, emulated: the interpreter's bits, as on every processor with fma."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from holdfast.compiled.forward_schedule import forward_schedule
from holdfast.compiled.parameters import parameters_of
from holdfast.compiled.structure import Options, Structure
from holdfast.compiler.interpret import interpret_schedule
from holdfast.compiler.lowering import lowered
from holdfast.compiler.schedule import Schedule
from tests.compiled.problems import chain_of, numbers, one
from tests.compiler.emulated import outputs, require_emulator
from tests.compiler.programs import NUMBERS, programs, same_bits, schedule_of
from tests.compiler.schedules import inputs_of, schedules
from tests.compiler.test_elementary import CIRCLE, hard_arguments

few = settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@pytest.fixture(autouse=True, scope="module")
def emulator():
    """Everything here needs it."""
    require_emulator()


def check(schedule: Schedule, systems: list[dict[str, np.ndarray]]) -> None:
    """Interpreter = alone = in a batch, for every system."""
    alone, batch = outputs(schedule, systems)
    for k, system in enumerate(systems):
        for name, expected in interpret_schedule(schedule, system).items():
            assert same_bits(alone[k][name], expected), (k, name)
            assert same_bits(batch[k][name], expected), (k, name)


@few
@given(programs(), st.lists(st.lists(NUMBERS, min_size=7, max_size=7), min_size=1, max_size=5))
def test_programs(program, values):
    """Random programs and numbers: every operation, overflow, zeros of both signs."""
    systems = [{"in0": np.array(x[:3]), "in1": np.reshape(x[3:], (2, 2))} for x in values]
    check(schedule_of(lowered(program)), systems)


@few
@given(schedules(), st.integers(0, 2**32), st.booleans(), st.integers(1, 4))
def test_schedules(schedule, seed, wild, count):
    """Random schedules: items in lanes, values that are handed on, statuses and guards."""
    check(schedule, [inputs_of(schedule, seed + k, wild) for k in range(count)])


def test_sine_and_cosine():
    """Of the arguments that are hardest to reduce, and of random ones."""
    random = np.random.default_rng(0)
    x = np.concatenate([hard_arguments()[::40], random.uniform(-1e5, 1e5, 300), [0.0, 1e5, 2e5, np.inf, np.nan]])
    check(schedule_of(lowered(CIRCLE.program)), [{"in0": np.array([v])} for v in x])


def test_chain():
    """Forward dynamics of a chain, its arms in lanes and one after the other."""
    chain = chain_of(((4, "rigid"), (3, "hinge"), (2, None)))
    given, own = numbers(chain, 2), parameters_of(chain, None)
    schedule = forward_schedule(Structure(chain, Options()))
    systems = [own | one(given, k) for k in range(2)]
    check(schedule, [{name: x for name, x in s.items() if name in schedule.externals} for s in systems])
