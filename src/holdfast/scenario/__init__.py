"""Scenes: TOML files that describe a simulation, and how a chain, a state and a controller are built from them."""
