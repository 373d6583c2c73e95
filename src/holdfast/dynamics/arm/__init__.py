"""Recursions over the links of one arm.

Sweeps use link axes: the quantities of link k are about the origin O_k of its frame, and along its own axes. Arrays are
ordered from base to tip, so k here is N - k in the paper. An "outward" sweep goes from base to tip (anticausal in the
paper), and an "inward" sweep from tip to base (causal).
"""
