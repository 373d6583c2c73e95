"""The benchmark: closed-chain forward dynamics against other libraries, at equal work and equal answers."""
