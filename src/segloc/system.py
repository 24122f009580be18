"""What machine this is, for reports."""

from __future__ import annotations

import platform
from pathlib import Path


def processor() -> str:
    """The processor in one line."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        lines = info.read_text("utf-8", "replace").splitlines()
        names = {line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")}
        model = ", ".join(sorted(names)) or model
    return model
