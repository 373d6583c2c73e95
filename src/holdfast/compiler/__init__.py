"""Turn a function of arrays into machine code: trace, fold, fuse, interpret, compile. It knows nothing of robots."""
