"""Draw prose of the source and the pages at random, and count words of the style before 0.3.0.

python -m segloc_lab.words --seed 2026 --count 40
python -m segloc_lab.words --against OTHER_TREE --report reports/VERSION-words
"""

from __future__ import annotations

import ast
import io
import json
import random
import re
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path

from .report import Table, publish, reporting

PATTERNS = ("said|says", "judged", "asked", "so (?:many|much|near)")
TREES = {
    "package and laboratory": ("src/segloc/**/*.py", "experiments/**/*.py", "lab/src/**/*.py"),
    "kernels": ("cpp/**/*.h", "cpp/**/*.cpp"),
    "pages": ("docs/**/*.md", "README.md", "CONTRIBUTING.md", "SECURITY.md"),
    "scripts of the pages": ("docs/**/*.py",),
    "tests": ("tests/**/*.py", "lab/tests/**/*.py"),
    "ROS 2": ("ros2/**/*.py", "ros2/**/*.md"),
}
"""Files in which words are counted; the laboratory of 0.2.0 is in experiments."""
Place = tuple[str, str, int, str]
"""Kind, file, line and text."""

_TOOL = re.compile(r"# ?(noqa|type:|pragma)")


def _files(*patterns: str, root: Path = Path()) -> list[Path]:
    return sorted(path for pattern in patterns for path in root.glob(pattern) if path.is_file())


def counts(root: Path, files: Iterable[str]) -> list[int]:
    """Count each of the ``PATTERNS`` in files below a folder; this module does not count."""
    paths = [path for path in _files(*files, root=root) if path.name != Path(__file__).name]
    text = "\n".join(path.read_text("utf-8") for path in paths)
    return [len(re.findall(rf"\b(?:{p})\b", text, re.IGNORECASE)) for p in PATTERNS]


def counted(root: Path, other: Path) -> Table:
    """Return the counts of two trees, folder by folder."""
    rows = [
        (name, *map("{}, {}".format, counts(other, files), counts(root, files)))
        for name, files in TREES.items()
    ]
    columns = (p.replace("(?:", "(").replace("|", " or ") for p in PATTERNS)
    return Table(("files", *columns), rows, "The count in the other tree, then the count now.")


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
    options = reporting(__doc__)
    options.add_argument("--against", type=Path, metavar="TREE", help="count beside another tree")
    options.add_argument("--seed", type=int, default=2026, help="random seed")
    options.add_argument("--count", type=int, default=40, help="places of code, and of pages")
    args = options.parse_args()
    if args.against is not None:
        publish(args.report, "Words of the style before 0.3.0", counted(Path(), args.against))
        return
    rng = random.Random(args.seed)
    parts = [sorted(set(code_places())), sorted(set(page_places()))]
    drawn = [sorted(rng.sample(part, args.count), key=lambda row: row[1:3]) for part in parts]
    found = dict(zip(PATTERNS, counts(Path(), ["src/segloc/**/*.py"]), strict=True))
    print(json.dumps({"counts": found, "places": drawn}, indent=1))


if __name__ == "__main__":
    main()
