"""Datasets of several surroundings in one small file, to be trained on where segloc is not built.

    python -m segloc_lab.studies.feature_quality.compact OUT DOMAIN=TRAIN:TEST ... kitti00=:TEST

A domain's folders are datasets of :func:`segloc_lab.studies.paper.domain_segments.simulated`. One
that is tested on alone has no first folder. Of a segment up to 320 points are kept, in the order of
farthest-point sampling and to the centimetre.
"""

from __future__ import annotations

import io
import lzma
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

POINTS = 320
_STEP_M = 0.01
_LARGEST = 32_767
_SQUARE_M = 40.0
_COLUMNS = ("labels", "sessions", "places", "held", "centroids")
FAR_M = 20.0
"""Beyond this distance segments surely show different objects."""

_PRESET = 6


@dataclass(frozen=True)
class Segments:
    """P labelled segments of one split of one domain.

    Attributes
    ----------
    points : (M, 3) int16
        About the centroid, centimetres.
    offsets : (P + 1,) int64
    labels, sessions, places : (P,) int64
        The object, the recording, and the world.
    held : (P,) bool
        Of worlds that are kept from training.
    centroids : (P, 3) float64
        In the frame of the world, metres.
    first, second : (N,) int64
        Pairs to be told apart; empty for a training split.
    same : (N,) bool
        Whether their centroids lie within 0.5 m; the others lie 20 m apart or more.
    """

    points: NDArray[np.int16]
    offsets: NDArray[np.int64]
    labels: NDArray[np.int64]
    sessions: NDArray[np.int64]
    places: NDArray[np.int64]
    held: NDArray[np.bool_]
    centroids: NDArray[np.float64]
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    same: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.labels)

    def squares(self) -> NDArray[np.int64]:
        """(P,) the square of 40 m that each lies in: what a bootstrap draws."""
        at = np.floor(self.centroids[:, :2] / _SQUARE_M)
        keys = np.column_stack([self.places, at])
        _, number = np.unique(keys, axis=0, return_inverse=True)
        result: NDArray[np.int64] = number.reshape(-1)
        return result

    def different(self, a: NDArray[np.integer], b: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Whether segments (broadcast) surely show different objects."""
        apart = np.linalg.norm(self.centroids[a] - self.centroids[b], axis=-1) > FAR_M
        result: NDArray[np.bool_] = (self.labels[a] != self.labels[b]) & (
            apart | (self.places[a] != self.places[b])
        )
        return result

    def only(self, rows: NDArray[np.bool_]) -> Segments:
        """Some segments, without the points and the pairs of all."""
        columns = {name: getattr(self, name)[rows] for name in _COLUMNS}
        return replace(self, points=self.points[:0], offsets=self.offsets[:0], **columns)

    def padded(self) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """(P, 320, 3) points in metres, zeros behind the last, and how many each has, (P,)."""
        sizes = np.diff(self.offsets)
        result = np.zeros((len(self), POINTS, 3), np.float32)
        rows = np.repeat(np.arange(len(self)), sizes)
        columns = np.arange(len(self.points)) - np.repeat(self.offsets[:-1], sizes)
        result[rows, columns] = self.points * np.float32(_STEP_M)
        return result, sizes


def write(path: Path, splits: dict[str, Segments]) -> None:
    """Write splits, named ``domain-train`` and ``domain-test``, to one file."""
    arrays = {}
    for name, split in splits.items():
        for field in fields(Segments):
            array = getattr(split, field.name)
            if field.name == "points":  # high and low bytes by axis compress better
                array = np.ascontiguousarray(array.T).view(np.uint8).reshape(3, -1, 2)
                array = np.ascontiguousarray(array.transpose(2, 0, 1))
            arrays[f"{name}/{field.name}"] = array
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    path.write_bytes(lzma.compress(stream.getvalue(), preset=_PRESET))


def read(path: Path) -> dict[str, Segments]:
    """The splits of a file that :func:`write` wrote."""
    with np.load(io.BytesIO(lzma.decompress(path.read_bytes())), allow_pickle=False) as file:
        names = dict.fromkeys(key.partition("/")[0] for key in file.files)
        found = {}
        for name in names:
            arrays = {field.name: file[f"{name}/{field.name}"] for field in fields(Segments)}
            planes = np.ascontiguousarray(arrays["points"].transpose(1, 2, 0))
            arrays["points"] = np.ascontiguousarray(planes.view(np.int16)[..., 0].T)
            found[name] = Segments(**arrays)
    return found


def main() -> None:
    from ...script import parser
    from .collect import compacted

    options = parser(__doc__)
    options.add_argument("out", type=Path)
    options.add_argument("domains", nargs="+", metavar="DOMAIN=TRAIN:TEST")
    options.add_argument("--most", type=int, default=8000, help="segments of a split")
    options.add_argument("--pairs", type=int, default=10_000, help="of each kind, of a test split")
    given = options.parse_args()
    splits = {}
    for domain in given.domains:
        name, _, folders = domain.partition("=")
        for split, folder in zip(("train", "test"), folders.split(":"), strict=True):
            if folder:
                key = f"{name}-{split}"
                splits[key] = compacted(Path(folder), split, given.most, given.pairs)
                print(f"{key}: {len(splits[key])} segments, {len(splits[key].first)} pairs")
    write(given.out, splits)
    print(f"{given.out}: {given.out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
