"""Machine code of chains on disk: found by the next process without tracing, rebuilt when damaged."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]

# Answers of a small chain in every way there is, as bits; `damage` is done to the entries in between.
SCRIPT = """
import json, sys
import numpy as np
import holdfast
from holdfast.compiler import composition
from holdfast.compiler.targets import cpu
from tests.compiled.problems import chain_of, numbers, one, outputs

compilations, traces = [], []
compiled, made = cpu._compiled, composition.Composition.__init__
cpu._compiled = lambda *given: compilations.append(1) or compiled(*given)
composition.Composition.__init__ = lambda self: traces.append(1) or made(self)

chain = chain_of(((2, "ball"), (3, "softfinger")))
given = numbers(chain, 5)
fast = holdfast.compile(chain)
single = fast.forward_dynamics(**one(given, 0))
fast.forward_dynamics(*one(given, 0).values(), out=single)
found = [x for result in (single, fast.forward_dynamics(**given)) for x in outputs(result)]
bits = np.concatenate([np.ravel(x) for x in found]).tobytes().hex()
print(json.dumps([len(compilations), len(traces), fast.operation_count, bits]))
"""


def run(cache: Path) -> list:
    """Return compilations, traces, operation count and the answers' bits, by a new process."""
    env = os.environ | {"HOLDFAST_CACHE": str(cache), "PYTHONPATH": os.pathsep.join(map(str, (ROOT / "src", ROOT)))}
    done = subprocess.run([sys.executable, "-c", SCRIPT], env=env, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_next_process(tmp_path):
    """Nothing is traced or compiled the second time; a damaged entry is made again, and only that one."""
    cache = tmp_path / "cache"
    compilations, traces, *answers = run(cache)
    entries = sorted(cache.iterdir())
    assert compilations == len(entries) == 4 and traces == 1  # single, batch, and two builtins
    assert run(cache) == [0, 0, *answers]
    whole = {path: path.read_bytes() for path in entries}
    random = np.random.default_rng(0)
    for path in entries:
        damaged = bytearray(whole[path])
        damaged[int(random.integers(len(damaged)))] ^= 16
        path.write_bytes(damaged)
    compilations, _, *again = run(cache)
    assert compilations == 4 and again == answers
    assert {path: path.read_bytes() for path in cache.iterdir()} == whole
    entries[0].write_bytes(whole[entries[0]][:100])
    entries[1].unlink()
    compilations, _, *again = run(cache)
    assert compilations == 2 and again == answers


def test_off(tmp_path):
    """HOLDFAST_CACHE=off compiles each time."""
    compilations, traces, *_ = run(Path("off"))
    assert compilations == 4 and traces == 1
    assert not Path("off").exists()
