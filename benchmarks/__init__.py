"""Measurements: speed beside other libraries, operation counts, drift, lines of code."""
