"""What is wrong with a recording is named: an error or a remark with the column, never a traceback, no false alarm."""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np
import pytest
from benchmarks import faulty_recordings
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


@pytest.mark.slow
@pytest.mark.parametrize("number", [90, 394, 508])
def test_sign_under_friction(number, tmp_path):
    """Friction hides the sign of a joint that feels no gravity: with the opposite one, it would drive the joint."""
    chain, how = arm()
    random, path = np.random.default_rng([8, number]), tmp_path / "log.csv"
    columns = sound(chain, random)
    names = IN_COLUMNS["sign of a torque"](columns, random)
    path.write_text(as_text(columns), encoding="utf-8")
    outcome, said = said_of(chain, how, path)
    assert names == ["tau1"]
    assert judged("sign of a torque", outcome, said, names, path) == "named remark", said
    assert "opposite sign" in said


@pytest.mark.parametrize("fate", ["unseen", "false alarm", "error without the column", "remark without the column"])
def test_exit_status(fate, monkeypatch):
    """Whatever is not as it should be shows in the exit status."""
    monkeypatch.setattr(sys, "argv", ["faulty_recordings"])
    for of, status in ((fate, 1), ("named error", 0)):
        monkeypatch.setattr(faulty_recordings, "count", lambda *given, of=of: Counter({("NaN", of): 1}))
        assert faulty_recordings.main() == status


@pytest.mark.long
def test_a_few_of_every_kind():
    """As the benchmark counts them: of 38 at most one goes unseen, and nothing sound is suspected."""
    table = count(38, seed=3, show=False)
    fates = [fate for _, fate in table.elements()]
    assert set(fates) <= {"named error", "named remark", "rightly silent", "unseen"}, table
    assert fates.count("unseen") <= 1, table
