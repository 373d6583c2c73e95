"""What the methods of a compiled chain share: the chain, and machine code that is made when it is first needed."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

from holdfast.compiled.kernels import compiling
from holdfast.compiled.structure import Options
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called

Code = TypeVar("Code")


class ChainMethods:
    """A base of `CompiledChain`.

    Attributes:
        chain: the chain.
        options: the options with which it was compiled.
        progress: whether to show that machine code is made.
    """

    chain: ClosedChain
    options: Options
    progress: bool = False

    def __init_subclass__(cls) -> None:
        """Let wrong calls of its methods raise errors of ours."""
        called(cls)

    def _code(self, key: Hashable, what: str, make: Callable[[], Code]) -> Code:
        """Return the machine code of a key; it is made, and progress is shown, when it is first requested."""
        made: dict[Hashable, Any] = self.__dict__.setdefault("_codes", {})
        if key not in made:
            with compiling(self.chain, what, self.progress):
                made[key] = make()
        return made[key]
