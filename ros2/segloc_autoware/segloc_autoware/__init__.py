"""segloc where Autoware's pose_initializer asks an NDT scan matcher: one service, and no more."""
