"""Write what is made of the declarations of questions: the stub of compiled chains, and the page of all questions.

python benchmarks/write_stubs.py [--check]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import holdfast
import holdfast.compiled.chain as chain
from holdfast.questions.documentation import page, stub
from holdfast.questions.question import QUESTIONS

ROOT = Path(__file__).parents[1]


def public_names() -> tuple[dict[str, str], set[str]]:
    """Return where users find the functions that answer questions on floats, and which of these have derivatives."""
    homes = {"holdfast": holdfast, "holdfast.dynamics": holdfast.dynamics, "holdfast.forces": holdfast.forces}
    found, differentiable = {}, set[str]()
    for home, of in reversed(homes.items()):
        for name in QUESTIONS:
            if name in dir(of):
                found[name] = f"{home}.{name}"
                differentiable |= {name} if hasattr(getattr(of, name), "vjp") else set()
    return found, differentiable


def written() -> dict[Path, str]:
    """Return the text of every file that is made; importing `compiled.chain` has loaded all declarations."""
    return {
        Path(chain.__file__).with_name("answers.pyi"): stub(),
        ROOT / "docs" / "api" / "questions.md": page(*public_names()),
    }


def main() -> None:
    """Write the files, or say which are stale."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--check", action="store_true", help="only say which are stale")
    check = arguments.parse_args().check
    for path, text in written().items():
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            print(f"{'stale' if check else 'written'}: {path.relative_to(ROOT)}")
            if not check:
                path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
