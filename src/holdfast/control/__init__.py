"""Controllers: functions (t, state, memory) -> (torques, memory)."""
