"""The questions that a compiled chain answers; the stub beside this file declares them for type checkers."""


class Answers:
    """Attributes of a compiled chain that `CompiledChain.__getattr__` makes of the questions."""
