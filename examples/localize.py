"""Map one drive, find single scans of another in it: the whole of segloc in a page.

python examples/localize.py
"""

from __future__ import annotations

from segloc_lab.simulation import Conditions, hdl64e, simulate_sessions, town

from segloc import Config, Localizer, build_map


def main() -> None:
    # Two drives through one town; on the second, other cars are parked and a tenth of the things
    # are others. With recordings of your own: segloc.tools.datasets.open_sequence(path, poses).
    first, second = simulate_sessions(
        town(7, size_m=150.0), hdl64e(600), [Conditions(), Conditions(replaced=0.1)], length_m=80.0
    )
    config = Config.preset("profile")
    prior_map = build_map(first, config)
    prior_map.save("site.segmap")
    print(f"site.segmap: {len(prior_map)} segments")

    localizer = Localizer(prior_map, config)
    for i in range(0, len(second), 5):
        result = localizer.localize(second.scan(i))
        if result.T_map_sensor is None:
            print(f"scan {i}: not localized: {result.reason}")
            continue
        x, y, z = result.T_map_sensor[:3, 3]
        print(f"scan {i}: x {x:.2f} y {y:.2f} z {z:.2f}, confidence {result.confidence:.3f}")


if __name__ == "__main__":
    main()
