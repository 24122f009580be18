"""Write the address of the repository, and the badges of the README.

python packaging/address.py https://HOST/OWNER/segloc

The address in pyproject.toml is replaced in every file that git tracks.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BADGES = "<!-- badges: packaging/address.py -->"


def address(root: Path) -> str:
    """Return the address in pyproject.toml."""
    text = (root / "pyproject.toml").read_text("utf-8")
    found = re.search(r'^Repository = "([^"]+)"$', text, re.MULTILINE)
    if found is None:
        raise SystemExit("pyproject.toml: no Repository in [project.urls]")
    return found[1]


def badges(url: str) -> str:
    """Return the badges: version on PyPI, Python versions, licence."""
    shields, package = "https://img.shields.io/pypi", "https://pypi.org/project/segloc"
    links = {
        f"[![PyPI]({shields}/v/segloc)]": package,
        f"[![Python]({shields}/pyversions/segloc)]": package,
        f"[![Licence]({shields}/l/segloc)]": f"{url}/blob/main/LICENSE",
    }
    return BADGES + "\n" + " ".join(f"{image}({target})" for image, target in links.items())


def replace(root: Path, files: list[Path], new: str) -> None:
    """Replace the address in the files, and the badges in the README."""
    old = address(root)
    for path in files:
        text = path.read_bytes()
        if old.encode() in text:
            path.write_bytes(text.replace(old.encode(), new.encode()))
    readme = root / "README.md"
    text = readme.read_text("utf-8")
    readme.write_text(re.sub(rf"{re.escape(BADGES)}(\n\[!.*)?", badges(new), text), "utf-8")


def main() -> None:
    if len(sys.argv) != 2 or not sys.argv[1].startswith("https://"):
        raise SystemExit("usage: python packaging/address.py https://HOST/OWNER/segloc")
    tracked = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.split("\0")
    replace(ROOT, [ROOT / name for name in tracked if name], sys.argv[1].rstrip("/"))


if __name__ == "__main__":
    main()
