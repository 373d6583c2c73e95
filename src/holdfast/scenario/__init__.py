"""Scenes: TOML files that say what to simulate, and what becomes of them."""
