"""Draw `segloc view` with a query of the sample: on a screen and a phone, light and dark.

PYTHONPATH=tests python docs/images/view.py   # writes view*.png beside itself; needs the extra view
                                              # and a Chromium
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from samples.browser import Page, browser

from segloc import Config, Localizer, build_map, sample
from segloc.frontend.local_cloud import Accumulator
from segloc.map.segment_map import SegmentMap
from segloc.tools.batch.report import sentence
from segloc.tools.cli.sample import TUESDAY_STEP
from segloc.tools.inspect import trace, viewer
from segloc.tools.inspect.results import Shown, stages_of

QUERY = 18
COLOURS = 128
SCREEN, PHONE = (1280, 720), (390, 720)
PICTURES = {
    "view.png": (SCREEN, "light"),
    "view_dark.png": (SCREEN, "dark"),
    "view_phone.png": (PHONE, "light"),
    "view_phone_dark.png": (PHONE, "dark"),
}
"""Size of the page and theme of the reader by file."""
SETTLE_S, DRAWN_S = 170.0, 25.0  # of a busy processor without a GPU
_CLOSE_NOTICES = "document.querySelectorAll('.mantine-Notification-closeButton')"
_CHOOSE = """(() => {
  const field = document.querySelector("input[inputmode=numeric], input[type=text]");
  const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
  field.focus();
  set.call(field, "%d");
  field.dispatchEvent(new Event("input", { bubbles: true }));
  field.blur();
})()"""


def answered() -> tuple[SegmentMap, list[Shown]]:
    """A map of the sample's Monday, and how each scan of its Tuesday is found in it."""
    monday, tuesday = sample.load("monday"), sample.load("tuesday")
    config = Config.preset("profile").model_copy(update={"threads": 1})
    localizer = Localizer(build_map(monday, config), config)
    clouds = Accumulator(config.local_cloud)
    shown = []
    for i in range(0, len(tuesday), TUESDAY_STEP):
        found = trace(localizer, clouds.gather(tuesday.scan(i)), f"scan {i}")
        result = found.result
        T = result.T_map_sensor if result.localized else None
        outcome = "localized" if result.localized else "refused"
        shown.append(Shown(i, outcome, sentence(result), T, stages_of(found)))
    return localizer.prior_map, shown


def picture(page: Page, address: str, query: int, size: tuple[int, int], theme: str) -> bytes:
    """What the browser shows of a query, once it is drawn."""
    screen = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
    page.do("Emulation.setDeviceMetricsOverride", **screen)
    preference = {"name": "prefers-color-scheme", "value": theme}
    page.do("Emulation.setEmulatedMedia", features=[preference])
    page.open(address)
    page.until(r"/\d: (localized|refused)/.test(document.body.innerText)", SETTLE_S)
    page.value(_CHOOSE % query)
    if not page.until(f"document.body.innerText.includes('{query}: ')", SETTLE_S):
        raise SystemExit(f"query {query} is not shown")
    page.wait(DRAWN_S)
    page.value(f"{_CLOSE_NOTICES}.forEach((button) => button.click())")
    page.wait(1.0)
    if page.faults:
        raise SystemExit(f"the page has faults: {page.faults}")
    return page.picture()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    options = parser.parse_args()
    server = viewer.serve(*answered(), 0)
    address = f"http://localhost:{server.get_port()}"  # the theme is in it: the page would reload
    try:
        for name, (size, theme) in PICTURES.items():
            with TemporaryDirectory() as profile, browser(Path(profile)) as page:
                page_of = f"{address}?darkMode" if theme == "dark" else address
                drawn = picture(page, page_of, QUERY, size, theme)
            with Image.open(io.BytesIO(drawn)) as image:  # few colours keep it small
                few = image.convert("RGB").quantize(
                    COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE
                )  # other methods turn the small swatches on a dark page into its larger colours
                few.save(options.out / name, optimize=True)
    finally:
        server.stop()


if __name__ == "__main__":
    main()
