"""Print the lowest versions that pyproject.toml allows, as constraints for pip.

python .ci/lowest.py [EXTRA...] > lowest.txt: of the dependencies and these extras, which may be
joined by commas.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    from pip._vendor import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
REQUIREMENT = re.compile(r"([\w.-]+)(?:\[([\w.,-]+)\])?\s*>=\s*([\w.]+)(?:,<[\w.]+)?")


def lowest(extras: list[str]) -> dict[str, str]:
    """Each package's lowest version, by its name; an error where a requirement names none."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    wanted, seen, found = list(project["dependencies"]), set(), {}
    waiting = list(extras)
    while waiting or wanted:
        if not wanted:
            extra = waiting.pop()
            if extra and extra not in seen:
                wanted += project["optional-dependencies"][extra]
                seen.add(extra)
            continue
        requirement = wanted.pop()
        if own := re.fullmatch(rf"{project['name']}\[([\w,-]+)\]", requirement):
            waiting += own[1].split(",")
        elif match := REQUIREMENT.fullmatch(requirement):
            found[match[1]] = match[3]
        else:
            raise SystemExit(f"pyproject.toml: {requirement!r} names no lowest version")
    return found


if __name__ == "__main__":
    for name, version in sorted(lowest(",".join(sys.argv[1:]).split(",")).items()):
        print(f"{name}=={version}")
