"""Where robots meet the compiler: chains become schedules of stages, and these machine code."""
