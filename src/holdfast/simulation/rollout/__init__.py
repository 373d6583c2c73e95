"""Many steps of many systems in machine code: the functions of the simulation, traced."""
