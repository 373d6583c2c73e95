"""Sweeps: plans, chunks, stores, summaries."""
