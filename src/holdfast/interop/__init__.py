"""To and from other libraries: MuJoCo's MJCF, Pinocchio's orders."""
