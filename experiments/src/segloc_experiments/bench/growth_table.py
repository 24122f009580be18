"""Time and memory against the size of the map and of the query: ``python bench_growth.py``."""

from segloc.system import processor

from .growth import growth
from .harness import in_process

MAPS = (1_000, 10_000, 100_000, 1_000_000)
QUERIES = (30, 300, 3_000)

if __name__ == "__main__":
    print(f"{processor()}, one thread")
    print(f"{'map':>10} {'query':>6} {'matching':>12} {'pose':>12} {'map':>10}  pose found")
    for segments in MAPS:
        for queries in QUERIES:
            g = in_process(1, growth, segments, queries)
            print(
                f"{g.segments:>10} {g.queries:>6} {g.matching_ms:>9.1f} ms {g.pose_ms:>9.1f} ms "
                f"{g.map_mb:>7.1f} MB  {'yes' if g.found else 'no'}",
                flush=True,
            )
