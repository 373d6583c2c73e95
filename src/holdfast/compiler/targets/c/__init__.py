"""The C11 target: source code for one system, which the user compiles."""
