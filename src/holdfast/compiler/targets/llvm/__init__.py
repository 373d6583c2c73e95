"""The LLVM target: machine code for the processor of this machine, and object files for others."""
