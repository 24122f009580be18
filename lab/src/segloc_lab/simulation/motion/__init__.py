"""How sensors move: routes, platforms, traversals, odometry."""
