"""Settings and fixtures of all tests."""

from __future__ import annotations

import os

from hypothesis import settings
from samples.fixtures import kitti as kitti
from samples.fixtures import localizer as localizer
from samples.fixtures import plaza as plaza
from samples.fixtures import plaza_map as plaza_map
from samples.marks import pytest_collection_modifyitems as pytest_collection_modifyitems
from samples.marks import pytest_ignore_collect as pytest_ignore_collect

# No deadlines: the time of an example depends on the machine more than on the code.
settings.register_profile("usual", deadline=None)
settings.register_profile("sanitized", deadline=None, max_examples=20)  # several times slower
settings.load_profile("sanitized" if "SEGLOC_NATIVE" in os.environ else "usual")
