"""Describe the machine, for reports."""

from __future__ import annotations

import os
import platform
import re
from importlib import metadata
from pathlib import Path

_DEVELOPMENT = re.compile(r"extra == ['\"](dev|fuzz|test|test-tools)['\"]")


def processor() -> str:
    """Return the processor in one line."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        lines = info.read_text("utf-8", "replace").splitlines()
        names = {line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")}
        model = ", ".join(sorted(names)) or model
    return model


def versions() -> list[str]:
    """Return lines for a bug report: Python, the machine, and installed packages."""
    from ..._native import instruction_set

    python = f"{platform.python_implementation()} {platform.python_version()}"
    return [
        f"{python}, {platform.platform()}",
        f"{processor()}, {os.cpu_count()} cores, {instruction_set()}",
        *(f"{name} {version}" for name, version in sorted(_package_versions().items())),
    ]


def _package_versions() -> dict[str, str]:
    """Return the versions of installed packages that segloc needs or can use."""
    found = {}
    for requirement in metadata.requires("segloc") or []:
        if _DEVELOPMENT.search(requirement):
            continue
        name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    found.pop("segloc", None)  # its own extras
    return found
