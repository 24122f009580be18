"""Check the style of documents: purpose first, plain words, short sentences.

python docs/style.py README.md docs    # files and folders; exit status 1 if there is a fault
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

MAX_WORDS = 40
"""Longest sentence."""
RULES = {
    r"\bso (many|much|near) (?!as)": "give a number",
    r"\b(clouds?|segments?|scans?|maps?|queries) (say|ask|judge|doubt|know)s?\b": "data compute",
    r"\b(goes|going|went) on\b": "continue, resume",
    r"\bwhat (is|was|are|were) (made|asked|told|seen|said)\b": "name the thing",
    r"\b1 (segments|scans|queries|points|matches)\b": "1 segment",
    r"\b(since decision|as it was before|used to be|formerly) ": "history is the changelog's",
    r"\b(MB|GB|KB|ms|s|poses?|one|lines?|points?|bytes?|segments?) an? "
    r"(kilometre|scan|query|point|segment|second|line|day|session)\b": "per",
    r"\b(verdict|lacking|beyond doubt|mends?|rivals?|intruding)\b": "use the field's word",
}
CODE = re.compile(
    r"^```.*?^```|^ {4}.*?$|`[^`\n]*`|<!--.*?-->|\]\([^)]*\)|\$\$.*?\$\$", re.M | re.S
)
"""Not prose."""


def faults(path: Path) -> Iterator[str]:
    """Yield the faults of a page, one line each."""
    text = path.read_text("utf-8")
    if not re.match(r"# .+\n\n([\w\"`\[]|## Context)", text):
        yield f"{path}:1: no sentence below the title that says what the page is for"
    prose = CODE.sub(lambda code: re.sub(r"[^\n]", " ", code[0]), text)
    for number, line in enumerate(prose.splitlines(), 1):
        for pattern, remedy in RULES.items():
            if found := re.search(pattern, line):
                yield f"{path}:{number}: {found[0]!r}: {remedy}"
        for sentence in [] if line.startswith(("|", "#")) else re.split(r"(?<=[.:;?!]) ", line):
            words = re.findall(r"\w\S*", sentence)
            if len(words) > MAX_WORDS:
                yield f"{path}:{number}: a sentence of {len(words)} words: {' '.join(words[:6])}"


if __name__ == "__main__":
    given = [Path(name) for name in sys.argv[1:]]
    pages = [page for path in given for page in ([path] if path.is_file() else path.rglob("*.md"))]
    found = [fault for page in sorted(pages) for fault in faults(page)]
    print("\n".join(found) or f"{len(pages)} pages: no faults")
    sys.exit(bool(found))
