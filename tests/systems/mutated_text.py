"""Texts spoilt without knowing what they say: bytes, letters, lines, matches of a pattern."""

from __future__ import annotations

import random
import re

WORD = re.compile(r"[A-Za-z_]{3,}")
CODECS = ("utf-8", "utf-16", "utf-16-be", "utf-32", "latin-1", "cp037")
STRAY = (b"", b"", b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\xc3\x28", b"\xed\xa0\x80")


def bytes_flipped(text: str, dice: random.Random) -> bytes:
    """Return the text with a few random bytes."""
    data = bytearray(text.encode())
    for _ in range(dice.choice([1, 3, 30])):
        data[dice.randrange(len(data))] = dice.randrange(256)
    return bytes(data)


def recoded(text: str, dice: random.Random) -> bytes:
    """Return the text in one of several encodings, perhaps cut or with stray bytes."""
    data = text.encode(dice.choice(CODECS), "replace")
    stray = dice.choice(STRAY)
    at = dice.choice([0, dice.randrange(len(data))])
    return data[:at] + stray + data[at : dice.choice([len(data), dice.randrange(at, len(data))])]


def mistyped(text: str, dice: random.Random, letters: str) -> str:
    """Return the text with one letter of one word changed (to one of these), dropped or doubled."""
    word = dice.choice(list(WORD.finditer(text)))
    k = dice.randrange(word.start(), word.end())
    return text[:k] + dice.choice(["", text[k] * 2, dice.choice(letters), text[k].swapcase()]) + text[k + 1 :]


def deleted(text: str, dice: random.Random, *patterns: re.Pattern[str]) -> str:
    """Return the text without everything beyond a point, one line, or one match of a pattern."""
    if (kind := dice.randrange(2 + len(patterns))) == 0:
        return text[: dice.randrange(len(text))]
    if kind == 1:
        lines = text.splitlines(keepends=True)
        del lines[dice.randrange(len(lines))]
        return "".join(lines)
    gone = dice.choice(list(patterns[kind - 2].finditer(text)))
    return text[: gone.start()] + text[gone.end() :]


def duplicated(text: str, dice: random.Random, first: int = 0) -> str:
    """Return the text with one line or block, from the `first` on, repeated a few or very many times, anywhere."""
    lines = text.splitlines(keepends=True)
    first = dice.randrange(first, len(lines))
    block = lines[first : first + dice.choice([1, 1, 1, 6, 12])] * dice.choice([1, 1, 2, 3000])
    where = dice.choice([first, dice.randrange(len(lines))])
    return "".join(lines[:where] + block + lines[where:])


def exchanged(text: str, dice: random.Random, *patterns: str) -> str:
    """Return the text with the first groups of two matches of one of the patterns exchanged."""
    found = list(re.finditer(dice.choice(patterns), text))
    a, b = sorted(dice.sample(found, 2), key=re.Match.start) if len(found) > 1 else (found[0], found[0])
    if a is b:
        return text
    return text[: a.start(1)] + b[1] + text[a.end(1) : b.start(1)] + a[1] + text[b.end(1) :]
