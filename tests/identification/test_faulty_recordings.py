"""What is wrong with a recording is named: an error or a remark with the column, never a traceback, no false alarm."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.faulty_recordings import IN_COLUMNS, IN_FILES, arm, as_text, count, judged, said_of, sound

FILES = [*IN_FILES, "NaN", "empty cells", "infinity", "texts", "decimal commas", "repeated stamp", "clock set back",
         "absent column", "column named twice"]  # fmt: skip


@pytest.mark.parametrize("kind", FILES)
def test_what_cannot_be_read(kind, tmp_path):
    """The file is named, or its column, before anything is fitted."""
    chain, how = arm()
    random = np.random.default_rng(1)
    columns, names, path = sound(chain, random), list[str](), tmp_path / "log.csv"
    if kind in IN_COLUMNS:
        names = IN_COLUMNS[kind](columns, random)
        path.write_text(as_text(columns), encoding="utf-8")
    else:
        suffix, spoil = IN_FILES[kind]
        path = path.with_suffix(suffix)
        path.write_bytes(spoil(as_text(columns), random))
    outcome, said = said_of(chain, how, path)
    assert judged(kind, outcome, said, names, path) == "named error", said


@pytest.mark.long
def test_a_few_of_every_kind():
    """As the benchmark counts them: of 38 at most one goes unseen, and nothing sound is suspected."""
    table = count(38, seed=3, show=False)
    fates = [fate for _, fate in table.elements()]
    assert set(fates) <= {"named error", "named remark", "rightly silent", "unseen"}, table
    assert fates.count("unseen") <= 1, table
