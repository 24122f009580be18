"""What the node does, without ROS: values in, values out."""

from .replies import Reply as Reply
from .robot import Robot as Robot
from .settings import Settings as Settings
