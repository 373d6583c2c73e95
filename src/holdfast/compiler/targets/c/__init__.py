"""C11 as a target: source for one system, to be compiled by whoever has it."""
