"""Random wrong arguments for every public call: nothing but errors of ours comes back."""
