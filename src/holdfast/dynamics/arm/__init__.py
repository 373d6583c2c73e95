"""Recursions over the links of one arm.

Sweeps run in link axes: link k's quantities are about its frame's origin O_k, along
its own axes. Arrays run base to tip, so `k` here is the paper's N - k; a sweep
"outward" goes base to tip (the paper's anticausal), "inward" tip to base (causal).
"""
