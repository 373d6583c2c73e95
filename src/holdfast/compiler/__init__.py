"""From a function of arrays to machine code: trace, fold, fuse, interpret, compile. Knows nothing of robots."""
