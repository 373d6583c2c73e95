"""The full-size checks: what the project promises, at the size it promises it."""
