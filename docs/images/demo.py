"""Keep the pictures of `segloc demo` for docs/tutorials/first-map.md and docs/how-to/debug.md.

python docs/images/demo.py        # writes demo.png and demo_errors.png beside itself
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from PIL.PngImagePlugin import PngInfo

from segloc.tools.cli.demo import demo

KEPT = {"trajectory.png": "demo.png", "errors.png": "demo_errors.png"}
KEY = "Description"
COLOURS, METHOD = 128, Image.Quantize.MAXCOVERAGE  # keeps the colours of few points


def keep(results: Path, out: Path) -> None:
    """Write the pictures of a results folder in few colours, with their description."""
    for drawn, name in KEPT.items():
        with Image.open(results / drawn) as image:
            info = PngInfo()
            if KEY in image.info:
                info.add_text(KEY, image.info[KEY])
            few = image.convert("RGB").quantize(COLOURS, METHOD, dither=Image.Dither.NONE)
            few.save(out / name, optimize=True, pnginfo=info)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        demo(Path(folder))
        keep(Path(folder) / "revisit", options.out)


if __name__ == "__main__":
    main()
