"""The paper's own protocol on KITTI odometry 00: the last 1300 m against all before them."""
