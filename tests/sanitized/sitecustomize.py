"""A process that finds this file on its path takes the native module from ``SEGLOC_NATIVE``.

So every test, and every process that a test starts, runs a build with sanitizers in the place of
the installed one.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from importlib.machinery import ModuleSpec


class _OtherBuild:
    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if name != "segloc._native":
            return None
        return importlib.util.spec_from_file_location(name, os.environ["SEGLOC_NATIVE"])


if "SEGLOC_NATIVE" in os.environ:
    sys.meta_path.insert(0, _OtherBuild)  # type: ignore[arg-type]
