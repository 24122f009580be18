"""Draw prose of the source and the pages at random, and count words of the style before 0.3.0.

python -m segloc_lab.words --seed 2026 --count 40
"""

from __future__ import annotations

import ast
import io
import json
import random
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

from .report import parser

PATTERNS = ("said|says", "judged", "asked", "so (?:many|much|near)")
Place = tuple[str, str, int, str]
"""Kind, file, line and text."""

_TOOL = re.compile(r"# ?(noqa|type:|pragma)")


def _files(*patterns: str) -> list[Path]:
    return sorted(path for pattern in patterns for path in Path().glob(pattern))


def _texts(path: Path, tree: ast.Module) -> Iterator[Place]:
    """Yield docstrings, names of functions and classes, and messages."""
    docstrings: set[int] = set()
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for part in body if isinstance(body, list) else []:
            inner = part.value if isinstance(part, ast.Expr) else None
            if isinstance(inner, ast.Constant) and isinstance(inner.value, str):
                docstrings.add(id(inner))
                yield "docstring", str(path), part.lineno, " ".join(inner.value.split())
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield "name", str(path), node.lineno, node.name
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and id(node) not in docstrings:
            text = node.value if isinstance(node.value, str) else ""
            if text.count(" ") >= 3:
                yield "message", str(path), node.lineno, " ".join(text.split())


def _comments(path: Path, text: str) -> Iterator[Place]:
    """Yield comments; consecutive lines are one."""
    block: list[tuple[int, str]] = []
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type != tokenize.COMMENT or _TOOL.match(token.string):
            continue
        line = token.start[0]
        if block and line != block[-1][0] + 1:
            yield "comment", str(path), block[0][0], " ".join(part for _, part in block)
            block = []
        block.append((line, token.string.lstrip("# ")))
    if block:
        yield "comment", str(path), block[0][0], " ".join(part for _, part in block)


def code_places() -> Iterator[Place]:
    """Yield the prose of the product's and the laboratory's modules."""
    for path in _files("src/segloc/**/*.py", "lab/src/**/*.py"):
        text = path.read_text("utf-8")
        yield from _texts(path, ast.parse(text))
        yield from _comments(path, text)


def page_places() -> Iterator[Place]:
    """Yield the sentences of the pages, without blocks of code."""
    for path in _files("README.md", "docs/**/*.md", "CONTRIBUTING.md", "SECURITY.md"):
        code = False
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
            code ^= line.startswith("```")
            if not code and not line.startswith("<") and re.search(r"[a-z]{3}", line):
                for sentence in re.split(r"(?<=[.!?]) +", line.strip()):
                    if sentence.count(" ") >= 3:
                        yield "page", str(path), number, sentence


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--seed", type=int, default=2026, help="random seed")
    options.add_argument("--count", type=int, default=40, help="places of code, and of pages")
    args = options.parse_args()
    rng = random.Random(args.seed)
    parts = [sorted(set(code_places())), sorted(set(page_places()))]
    drawn = [sorted(rng.sample(part, args.count), key=lambda row: row[1:3]) for part in parts]
    text = "\n".join(path.read_text("utf-8") for path in _files("src/segloc/**/*.py"))
    counts = {p: len(re.findall(rf"\b(?:{p})\b", text, re.IGNORECASE)) for p in PATTERNS}
    print(json.dumps({"counts": counts, "places": drawn}, indent=1))


if __name__ == "__main__":
    main()
