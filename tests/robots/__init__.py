"""Tests of the ready-made arms."""
