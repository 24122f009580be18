"""Descriptors, found by name."""

from .base import Descriptor as Descriptor
from .base import Pruner as Pruner
from .base import available as available
from .base import create as create
from .base import preset as preset
