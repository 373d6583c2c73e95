"""Schedules as machine code of this processor, by LLVM."""
