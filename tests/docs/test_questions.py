"""What is made of the declarations of questions: the stub of compiled chains, their docstrings, and the page."""

from benchmarks.write_stubs import written

import holdfast as hf
from holdfast.questions.arrays import ARRAYS
from holdfast.questions.question import QUESTIONS
from tests.systems.problems import random_problem


def test_what_is_made_is_up_to_date():
    """`make stubs` would change nothing."""
    stale = [path.name for path, text in written().items() if path.read_text(encoding="utf-8") != text]
    assert not stale, "run `make stubs`"


def test_docstrings_name_every_array():
    """The docstring of a compiled question names what it takes, with units, and the arrays that it returns."""
    fast = hf.compile(random_problem(3, joints=(6, 6), grasps=("rigid", "rigid")).chain)
    for name, question in QUESTIONS.items():
        said = getattr(fast, name).__doc__
        for given in question.inputs:
            assert f"{given}: (" in said and ARRAYS[given].unit in said, (name, given)
        assert name in dir(fast)
