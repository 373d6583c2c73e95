"""Independent truths that share no code with the library."""
