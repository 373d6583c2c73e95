"""Many steps of many systems in machine code: the texts of the simulation, traced."""
