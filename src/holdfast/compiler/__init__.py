"""From an algorithm's text to machine code: trace, fold, fuse, interpret, compile. Knows nothing of robots."""
